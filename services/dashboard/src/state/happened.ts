// What happened lately, of which people are told. Most events of a working farm are about leases and progress, so
// the newest of all say little.

import { signal } from "@preact/signals";
import type { Event, EventKind } from "../api/types";
import { EVENT_KINDS } from "./live";
import { openStream } from "./stream";

const TOLD = [
  "job_created",
  "job_state",
  "job_changed",
  "forecast_ready",
  "job_off_forecast",
  "job_on_forecast",
  "plan_stored",
  "task_failed",
  "lease_expired",
  "node_registered",
  "node_changed",
  "node_set_aside",
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

const KEPT = 50;

/** Adds events in any order. Those that are known already change nothing. */
export function happen(events: readonly Event[]): void {
  const known = new Set(happened.peek().map((event) => event.id));
  const fresh = events.filter(isTold).filter((event) => !known.has(event.id));
  if (fresh.length === 0) return;
  happened.value = [...fresh, ...happened.peek()].sort((one, other) => other.id - one.id).slice(0, KEPT);
}

/** How many events to look back before a document. */
const BACK = 600;
const LONGEST = 10_000;
const TOGETHER = 250;
let stop: (() => void) | null = null;

/** Asks for what happened before this event, the newest that a document tells of. */
export function askEarlier(until: number): void {
  if (until <= 0) return;
  let collected: Event[] = [];
  let handing: ReturnType<typeof setTimeout> | undefined;
  const hand = () => {
    handing = undefined;
    happen(collected);
    collected = [];
  };
  const begin = Math.max(0, until - BACK);
  const stream = openStream({
    address: (after) => `/v1/events?last_event_id=${after ?? begin}`,
    kinds: EVENT_KINDS,
    take: (event) => {
      collected.push(event);
      handing ??= setTimeout(hand, TOGETHER);
      if (event.id >= until) end();
    },
    opened: () => undefined,
    broke: () => undefined,
  });
  // A viewer may not be allowed to see the last event.
  const giveUp = setTimeout(() => end(), LONGEST);
  const end = () => {
    clearTimeout(giveUp);
    stream.close();
  };
  stop = () => {
    end();
    clearTimeout(handing);
  };
  stream.connect();
}

export function forgetHappened(): void {
  stop?.();
  stop = null;
  happened.value = [];
}
