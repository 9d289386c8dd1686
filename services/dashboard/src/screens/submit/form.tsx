// What is asked for: frames, quality, deadline, confidence, budget.

import { useId } from "preact/hooks";
import { get } from "../../api/client";
import type { Bundle, Confidence, Job, JobRequest } from "../../api/types";
import { parseMoney, timeZone } from "../../ui/format";
import { Choice, Field } from "../../ui/parts";
import { useResource } from "../../ui/resource";
import { CONFIDENCES, localText } from "../job/change";

export interface Draft {
  name: string;
  project: string;
  frames: string;
  width: string;
  height: string;
  spp: string;
  integrator: "" | "ambient" | "path";
  cache: "" | "on" | "off";
  bounces: string;
  deadline: string;
  confidence: Confidence;
  budget: string;
  priority: string;
  ladders: boolean;
  /** Name of another renderer, and its version if one is wanted: `cycles 5.0`. Empty for our own. */
  renderer: string;
}

export function draftFor(bundle: Bundle): Draft {
  const { scene } = bundle;
  return {
    name: scene.name,
    project: "default",
    frames: scene.frames > 1 ? `0-${scene.frames - 1}` : "0",
    width: "",
    height: "",
    spp: "",
    integrator: "",
    cache: "",
    bounces: "",
    deadline: localText(Date.now() + 12 * 3_600_000),
    confidence: "p80",
    budget: "",
    priority: "",
    ladders: false,
    // Only Blender files are uploaded of all scenes that our own renderer cannot open.
    renderer: scene.frames === 0 ? "cycles" : "",
  };
}

/** A job that was asked for before, as a draft. */
export function draftOf(job: Job): Draft {
  const settings = job.settings as Partial<Record<string, number | string>>;
  const text = (value: number | string | undefined | null) => (value == null ? "" : String(value));
  return {
    name: job.name,
    project: job.project,
    frames: job.frames,
    width: text(settings["width"]),
    height: text(settings["height"]),
    spp: text(settings["spp"] ?? settings["samples"]),
    integrator: (settings["integrator"] as Draft["integrator"]) ?? "",
    cache: (settings["cache"] as Draft["cache"]) ?? "",
    bounces: text(settings["ambient_bounces"]),
    deadline: job.deadline ? localText(Date.parse(job.deadline)) : "",
    confidence: job.confidence,
    budget: job.budget == null ? "" : String(job.budget / 1e6),
    priority: job.priority ? String(job.priority) : "",
    ladders: job.ladders === "all",
    renderer: job.renderer ? [job.renderer.name, job.renderer.version ?? ""].join(" ").trim() : "",
  };
}

/** Width and height in pixels as they will be: one of them alone keeps the camera's shape. */
export function sizeOf(draft: Draft, scene: Bundle["scene"] | null): { width: string; height: string } {
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
): { request: JobRequest; wrong: Partial<Record<keyof Draft, string>> } {
  const wrong: Partial<Record<keyof Draft, string>> = {};
  const settings: Record<string, number | string> = {};
  const numbers = [
    ["width", "width"],
    ["height", "height"],
    ["spp", "spp"],
    ["bounces", "ambient_bounces"],
  ] as const;
  const sized = { ...draft, ...sizeOf(draft, scene) };
  for (const [field, setting] of numbers) {
    const text = sized[field].trim();
    if (text === "") continue;
    if (/^\d{1,7}$/.test(text)) settings[setting] = Number(text);
    else wrong[field] = "Write a whole number.";
  }
  const [renderer, version] = draft.renderer.trim().split(/\s+/);
  if (draft.integrator) settings["integrator"] = draft.integrator;
  if (draft.cache) settings["cache"] = draft.cache;
  const budget = draft.budget.trim() === "" ? null : parseMoney(draft.budget);
  if (draft.budget.trim() !== "" && budget === null) wrong.budget = "Write an amount such as 12.50.";
  const priority = draft.priority.trim() === "" ? 0 : Number(draft.priority);
  if (!Number.isInteger(priority)) wrong.priority = "Write a whole number.";
  const request: JobRequest = {
    name: draft.name.trim(),
    project: draft.project.trim() || "default",
    bundle,
    frames: draft.frames.trim(),
    settings: settings as unknown as NonNullable<JobRequest["settings"]>,
    deadline: draft.deadline === "" ? null : new Date(draft.deadline).toISOString(),
    confidence: draft.confidence,
    budget,
    priority,
    ladders: draft.ladders ? "all" : "own",
    ...(renderer ? { renderer: { name: renderer, ...(version ? { version } : {}) } } : {}),
    weight: 1,
    samples: 256,
    hold: true,
  };
  return { request: request, wrong };
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
    "/settings/ambient_bounces": "bounces",
    "/settings/integrator": "integrator",
    "/settings/cache": "cache",
    "/deadline": "deadline",
    "/budget": "budget",
    "/priority": "priority",
    "/renderer": "renderer",
    "/renderer/name": "renderer",
    "/renderer/version": "renderer",
  };
  return pointer === null ? null : (known[pointer] ?? null);
}

export function Fields(props: {
  draft: Draft;
  scene: Bundle["scene"] | null;
  own: boolean;
  wrong: Partial<Record<keyof Draft, string>>;
  change: (part: Partial<Draft>) => void;
}) {
  const { draft, scene, wrong, change } = props;
  const text = (
    name: "name" | "project" | "frames" | "width" | "height" | "spp" | "bounces" | "budget" | "priority",
    label: string,
    hint: string,
    placeholder = "",
  ) => (
    <Field label={label} hint={hint} error={wrong[name] ?? null}>
      {(id) => (
        <input
          id={id}
          value={draft[name]}
          placeholder={placeholder}
          required={name === "name" || name === "frames"}
          onInput={(event) => change({ [name]: event.currentTarget.value })}
        />
      )}
    </Field>
  );
  const size = sizeOf(draft, scene);
  const placeholder = (side: "width" | "height") =>
    size[side] ? `${size[side]}, in proportion` : scene ? `${scene[side]}, of the camera` : "of the camera";
  return (
    <>
      <fieldset>
        <legend>What</legend>
        <div class="columns">
          {text("name", "Name", "How the job is listed.")}
          {text("project", "Project", "It is charged, and its share of the farm is used.", "default")}
          {text("frames", "Frames", "0-47, or 0,5,9-12.")}
        </div>
      </fieldset>
      <fieldset>
        <legend>Quality</legend>
        <div class="columns">
          {text("width", "Width", "Pixels. Alone, it keeps the camera’s shape.", placeholder("width"))}
          {text("height", "Height", "Pixels.", placeholder("height"))}
          {text(
            "spp",
            "Camera samples per pixel",
            "More samples, less noise.",
            props.own ? "16" : "of the scene",
          )}
        </div>
        {props.own && (
          <div class="columns">
            {text("bounces", "Bounces", "Diffuse bounces; 0 is direct light only.", "2")}
            <Field
              label="Light"
              hint="Path tracing has caustics, and more noise."
              error={wrong.integrator ?? null}
            >
              {(id) => (
                <select
                  id={id}
                  value={draft.integrator}
                  onChange={(event) =>
                    change({ integrator: event.currentTarget.value as Draft["integrator"] })
                  }
                >
                  <option value="">default: gathered</option>
                  <option value="ambient">gathered</option>
                  <option value="path">path tracing</option>
                </select>
              )}
            </Field>
            <Field
              label="Irradiance cache"
              hint="Interpolates indirect light between records."
              error={wrong.cache ?? null}
            >
              {(id) => (
                <select
                  id={id}
                  value={draft.cache}
                  onChange={(event) => change({ cache: event.currentTarget.value as Draft["cache"] })}
                >
                  <option value="">default: off</option>
                  <option value="on">on</option>
                  <option value="off">off</option>
                </select>
              )}
            </Field>
          </div>
        )}
        {props.own ? (
          <label>
            <input
              type="checkbox"
              checked={draft.ladders}
              onChange={(event) => change({ ladders: event.currentTarget.checked })}
            />{" "}
            Price other qualities too
            <span class="hint"> (profiles one frame with other settings as well)</span>
          </label>
        ) : (
          <Renderer value={draft.renderer} wrong={wrong.renderer ?? null} change={change} />
        )}
      </fieldset>
      <fieldset>
        <legend>When and how much</legend>
        <div class="columns">
          <Field
            label={`Deadline (${timeZone})`}
            hint="Empty: when nodes are free."
            error={wrong.deadline ?? null}
          >
            {(id) => (
              <input
                id={id}
                type="datetime-local"
                value={draft.deadline}
                onInput={(event) => change({ deadline: event.currentTarget.value })}
              />
            )}
          </Field>
          {text("budget", "Budget", "What the job may cost. Empty: no limit.", "12.50")}
          {text("priority", "Priority", "Among jobs with the same deadline; the greatest goes first.", "0")}
        </div>
        <p class="label">How sure the plan must be</p>
        <Choice
          label="How sure the plan must be"
          value={draft.confidence}
          options={CONFIDENCES}
          choose={(confidence) => change({ confidence })}
        />
      </fieldset>
    </>
  );
}

/** Which renderer opens the scene: those that the farm's nodes have. */
function Renderer(props: { value: string; wrong: string | null; change: (part: Partial<Draft>) => void }) {
  const nodes = useResource((signal) => get("/v1/nodes", { query: { page_size: 200 }, signal }), []);
  const known = (nodes.data?.items ?? []).flatMap((node) => node.capabilities?.renderers ?? []);
  const names = [...new Set(known.flatMap((one) => [one.name, `${one.name} ${one.version}`]))].sort();
  const list = useId();
  return (
    <Field
      label="Renderer"
      hint={
        nodes.data && names.length === 0
          ? "No node of the farm has another renderer yet: the quote waits for one."
          : "With a version, such as “cycles 5.0”, only that one renders the job."
      }
      error={props.wrong}
    >
      {(id) => (
        <>
          <input
            id={id}
            list={list}
            required
            value={props.value}
            onInput={(event) => props.change({ renderer: event.currentTarget.value })}
          />
          <datalist id={list}>
            {names.map((name) => (
              <option key={name} value={name} />
            ))}
          </datalist>
        </>
      )}
    </Field>
  );
}
