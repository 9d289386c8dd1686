// Two images of a frame on one another with a slider between them; zoom to single pixels; and what is under the
// pointer or the crosshair.

import { useState } from "preact/hooks";
import type { FrameRow, Job } from "../../api/types";
import { numbersOf, numbersText, useAddressed } from "../../state/addressed";
import { clean, percent, significant } from "../../ui/format";
import { type Resource, useResource, useWidth } from "../../ui/resource";
import { crossed, type Pixel, placeOf } from "./crosshair";
import { Picture } from "./picture";
import { type Pixels, readPixels, type Shown } from "./pixels";
import { useZoom, type View, type Zoom } from "./zoom";

export const LAYERS = [
  ["image", "Picture"],
  ["preview", "ID preview"],
  ["cost-map", "Cost map"],
] as const;
export type LayerName = (typeof LAYERS)[number][0];

/** Images of at most so many pixels are read for names without being asked. */
const SMALL = 1_200_000;

interface Compared {
  job: Job;
  row: FrameRow;
  left: LayerName;
  right: LayerName;
}

export function Compare(asked: Compared) {
  const { job, row } = asked;
  // Before a frame is rendered, its ID preview is all that there is.
  const isEarly = !exists(row, asked.left) && !exists(row, asked.right) && exists(row, "preview");
  const props: Compared = isEarly ? { ...asked, left: "preview", right: "preview" } : asked;
  const { left, right } = props;
  const [wipe, setWipe] = useAddressed("wipe");
  const split = Math.min(100, Math.max(0, numbersOf(wipe, 1)?.[0] ?? 50));
  const [size, setSize] = useState<[number, number] | null>(null);
  const [names, setNames] = useState(false);
  const [under, setUnder] = useState<Pixel | null>(null);
  const [pixel, setPixel] = useAddressed("pixel");
  const cross = numbersOf(pixel, 2) as Pixel | null;
  const [box, width] = useWidth<HTMLDivElement>();
  const height = size ? Math.min(640, Math.max(200, Math.round((width * size[1]) / size[0]))) : 320;
  const zoom = useZoom(box, [width, height], size, cross);
  const { view } = zoom;
  const small = size !== null && size[0] * size[1] <= SMALL;
  const wanted = Boolean(row.artifacts.image_exr) && (names || small || cross !== null);
  const pixels = useResource(
    (signal) => (wanted ? readPixels(job.id, row.frame, signal) : null),
    [job.id, row.frame, row.artifacts.image_exr, wanted],
  );
  if (!exists(row, right) && !exists(row, left)) {
    return (
      <p class="note">
        Frame {row.frame} has no picture yet. The ID preview is made first, the picture and its cost map when
        it is rendered.
      </p>
    );
  }
  const look = (event: PointerEvent) => {
    const place = box.current?.getBoundingClientRect();
    // Browsers also say that the pointer moved where the page did.
    if (!place || !size || (cross && event.movementX === 0 && event.movementY === 0)) return;
    setUnder([
      Math.floor((event.clientX - place.left - view.x) / view.scale),
      Math.floor((event.clientY - place.top - view.y) / view.scale),
    ]);
  };
  const press = (event: KeyboardEvent) => {
    if (event.key === "Escape" && cross) return setPixel(null);
    const next = event.shiftKey && size && crossed(cross, event.key, view, [width, height], size);
    if (!next) return;
    event.preventDefault();
    setUnder(null);
    setPixel(numbersText(next));
    zoom.reveal(...placeOf(next, view));
  };
  return (
    <>
      <div
        class="compare"
        ref={box}
        tabIndex={0}
        role="group"
        aria-label={`Images of frame ${row.frame}. Plus and minus zoom, arrows move, 0 shows all. Arrows with Shift move a crosshair: what lies under it is told below.`}
        onPointerMove={look}
        onPointerLeave={() => setUnder(null)}
        onKeyDown={press}
        style={{ height: `${height}px` }}
      >
        <Layers {...props} view={view} size={size} cut={(width * split) / 100 - view.x} sized={setSize} />
        <span class="divider" style={{ left: `${split}%` }} />
        {cross && <Cross at={placeOf(cross, view)} />}
      </div>
      {isEarly && <p class="note">Frame {row.frame} is not rendered yet. This is its ID preview.</p>}
      <Wipe split={split} set={setWipe} />
      <div class="filters">
        <Zooming zoom={zoom} />
        <p class="under-pointer" role="status">
          <Under at={under ?? cross} pixels={pixels} row={row} wanted={wanted} ask={() => setNames(true)} />
        </p>
      </div>
    </>
  );
}

function Wipe(props: { split: number; set: (percent: string) => void }) {
  return (
    <label class="wipe">
      <span class="unseen">Where the left image ends</span>
      <input
        type="range"
        min="0"
        max="100"
        value={props.split}
        onInput={(event) => props.set(event.currentTarget.value)}
      />
    </label>
  );
}

function Zooming(props: { zoom: Zoom }) {
  const { zoom } = props;
  return (
    <span class="zooming">
      <button type="button" aria-label="Zoom out" onClick={() => zoom.by(0.5)}>
        −
      </button>{" "}
      <span class="number">{percent(zoom.view.scale)}</span>{" "}
      <button type="button" aria-label="Zoom in" onClick={() => zoom.by(2)}>
        +
      </button>{" "}
      <button type="button" onClick={zoom.all}>
        Whole image
      </button>
    </span>
  );
}

/** The two images, or words where one is missing. */
function Layers(
  props: Compared & {
    view: View;
    size: [number, number] | null;
    /** Where the left image ends, CSS pixels of the image. */
    cut: number;
    sized: (size: [number, number]) => void;
  },
) {
  const { job, row, left, right, view, size } = props;
  const style = size
    ? {
        width: `${size[0] * view.scale}px`,
        height: `${size[1] * view.scale}px`,
        transform: `translate(${view.x}px, ${view.y}px)`,
      }
    : {};
  const layers = [
    [right, "under"],
    [left, "over"],
  ] as const;
  return (
    <>
      {layers.map(([layer, place]) =>
        exists(row, layer) ? (
          <Picture
            key={place + layer}
            lost={
              <p class={`missing ${place === "over" ? "left" : "right"}`}>This image could not be loaded.</p>
            }
            src={source(job.id, row, layer)}
            alt={`${LAYERS.find(([name]) => name === layer)![1]} of frame ${row.frame}`}
            class={view.scale >= 2 ? "pixelated" : ""}
            draggable={false}
            decoding="async"
            onLoad={(event) => {
              const { naturalWidth, naturalHeight } = event.currentTarget;
              if (size?.[0] !== naturalWidth || size[1] !== naturalHeight)
                props.sized([naturalWidth, naturalHeight]);
            }}
            style={
              place === "over" && size
                ? { ...style, clipPath: `inset(0 calc(100% - ${props.cut}px) 0 0)` }
                : style
            }
          />
        ) : null,
      )}
      {!exists(row, left) && <p class="missing left">{missing(left)}</p>}
      {!exists(row, right) && <p class="missing right">{missing(right)}</p>}
    </>
  );
}

function Cross(props: { at: Pixel }) {
  const [x, y] = props.at;
  return (
    <>
      <span class="cross down" style={{ left: `${x}px` }} />
      <span class="cross across" style={{ top: `${y}px` }} />
    </>
  );
}

/** What lies at a pixel, or how that can be known. */
function Under(props: {
  at: Pixel | null;
  pixels: Resource<Pixels>;
  row: FrameRow;
  wanted: boolean;
  ask: () => void;
}) {
  const { at, pixels, wanted } = props;
  if (pixels.data)
    return at ? (
      <>{underWords(at, pixels.data.at(...at))}</>
    ) : (
      <>
        Point at the image, or press Shift and an arrow on it, to see object, material and their share of the
        cost.
      </>
    );
  if (pixels.loading && wanted) return <>Reading the EXR file for names…</>;
  if (pixels.error) return <>{pixels.error.message}</>;
  if (!props.row.artifacts.image_exr) return <>Names appear once the frame is rendered.</>;
  return (
    <button type="button" class="plain" onClick={props.ask}>
      Name objects under the pointer (reads the EXR file)
    </button>
  );
}

function exists(row: FrameRow, layer: LayerName): boolean {
  return Boolean(artifact(row, layer));
}

function artifact({ artifacts }: FrameRow, layer: LayerName): string | null | undefined {
  return layer === "image"
    ? artifacts.image_png
    : layer === "preview"
      ? artifacts.preview_png
      : artifacts.cost_map_png;
}

/** The address names the artefact, so that a new image of a retried frame is not taken for the old one. */
function source(job: string, row: FrameRow, layer: LayerName): string {
  return `/v1/jobs/${job}/frames/${row.frame}/${layer}.png#${artifact(row, layer) ?? ""}`;
}

function missing(layer: LayerName): string {
  return layer === "preview" ? "No ID preview of this frame" : "Not rendered yet";
}

function underWords([x, y]: Pixel, shown: Shown | null): string {
  if (!shown) return "Beside the image.";
  const parts = [`Pixel ${x}, ${y}: ${shown.object ? clean(shown.object) : "background"}`];
  if (shown.material) parts.push(clean(shown.material));
  if (shown.objectShare !== null && shown.object)
    parts.push(`its object takes ${percent(shown.objectShare, 1)} of the frame’s work`);
  if (shown.timesMean !== null) parts.push(`this pixel ${significant(shown.timesMean, 2)} times the mean`);
  return parts.join(" · ");
}
