// A job that is being written: from a bundle or an earlier job, and as a request.

import { requestOf as requestThatRepeats } from "../../actions/jobs";
import type { Bundle, Confidence, Job, JobRequest } from "../../api/types";
import { parseMoney } from "../../ui/format";
import { localText, NOT_A_TIME, timestampOf } from "../../ui/moment";

export interface Draft {
  name: string;
  project: string;
  frames: string;
  width: string;
  height: string;
  spp: string;
  /** Largest noise of an image, in per cent of its mean. Empty: samples are given. */
  error: string;
  integrator: "" | "ambient" | "path";
  cache: "" | "on" | "off";
  bounces: string;
  deadline: string;
  confidence: Confidence;
  budget: string;
  priority: string;
  ladders: boolean;
  /** Whether the noise of the images is removed. */
  denoise: boolean;
  /** Whether a video is made of the frames. */
  video: boolean;
  /** Name of another renderer, and its version if one is wanted: `cycles 5.0`. Empty for our own. */
  renderer: string;
  /** The request that is changed. What the form does not ask stays as it was there. */
  base: JobRequest | null;
}

/** What cannot be read or is refused, by field. */
export type Wrong = Partial<Record<keyof Draft, string>>;

export function draftFor(bundle: Bundle): Draft {
  const { scene } = bundle;
  return {
    name: scene.name,
    project: "default",
    frames: scene.frames > 1 ? `0-${scene.frames - 1}` : "0",
    width: "",
    height: "",
    spp: "",
    error: "",
    integrator: "",
    cache: "",
    bounces: "",
    deadline: localText(Date.now() + 12 * 3_600_000),
    confidence: "p80",
    budget: "",
    priority: "",
    ladders: false,
    denoise: false,
    video: false,
    // Only Blender files are uploaded of all scenes that our own renderer cannot open.
    renderer: scene.frames === 0 ? "cycles" : "",
    base: null,
  };
}

/** A job that was asked for before, as a draft. */
export function draftOf(job: Job): Draft {
  const settings = job.settings as Partial<Record<string, number | string>>;
  const text = (value: number | string | undefined | null) => (value == null ? "" : String(value));
  const { width, height } = settings;
  // A height that follows from the width is left to follow.
  const follows = sizeOf({ width: text(width), height: "" }, job.scene).height === text(height);
  return {
    name: job.name,
    project: job.project,
    frames: job.frames,
    width: text(width),
    height: follows ? "" : text(height),
    spp: text(settings["spp"] ?? settings["samples"]),
    error: job.error_target ? String(job.error_target.ppm / 1e4) : "",
    integrator: (settings["integrator"] as Draft["integrator"]) ?? "",
    cache: (settings["cache"] as Draft["cache"]) ?? "",
    bounces: text(settings["ambient_bounces"]),
    deadline: job.deadline ? localText(Date.parse(job.deadline)) : "",
    confidence: job.confidence,
    budget: job.budget == null ? "" : String(job.budget / 1e6),
    priority: job.priority ? String(job.priority) : "",
    ladders: job.ladders === "all",
    denoise: job.denoise ?? false,
    video: job.video != null,
    renderer: job.renderer ? [job.renderer.name, job.renderer.version ?? ""].join(" ").trim() : "",
    base: requestThatRepeats(job),
  };
}

/** Width and height in pixels as they will be: one of them alone keeps the camera's shape. */
export function sizeOf(
  draft: Pick<Draft, "width" | "height">,
  scene: Bundle["scene"] | null,
): { width: string; height: string } {
  const [width, height] = [draft.width.trim(), draft.height.trim()];
  if (!scene || scene.width === 0 || scene.height === 0 || (width === "") === (height === ""))
    return { width, height };
  const inProportion = (side: string, from: number, to: number) =>
    /^\d{1,7}$/.test(side) ? String(Math.max(1, Math.round((Number(side) * to) / from))) : "";
  return width === ""
    ? { width: inProportion(height, scene.height, scene.width), height }
    : { width, height: inProportion(width, scene.width, scene.height) };
}

/** The request of a draft, and what cannot be read in it, by field. */
export function requestOf(
  draft: Draft,
  bundle: Job["bundle"],
  scene: Bundle["scene"] | null,
): { request: JobRequest; wrong: Wrong } {
  const wrong: Wrong = {};
  const { base } = draft;
  const settings: Record<string, unknown> = base && !base.renderer ? { ...base.settings } : {};
  const numbers = [
    ["width", "width"],
    ["height", "height"],
    ["spp", "spp"],
    ["bounces", "ambient_bounces"],
  ] as const;
  const sized = { ...draft, ...sizeOf(draft, scene) };
  for (const [field, setting] of numbers) {
    const text = sized[field].trim();
    delete settings[setting];
    if (text === "") continue;
    if (/^\d{1,7}$/.test(text)) settings[setting] = Number(text);
    else wrong[field] = "Write a whole number.";
  }
  const error = Number(draft.error.trim().replace(",", "."));
  if (draft.error.trim() !== "" && !(error >= 0.0001 && error <= 100)) {
    wrong.error = "Write a number of per cent such as 1.5.";
  }
  const [renderer, version] = draft.renderer.trim().split(/\s+/);
  for (const setting of ["integrator", "cache"] as const) {
    if (draft[setting]) settings[setting] = draft[setting];
    else delete settings[setting];
  }
  const budget = draft.budget.trim() === "" ? null : parseMoney(draft.budget);
  if (draft.budget.trim() !== "" && budget === null) wrong.budget = "Write an amount such as 12.50.";
  const priority = draft.priority.trim() === "" ? 0 : Number(draft.priority);
  if (!Number.isInteger(priority)) wrong.priority = "Write a whole number.";
  const deadline = draft.deadline === "" ? null : timestampOf(draft.deadline);
  if (draft.deadline !== "" && deadline === null) wrong.deadline = NOT_A_TIME;
  const first: Partial<JobRequest> & Pick<JobRequest, "weight" | "samples"> = { weight: 1, samples: 256 };
  const { renderer: _, video, denoise: __, error_target, within, cache, ...kept } = base ?? first;
  const request: JobRequest = {
    ...kept,
    name: draft.name.trim(),
    project: draft.project.trim() || "default",
    bundle,
    frames: draft.frames.trim(),
    settings: settings as unknown as NonNullable<JobRequest["settings"]>,
    deadline,
    confidence: draft.confidence,
    budget,
    priority,
    // A noise sets the samples: no limit does, frames make their own caches, no samples are compared, and the
    // noise stays.
    ladders: draft.ladders && !(error > 0) ? "all" : "own",
    ...(within && !(error > 0) ? { within } : {}),
    ...(cache && !(error > 0) ? { cache } : {}),
    ...(error > 0 ? { error_target: { ...(error_target ?? {}), ppm: Math.round(error * 1e4) } } : {}),
    ...(draft.denoise && !renderer && !within && !(error > 0) ? { denoise: true } : {}),
    ...(draft.video ? { video: video ?? {} } : {}),
    ...(renderer ? { renderer: { name: renderer, ...(version ? { version } : {}) } } : {}),
    hold: true,
  };
  return { request, wrong };
}

/** Fields of the form by the pointers of the service's answers. */
export function fieldOf(pointer: string | null): keyof Draft | null {
  const known: Record<string, keyof Draft> = {
    "/name": "name",
    "/project": "project",
    "/frames": "frames",
    "/settings/width": "width",
    "/settings/height": "height",
    "/settings/spp": "spp",
    "/error_target": "error",
    "/error_target/ppm": "error",
    "/settings/ambient_bounces": "bounces",
    "/settings/integrator": "integrator",
    "/settings/cache": "cache",
    "/denoise": "denoise",
    "/video": "video",
    "/deadline": "deadline",
    "/budget": "budget",
    "/priority": "priority",
    "/renderer": "renderer",
    "/renderer/name": "renderer",
    "/renderer/version": "renderer",
  };
  return pointer === null ? null : (known[pointer] ?? null);
}
