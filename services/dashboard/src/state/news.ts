// What events say of jobs, put into documents that are on screen already. Pure.

import type { DashboardJob, Event, Farm, FarmSummary, JobState, Node } from "../api/types";

/** What rows and documents of jobs share. */
interface Known {
  state: JobState;
  frames_done: number;
  hold?: boolean | undefined;
  paused?: boolean | undefined;
  deadline?: string | null | undefined;
  budget?: number | null | undefined;
  eta?: string | null | undefined;
  finish?: DashboardJob["finish"] | undefined;
  probability?: number | null | undefined;
  waits?: DashboardJob["waits"] | undefined;
  promise?: DashboardJob["promise"] | undefined;
}

/** Whether an event says more than how far a task is. */
export const isNews = (event: Event) => event.kind !== "task_progress";

/** Whether a job is over. */
export const isOver = (state: JobState) => state === "done" || neverEnds(state);

/** Whether it is over without its last frames, so that it met no deadline. */
export const neverEnds = (state: JobState) => state === "failed" || state === "cancelled";

/** A job after an event of it: the same object if the event says nothing that is shown. */
export function jobAfter<J extends Known>(job: J, event: Event): J {
  const after: Partial<Known> = {};
  if (event.job_state) after.state = event.job_state;
  if (event.job_state === "rendering") after.waits = null;
  if (event.frames_done != null) after.frames_done = event.frames_done;
  if (event.promise) Object.assign(after, { promise: event.promise, probability: event.promise.probability });
  const { terms, eta, finish, probability } = event.job ?? {};
  if (terms) {
    Object.assign(after, {
      hold: terms.hold,
      deadline: terms.deadline ?? null,
      budget: terms.budget ?? null,
      paused: terms.paused ?? false,
    });
    if (job.paused && !after.paused) after.waits = null;
    if (after.paused) Object.assign(after, { eta: null, finish: null });
    // What was likely of another deadline says nothing of this one.
    if (after.deadline !== (job.deadline ?? null)) Object.assign(after, { promise: null, probability: null });
  }
  if (eta != null) after.eta = eta;
  if (finish) after.finish = finish;
  if (probability != null) after.probability = probability;
  if (event.kind === "plan_stored") {
    after.waits = event.job?.waits ?? null;
    // What is held has no end.
    if (after.waits?.kind === "budget" || after.waits?.kind === "paused")
      Object.assign(after, { eta: null, finish: null });
  }
  return Object.keys(after).length === 0 ? job : { ...job, ...after };
}

/** A row of a list after an event. */
export function rowAfter(row: DashboardJob, event: Event): DashboardJob {
  const { verdict, booked_cost, cost } = event.job ?? {};
  const said = {
    ...(verdict && { verdict }),
    ...(booked_cost != null && { booked_cost }),
    ...(cost && { cost }),
  };
  const after = jobAfter(row, event);
  return Object.keys(said).length === 0 ? after : { ...after, ...said };
}

/** A job that was just submitted; `null` for other events. */
function newRow(event: Event): DashboardJob | null {
  const { job_id: id, job_name: name } = event;
  const frames_total = event.job?.frames_total;
  if (event.kind !== "job_created" || !id || name == null || frames_total == null) return null;
  const row: DashboardJob = {
    id,
    name,
    project: event.project ?? "",
    state: "previewing",
    frames_total,
    frames_done: 0,
    progress: 0,
  };
  return rowAfter(row, event);
}

/**
 * The farm after some events, oldest first: the same object if they changed none of its jobs. Its counts know the
 * events up to `counted` already.
 */
export function farmAfter(old: Farm, events: readonly Event[], counted = 0): Farm {
  const rows = new Map(old.jobs.map((job) => [job.id, job]));
  const counts = { ...old.counts.jobs };
  let total = old.jobs_open_total;
  let changed = false;
  for (const event of events) {
    if (!event.job_id) continue;
    const before = rows.get(event.job_id);
    const after = before ? rowAfter(before, event) : newRow(event);
    if (!after || after === before) continue;
    changed = true;
    const isGone = isOver(after.state);
    if (isGone) rows.delete(after.id);
    else rows.set(after.id, after);
    if (event.id <= counted) continue;
    total += Number(!before) - Number(isGone);
    if (before?.state !== after.state) {
      if (before) counts[before.state]--;
      counts[after.state]++;
    }
  }
  if (!changed) return old;
  return {
    ...old,
    jobs: [...rows.values()],
    jobs_open_total: total,
    counts: { ...old.counts, jobs: counts },
  };
}

/** The farm after a summary. Its jobs are counted anew unless events that the summary does not know changed them. */
export function farmSummed(old: Farm, summary: FarmSummary, isAhead: boolean): Farm {
  const { counts, node_counts, versions, finish = null, spending } = summary;
  const jobs = isAhead ? old.counts.jobs : counts.jobs;
  const jobs_open_total = isAhead ? old.jobs_open_total : counts.jobs_active;
  return { ...old, counts: { ...counts, jobs }, jobs_open_total, node_counts, versions, finish, spending };
}

/** Events that end what a node does. A task that is late goes on. */
const ENDS = /^(task_done|task_failed|result_refused|lease_(expired|released|lost))$/;

/** A node after some events of tasks, oldest first: the same object if none is about its own. */
export function nodeAfter(old: Node, events: readonly Event[]): Node {
  let node = old;
  for (const event of events) {
    const own = node.activity?.task_id === event.task_id ? node.activity : null;
    if (event.kind === "task_progress") {
      if (own && event.progress != null) node = { ...node, activity: { ...own, progress: event.progress } };
    } else if (event.kind === "task_leased" && event.node_id === node.id && event.task_id && event.job_id) {
      node = {
        ...node,
        state: node.state === "idle" ? "working" : node.state,
        activity: {
          task_id: event.task_id,
          kind: event.task_kind ?? "render",
          job_id: event.job_id,
          job: event.job_name ?? "",
          frame: event.frame ?? null,
          progress: 0,
          started: event.at,
        },
      };
    } else if (own && ENDS.test(event.kind)) {
      node = { ...node, state: node.state === "working" ? "idle" : node.state, activity: null };
    }
  }
  return node;
}
