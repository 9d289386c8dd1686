// What is asked for: frames, quality, deadline, confidence, budget.

import { useId } from "preact/hooks";
import { get } from "../../api/client";
import type { Bundle } from "../../api/types";
import { Moment } from "../../ui/moment";
import { Choice, Field } from "../../ui/parts";
import { useResource } from "../../ui/resource";
import { CONFIDENCES } from "../job/change";
import { type Draft, sizeOf, type Wrong } from "./draft";

type Change = (part: Partial<Draft>) => void;

interface Asked {
  draft: Draft;
  wrong: Wrong;
  change: Change;
}

export function Fields(props: Asked & { scene: Bundle["scene"] | null; own: boolean }) {
  const { draft, scene, wrong, change } = props;
  const asked = { draft, wrong, change };
  const size = sizeOf(draft, scene);
  const placeholder = (side: "width" | "height") =>
    size[side] ? `${size[side]}, in proportion` : scene ? `${scene[side]}, of the camera` : "of the camera";
  return (
    <>
      <fieldset>
        <legend>What</legend>
        <div class="columns">
          <Text {...asked} name="name" label="Name" hint="How the job is listed." />
          <Text
            {...asked}
            name="project"
            label="Project"
            hint="It is charged, and its share of the farm is used."
            placeholder="default"
          />
          <Text {...asked} name="frames" label="Frames" hint="0-47, or 0,5,9-12." />
        </div>
        <label>
          <input
            type="checkbox"
            checked={draft.video}
            onChange={(event) => change({ video: event.currentTarget.checked })}
          />{" "}
          Make a video
          <span class="hint"> (when the last frame is finished, by a node with ffmpeg)</span>
        </label>
        {wrong.video && (
          <p class="wrong-text" role="alert">
            {wrong.video}
          </p>
        )}
      </fieldset>
      <fieldset>
        <legend>Quality</legend>
        <div class="columns">
          <Text
            {...asked}
            name="width"
            label="Width"
            hint="Pixels. Alone, it keeps the camera’s shape."
            placeholder={placeholder("width")}
          />
          <Text {...asked} name="height" label="Height" hint="Pixels." placeholder={placeholder("height")} />
          <Text
            {...asked}
            name="spp"
            label="Camera samples per pixel"
            hint={draft.error.trim() ? "Of the profile; 4 or more." : "More samples, less noise."}
            placeholder={props.own ? "16" : "of the scene"}
          />
        </div>
        {props.own ? (
          <OwnQuality {...asked} />
        ) : (
          <Renderer value={draft.renderer} wrong={wrong.renderer ?? null} change={change} />
        )}
      </fieldset>
      <Terms {...asked} />
    </>
  );
}

/** A field of one line of text. */
function Text(
  props: Asked & {
    name:
      | "name"
      | "project"
      | "frames"
      | "width"
      | "height"
      | "spp"
      | "error"
      | "bounces"
      | "budget"
      | "priority";
    label: string;
    hint: string;
    placeholder?: string;
  },
) {
  const { name } = props;
  return (
    <Field label={props.label} hint={props.hint} error={props.wrong[name] ?? null}>
      {(id) => (
        <input
          id={id}
          value={props.draft[name]}
          placeholder={props.placeholder ?? ""}
          required={name === "name" || name === "frames"}
          onInput={(event) => props.change({ [name]: event.currentTarget.value })}
        />
      )}
    </Field>
  );
}

/** What only our own renderer is asked for. */
function OwnQuality(props: Asked) {
  const { draft, wrong, change } = props;
  /** Whether an error or a limit chooses the samples. */
  const chosen = draft.error.trim() !== "" || draft.base?.within != null;
  return (
    <>
      <div class="columns">
        <Text
          {...props}
          name="error"
          label="Noise at most"
          hint="Per cent of the image’s mean, such as 2. Samples then go where they help."
          placeholder="as the samples make it"
        />
        <Text
          {...props}
          name="bounces"
          label="Bounces"
          hint="Diffuse bounces; 0 is direct light only."
          placeholder="2"
        />
        <Field
          label="Light"
          hint="Path tracing has caustics, and more noise."
          error={wrong.integrator ?? null}
        >
          {(id) => (
            <select
              id={id}
              value={draft.integrator}
              onChange={(event) => change({ integrator: event.currentTarget.value as Draft["integrator"] })}
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
      <p>
        <label>
          <input
            type="checkbox"
            checked={draft.ladders && !draft.error.trim()}
            disabled={draft.error.trim() !== ""}
            onChange={(event) => change({ ladders: event.currentTarget.checked })}
          />{" "}
          Price other qualities too
          <span class="hint"> (profiles one frame with other settings as well)</span>
        </label>
      </p>
      <p>
        <label>
          <input
            type="checkbox"
            checked={draft.denoise && !chosen}
            disabled={chosen}
            onChange={(event) => change({ denoise: event.currentTarget.checked })}
          />{" "}
          Remove the noise
          <span class="hint"> (by nodes with Open Image Denoise; the error that is left is measured)</span>
        </label>
      </p>
      {wrong.denoise && (
        <p class="wrong-text" role="alert">
          {wrong.denoise}
        </p>
      )}
    </>
  );
}

function Terms(props: Asked) {
  const { draft, wrong, change } = props;
  return (
    <fieldset>
      <legend>When and how much</legend>
      <div class="columns">
        <Moment
          label="Deadline"
          hint="Empty: when nodes are free."
          error={wrong.deadline ?? null}
          value={draft.deadline}
          change={(deadline) => change({ deadline })}
        />
        <Text
          {...props}
          name="budget"
          label="Budget"
          hint="What the job may cost. Empty: no limit."
          placeholder="12.50"
        />
        <Text
          {...props}
          name="priority"
          label="Priority"
          hint="Among jobs with the same deadline; the greatest goes first."
          placeholder="0"
        />
      </div>
      <p class="label">How sure the plan must be</p>
      <Choice
        label="How sure the plan must be"
        value={draft.confidence}
        options={CONFIDENCES}
        choose={(confidence) => change({ confidence })}
      />
    </fieldset>
  );
}

/** Which renderer opens the scene: those that the farm's nodes have. */
function Renderer(props: { value: string; wrong: string | null; change: Change }) {
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
