// What the page does to jobs: every change is one request of the public API.

import { get, newKey, patch, post } from "../api/client";
import type { Job, JobChange, JobRequest, PlanChange, RenderSettings } from "../api/types";

/** A request that repeats a job. */
export function requestOf(job: Job): JobRequest {
  const {
    settings,
    renderer,
    within,
    error_target,
    limits,
    cache,
    ladders,
    division,
    output,
    video,
    denoise,
  } = job;
  return {
    name: job.name,
    project: job.project,
    bundle: job.bundle,
    frames: job.frames,
    settings: settings as JobRequest["settings"],
    priority: job.priority,
    weight: job.weight ?? 1,
    samples: job.samples,
    confidence: job.confidence,
    deadline: job.deadline ?? null,
    budget: job.budget ?? null,
    profile_frames: job.profile_frames ?? null,
    ...(renderer ? { renderer } : {}),
    ...(within ? { within } : {}),
    ...(error_target ? { error_target } : {}),
    ...(limits ? { limits } : {}),
    ...(cache ? { cache } : {}),
    ...(ladders ? { ladders } : {}),
    ...(division ? { division } : {}),
    ...(output ? { output } : {}),
    ...(denoise ? { denoise } : {}),
    ...(video ? { video: { frames_per_second: video.frames_per_second } } : {}),
  };
}

/** Submits the job again with other settings. Returns the new job: with the same `key`, the same one. */
export function submitAgain(
  job: Job,
  settings: Partial<RenderSettings>,
  { hold = false, key = newKey() } = {},
): Promise<Job> {
  // The quality was priced with equally many samples for every pixel.
  const { within: _, error_target: __, ...request } = requestOf(job);
  const body = { ...request, settings: { ...request.settings, ...settings }, ...(hold ? { hold } : {}) };
  return post("/v1/jobs", { body: body as JobRequest, key });
}

/** Changes deadline, confidence or budget, and plans anew. */
export function changeJob(id: string, change: JobChange): Promise<unknown> {
  return patch("/v1/jobs/{id}", { path: { id }, body: change });
}

export function cancelJob(id: string): Promise<unknown> {
  return post("/v1/jobs/{id}/cancel", { path: { id } });
}

/** Whether a button can make this change. If not, `whatToDo` says how a person does. */
export function canTake(change: PlanChange): boolean {
  return !("more_nodes" in change) && !("node_gone" in change);
}

/** Deadlines that are being moved, by what moves them. Who tries again after a lost answer moves none twice. */
const moving = new Map<string, string>();

async function moveDeadline(id: string, byMs: number): Promise<void> {
  const { deadline } = await get("/v1/jobs/{id}", { path: { id } });
  if (!deadline) throw new Error("This job has no deadline any more.");
  const key = `${id} ${byMs}`;
  const begun = moving.get(key);
  if (!begun || Date.parse(begun) !== Date.parse(deadline)) {
    const to = new Date(Date.parse(deadline) + byMs).toISOString();
    moving.set(key, to);
    await changeJob(id, { deadline: to });
  }
  moving.delete(key);
}

/** Makes a change that was offered as a rescue. Returns the job to look at afterwards. */
export async function take(change: PlanChange, about: string): Promise<string> {
  if ("later" in change) {
    await moveDeadline(change.later.job_id, change.later.by_ms);
  } else if ("confidence" in change) {
    const { job_id: id, confidence } = change.confidence;
    await changeJob(id, { confidence });
  } else if ("make_way" in change) {
    await changeJob(change.make_way.job_id, { deadline: null });
  } else if ("without_job" in change) {
    await cancelJob(change.without_job.job_id);
  } else if ("quality" in change) {
    const { settings, width, height, spp } = change.quality;
    const job = await get("/v1/jobs/{id}", { path: { id: about } });
    // If cancelling fails, whoever tries again gets the job that was made, and not a second one.
    const key = ["rescue", about, width, height, spp, job.deadline, job.budget].join(" ");
    const made = await submitAgain(job, { ...(settings ?? {}), width, height, spp }, { key });
    await cancelJob(about);
    return made.id;
  }
  return about;
}

/** What a person does about a change that no button can make. */
export function whatToDo(change: PlanChange): string {
  if ("more_nodes" in change) {
    const { count } = change.more_nodes;
    return count === 1
      ? "Start one more worker like it: on the Farm screen, “Add a node” makes its token and shows the command."
      : `Start ${count} more workers like it: on the Farm screen, “Add a node” makes a token for each and shows the command.`;
  }
  return "";
}
