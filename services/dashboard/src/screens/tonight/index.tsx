// Tonight, the first screen: will everything be ready, what does it cost, and what is to be done now.

import { useCallback, useEffect, useMemo, useRef } from "preact/hooks";
import { get } from "../../api/client";
import type { Farm, DashboardJob, Job } from "../../api/types";
import { atRisk, farm, farmError, now } from "../../state/farm";
import { param, setQuery } from "../../state/route";
import { titled } from "../../state/tab";
import { axisFor, AxisHead, Fan, spreadWords } from "../../ui/fan";
import { clockTime, counted, grouped, maybeInstant, money } from "../../ui/format";
import { Choice, Section, TableBehind, Time, Trouble, Waiting } from "../../ui/parts";
import { PAGE, usePages } from "../../ui/pages";
import { useWidth } from "../../ui/resource";
import { Events } from "./events";
import { FirstSteps } from "./first-steps";
import { Ends, JobTable, Risks, spreadOf, troubleOf } from "./jobs";
import { seesAll } from "../../state/session";
import { Spend } from "./spend";

const SHOWN = [
  ["open", "Open"],
  ["done", "Done"],
  ["failed", "Failed"],
  ["cancelled", "Cancelled"],
] as const;
type Shown = (typeof SHOWN)[number][0];

const SORTS = [
  ["risk", "At risk first"],
  ["deadline", "Deadline"],
  ["-created", "Newest"],
  ["name", "Name"],
  ["cost", "Cost"],
] as const;
type Sort = (typeof SORTS)[number][0];

export function Tonight() {
  useEffect(() => titled("Tonight"), []);
  const doc = farm.value;
  if (!doc) {
    return farmError.value ? (
      <Trouble error={farmError.value} />
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
  const risks = atRisk.value.length;
  const late = doc.jobs.filter((job) => !job.promise && troubleOf(job) !== null).length;
  const p80 = maybeInstant(doc.finish?.p80);
  const p95 = maybeInstant(doc.finish?.p95);
  const nodes = doc.node_counts;
  const trouble = nodes.silent + nodes.set_aside;
  const spent = doc.spending.reduce((sum, line) => sum + line.tonight, 0);
  return (
    <p class="summary">
      {risks > 0 ? (
        <strong class="tone-bad">
          <span aria-hidden="true">⚠ </span>
          {counted(risks, "promise")} at risk.{" "}
        </strong>
      ) : (
        <strong>No promise is at risk. </strong>
      )}
      {late > 0 && <strong class="tone-warn">{counted(late, "job")} late in every plan. </strong>}
      {counted(doc.jobs_open_total, "job")} open
      {p80 !== null && (
        <>
          ; all ready by <Time at={p80} /> at P80
          {p95 !== null && <>, by {clockTime(p95)} at P95</>}
        </>
      )}
      .{" "}
      {doc.counts.jobs.quoted > 0 && (
        <>{counted(doc.counts.jobs.quoted, "quote waits", "quotes wait")} to be accepted. </>
      )}
      {grouped(nodes.working)} of {counted(doc.counts.nodes, "node")} working
      {trouble > 0 && <strong class="tone-warn">, {trouble} silent or set aside</strong>}. Spent tonight:{" "}
      <span class="number">{money(spent)}</span>.
    </p>
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

  const axis = useMemo(() => axisFor(now.value, doc.jobs.flatMap(instantsOf), 0.92), [doc.jobs, now.value]);
  const riskAxis = axisFor(now.value, risks.flatMap(instantsOf));
  const finish = {
    p50: maybeInstant(doc.finish?.p50),
    p80: maybeInstant(doc.finish?.p80),
    p95: maybeInstant(doc.finish?.p95),
  };

  const farmAxis = axisFor(
    now.value,
    [finish.p95 ?? finish.p80 ?? finish.p50].filter((at) => at !== null),
  );

  return (
    <div class="main" ref={box}>
      {finish.p50 !== null && (
        <div class="farm-finish">
          <h2>The farm finishes</h2>
          <span class="number">{spreadWords(finish)}</span>
          <div class="farm-axis">
            <AxisHead axis={farmAxis} />
            <Fan
              axis={farmAxis}
              spread={finish}
              deadline={null}
              label={`All open jobs: ${spreadWords(finish)}`}
            />
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
      )}
      {risks.length > 0 && (
        <Section title={`At risk or late: ${risks.length}`}>
          <Risks jobs={risks} axis={riskAxis} narrow={width < 720} />
        </Section>
      )}
      <Section
        title="Jobs"
        aside={
          <div class="filters">
            <Choice
              label="Which jobs"
              value={shown}
              options={SHOWN}
              choose={(value) => setQuery({ show: value === "open" ? null : value })}
            />
            <label>
              Sort{" "}
              <select value={sort} onChange={(event) => setQuery({ sort: event.currentTarget.value })}>
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
                value={search}
                placeholder="name or project"
                onInput={(event) => setQuery({ search: event.currentTarget.value })}
              />
            </label>
          </div>
        }
      >
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
            {listed.loading
              ? "Asking for more jobs…"
              : `${counted(listed.jobs.length, "job")} shown${listed.total === null ? "" : ` of ${listed.total}`}.`}{" "}
            The bar runs from P50 to P95, dark to P80; the line is the deadline. Times are yours: see the
            clock above.
          </p>
        )}
        <Ends jobs={listed.jobs} label="Ends and deadlines, as a table" />
      </Section>
    </div>
  );
}

function instantsOf(job: DashboardJob): number[] {
  const spread = spreadOf(job);
  return [spread.p95 ?? spread.p80 ?? spread.p50, maybeInstant(job.deadline)].filter((at) => at !== null);
}

function none(shown: Shown, search: string, others: boolean): string {
  const kind = SHOWN.find(([value]) => value === shown)?.[1].toLowerCase() ?? "";
  return search
    ? `No ${kind} job has “${search}” in its name or project.`
    : `No ${others && shown === "open" ? "other " : ""}${kind} jobs.`;
}

interface Listed {
  jobs: readonly DashboardJob[];
  /** Open jobs in trouble. They are shown above the list, and without a filter not in it. */
  risks: readonly DashboardJob[];
  total: number | null;
  loading: boolean;
  error: Error | null;
  see: (first: number, last: number) => void;
  again: () => void;
}

/** Open jobs by risk come with the dashboard; everything else, and what is beyond it, is asked page by page. */
function useListed(doc: Farm, shown: Shown, sort: Sort, search: string): Listed {
  const plain = shown === "open" && sort === "risk" && search === "";
  const isNeeded = !plain || doc.jobs_open_total > doc.jobs.length;
  const ask = useCallback(
    async (token: string | null) => {
      if (!isNeeded) return { items: [], next: null };
      const page = await get("/v1/jobs", {
        query: {
          ...(shown === "open" ? { open: true } : { state: shown }),
          ...(search ? { search } : {}),
          sort: shown === "open" ? sort : "-created",
          ...(token ? { page_token: token } : {}),
          page_size: PAGE,
        },
      });
      return { items: page.items.map(asRow), next: page.next_page_token ?? null };
    },
    [shown, sort, search, isNeeded],
  );
  const pages = usePages(ask, () => null);
  const version = Math.floor(now.value / 20_000);
  const first = useRef(version);
  useEffect(() => {
    if (version !== first.current) pages.again();
  }, [version]);

  const [jobs, risks] = useMemo(() => {
    const listed = new Map<string, DashboardJob>();
    if (plain) for (const job of doc.jobs) listed.set(job.id, job);
    for (const job of pages.items) if (!listed.has(job.id)) listed.set(job.id, job);
    const all = [...listed.values()];
    const isInTrouble = (job: DashboardJob) => troubleOf(job) !== null;
    return plain
      ? [all.filter((job) => !isInTrouble(job)), all.filter(isInTrouble)]
      : [all, doc.jobs.filter(isInTrouble)];
  }, [plain, doc.jobs, pages.items]);

  // Jobs in trouble come first in the pages: what follows them is asked for, however many they are.
  const above = plain ? risks.length : 0;
  useEffect(() => pages.see(above, above + 50), [above]);
  const see = useCallback(
    (first: number, last: number) => pages.see(first + above, last + above),
    [pages.see, above],
  );
  return {
    jobs,
    risks,
    total: plain ? doc.jobs_open_total : null,
    loading: pages.loading,
    error: pages.error,
    see,
    again: pages.again,
  };
}

/** A job of a list, as a row of the dashboard. */
function asRow(job: Job): DashboardJob {
  return {
    ...job,
    eta: job.eta ?? job.finished_at ?? null,
    cost: job.live?.cost ?? null,
    booked_cost: job.verdict?.cost ?? null,
    verdict: job.verdict?.verdict ?? null,
  };
}
