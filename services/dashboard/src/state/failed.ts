// Jobs that failed and still need somebody: those of the last day, and those whose deadline is ahead.

import { computed, signal } from "@preact/signals";
import { get } from "../api/client";
import type { Event, Job } from "../api/types";
import { now } from "./now";

const DAY = 86_400_000;
const MOST = 200;

/** The newest failed jobs. */
const known = signal<readonly Job[]>([]);

const isAhead = (job: Job, at: number) => job.deadline != null && Date.parse(job.deadline) > at;

export const failed = computed(() =>
  known.value.filter(
    (job) => isAhead(job, now.value) || Date.parse(job.finished_at ?? job.created_at) > now.value - DAY,
  ),
);

/** Those that could still be ready by their deadline, if somebody did something. */
export const failedAhead = computed(() => failed.value.filter((job) => isAhead(job, now.value)));

/** Number of the request, so that an older answer does not replace a newer one. */
let asked = 0;

/** Asks for them. `count` is the number of failed jobs that the farm tells of. */
export async function askFailed(count: number): Promise<void> {
  const mine = ++asked;
  const items =
    count === 0 ? [] : (await get("/v1/jobs", { query: { state: "failed", page_size: MOST } })).items;
  if (mine === asked) known.value = items;
}

export function forgetFailed(): void {
  asked++;
  known.value = [];
}

/** Whether an event changes which jobs failed. */
export const tellsOfFailed = (event: Event) =>
  event.job_state === "failed" || known.peek().some((job) => job.id === event.job_id);
