// Which jobs the first screen lists, and in which order.

import { useCallback, useEffect, useMemo, useRef } from "preact/hooks";
import { get } from "../../api/client";
import type { DashboardJob, Event, Farm, Job } from "../../api/types";
import { onEvents } from "../../state/live";
import { isNews, rowAfter } from "../../state/news";
import { now } from "../../state/now";
import { PAGE, usePages } from "../../ui/pages";
import { troubleOf } from "./jobs";

export const SHOWN = [
  ["open", "Open"],
  ["done", "Done"],
  ["failed", "Failed"],
  ["cancelled", "Cancelled"],
] as const;
export type Shown = (typeof SHOWN)[number][0];

export const SORTS = [
  ["risk", "At risk first"],
  ["deadline", "Deadline"],
  ["-created", "Newest"],
  ["name", "Name"],
  ["cost", "Cost"],
] as const;
export type Sort = (typeof SORTS)[number][0];

export interface Listed {
  jobs: readonly DashboardJob[];
  /** Open jobs in trouble. They are shown above the list, and without a filter not in it. */
  risks: readonly DashboardJob[];
  /** Open jobs that are not above the list, and how many are. `null` if that is not known. */
  others: { total: number; above: number } | null;
  loading: boolean;
  error: Error | null;
  see: (first: number, last: number) => void;
  again: () => void;
}

/** Open jobs by risk come with the dashboard; everything else, and what is beyond it, is asked page by page. */
export function useListed(doc: Farm, shown: Shown, sort: Sort, search: string): Listed {
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
  useEffect(
    () =>
      onEvents((events) => {
        const news = new Map<string, Event[]>();
        for (const event of events.filter(isNews))
          if (event.job_id) news.set(event.job_id, [...(news.get(event.job_id) ?? []), event]);
        if (news.size > 0) pages.change((row) => (news.get(row.id) ?? []).reduce(rowAfter, row));
      }),
    [pages.change],
  );
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
    others: plain ? { total: doc.jobs_open_total - risks.length, above: risks.length } : null,
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
