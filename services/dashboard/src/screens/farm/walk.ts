// Going from span to span by keys: for people without a pointer.

import type { Row, Span, Stretch } from "./timeline";

/** A span of a node in words that last when the rows are asked for again. */
export interface Spot {
  node: string;
  /** Of a span of a job. */
  job: string | null;
  frames: string | null;
  /** The instant at which somebody looks: in the span, or where the node has none. */
  at: number;
}

/** What is told of a place of the chart. */
export interface Hit {
  row: Row;
  span: Span | null;
}

const byStart = (row: Row) => [...row.spans].sort((a, b) => a.start - b.start || a.end - b.end);

/** How far an instant lies outside of a span. */
function apart(span: Span, at: number): number {
  return Math.max(0, span.start - at, at - span.end);
}

/** The span that is nearest to an instant. Jobs lie on top of nights and maintenance. */
export function nearest(spans: readonly Span[], at: number): Span | null {
  const order = (a: Span, b: Span) =>
    apart(a, at) - apart(b, at) || Number(!a.job_id) - Number(!b.job_id) || a.start - b.start;
  return [...spans].sort(order)[0] ?? null;
}

/** The spans of a row that lie in a view, if only in part. */
export const inView = (row: Row, view: Stretch): Span[] =>
  row.spans.filter((span) => span.end >= view.from && span.start <= view.to);

export function spotOf(row: Row, span: Span | null, at: number): Spot {
  if (!span) return { node: row.node_id, job: null, frames: null, at };
  const inside = Math.min(span.end, Math.max(span.start, at));
  return { node: row.node_id, job: span.job_id ?? null, frames: span.frames ?? null, at: inside };
}

/**
 * Where a spot is now: the same frames of the same job, nearest in time; else the job's nearest span, since the
 * frames of a span come and go; else what the node does then.
 */
export function find(rows: readonly Row[], spot: Spot): Hit | null {
  const row = rows.find((one) => one.node_id === spot.node);
  if (!row) return null;
  const sameJob = row.spans.filter((span) => (span.job_id ?? null) === spot.job);
  const same = sameJob.filter((span) => (span.frames ?? null) === spot.frames);
  const present = row.spans.filter((span) => apart(span, spot.at) === 0);
  const ofJob = spot.job ? nearest(sameJob, spot.at) : null;
  return { row, span: nearest(same, spot.at) ?? ofJob ?? nearest(present, spot.at) };
}

/** The spot that a key leads to. The first press leads to the first row in view. `null`: not its key. */
export function walked(
  rows: readonly Row[],
  from: Spot | null,
  key: string,
  view: Stretch,
  top: number,
): Spot | null {
  if (!/^Arrow(Left|Right|Up|Down)$/.test(key) || rows.length === 0) return null;
  const here = from && find(rows, from);
  if (!from || !here) {
    const row = rows[Math.min(top, rows.length - 1)]!;
    const middle = (view.from + view.to) / 2;
    return spotOf(row, nearest(inView(row, view), middle), middle);
  }
  const by = key === "ArrowRight" || key === "ArrowDown" ? 1 : -1;
  if (key === "ArrowUp" || key === "ArrowDown") {
    const row = rows[Math.min(rows.length - 1, Math.max(0, rows.indexOf(here.row) + by))]!;
    // The instant stays, so that the way down and up again leads back.
    return { ...spotOf(row, nearest(inView(row, view), from.at), from.at), at: from.at };
  }
  const spans = byStart(here.row);
  const place = here.span ? spans.indexOf(here.span) : -1;
  const next = here.span
    ? spans[Math.min(spans.length - 1, Math.max(0, place + by))]!
    : ((by > 0
        ? spans.find((span) => span.start >= from.at)
        : [...spans].reverse().find((span) => span.end <= from.at)) ?? null);
  return next ? spotOf(here.row, next, (next.start + next.end) / 2) : from;
}

/** A view that shows a stretch, as little moved as can be. What is longer than the view is shown from its start. */
export function showing(view: Stretch, wanted: Stretch): Stretch {
  const length = view.to - view.from;
  const edge = length / 20;
  if (wanted.to - wanted.from > length - 2 * edge) {
    const visible = Math.min(view.to, wanted.to) - Math.max(view.from, wanted.from);
    return visible > length / 3 ? view : { from: wanted.from - edge, to: wanted.from - edge + length };
  }
  if (wanted.from < view.from) return { from: wanted.from - edge, to: wanted.from - edge + length };
  if (wanted.to > view.to) return { from: wanted.to + edge - length, to: wanted.to + edge };
  return view;
}

/** A spot as text of the address, and back. `null` if it is none. */
export function spotText(spot: Spot): string {
  return [spot.node, spot.job ?? "", Math.round(spot.at / 1000), spot.frames ?? ""].join("_");
}

export function spotFrom(text: string | null): Spot | null {
  const [node, job, seconds, frames] = (text ?? "").split("_");
  const at = Number(seconds) * 1000;
  return node && job && at > 0 ? { node, job, frames: frames || null, at } : null;
}
