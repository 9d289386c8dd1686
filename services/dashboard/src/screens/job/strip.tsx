// The frame strip: one cell a frame, thousands of frames. Height and sign tell a state, colour helps.

import { useEffect, useRef, useState } from "preact/hooks";
import { colour, theme } from "../../ui/theme";
import { useWidth } from "../../ui/resource";
import { cellAt, layOut, type StripLayout } from "./strip-layout";

export const STATES: Record<string, string> = {
  w: "waiting",
  b: "booked",
  r: "running",
  d: "done",
  f: "failed",
  c: "cancelled",
};

export interface StripProps {
  /** Frame numbers, ascending, and a letter of `STATES` for each. */
  frames: number[];
  states: string;
  /** Actual ÷ forecast of each frame, if the strip shows that. */
  ratios: (number | null)[] | null;
  /** Indices of selected frames. */
  selected: ReadonlySet<number>;
  select: (indices: Set<number>) => void;
  cursor: number | null;
  setCursor: (index: number | null) => void;
  open: (index: number) => void;
  /** A cell in words, for people who do not see it. */
  describe: (index: number) => string;
}

export function Strip(props: StripProps) {
  const [box, width] = useWidth<HTMLDivElement>();
  const canvas = useRef<HTMLCanvasElement>(null);
  const drag = useRef<{ from: number; keep: ReadonlySet<number> } | null>(null);
  /** The cells under a drag. They become the selection when it ends. */
  const [dragged, setDragged] = useState<ReadonlySet<number> | null>(null);
  /** Where a selection with Shift begins. */
  const anchor = useRef<number | null>(null);
  const selected = dragged ?? props.selected;
  const layout = layOut(props.frames.length, width || 600);
  const look = theme.value;

  useEffect(() => {
    if (width > 0 && canvas.current) paint(canvas.current, layout, width, { ...props, selected });
  }, [width, look, props.states, props.ratios, selected, props.cursor, props.frames.length]);

  const at = (event: PointerEvent) => {
    const place = canvas.current!.getBoundingClientRect();
    return cellAt(layout, event.clientX - place.left, event.clientY - place.top);
  };
  const move = (to: number, extend: boolean) => {
    const next = Math.min(props.frames.length - 1, Math.max(0, to));
    if (extend) {
      anchor.current ??= props.cursor ?? next;
      props.select(stretch(anchor.current, next, new Set()));
    } else anchor.current = null;
    props.setCursor(next);
  };
  const press = (event: KeyboardEvent) => {
    const now = props.cursor ?? -1;
    const steps: Record<string, number> = {
      ArrowRight: now + 1,
      ArrowLeft: Math.max(0, now - 1),
      ArrowDown: now + layout.perRow,
      ArrowUp: now - layout.perRow,
      Home: 0,
      End: props.frames.length - 1,
    };
    const to = steps[event.key];
    if (to !== undefined) move(to, event.shiftKey);
    else if (event.key === "Enter" && now >= 0) props.open(now);
    else if (event.key === " " && now >= 0) toggle(now);
    else if (event.key === "Escape") props.select(new Set());
    else if (event.key === "a" && (event.ctrlKey || event.metaKey))
      props.select(stretch(0, props.frames.length - 1, new Set()));
    else return;
    event.preventDefault();
  };
  const toggle = (index: number) => {
    const next = new Set(props.selected);
    if (!next.delete(index)) next.add(index);
    props.select(next);
  };

  return (
    <div ref={box} class="strip-box">
      <div
        class="strip"
        role="slider"
        tabIndex={0}
        aria-label="Frames"
        aria-valuemin={props.frames[0] ?? 0}
        aria-valuemax={props.frames[props.frames.length - 1] ?? 0}
        aria-valuenow={props.frames[props.cursor ?? 0] ?? 0}
        aria-valuetext={props.cursor === null ? "No frame chosen" : props.describe(props.cursor)}
        onKeyDown={press}
        onPointerDown={(event) => {
          if (event.button !== 0) return;
          const index = at(event);
          const keep = event.ctrlKey || event.metaKey ? props.selected : new Set<number>();
          if (!event.shiftKey || anchor.current === null) anchor.current = index;
          drag.current = { from: anchor.current, keep };
          canvas.current!.setPointerCapture(event.pointerId);
          setDragged(stretch(drag.current.from, index, keep));
          props.setCursor(index);
        }}
        onPointerMove={(event) => {
          const index = at(event);
          if (drag.current && index !== props.cursor)
            setDragged(stretch(drag.current.from, index, drag.current.keep));
          props.setCursor(index);
        }}
        onPointerUp={(event) => {
          if (!drag.current) return;
          props.select(stretch(drag.current.from, at(event), drag.current.keep));
          drag.current = null;
          setDragged(null);
        }}
        onPointerCancel={() => {
          drag.current = null;
          setDragged(null);
        }}
        onPointerLeave={() => drag.current === null && props.setCursor(null)}
        onDblClick={() => props.cursor !== null && props.open(props.cursor)}
      >
        <canvas ref={canvas} style={{ width: `${width}px`, height: `${layout.rows * layout.cell[1]}px` }} />
      </div>
    </div>
  );
}

function stretch(from: number, to: number, keep: ReadonlySet<number>): Set<number> {
  const next = new Set(keep);
  for (let index = Math.min(from, to); index <= Math.max(from, to); index++) next.add(index);
  return next;
}

function paint(canvas: HTMLCanvasElement, layout: StripLayout, width: number, props: StripProps): void {
  const scale = devicePixelRatio || 1;
  const [w, h] = layout.cell;
  canvas.width = width * scale;
  canvas.height = layout.rows * h * scale;
  const draw = canvas.getContext("2d");
  if (!draw) return;
  draw.scale(scale, scale);
  draw.clearRect(0, 0, width, layout.rows * h);
  const colours = palette();
  const gap = w > 5 ? 1 : w > 3 ? 0.5 : 0;
  if (layout.left > 0) {
    draw.fillStyle = colours.muted;
    draw.font = "12px system-ui, sans-serif";
    draw.textBaseline = "middle";
    draw.textAlign = "right";
    draw.fillText("state", layout.left - 9, h / 2);
  }
  for (let index = 0; index < layout.count; index++) {
    const x = layout.left + (index % layout.perRow) * w;
    const y = Math.floor(index / layout.perRow) * h;
    // Low rows have no room for a line below a selected cell: there the ground behind it is coloured.
    const low = h < 14;
    const cell: Cell = low ? { x, y: y + 1, w: w - gap, h: h - 3 } : { x, y: y + 2, w: w - gap, h: h - 5 };
    if (low && props.selected.has(index)) {
      draw.fillStyle = colours.chosen;
      draw.fillRect(x, y, w, h - 1);
    }
    const state = props.states[index] ?? "w";
    const ratio = props.ratios?.[index];
    if (props.ratios && ratio != null) fill(draw, cell, 1, ratioColour(ratio, colours));
    else paintState(draw, cell, props.ratios && state === "d" ? "w" : state, colours);
    if (!low && props.selected.has(index)) {
      draw.fillStyle = colours.text;
      draw.fillRect(x, y + h - 2, w, 2);
    }
    if (props.cursor === index) {
      draw.strokeStyle = colours.text;
      draw.lineWidth = 1.5;
      draw.strokeRect(x - 0.75, y + 1.25, Math.max(w, 3) + 0.5, h - 3.5);
    }
  }
}

interface Cell {
  x: number;
  y: number;
  w: number;
  h: number;
}

type Palette = Record<
  | "text"
  | "chosen"
  | "muted"
  | "good"
  | "busy"
  | "bad"
  | "plan"
  | "line"
  | "sunk"
  | "surface"
  | "warn"
  | "cheap"
  | "mid",
  string
>;

function palette(): Palette {
  return {
    text: colour("text"),
    muted: colour("muted"),
    chosen: colour("chosen"),
    good: colour("good-soft"),
    busy: colour("busy"),
    bad: colour("bad"),
    plan: colour("line-strong"),
    line: colour("plan-soft"),
    sunk: colour("sunk"),
    surface: colour("surface"),
    warn: colour("warn"),
    cheap: colour("accent"),
    mid: colour("plan-soft"),
  };
}

function fill(draw: CanvasRenderingContext2D, cell: Cell, share: number, style: string): void {
  draw.fillStyle = style;
  const high = Math.max(1, cell.h * share);
  draw.fillRect(cell.x, cell.y + cell.h - high, cell.w, high);
}

/** Waiting is a low line, booked an empty box, running half full, done full, failed full with a cross. */
function paintState(draw: CanvasRenderingContext2D, cell: Cell, state: string, colours: Palette): void {
  switch (state) {
    case "d":
      fill(draw, cell, 1, colours.good);
      break;
    case "r":
      fill(draw, cell, 1, colours.sunk);
      fill(draw, cell, 0.55, colours.busy);
      break;
    case "f":
      fill(draw, cell, 1, colours.bad);
      draw.strokeStyle = colours.surface;
      draw.lineWidth = 1.25;
      draw.beginPath();
      draw.moveTo(cell.x + 1, cell.y + cell.h / 2 - 3);
      draw.lineTo(cell.x + cell.w - 1, cell.y + cell.h / 2 + 3);
      draw.moveTo(cell.x + cell.w - 1, cell.y + cell.h / 2 - 3);
      draw.lineTo(cell.x + 1, cell.y + cell.h / 2 + 3);
      draw.stroke();
      break;
    case "b":
      draw.strokeStyle = colours.plan;
      draw.lineWidth = 1;
      if (cell.w >= 4) draw.strokeRect(cell.x + 0.5, cell.y + 0.5, cell.w - 1, cell.h - 1);
      else fill(draw, cell, 0.4, colours.plan);
      break;
    case "c":
      draw.fillStyle = colours.line;
      draw.fillRect(cell.x, cell.y + cell.h / 2 - 0.75, cell.w, 1.5);
      break;
    default:
      fill(draw, cell, 0.14, colours.line);
  }
}

/** Cheaper than forecast is blue, as forecast is grey, dearer is amber, far dearer red. */
export function ratioColour(ratio: number, colours: Pick<Palette, "cheap" | "mid" | "warn" | "bad">): string {
  if (ratio < 0.9) return colours.cheap;
  if (ratio <= 1.1) return colours.mid;
  if (ratio <= 1.3) return colours.warn;
  return colours.bad;
}
