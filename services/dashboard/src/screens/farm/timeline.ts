// The rows of the chart: which nodes did, do and will do what, asked page by page for a stretch of time.

import { useCallback, useEffect, useRef } from "preact/hooks";
import { get } from "../../api/client";
import type { NodeState, TimelineNode, TimelineSpan } from "../../api/types";
import { onEvents } from "../../state/live";
import { isNews } from "../../state/news";
import { PAGE, type Pages, usePages } from "../../ui/pages";
import { useThrottled } from "../../ui/resource";

export interface Stretch {
  from: number;
  to: number;
}

const SHORTEST = 2 * 60_000;
const LONGEST = 21 * 86_400_000;

/** Zooms a stretch around an instant. */
export function zoomed(view: Stretch, factor: number, around: number): Stretch {
  const length = Math.min(LONGEST, Math.max(SHORTEST, (view.to - view.from) / factor));
  const share = (around - view.from) / (view.to - view.from);
  const from = around - share * length;
  return { from, to: from + length };
}

/** A span with its instants as numbers, milliseconds since 1970. */
export interface Span extends Pick<TimelineSpan, "job_id" | "frames" | "kind"> {
  start: number;
  end: number;
  /** The P80 of its end; its end where that is not known. */
  tail: number;
}

export interface Row extends Omit<TimelineNode, "spans"> {
  spans: Span[];
}

export interface Rows extends Pages<Row> {
  /** Names of jobs. */
  jobs: ReadonlyMap<string, string>;
}

/** The longest stretch that the service answers. */
const MOST_ANSWERED = 31 * 24 * 3_600_000;

/** A stretch with room to pan in, so that small movements ask for nothing. */
function padded(view: Stretch): Stretch {
  const length = Math.min(MOST_ANSWERED, view.to - view.from);
  const room = Math.min(length, MOST_ANSWERED - length) / 2;
  return { from: view.from - room, to: view.from + length + room };
}

/** Whether what was asked still covers the view, and is not far more than is seen. */
function serves(asked: Stretch, view: Stretch): boolean {
  return asked.from <= view.from && asked.to >= view.to && asked.to - asked.from < 6 * (view.to - view.from);
}

function asRow(node: TimelineNode): Row {
  const asSpan = ({ job_id, frames, kind, start, end, end_p80 }: TimelineSpan): Span => {
    const until = Date.parse(end);
    const tail = end_p80 ? Date.parse(end_p80) : until;
    return {
      job_id: job_id ?? null,
      frames: frames ?? null,
      kind,
      start: Date.parse(start),
      end: until,
      tail,
    };
  };
  return { ...node, spans: node.spans.map(asSpan) };
}

export function useTimeline(view: Stretch, state: NodeState | "", search: string): Rows {
  const jobs = useRef(new Map<string, string>());
  const ask = useCallback(
    async (token: string | null, asked: Stretch) => {
      const page = await get("/v1/timeline", {
        query: {
          from: new Date(asked.from).toISOString(),
          to: new Date(asked.to).toISOString(),
          ...(state ? { state } : {}),
          ...(search ? { search } : {}),
          ...(token ? { page_token: token } : {}),
          page_size: PAGE,
        },
      });
      for (const job of page.jobs) jobs.current.set(job.id, job.name);
      return { items: page.items.map(asRow), next: page.next_page_token ?? null };
    },
    [state, search],
  );
  const pages = usePages(
    ask,
    () => padded(view),
    (asked) => serves(asked, view),
  );

  const seen = useRef<[number, number]>([0, 50]);
  const see = useCallback(
    (first: number, last: number) => pages.see(...(seen.current = [first, last])),
    [pages.see],
  );
  // When the view rests outside of what was asked, it is asked again.
  useEffect(() => {
    const timer = setTimeout(() => pages.see(...seen.current), 120);
    return () => clearTimeout(timer);
  }, [view.from, view.to, pages.see]);

  const refresh = useThrottled(pages.again, 4_000);
  useEffect(() => onEvents((events) => events.some(isNews) && refresh(), refresh), [refresh]);
  return { ...pages, see, jobs: jobs.current };
}
