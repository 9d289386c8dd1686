// The tasks of a job, as its events tell of them: which there are, and how each stands.

import { signal } from "@preact/signals";
import { useEffect, useMemo } from "preact/hooks";
import type { Event } from "../../api/types";
import { openStream } from "../../state/stream";

export interface Task {
  id: string;
  kind: string;
  frame: number | null;
  /** The part of the frame or of the cache, from 0. */
  part: number | null;
  state: "running" | "done" | "failed" | "waiting";
  /** Instant of the last event. */
  at: string;
}

const STATE: Partial<Record<Event["kind"], Task["state"]>> = {
  task_leased: "running",
  task_submitted: "waiting",
  task_done: "done",
  task_failed: "failed",
  result_refused: "waiting",
  lease_expired: "waiting",
  lease_released: "waiting",
  lease_lost: "waiting",
};

/** Reads the job's events from its beginning, and follows them. */
export function useTasks(job: string): { tasks: Task[]; error: string | null } {
  const state = useMemo(
    () => signal<{ tasks: Task[]; error: string | null }>({ tasks: [], error: null }),
    [job],
  );
  useEffect(() => {
    const tasks = new Map<string, Task>();
    let timer: ReturnType<typeof setTimeout> | undefined;
    const take = (event: Event) => {
      const next = STATE[event.kind];
      if (!event.task_id || !next) return;
      const old = tasks.get(event.task_id);
      tasks.set(event.task_id, {
        id: event.task_id,
        kind: event.task_kind ?? old?.kind ?? "task",
        frame: event.frame ?? old?.frame ?? null,
        part: event.part ?? old?.part ?? null,
        state: next,
        at: event.at,
      });
      // Thousands of events arrive at once at first.
      timer ??= setTimeout(() => {
        timer = undefined;
        state.value = { tasks: [...tasks.values()], error: null };
      }, 100);
    };
    const address = `/v1/jobs/${job}/events`;
    const stream = openStream({
      address: (after) => (after === null ? address : `${address}?last_event_id=${after}`),
      kinds: Object.keys(STATE),
      take,
      opened: () => (state.value = { ...state.peek(), error: null }),
      broke: (tries) => {
        const error = "The job’s events could not be read. They are asked for again.";
        if (tries > 0 && tasks.size === 0) state.value = { tasks: [], error };
      },
      ends: true,
    });
    stream.connect();
    return () => {
      clearTimeout(timer);
      stream.close();
    };
  }, [job]);
  return state.value;
}
