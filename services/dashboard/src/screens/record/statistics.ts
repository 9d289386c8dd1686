// How often quotes were right, from finished frames.

import type { TrackRecord } from "../../api/types";

export type Row = TrackRecord["items"][number];
export const LEVELS = [0.5, 0.8, 0.95] as const;
export const NAMES = ["P50", "P80", "P95"] as const;
export type Measure = "cpu" | "work";

/** The interval that holds a share with 95 %: Wilson, E. B. (1927), JASA 22, 209. */
export function wilson(hits: number, count: number): [low: number, high: number] {
  if (count === 0) return [0, 1];
  const z = 1.96;
  const p = hits / count;
  const middle = (p + (z * z) / (2 * count)) / (1 + (z * z) / count);
  const half = (z / (1 + (z * z) / count)) * Math.sqrt((p * (1 - p)) / count + (z * z) / (4 * count * count));
  return [Math.max(0, middle - half), Math.min(1, middle + half)];
}

function sides(row: Row, measure: Measure): { actual: number; forecast: Row["cpu_forecast"] } {
  return measure === "cpu"
    ? { actual: row.cpu_actual, forecast: row.cpu_forecast }
    : { actual: row.work_actual, forecast: row.work_forecast };
}

/** Whether the actual value was at or below P50, P80 and P95. */
export function hits(row: Row, measure: Measure): [boolean, boolean, boolean] {
  const { actual, forecast } = sides(row, measure);
  return [actual <= forecast.p50, actual <= forecast.p80, actual <= forecast.p95];
}

/** Forecast mean ÷ actual − 1. */
export function errorOf(row: Row, measure: Measure): number {
  const { actual, forecast } = sides(row, measure);
  return actual > 0 ? forecast.mean / actual - 1 : 0;
}

export interface Batch {
  /** Instant of the batch's last frame. */
  at: number;
  count: number;
  shares: [number, number, number];
}

/** Batches of equally many frames in the order in which they were finished, with the shares of hits. */
export function batches(rows: readonly Row[], measure: Measure, size: number): Batch[] {
  const ordered = [...rows].sort((a, b) => a.finished.localeCompare(b.finished));
  const out: Batch[] = [];
  for (let begin = 0; begin < ordered.length; begin += size) {
    const part = ordered.slice(begin, begin + size);
    if (part.length < Math.min(size, ordered.length) / 2) break;
    const sums = [0, 0, 0];
    for (const row of part) hits(row, measure).forEach((hit, at) => (sums[at]! += Number(hit)));
    out.push({
      at: Date.parse(part[part.length - 1]!.finished),
      count: part.length,
      shares: sums.map((sum) => sum / part.length) as [number, number, number],
    });
  }
  return out;
}

export interface Group {
  name: string;
  frames: number;
  shares: [number, number, number];
  /** Mean of |forecast ÷ actual − 1|. */
  error: number;
  /** Mean of forecast ÷ actual − 1. */
  bias: number;
}

/** The same by a name of each row, the most frames first. */
export function groups(rows: readonly Row[], measure: Measure, nameOf: (row: Row) => string): Group[] {
  const parts = new Map<string, Row[]>();
  for (const row of rows) {
    const name = nameOf(row);
    parts.set(name, [...(parts.get(name) ?? []), row]);
  }
  return [...parts]
    .map(([name, part]) => {
      const sums = [0, 0, 0];
      for (const row of part) hits(row, measure).forEach((hit, at) => (sums[at]! += Number(hit)));
      const errors = part.map((row) => errorOf(row, measure));
      return {
        name,
        frames: part.length,
        shares: sums.map((sum) => sum / part.length) as [number, number, number],
        error: errors.reduce((sum, error) => sum + Math.abs(error), 0) / part.length,
        bias: errors.reduce((sum, error) => sum + error, 0) / part.length,
      };
    })
    .sort((a, b) => b.frames - a.frames);
}
