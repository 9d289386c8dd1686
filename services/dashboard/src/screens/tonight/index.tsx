// Tonight, the first screen: will everything be ready, what does it cost, and what is to be done now.

import { useEffect, useMemo } from "preact/hooks";
import type { Farm, DashboardJob } from "../../api/types";
import { failed, failedAhead } from "../../state/failed";
import { atRisk, farm, farmError, openAtRisk, refresh } from "../../state/farm";
import { now } from "../../state/now";
import { href, param, setQuery } from "../../state/route";
import { seesAll } from "../../state/session";
import { titled } from "../../state/tab";
import { AxisHead, Fan, spreadWords } from "../../ui/fan";
import { clockTime, counted, grouped, maybeInstant, money } from "../../ui/format";
import { Choice, Section, TableBehind, Time, Trouble, Waiting } from "../../ui/parts";
import { useWidth } from "../../ui/resource";
import { axisFor } from "../../ui/time-axis";
import { Events } from "./events";
import { FirstSteps } from "./first-steps";
import { Ends, JobTable, Risks, spreadOf, troubleOf } from "./jobs";
import { type Listed, type Shown, SHOWN, type Sort, SORTS, useListed } from "./listed";
import { Spend } from "./spend";

export function Tonight() {
  useEffect(() => titled("Tonight"), []);
  const doc = farm.value;
  if (!doc) {
    return farmError.value ? (
      <Trouble error={farmError.value} retry={() => void refresh()} />
    ) : (
      <Waiting>Asking the service how the farm stands…</Waiting>
    );
  }
  const empty = doc.jobs_open_total === 0 && !Object.values(doc.counts.jobs).some((count) => count > 0);
  return (
    <div class="tonight">
      <h1 class="unseen">Tonight</h1>
      {empty ? <p class="summary">The farm is empty: it has no jobs.</p> : <Summary doc={doc} />}
      {empty ? <FirstSteps farm={doc} /> : <Jobs doc={doc} />}
      <div class="side">
        {!empty && seesAll.value && <Spend version={Math.floor(now.value / 900_000)} />}
        <Events />
      </div>
    </div>
  );
}

/** The farm in one glance, in words. */
function Summary(props: { doc: Farm }) {
  const { doc } = props;
  const risks = openAtRisk.value;
  const late = doc.jobs.filter((job) => !job.promise && troubleOf(job) !== null).length;
  const p80 = maybeInstant(doc.finish?.p80);
  const p95 = maybeInstant(doc.finish?.p95);
  const nodes = doc.node_counts;
  const trouble = nodes.silent + nodes.set_aside;
  // Open jobs without an expected end: those that are being quoted, those that the plan has no place for, and
  // those for which a budget has to be raised first.
  const { previewing, profiling } = doc.counts.jobs;
  const unplaced = doc.jobs.filter(({ state, eta }) => (state === "booked" || state === "rendering") && !eta);
  const without = previewing + profiling + unplaced.length;
  const spent = doc.spending.reduce((sum, line) => sum + line.tonight, 0);
  return (
    <p class="summary">
      {risks > 0 ? (
        <strong class="tone-bad">
          <span aria-hidden="true">⚠ </span>
          {counted(risks, "promise")} at risk.{" "}
        </strong>
      ) : (
        atRisk.value === 0 && <strong>No promise is at risk. </strong>
      )}
      <Failed />
      {late > 0 && <strong class="tone-warn">{counted(late, "job")} late in every plan. </strong>}
      {counted(doc.jobs_open_total, "job")} open
      {p80 !== null && (
        <>
          ; {without > 0 ? "the others are" : "all"} ready by <Time at={p80} /> at P80
          {p95 !== null && <>, by {clockTime(p95)} at P95</>}
        </>
      )}
      {without > 0 && `; ${grouped(without)} without an expected end`}.{" "}
      {doc.counts.jobs.quoted > 0 && (
        <>{counted(doc.counts.jobs.quoted, "quote waits", "quotes wait")} to be accepted. </>
      )}
      {grouped(nodes.working)} of {counted(doc.counts.nodes, "node")} working
      {trouble > 0 && <strong class="tone-warn">, {grouped(trouble)} silent or set aside</strong>}. Spent
      tonight: <span class="number">{money(spent)}</span>.
    </p>
  );
}

/** How many jobs failed, and for how many of them there is still time. */
function Failed() {
  const count = failed.value.length;
  const ahead = failedAhead.value.length;
  if (count === 0) return null;
  return (
    <>
      <a class="tone-bad" href={href(["tonight"], { show: "failed" })}>
        <strong>
          <span aria-hidden="true">✕ </span>
          {counted(count, "job")} failed
          {ahead > 0 && `, ${ahead === count ? "" : `${grouped(ahead)} `}before the deadline`}.
        </strong>
      </a>{" "}
    </>
  );
}

function Jobs(props: { doc: Farm }) {
  const { doc } = props;
  const shown = SHOWN.find(([value]) => value === param("show"))?.[0] ?? "open";
  const sort = SORTS.find(([value]) => value === param("sort"))?.[0] ?? "risk";
  const search = param("search") ?? "";
  const [box, width] = useWidth<HTMLDivElement>();
  const listed = useListed(doc, shown, sort, search);
  const { risks } = listed;

  const axis = useMemo(() => axisOf(doc.jobs, now.value, 0.92), [doc.jobs, now.value]);
  return (
    <div class="main" ref={box}>
      <Finish of={doc.finish} />
      {risks.length > 0 && (
        <Section title={`At risk or late: ${shownOf(risks.length, openAtRisk.value)}`}>
          <Risks jobs={risks} axis={axisOf(risks, now.value)} narrow={width < 720} />
        </Section>
      )}
      <Section title="Jobs" aside={<Filters shown={shown} sort={sort} search={search} />}>
        {listed.error && <Trouble error={listed.error} retry={listed.again} />}
        {listed.jobs.length === 0 ? (
          listed.loading ? (
            <Waiting>Asking for jobs…</Waiting>
          ) : (
            <p class="note">{none(shown, search, risks.length > 0)}</p>
          )
        ) : (
          <JobTable
            jobs={listed.jobs}
            axis={axis}
            narrow={width < 720}
            seen={listed.see}
            label={`${shown} jobs`}
          />
        )}
        {listed.jobs.length > 0 && (
          <p class="note">
            {listed.loading ? "Asking for more jobs…" : `${shownWords(listed.jobs.length, listed.others)}.`}{" "}
            The bar runs from P50 to P95, dark to P80; the line is the deadline. Times are yours: see the
            clock above.
          </p>
        )}
        <Ends jobs={listed.jobs} label="Ends and deadlines, as a table" />
      </Section>
    </div>
  );
}

/** When all open jobs are ready. */
function Finish(props: { of: Farm["finish"] }) {
  const finish = {
    p50: maybeInstant(props.of?.p50),
    p80: maybeInstant(props.of?.p80),
    p95: maybeInstant(props.of?.p95),
  };
  if (finish.p50 === null) return null;
  const axis = axisFor(now.value, [finish.p95 ?? finish.p80 ?? finish.p50]);
  return (
    <div class="farm-finish">
      <h2>The farm finishes</h2>
      <span class="number">{spreadWords(finish)}</span>
      <div class="farm-axis">
        <AxisHead axis={axis} />
        <Fan axis={axis} spread={finish} deadline={null} label={`All open jobs: ${spreadWords(finish)}`} />
      </div>
      <TableBehind
        label="When the farm finishes, as a table"
        head={["Confidence", "All open jobs ready by"]}
        rows={() =>
          (["p50", "p80", "p95"] as const).map((level) => [
            level.toUpperCase(),
            <Time at={finish[level]} exact />,
          ])
        }
      />
    </div>
  );
}

function Filters(props: { shown: Shown; sort: Sort; search: string }) {
  return (
    <div class="filters">
      <Choice
        label="Which jobs"
        value={props.shown}
        options={SHOWN}
        choose={(value) => setQuery({ show: value === "open" ? null : value })}
      />
      <label>
        Sort{" "}
        <select value={props.sort} onChange={(event) => setQuery({ sort: event.currentTarget.value })}>
          {SORTS.map(([value, word]) => (
            <option value={value} key={value}>
              {word}
            </option>
          ))}
        </select>
      </label>
      <label>
        Search{" "}
        <input
          type="search"
          id="search"
          value={props.search}
          placeholder="name or project"
          onInput={(event) => setQuery({ search: event.currentTarget.value })}
        />
      </label>
    </div>
  );
}

function axisOf(jobs: readonly DashboardJob[], from: number, share?: number) {
  const ends = jobs.map(spreadOf).map((spread) => spread.p95 ?? spread.p80 ?? spread.p50);
  const deadlines = jobs.map((job) => maybeInstant(job.deadline));
  const known = (at: number | null) => at !== null;
  return axisFor(from, ends.filter(known), deadlines.filter(known), share);
}

/** On a large farm, the rows are asked page by page, and their number is known before. */
function shownOf(rows: number, known: number): string {
  return rows < known ? `${grouped(rows)} of ${grouped(known)}` : grouped(rows);
}

/** How many jobs are in the list, of those that are not above it. */
function shownWords(shown: number, others: Listed["others"]): string {
  if (others === null) return `${counted(shown, "job")} shown`;
  const [one, many] = others.above > 0 ? ["other job", "other jobs"] : ["job", "jobs"];
  return shown < others.total
    ? `${grouped(shown)} of ${counted(others.total, one, many)} shown`
    : counted(shown, one, many);
}

function none(shown: Shown, search: string, others: boolean): string {
  const kind = SHOWN.find(([value]) => value === shown)?.[1].toLowerCase() ?? "";
  return search
    ? `No ${kind} job has “${search}” in its name or project.`
    : `No ${others && shown === "open" ? "other " : ""}${kind} jobs.`;
}
