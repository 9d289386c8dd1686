// Names of jobs by id, for events that tell only ids. Jobs that are no longer open are asked for, once each.

import { signal } from "@preact/signals";
import { get } from "../api/client";
import { farm } from "./farm";

const known = signal<ReadonlyMap<string, string>>(new Map());
const asked = new Set<string>();

/** The name of a job, or `null` until it is known. Reading it subscribes. */
export function jobName(id: string): string | null {
  const open = farm.value?.jobs.find((job) => job.id === id);
  const name = open?.name ?? known.value.get(id);
  if (name !== undefined) return name;
  if (!asked.has(id)) {
    asked.add(id);
    get("/v1/jobs/{id}", { path: { id } }).then(
      (job) => (known.value = new Map(known.peek()).set(id, job.name)),
      () => undefined,
    );
  }
  return null;
}
