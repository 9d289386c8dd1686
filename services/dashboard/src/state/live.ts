// The stream of events. It is one connection a tab, and none while the tab is hidden for long: browsers allow
// six to a service. After a break it goes on behind the last event that was seen, so nothing is missed.

import { signal } from "@preact/signals";
import { hooks } from "../api/client";
import type { Event, EventKind } from "../api/types";

/** `live`: events arrive. `catching-up`: connecting. `lost`: the service does not answer. */
export type Link = "live" | "catching-up" | "lost";

export const link = signal<Link>("catching-up");

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

const HIDDEN_FOR = 20_000;
const RETRY = [1_000, 2_000, 4_000];

type Listener = (event: Event) => void;

const listeners = new Set<Listener>();
let source: EventSource | null = null;
let lastId: number | null = null;
let tries = 0;
let retry: ReturnType<typeof setTimeout> | undefined;
let hide: ReturnType<typeof setTimeout> | undefined;
let started = false;

hooks.heard = () => {
  lastHeard.value = Date.now();
  if (link.peek() === "lost") {
    link.value = "catching-up";
    connect();
  }
};
hooks.unheard = () => {
  link.value = "lost";
};

/** Calls `listener` for each event from now on. Returns how to stop. */
export function onEvent(listener: Listener): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

/** Starts behind this event. Later calls only move forward. */
export function follow(after: number): void {
  lastId = Math.max(after, lastId ?? after);
  if (started) return;
  started = true;
  connect();
  document.addEventListener("visibilitychange", seen);
  addEventListener("online", connect);
}

export function unfollow(): void {
  started = false;
  lastId = null;
  document.removeEventListener("visibilitychange", seen);
  removeEventListener("online", connect);
  disconnect();
}

function seen(): void {
  clearTimeout(hide);
  if (document.visibilityState === "hidden") {
    hide = setTimeout(disconnect, HIDDEN_FOR);
  } else if (!source || source.readyState === EventSource.CLOSED) {
    connect();
  }
}

function disconnect(): void {
  clearTimeout(retry);
  source?.close();
  source = null;
}

function connect(): void {
  if (!started || lastId === null) return;
  disconnect();
  const stream = new EventSource(`/v1/events?last_event_id=${lastId}`);
  source = stream;
  stream.onopen = () => {
    tries = 0;
    lastHeard.value = Date.now();
    link.value = "live";
  };
  // The browser would retry by itself, but with an address that holds an old event, and not after an error
  // status.
  stream.onerror = () => {
    if (source !== stream) return;
    disconnect();
    link.value = tries === 0 ? "catching-up" : "lost";
    retry = setTimeout(connect, RETRY[Math.min(tries++, RETRY.length - 1)]);
  };
  for (const kind of Object.keys(KINDS)) {
    stream.addEventListener(kind, (message) =>
      take(JSON.parse((message as MessageEvent<string>).data) as Event),
    );
  }
}

function take(event: Event): void {
  if (lastId !== null && event.id <= lastId) return;
  lastId = event.id;
  lastHeard.value = Date.now();
  for (const listener of [...listeners]) listener(event);
}
