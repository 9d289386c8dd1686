// The farm at one instant, kept fresh: events change jobs and their counts at once. What only the service can
// compute comes as summaries, a few seconds after events. Who gets none, asks then; and all ask now and then.

import { computed, effect, signal } from "@preact/signals";
import { get } from "../api/client";
import type { Event, Farm, FarmSummary } from "../api/types";
import { askFailed, failedAhead, forgetFailed, tellsOfFailed } from "./failed";
import { forgetHappened, happen } from "./happened";
import { follow, onEvents, summary, unfollow } from "./live";
import { farmAfter, farmSummed, isNews } from "./news";
import { now } from "./now";

export const farm = signal<Farm | null>(null);
export const farmError = signal<Error | null>(null);

/** The newest events of the stream, newest first. */
const recent = signal<Event[]>([]);

/** Number of open promises at risk. The document has them all only on a farm that is not large. */
export const openAtRisk = computed(() => {
  const doc = farm.value;
  if (!doc) return 0;
  const shown = doc.jobs.filter((job) => job.promise && !job.promise.kept).length;
  return doc.jobs_open_total > doc.jobs.length ? Math.max(shown, doc.counts.promises_at_risk) : shown;
});

/** The same with jobs that failed before their deadlines: the tab, its icon and the head tell of them. */
export const atRisk = computed(() => openAtRisk.value + failedAhead.value.length);

const SOON = 3_000;
const LATER = 10_000;
const QUIET = 30_000;

/** Events that move what only the service can compute: expected ends, money, what jobs wait for. */
const ASKED_SOON: ReadonlySet<Event["kind"]> = new Set([
  "plan_stored",
  "job_state",
  "job_changed",
  "budget",
  "engine_state",
  "job_promise_at_risk",
  "job_promise_safe",
  "node_registered",
  "node_changed",
  "node_set_aside",
  "node_removed",
]);
const KEPT_EVENTS = 200;

/** The last event that the counts of jobs know from the service. */
let counted = 0;
let timer: ReturnType<typeof setTimeout> | undefined;
let due = 0;
let stop: (() => void) | null = null;
let unsum: (() => void) | null = null;
let minute: ReturnType<typeof setInterval> | undefined;
const failedCount = computed(() => farm.value?.counts.jobs.failed ?? null);
/** Number of failed jobs when they were last asked for. */
let failedKnown: number | null = null;

/** Starts to watch the farm. */
export function watch(): void {
  if (stop) return;
  stop = onEvents(take);
  const unlisten = [
    effect(() => {
      if (summary.value) sumUp(summary.value);
    }),
    effect(() => {
      if (failedCount.value !== null && failedCount.value !== failedKnown) refreshFailed();
    }),
  ];
  unsum = () => unlisten.forEach((end) => end());
  minute = setInterval(() => (now.value = Date.now()), 20_000);
  document.addEventListener("visibilitychange", woken);
  void refresh();
}

export function unwatch(): void {
  stop?.();
  unsum?.();
  stop = unsum = null;
  clearInterval(minute);
  clearTimeout(timer);
  document.removeEventListener("visibilitychange", woken);
  unfollow();
  farm.value = null;
  farmError.value = null;
  recent.value = [];
  failedKnown = null;
  forgetFailed();
  forgetHappened();
}

function woken(): void {
  if (document.visibilityState === "visible") {
    now.value = Date.now();
    void refresh();
  }
}

/** Asks for the farm now. */
export async function refresh(): Promise<void> {
  clearTimeout(timer);
  due = Infinity;
  try {
    const next = (await get("/v1/dashboard")) as Farm;
    if (!stop) return;
    // Events that came meanwhile are newer than the document.
    const meanwhile = recent.peek().filter((event) => event.id > next.last_event_id);
    farm.value = farmAfter(next, meanwhile.reverse());
    counted = next.last_event_id;
    farmError.value = null;
    if (failedKnown === null) refreshFailed();
    now.value = Date.now();
    happen(next.events);
    follow(next.last_event_id);
  } catch (error) {
    farmError.value = error instanceof Error ? error : new Error(String(error));
  }
  if (stop) schedule(QUIET);
}

/** Asks for the failed jobs. If there is no answer, the next document of the farm asks again. */
function refreshFailed(): void {
  const count = failedCount.peek();
  if (count === null) return;
  failedKnown = count;
  askFailed(count).catch(() => (failedKnown = null));
}

function schedule(after: number): void {
  const at = Date.now() + after;
  if (at >= due) return;
  due = at;
  clearTimeout(timer);
  timer = setTimeout(() => void refresh(), after);
}

function take(events: readonly Event[]): void {
  const told = events.filter(isNews).reverse();
  const old = farm.peek();
  if (told.length) recent.value = [...told, ...recent.peek()].slice(0, KEPT_EVENTS);
  happen(events);
  // The document knows what happened before it.
  const news = events.filter((event) => event.id > (old?.last_event_id ?? 0));
  if (old) farm.value = farmAfter(old, news, counted);
  if (events.some(tellsOfFailed)) refreshFailed();
  if (!summary.peek()) schedule(events.some((event) => ASKED_SOON.has(event.kind)) ? SOON : LATER);
}

function sumUp(told: FarmSummary): void {
  const old = farm.peek();
  if (!old || told.last_event_id < old.last_event_id) return;
  const counts = (event: Event) => event.kind === "job_created" || event.job_state != null;
  const isAhead = recent.peek().some((event) => event.id > told.last_event_id && counts(event));
  if (!isAhead) counted = told.last_event_id;
  farm.value = farmSummed(old, told, isAhead);
  now.value = Date.now();
}
