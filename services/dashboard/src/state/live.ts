// The stream of all events, and how the connection to the service is. It is one connection a tab.

import { batch, signal } from "@preact/signals";
import { hooks } from "../api/client";
import type { Event, EventKind, FarmSummary } from "../api/types";
import { openStream, type Stream } from "./stream";

/** `live`: events arrive. `catching-up`: connecting. `lost`: the service does not answer. */
export type Link = "live" | "catching-up" | "lost";

export const link = signal<Link>("catching-up");

/** The newest summary of the farm on this connection. Who sees some projects only, gets none. */
export const summary = signal<FarmSummary | null>(null);

/** When the service was last heard, milliseconds since 1970. */
export const lastHeard = signal(Date.now());

/** Kinds of events. The compiler checks that none is missing. */
const KINDS: Record<EventKind, true> = {
  job_created: true,
  job_state: true,
  job_changed: true,
  forecast_ready: true,
  job_off_forecast: true,
  job_on_forecast: true,
  plan_stored: true,
  task_leased: true,
  task_submitted: true,
  submission_lost: true,
  task_progress: true,
  task_done: true,
  task_failed: true,
  result_refused: true,
  task_late: true,
  task_stalled: true,
  lease_expired: true,
  lease_released: true,
  lease_lost: true,
  node_registered: true,
  node_changed: true,
  node_set_aside: true,
  node_removed: true,
  budget: true,
  engine_state: true,
  job_promise_at_risk: true,
  job_promise_safe: true,
  artifact_damaged: true,
};

const EVENT_KINDS: readonly string[] = Object.keys(KINDS);

type Listener = (events: readonly Event[]) => void;

/** What is called for events, with what is called when some are left out. */
const listeners = new Map<Listener, () => void>();
/** Milliseconds in which events are collected. A large farm writes hundreds a second, and a new plan thousands. */
const TOGETHER = 250;
let collected: Event[] = [];
let handing: ReturnType<typeof setTimeout> | undefined;
/** The newest event that was heard. */
let newest = 0;
let stream: Stream | null = null;

hooks.heard = () => {
  lastHeard.value = Date.now();
  if (link.peek() === "lost") {
    link.value = "catching-up";
    stream?.connect();
  }
};
hooks.unheard = () => {
  link.value = "lost";
};

/**
 * Calls `listener` with the events from now on, oldest first, at most four times a second. Calls `missed` when so
 * many came while the page slept that they are left out. Returns how to stop.
 */
export function onEvents(listener: Listener, missed: () => void = () => undefined): () => void {
  listeners.set(listener, missed);
  return () => listeners.delete(listener);
}

/** With more events to catch up with, screens ask again for what they show. */
const MOST_BEHIND = 5_000;

/**
 * Starts behind this event, the newest that a document tells of. Documents may be ahead of the stream, so later
 * calls leave nothing out, unless the stream is far behind.
 */
export function follow(after: number): void {
  const isNew = stream === null;
  if (isNew) newest = after;
  stream ??= openStream({
    address: (last) => `/v1/events?summaries=true&last_event_id=${last}`,
    kinds: EVENT_KINDS,
    take,
    others: { farm: (data) => (summary.value = JSON.parse(data) as FarmSummary) },
    opened: () => {
      lastHeard.value = Date.now();
      link.value = "live";
    },
    broke: (tries) => {
      link.value = tries === 0 ? "catching-up" : "lost";
      summary.value = null;
    },
  });
  if (isNew || after - newest > MOST_BEHIND) {
    newest = after;
    stream.after(after);
    if (!isNew) for (const missed of [...listeners.values()]) missed();
    stream.connect();
  }
}

export function unfollow(): void {
  stream?.close();
  stream = null;
  summary.value = null;
  clearTimeout(handing);
  handing = undefined;
  collected = [];
}

function take(event: Event): void {
  newest = event.id;
  collected.push(event);
  handing ??= setTimeout(hand, TOGETHER);
}

function hand(): void {
  handing = undefined;
  lastHeard.value = Date.now();
  const events = collected;
  collected = [];
  batch(() => {
    for (const listener of [...listeners.keys()]) listener(events);
  });
}
