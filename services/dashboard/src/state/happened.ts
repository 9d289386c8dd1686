// What happened lately, of which people are told. The farm's document has the newest of these, and the stream tells
// what comes.

import { signal } from "@preact/signals";
import type { Event, EventKind } from "../api/types";

const TOLD = [
  "job_created",
  "job_state",
  "job_changed",
  "forecast_ready",
  "job_off_forecast",
  "job_on_forecast",
  "plan_stored",
  "task_failed",
  "result_refused",
  "lease_expired",
  "node_registered",
  "node_changed",
  "node_set_aside",
  "node_removed",
  "budget",
  "engine_state",
  "job_promise_at_risk",
  "job_promise_safe",
  "submission_lost",
  "artifact_damaged",
] as const satisfies readonly EventKind[];

type Told = Event & { kind: (typeof TOLD)[number] };

const isTold = (event: Event): event is Told => TOLD.some((kind) => kind === event.kind);

/** Newest first. */
export const happened = signal<readonly Told[]>([]);

/** As many as the document of the farm has. */
const KEPT = 20;

/** Adds events in any order. Those that are known already change nothing. */
export function happen(events: readonly Event[]): void {
  const known = new Set(happened.peek().map((event) => event.id));
  const fresh = events.filter(isTold).filter((event) => !known.has(event.id));
  if (fresh.length === 0) return;
  happened.value = [...fresh, ...happened.peek()].sort((one, other) => other.id - one.id).slice(0, KEPT);
}

export function forgetHappened(): void {
  happened.value = [];
}
