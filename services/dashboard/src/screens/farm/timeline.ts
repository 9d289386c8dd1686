// The rows of the chart: which nodes did, do and will do what, asked page by page for a stretch of time.

import { useCallback, useEffect, useRef, useState } from "preact/hooks";
import { get } from "../../api/client";
import type { NodeState, TimelinePage, TimelineNode } from "../../api/types";
import { onEvent } from "../../state/live";
import { asError, useThrottled } from "../../ui/resource";

export interface Stretch {
  from: number;
  to: number;
}

export interface Rows {
  rows: readonly TimelineNode[];
  jobs: ReadonlyMap<string, string>;
  complete: boolean;
  loading: boolean;
  error: Error | null;
  more: () => void;
  again: () => void;
}

const PAGE = 100;

interface State {
  rows: TimelineNode[];
  jobs: Map<string, string>;
  next: string | null;
  asked: Stretch | null;
}

/** A stretch with room to pan in, so that small movements ask for nothing. */
function padded(view: Stretch): Stretch {
  const length = view.to - view.from;
  return { from: view.from - length / 2, to: view.to + length / 2 };
}

/** Whether what was asked still covers the view, and is not far more than is seen. */
function serves(asked: Stretch | null, view: Stretch): boolean {
  return (
    asked !== null &&
    asked.from <= view.from &&
    asked.to >= view.to &&
    asked.to - asked.from < 6 * (view.to - view.from)
  );
}

export function useTimeline(view: Stretch, state: NodeState | "", search: string): Rows {
  const [got, setGot] = useState<State>({ rows: [], jobs: new Map(), next: null, asked: null });
  const [loading, setLoading] = useState(true);
  const [error, setError] = useState<Error | null>(null);
  const round = useRef(0);
  const current = useRef(got);
  current.current = got;

  const ask = useCallback(
    async (asked: Stretch, token: string | null, size: number): Promise<TimelinePage> =>
      await get("/v1/timeline", {
        query: {
          from: new Date(asked.from).toISOString(),
          to: new Date(asked.to).toISOString(),
          ...(state ? { state: state } : {}),
          ...(search ? { search } : {}),
          ...(token ? { page_token: token } : {}),
          page_size: size,
        },
      }),
    [state, search],
  );

  /** Asks anew for as many rows as are shown. */
  const load = useCallback(
    async (asked: Stretch) => {
      const mine = ++round.current;
      setLoading(true);
      try {
        const rows: TimelineNode[] = [];
        const jobs = new Map<string, string>();
        const wanted = Math.max(PAGE, current.current.rows.length);
        let next: string | null = null;
        do {
          const page: TimelinePage = await ask(asked, next, PAGE);
          if (mine !== round.current) return;
          rows.push(...page.items);
          for (const job of page.jobs) jobs.set(job.id, job.name);
          next = page.next_page_token ?? null;
        } while (next && rows.length < wanted);
        setGot({ rows, jobs, next, asked });
        setError(null);
      } catch (failure) {
        if (mine === round.current) setError(asError(failure));
      }
      if (mine === round.current) setLoading(false);
    },
    [ask],
  );

  useEffect(() => {
    if (serves(current.current.asked, view)) return undefined;
    const timer = setTimeout(() => void load(padded(view)), current.current.asked ? 120 : 0);
    return () => clearTimeout(timer);
  }, [view.from, view.to, load]);

  // Other nodes are asked for: the old rows are of no use.
  useEffect(() => {
    setGot({ rows: [], jobs: new Map(), next: null, asked: null });
    current.current = { rows: [], jobs: new Map(), next: null, asked: null };
    void load(padded(view));
  }, [load]);

  const refresh = useThrottled(() => current.current.asked && void load(padded(view)), 4_000);
  useEffect(() => onEvent((event) => event.kind !== "task_progress" && refresh()), [refresh]);

  const more = useCallback(() => {
    const { next, asked, rows, jobs } = current.current;
    if (loading || !next || !asked) return;
    const mine = round.current;
    setLoading(true);
    ask(asked, next, PAGE).then(
      (page) => {
        if (mine !== round.current) return;
        for (const job of page.jobs) jobs.set(job.id, job.name);
        setGot({ rows: [...rows, ...page.items], jobs, next: page.next_page_token ?? null, asked });
        setLoading(false);
      },
      (failure: unknown) => {
        setError(asError(failure));
        setLoading(false);
      },
    );
  }, [ask, loading]);

  const again = useCallback(() => void load(padded(view)), [load, view.from, view.to]);
  return {
    rows: got.rows,
    jobs: got.jobs,
    complete: got.next === null && got.asked !== null,
    loading,
    error,
    more,
    again,
  };
}
