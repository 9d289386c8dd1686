// Which frame's images are shown, and which two of preview, picture and cost map.

import { useEffect, useMemo } from "preact/hooks";
import { get } from "../../api/client";
import type { FrameRow, Job, FrameStrip } from "../../api/types";
import { param, setQuery } from "../../state/route";
import { parseFrames } from "../../ui/frames";
import { isTyping } from "../../ui/keys";
import { Choice, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";
import { Compare, type LayerName, LAYERS } from "./compare";
import { Picture } from "./picture";

export function Images(props: { job: Job; strip: FrameStrip | null }) {
  const { job, strip } = props;
  const numbers = useMemo(() => (strip ? (parseFrames(strip.frames) ?? []) : []), [strip?.frames]);
  const firstDone = strip ? Math.max(0, strip.states.indexOf("d")) : 0;
  const frame = Number(param("frame") ?? numbers[firstDone] ?? 0);
  const at = numbers.indexOf(frame);
  const left = layerOf(param("left"), "cost-map");
  const right = layerOf(param("right"), "image");
  const state = strip?.states[at] ?? "w";
  const row = useResource<FrameRow>(
    (signal) =>
      numbers.length ? get("/v1/jobs/{id}/frames/{frame}", { path: { id: job.id, frame }, signal }) : null,
    [job.id, frame, state],
    // Previews are made while all frames wait.
    job.state,
  );
  const step = (by: number) => {
    const next = numbers[Math.min(numbers.length - 1, Math.max(0, at + by))];
    if (next !== undefined) setQuery({ frame: String(next) });
  };
  useEffect(() => {
    const press = (event: KeyboardEvent) => {
      if (isTyping(event) || document.querySelector("dialog[open]")) return;
      if (event.key === ",") step(-1);
      if (event.key === ".") step(1);
    };
    addEventListener("keydown", press);
    return () => removeEventListener("keydown", press);
  });

  return (
    <div class="images">
      <div class="filters">
        <span class="stepper">
          <button type="button" onClick={() => step(-1)} disabled={at <= 0} aria-label="Frame before">
            ‹
          </button>{" "}
          Frame <span class="number">{frame}</span>{" "}
          <button
            type="button"
            onClick={() => step(1)}
            disabled={at >= numbers.length - 1}
            aria-label="Next frame"
          >
            ›
          </button>
        </span>
        <label>
          Left{" "}
          <select value={left} onChange={(event) => setQuery({ left: event.currentTarget.value })}>
            {LAYERS.map(([value, word]) => (
              <option key={value} value={value}>
                {word}
              </option>
            ))}
          </select>
        </label>
        <Choice label="Right" value={right} options={LAYERS} choose={(value) => setQuery({ right: value })} />
      </div>
      {row.data ? (
        <Compare job={job} row={row.data} left={left} right={right} />
      ) : row.error ? (
        <Trouble error={row.error} retry={row.reload} />
      ) : (
        <Waiting>Asking for frame {frame}…</Waiting>
      )}
      <Thumbnails job={job} numbers={numbers} states={strip?.states ?? ""} frame={frame} />
    </div>
  );
}

function layerOf(name: string | null, otherwise: LayerName): LayerName {
  return LAYERS.find(([layer]) => layer === name)?.[0] ?? otherwise;
}

/** Finished frames around the chosen one. The browser loads those in view. */
function Thumbnails(props: { job: Job; numbers: number[]; states: string; frame: number }) {
  const at = Math.max(0, props.numbers.indexOf(props.frame));
  const from = Math.max(0, Math.min(at - 12, props.numbers.length - 25));
  const around = props.numbers
    .slice(from, from + 25)
    .map((frame, index) => [frame, props.states[from + index]] as const);
  return (
    <ul class="thumbnails" aria-label="Frames nearby">
      {around.map(([frame, state]) => (
        <li key={frame}>
          <button
            type="button"
            aria-pressed={frame === props.frame}
            onClick={() => setQuery({ frame: String(frame) })}
          >
            {state === "d" ? (
              <Picture
                lost={<span class="no-image" />}
                src={`/v1/jobs/${props.job.id}/frames/${frame}/image.png`}
                alt=""
                loading="lazy"
                decoding="async"
                width={96}
                height={54}
              />
            ) : (
              <span class="no-image" />
            )}
            <span class="number">{frame}</span>
            {state !== "d" && <span class="unseen"> not done</span>}
          </button>
        </li>
      ))}
    </ul>
  );
}
