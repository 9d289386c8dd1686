// The images of a frame: two of preview, picture and cost map on one another with a slider between them; zoom
// to single pixels; and what is under the pointer.

import { useEffect, useMemo, useState } from "preact/hooks";
import { get } from "../../api/client";
import type { FrameRow, Job, FrameStrip } from "../../api/types";
import { param, setQuery } from "../../state/route";
import { clean, percent, significant } from "../../ui/format";
import { parseFrames } from "../../ui/frames";
import { isTyping } from "../../ui/keys";
import { Choice, Trouble, Waiting } from "../../ui/parts";
import { useResource, useWidth } from "../../ui/resource";
import { readPixels, type Shown } from "./pixels";
import { useZoom } from "./zoom";

const LAYERS = [
  ["image", "Picture"],
  ["preview", "ID preview"],
  ["cost-map", "Cost map"],
] as const;
type LayerName = (typeof LAYERS)[number][0];

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

function exists(row: FrameRow, layer: LayerName): boolean {
  const { artifacts } = row;
  return Boolean(
    layer === "image"
      ? artifacts.image_png
      : layer === "preview"
        ? artifacts.preview_png
        : artifacts.cost_map_png,
  );
}

/** The address names the artefact, so that a new image of a retried frame is not taken for the old one. */
function source(job: string, row: FrameRow, layer: LayerName): string {
  const { artifacts } = row;
  const hash =
    layer === "image"
      ? artifacts.image_png
      : layer === "preview"
        ? artifacts.preview_png
        : artifacts.cost_map_png;
  return `/v1/jobs/${job}/frames/${row.frame}/${layer}.png#${hash ?? ""}`;
}

function Compare(props: { job: Job; row: FrameRow; left: LayerName; right: LayerName }) {
  const { job, row, left, right } = props;
  const [split, setSplit] = useState(50);
  const [size, setSize] = useState<[number, number] | null>(null);
  const [names, setNames] = useState(false);
  const [under, setUnder] = useState<{ x: number; y: number } | null>(null);
  const [box, width] = useWidth<HTMLDivElement>();
  const height = size ? Math.min(640, Math.max(200, Math.round((width * size[1]) / size[0]))) : 320;
  const zoom = useZoom(box, [width, height], size);
  const hasExr = Boolean(row.artifacts.image_exr);
  const small = size !== null && size[0] * size[1] <= 1_200_000;
  const pixels = useResource(
    (signal) => (hasExr && (names || small) ? readPixels(job.id, row.frame, signal) : null),
    [job.id, row.frame, row.artifacts.image_exr, names || small],
  );
  if (!exists(row, right) && !exists(row, left)) {
    return (
      <p class="note">
        Frame {row.frame} has no picture yet. The ID preview is made first, the picture and its cost map when
        it is rendered.
      </p>
    );
  }
  const shown = (layer: LayerName) => (exists(row, layer) ? layer : null);
  const view = zoom.view;
  const style = size
    ? {
        width: `${size[0] * view.scale}px`,
        height: `${size[1] * view.scale}px`,
        transform: `translate(${view.x}px, ${view.y}px)`,
      }
    : {};
  const look = (event: PointerEvent) => {
    const place = box.current?.getBoundingClientRect();
    if (!place || !size) return;
    setUnder({
      x: Math.floor((event.clientX - place.left - view.x) / view.scale),
      y: Math.floor((event.clientY - place.top - view.y) / view.scale),
    });
  };
  const cut = (width * split) / 100 - view.x;
  const layers: [LayerName | null, "under" | "over"][] = [
    [shown(right), "under"],
    [shown(left), "over"],
  ];
  return (
    <>
      <div
        class="compare"
        ref={box}
        tabIndex={0}
        role="group"
        aria-label={`Images of frame ${row.frame}. Plus and minus zoom, arrows move, 0 shows all.`}
        onPointerMove={look}
        onPointerLeave={() => setUnder(null)}
        style={{
          height: `${height}px`,
        }}
      >
        {layers.map(([layer, place]) =>
          layer ? (
            <img
              key={place + layer}
              src={source(job.id, row, layer)}
              alt={`${LAYERS.find(([name]) => name === layer)![1]} of frame ${row.frame}`}
              class={view.scale >= 2 ? "pixelated" : ""}
              draggable={false}
              decoding="async"
              onLoad={(event) => {
                const { naturalWidth, naturalHeight } = event.currentTarget;
                setSize((old) =>
                  old && old[0] === naturalWidth && old[1] === naturalHeight
                    ? old
                    : [naturalWidth, naturalHeight],
                );
              }}
              style={
                place === "over" && size
                  ? { ...style, clipPath: `inset(0 calc(100% - ${cut}px) 0 0)` }
                  : style
              }
            />
          ) : null,
        )}
        {!exists(row, left) && <p class="missing left">{missing(left)}</p>}
        {!exists(row, right) && <p class="missing right">{missing(right)}</p>}
        <span class="divider" style={{ left: `${split}%` }} />
      </div>
      <label class="wipe">
        <span class="unseen">Where the left image ends</span>
        <input
          type="range"
          min="0"
          max="100"
          value={split}
          onInput={(event) => setSplit(Number(event.currentTarget.value))}
        />
      </label>
      <div class="filters">
        <span class="zooming">
          <button type="button" aria-label="Zoom out" onClick={() => zoom.by(0.5)}>
            −
          </button>{" "}
          <span class="number">{percent(view.scale)}</span>{" "}
          <button type="button" aria-label="Zoom in" onClick={() => zoom.by(2)}>
            +
          </button>{" "}
          <button type="button" onClick={zoom.all}>
            Whole image
          </button>
        </span>
        <p class="under-pointer" role="status">
          {pixels.data ? (
            under ? (
              underWords(under, pixels.data.at(under.x, under.y))
            ) : (
              "Point at the image to see object, material and their share of the cost."
            )
          ) : pixels.loading && hasExr && (names || small) ? (
            "Reading the EXR file for names…"
          ) : pixels.error ? (
            pixels.error.message
          ) : hasExr ? (
            <button type="button" class="plain" onClick={() => setNames(true)}>
              Name objects under the pointer (reads the EXR file)
            </button>
          ) : (
            "Names appear once the frame is rendered."
          )}
        </p>
      </div>
    </>
  );
}

function missing(layer: LayerName): string {
  return layer === "preview" ? "No ID preview of this frame" : "Not rendered yet";
}

function underWords(at: { x: number; y: number }, shown: Shown | null): string {
  if (!shown) return "Beside the image.";
  const parts = [`Pixel ${at.x}, ${at.y}: ${shown.object ? clean(shown.object) : "background"}`];
  if (shown.material) parts.push(clean(shown.material));
  if (shown.objectShare !== null && shown.object)
    parts.push(`its object takes ${percent(shown.objectShare, 1)} of the frame’s work`);
  if (shown.timesMean !== null) parts.push(`this pixel ${significant(shown.timesMean, 2)} times the mean`);
  return parts.join(" · ");
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
              <img
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
