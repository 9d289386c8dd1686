// Jobs as rows on one time axis: what each waits for, how likely its deadline is, when it ends, what it costs.

import { useState } from "preact/hooks";
import type { DashboardJob } from "../../api/types";
import { neverEnds } from "../../state/news";
import { maySubmitTo } from "../../state/session";
import { href, param, setQuery } from "../../state/route";
import { AxisHead, Fan, slackWords, type Spread, spreadWords } from "../../ui/fan";
import { clean, grouped, maybeInstant, money, percent, told, zoneAt } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { Prose, Time } from "../../ui/parts";
import { LongTableBehind, VirtualRows } from "../../ui/virtual";
import type { Axis } from "../../ui/time-axis";
import { RescueDialog } from "./rescue";

/** The ends of a job, as far as they are known. */
export function spreadOf(job: DashboardJob): Spread {
  const finish = job.finish;
  const p95 = maybeInstant(finish?.p95);
  // A plan that breaks a promise is newer than the scenarios, if they do not show that.
  const broken = job.promise && !job.promise.kept ? maybeInstant(job.promise.finish) : null;
  if (broken !== null && (p95 === null || broken > p95)) return { p50: broken, p80: broken, p95: broken };
  return { p50: maybeInstant(finish?.p50 ?? job.eta), p80: maybeInstant(finish?.p80), p95 };
}

/** `risk`: a plan kept the deadline and the newest one does not. `late`, `impossible`: no plan ever did. */
export function troubleOf(job: DashboardJob): "risk" | "late" | "impossible" | null {
  if (job.promise) return job.promise.kept ? null : "risk";
  return job.verdict === "late" || job.verdict === "impossible" ? job.verdict : null;
}

function probabilityOf(job: DashboardJob): number | null {
  return neverEnds(job.state) ? null : (job.probability ?? job.promise?.probability ?? null);
}

export function JobTable(props: {
  jobs: readonly DashboardJob[];
  axis: Axis;
  narrow: boolean;
  seen: (first: number, last: number) => void;
  label: string;
}) {
  const { axis, narrow } = props;
  return (
    <div role="table" aria-label={props.label} aria-rowcount={props.jobs.length + 1} class="jobs">
      <div role="rowgroup">
        <div role="row" class="job-row job-head">
          <span role="columnheader">State</span>
          <span role="columnheader">Job</span>
          <span role="columnheader" class="right">
            In time
          </span>
          <span role="columnheader" class="right">
            Ready by
          </span>
          <span role="columnheader">
            <span class="unseen">Spread of the end, on a time axis</span>
            <AxisHead axis={axis} />
          </span>
          <span role="columnheader" class="right">
            Cost
          </span>
        </div>
      </div>
      <VirtualRows
        role="rowgroup"
        items={props.jobs}
        height={narrow ? 108 : 48}
        row={(job) => <JobRow job={job} axis={axis} />}
        keyOf={(job) => job.id}
        seen={props.seen}
      />
    </div>
  );
}

function JobRow(props: { job: DashboardJob; axis: Axis }) {
  const { job, axis } = props;
  const spread = spreadOf(job);
  const deadline = maybeInstant(job.deadline);
  const trouble = troubleOf(job);
  const chance = probabilityOf(job);
  const end = spread.p80 ?? spread.p50;
  return (
    <div role="row" class="job-row">
      <span role="cell" class="cell-state">
        <Mark of={trouble ?? (job.paused ? "paused" : job.state)} />
      </span>
      <span role="cell" class="cell-name">
        <a href={linkOf(job)} class="name" title={clean(job.name)}>
          {clean(job.name)}
        </a>
        <span class="under" title={job.waits ? told(job.waits.because) : undefined}>
          {under(job)}
        </span>
      </span>
      <span role="cell" class="cell-chance right">
        {deadline === null ? (
          <span class="none">no deadline</span>
        ) : (
          <span class="number chance">{chance === null ? "–" : percent(chance)}</span>
        )}
      </span>
      <span role="cell" class="cell-end right">
        <span class="number">
          <Time at={end} none="not known yet" />
        </span>
        <span class="under">
          {job.state === "quoted" && end !== null
            ? "if accepted now"
            : neverEnds(job.state)
              ? job.state
              : slackWords(end, deadline)}
        </span>
      </span>
      <span role="cell" class="cell-fan">
        <Fan
          axis={axis}
          spread={spread}
          deadline={deadline}
          late={trouble !== null}
          label={spreadLabel(spread, deadline)}
        />
      </span>
      <span role="cell" class="cell-cost right">
        <Cost job={job} />
      </span>
    </div>
  );
}

function spreadLabel(spread: Spread, deadline: number | null): string {
  const words = spreadWords(spread);
  return deadline === null
    ? words
    : `${words}; deadline ${new Date(deadline).toLocaleString("en-GB")} ${zoneAt(deadline)}`;
}

/** A quote that nobody has accepted yet is on the screen where that is done. */
function linkOf(job: DashboardJob): string {
  return job.state === "quoted" ? href(["submit"], { job: job.id }) : href(["jobs", job.id]);
}

function under(job: DashboardJob): string {
  const parts = [clean(job.project)];
  if (job.state === "quoted") parts.push("its quote waits to be accepted");
  else if (job.waits) parts.push(told(job.waits.because));
  else parts.push(`${grouped(job.frames_done)} of ${grouped(job.frames_total)} frames`);
  return parts.join(" · ");
}

/** What it has cost and will cost, against its budget. */
function Cost(props: { job: DashboardJob }) {
  const { job } = props;
  const expected = job.cost?.p80 ?? job.booked_cost ?? null;
  const over = job.budget != null && expected !== null && expected > job.budget;
  return (
    <>
      <span class={over ? "number over" : "number"}>{expected === null ? "–" : money(expected)}</span>
      <span class="under">
        {job.budget == null ? "no budget" : `${over ? "over its" : "of"} ${money(job.budget)}`}
      </span>
    </>
  );
}

/** The numbers of the fans. */
export function Ends(props: { jobs: readonly DashboardJob[]; label: string }) {
  return (
    <LongTableBehind
      label={props.label}
      head={["Job", "P50", "P80", "P95", "Deadline"]}
      count={props.jobs.length}
      row={(at) => {
        const job = props.jobs[at]!;
        const spread = spreadOf(job);
        return [
          clean(job.name),
          <Time at={spread.p50} />,
          <Time at={spread.p80} />,
          <Time at={spread.p95} />,
          <Time at={job.deadline} />,
        ];
      }}
    />
  );
}

/** The first ones are shown with all their words. */
const FIRST = 8;

/** The promises at risk: each with its cheapest rescue. */
export function Risks(props: { jobs: readonly DashboardJob[]; axis: Axis; narrow: boolean }) {
  const { jobs, axis } = props;
  const [open, setOpen] = useState<string | null>(null);
  const isLong = param("risks") === "all" && jobs.length > FIRST;
  const chosen = jobs.find((job) => job.id === open);
  const risk = (job: DashboardJob) => <Risk job={job} axis={axis} open={() => setOpen(job.id)} />;
  return (
    <>
      {isLong ? (
        <div class="risks long-risks" role="list">
          <VirtualRows items={jobs} height={props.narrow ? 240 : 104} row={risk} />
        </div>
      ) : (
        <div class="risks" role="list">
          {jobs.slice(0, FIRST).map((job) => (
            <div key={job.id} role="presentation">
              {risk(job)}
            </div>
          ))}
        </div>
      )}
      {jobs.length > FIRST && (
        <button type="button" class="plain" onClick={() => setQuery({ risks: isLong ? null : "all" })}>
          {isLong ? `Show the first ${FIRST}` : `Show all ${jobs.length}`}
        </button>
      )}
      <Ends jobs={jobs} label="Promises at risk and late jobs, as a table" />
      {chosen && (
        <RescueDialog
          jobId={chosen.id}
          name={chosen.name}
          rescue={chosen.promise?.rescue ?? null}
          close={() => setOpen(null)}
        />
      )}
    </>
  );
}

function Risk(props: { job: DashboardJob; axis: Axis; open: () => void }) {
  const { job, axis } = props;
  const spread = spreadOf(job);
  const deadline = maybeInstant(job.deadline);
  const chance = probabilityOf(job);
  const end = spread.p80 ?? spread.p50;
  const rescue = job.promise?.rescue;
  return (
    <div role="listitem" class="risk">
      <div class="risk-line">
        <Mark of={troubleOf(job) ?? "risk"} />
        <a class="name" href={href(["jobs", job.id])}>
          {clean(job.name)}
        </a>
        <span class="muted">{clean(job.project)}</span>
        <span class="risk-facts number">
          {chance !== null && <>in time with {percent(chance)} · </>}
          ready by <Time at={end} none="no known time" />
          {deadline !== null && (
            <>
              , deadline <Time at={deadline} />
              {end !== null && end > deadline && <> ({slackWords(end, deadline)})</>}
            </>
          )}
        </span>
      </div>
      <Fan axis={axis} spread={spread} deadline={deadline} late label={spreadLabel(spread, deadline)} />
      <div class="risk-line">
        {rescue && (
          <span class="risk-rescue" title={told(rescue.words)}>
            Cheapest rescue: <Prose text={rescue.words} bare />.
          </span>
        )}
        {maySubmitTo(job.project) ? (
          <button type="button" class="primary" onClick={props.open}>
            {rescue ? "Look at the rescue…" : "Look for a way out…"}
          </button>
        ) : (
          <a href={href(["jobs", job.id], { tab: "price" })}>Why, and what would help</a>
        )}
      </div>
    </div>
  );
}
