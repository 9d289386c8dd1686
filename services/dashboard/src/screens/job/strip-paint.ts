// How the frame strip is painted. Height and sign tell a state, colour helps.

import { colour } from "../../ui/theme";
import type { StripProps } from "./strip";
import type { StripLayout } from "./strip-layout";

type Painted = Pick<StripProps, "states" | "ratios" | "selected" | "cursor">;

export function paint(canvas: HTMLCanvasElement, layout: StripLayout, width: number, shown: Painted): void {
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
    if (low && shown.selected.has(index)) {
      draw.fillStyle = colours.chosen;
      draw.fillRect(x, y, w, h - 1);
    }
    const state = shown.states[index] ?? "w";
    const ratio = shown.ratios?.[index];
    if (shown.ratios && ratio != null) fill(draw, cell, 1, ratioColour(ratio, colours));
    else paintState(draw, cell, shown.ratios && state === "d" ? "w" : state, colours);
    if (!low && shown.selected.has(index)) {
      draw.fillStyle = colours.text;
      draw.fillRect(x, y + h - 2, w, 2);
    }
    if (shown.cursor === index) {
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
function ratioColour(ratio: number, colours: Pick<Palette, "cheap" | "mid" | "warn" | "bad">): string {
  if (ratio < 0.9) return colours.cheap;
  if (ratio <= 1.1) return colours.mid;
  if (ratio <= 1.3) return colours.warn;
  return colours.bad;
}
