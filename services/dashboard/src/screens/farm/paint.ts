// Draws the chart: rows of nodes, spans of jobs. Only what is in view is drawn.

import { ticks } from "../../ui/time-axis";
import { colour } from "../../ui/theme";
import type { Row, Span, Stretch } from "./timeline";
import type { Hit } from "./walk";

export const ROW = 24;
export const HEAD = 24;

export interface Move {
  row: number;
  from: [start: number, end: number] | null;
  to: [start: number, end: number] | null;
  /** Row before, if the frame changes its node. */
  rowBefore: number;
  job: string;
}

export interface Drawing {
  width: number;
  height: number;
  /** How far the rows are scrolled, CSS pixels. */
  scroll: number;
  view: Stretch;
  now: number;
  rows: readonly Row[];
  jobs: ReadonlyMap<string, string>;
  /** A job whose spans stand out. */
  marked: string | null;
  /** Where keys lead: the place of a row, and what is there at an instant. */
  cursor: { row: number; span: Span | null; at: number } | null;
  /** Moves of a new plan, and how far they are played, 0 to 1. */
  moves: readonly Move[];
  played: number;
}

export interface Colours {
  text: string;
  muted: string;
  ground: string;
  line: string;
  sunk: string;
  surface: string;
  accent: string;
  bad: string;
  hues: [fill: string, soft: string][];
}

const HUES = [210, 150, 28, 280, 185, 340, 95, 245];

/** Colours of the present theme. */
export function chartColours(dark: boolean): Colours {
  const hues = HUES.map((hue): [string, string] =>
    dark ? [`hsl(${hue} 38% 42%)`, `hsl(${hue} 24% 25%)`] : [`hsl(${hue} 42% 66%)`, `hsl(${hue} 40% 87%)`],
  );
  return {
    text: colour("text"),
    muted: colour("muted"),
    ground: colour("ground"),
    line: colour("line"),
    sunk: colour("sunk"),
    surface: colour("surface"),
    accent: colour("accent"),
    bad: colour("bad"),
    hues,
  };
}

/** A colour of its own for each job, the same on every screen and day. */
export function hueOf(job: string, colours: Colours): [fill: string, soft: string] {
  let hash = 0;
  for (let at = 0; at < job.length; at++) hash = (hash * 31 + job.charCodeAt(at)) | 0;
  return colours.hues[Math.abs(hash) % colours.hues.length]!;
}

export function paint(canvas: HTMLCanvasElement, drawing: Drawing, colours: Colours): void {
  const { width, height, view } = drawing;
  const scale = devicePixelRatio || 1;
  const pixels = [Math.round(width * scale), Math.round(height * scale)] as const;
  if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) [canvas.width, canvas.height] = pixels;
  const draw = canvas.getContext("2d", { alpha: false });
  if (!draw) return;
  draw.setTransform(scale, 0, 0, scale, 0, 0);
  draw.fillStyle = colours.ground;
  draw.fillRect(0, 0, width, height);
  draw.font = "12px system-ui, sans-serif";
  draw.textBaseline = "middle";
  letter = draw.measureText("sh0120_lighting_v12 0-47").width / 24;
  const x = (at: number) => ((at - view.from) / (view.to - view.from)) * width;
  const lines = ticks(view.from, view.to, Math.max(2, width / 90), drawing.now);

  draw.save();
  draw.beginPath();
  draw.rect(0, HEAD, width, height - HEAD);
  draw.clip();
  draw.fillStyle = colours.line;
  for (const { at } of lines) draw.fillRect(Math.round(x(at)), HEAD, 1, height);
  const first = Math.max(0, Math.floor(drawing.scroll / ROW));
  const last = Math.min(drawing.rows.length, Math.ceil((drawing.scroll + height - HEAD) / ROW));
  for (let row = first; row < last; row++) {
    const y = HEAD + row * ROW - drawing.scroll;
    draw.fillStyle = colours.line;
    draw.fillRect(0, y + ROW - 1, width, 1);
    for (const span of drawing.rows[row]!.spans) paintSpan(draw, span, y, x, drawing, colours);
  }
  paintMoves(draw, drawing, x, colours);
  paintCursor(draw, drawing, x, colours);
  const now = x(drawing.now);
  if (now >= 0 && now <= width) {
    draw.fillStyle = colours.bad;
    draw.fillRect(Math.round(now), HEAD, 1.5, height);
  }
  draw.restore();

  draw.fillStyle = colours.surface;
  draw.fillRect(0, 0, width, HEAD);
  draw.fillStyle = colours.line;
  draw.fillRect(0, HEAD - 1, width, 1);
  draw.textAlign = "center";
  for (const { at, word } of lines) {
    const place = x(at);
    if (place < 24 || place > width - 28 || Math.abs(place - now) < 34) continue;
    draw.fillStyle = colours.muted;
    draw.fillText(word, place, HEAD / 2);
  }
  if (now >= 0 && now <= width) {
    draw.fillStyle = colours.bad;
    draw.fillText("now", Math.min(width - 14, Math.max(14, now)), HEAD / 2);
  }
}

type X = (at: number) => number;

function paintSpan(
  draw: CanvasRenderingContext2D,
  span: Span,
  y: number,
  x: X,
  drawing: Drawing,
  colours: Colours,
): void {
  const left = x(span.start);
  const right = x(span.end);
  const tail = x(span.tail);
  if (Math.max(right, tail) < 0 || left > drawing.width) return;
  const from = Math.max(left, -2);
  const width = Math.max(1, Math.min(right, drawing.width + 2) - from);
  const top = y + 3;
  const high = ROW - 7;
  if (span.kind === "asleep" || span.kind === "maintenance") {
    draw.fillStyle = colours.sunk;
    draw.fillRect(from, y, width, ROW - 1);
    if (span.kind === "maintenance") hatch(draw, from, y, width, ROW - 1, colours.line);
    label(draw, span.kind === "asleep" ? "asleep" : "maintenance", from, width, y, colours.muted);
    return;
  }
  const job = span.job_id ?? "";
  const [fill, soft] = hueOf(job, colours);
  const faint = drawing.marked !== null && drawing.marked !== job;
  draw.globalAlpha = faint ? 0.35 : 1;
  if (tail > right + 1) {
    draw.fillStyle = fill;
    draw.fillRect(right, top + high / 2 - 1, Math.min(tail, drawing.width) - right, 2);
    draw.fillRect(Math.min(tail, drawing.width) - 1, top + 3, 1.5, high - 6);
  }
  draw.fillStyle = span.kind === "booked" ? soft : fill;
  draw.fillRect(from, top, width - (width > 3 ? 0.5 : 0), high);
  if (span.kind === "booked" && width > 3) {
    draw.strokeStyle = fill;
    draw.lineWidth = 1;
    draw.strokeRect(from + 0.5, top + 0.5, width - 1.5, high - 1);
  }
  if (span.kind === "running") {
    draw.fillStyle = colours.text;
    draw.fillRect(from, top + high - 2, width, 2);
  }
  const name = drawing.jobs.get(job) ?? "";
  label(draw, span.frames ? `${name} ${span.frames}` : name, from, width, y, colours.text);
  draw.globalAlpha = 1;
}

function hatch(
  draw: CanvasRenderingContext2D,
  x: number,
  y: number,
  width: number,
  height: number,
  style: string,
): void {
  draw.save();
  draw.beginPath();
  draw.rect(x, y, width, height);
  draw.clip();
  draw.strokeStyle = style;
  draw.lineWidth = 2;
  draw.beginPath();
  for (let at = x - height - (x % 8); at < x + width; at += 8) {
    draw.moveTo(at, y + height);
    draw.lineTo(at + height, y);
  }
  draw.stroke();
  draw.restore();
}

/** Mean width of a letter of the chart, CSS pixels. */
let letter = 7;

/** A word inside a span, cut to what fits. Narrow spans have none. */
function label(
  draw: CanvasRenderingContext2D,
  text: string,
  x: number,
  width: number,
  y: number,
  style: string,
): void {
  if (width < 36 || text === "") return;
  const most = Math.floor((width - 10) / letter);
  const shown = text.length <= most ? text : most > 3 ? `${text.slice(0, most - 1)}…` : "";
  draw.fillStyle = style;
  draw.textAlign = "left";
  draw.fillText(shown, x + 5, y + ROW / 2 - 0.5);
}

function paintMoves(draw: CanvasRenderingContext2D, drawing: Drawing, x: X, colours: Colours): void {
  const { moves, played } = drawing;
  const ease = played * played * (3 - 2 * played);
  for (const move of moves) {
    const [from, to] = [move.from ?? move.to!, move.to ?? move.from!];
    const row = move.rowBefore + (move.row - move.rowBefore) * ease;
    const start = from[0] + (to[0] - from[0]) * ease;
    const end = from[1] + (to[1] - from[1]) * ease;
    const y = HEAD + row * ROW - drawing.scroll;
    if (y < -ROW || y > drawing.height) continue;
    draw.globalAlpha = move.from === null ? ease : move.to === null ? 1 - ease : 1;
    draw.strokeStyle = colours.text;
    draw.lineWidth = 1.5;
    draw.fillStyle = hueOf(move.job, colours)[0];
    const left = x(start);
    const width = Math.max(2, x(end) - left);
    draw.fillRect(left, y + 3, width, ROW - 7);
    draw.strokeRect(left + 0.5, y + 3.5, width - 1, ROW - 8);
  }
  draw.globalAlpha = 1;
}

function paintCursor(draw: CanvasRenderingContext2D, drawing: Drawing, x: X, colours: Colours): void {
  if (!drawing.cursor) return;
  const { row, span, at } = drawing.cursor;
  const left = Math.max(-2, span ? x(span.start) : x(at) - 6);
  const width = Math.min(drawing.width + 2, span ? x(span.end) : x(at) + 6) - left;
  draw.strokeStyle = colours.text;
  draw.lineWidth = 2;
  const y = HEAD + row * ROW - drawing.scroll;
  draw.strokeRect(left - 1, y + 1, Math.max(3, width) + 2, ROW - 3);
}

/** The span under a point of the chart. */
export function spanAt(drawing: Drawing, px: number, py: number): Hit | null {
  const row = drawing.rows[Math.floor((py - HEAD + drawing.scroll) / ROW)];
  if (!row || py < HEAD) return null;
  const at = drawing.view.from + (px / drawing.width) * (drawing.view.to - drawing.view.from);
  const slack = ((drawing.view.to - drawing.view.from) / drawing.width) * 2;
  const hits = row.spans.filter((span) => span.start - slack <= at && at <= span.tail + slack);
  // Jobs lie on top of nights and maintenance.
  return { row, span: hits.find((span) => span.job_id) ?? hits[0] ?? null };
}
