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

/** The accuracy of projects, the most frames first. */
export function projectGroups(projects: NonNullable<TrackRecord["projects"]>, measure: Measure): Group[] {
  return projects
    .map(({ project, frames, work_bias, cpu_bias }) => ({
      name: project,
      frames: frames.count,
      shares: sharesOf(frames, measure),
      error: (measure === "cpu" ? frames.cpu_mean_absolute_error : frames.work_mean_absolute_error) ?? 0,
      bias: (measure === "cpu" ? cpu_bias : work_bias) ?? 0,
    }))
    .sort((a, b) => b.frames - a.frames);
}

type Coverage = NonNullable<TrackRecord["days"]>[number]["frames"];

function sharesOf(frames: Coverage, measure: Measure): [number, number, number] {
  const hits = measure === "cpu" ? frames.cpu_hits : frames.work_hits;
  const count = Math.max(1, frames.count);
  return [hits.p50 / count, hits.p80 / count, hits.p95 / count];
}

/** Most points of a course over time. */
const POINTS = 60;

/** The shares of hits over time: of batches while the record is short, and of days when it is long. */
export function course(record: TrackRecord, measure: Measure): Batch[] {
  const days = record.days ?? [];
  if (record.items.length >= record.frames || days.length === 0) {
    return batches(record.items, measure, Math.max(4, Math.ceil(record.items.length / 24)));
  }
  const together = Math.ceil(days.length / POINTS);
  const out: Batch[] = [];
  for (let begin = 0; begin < days.length; begin += together) {
    const part = days.slice(begin, begin + together);
    const count = part.reduce((sum, day) => sum + day.frames.count, 0);
    const shares = [0, 0, 0];
    for (const { frames } of part)
      sharesOf(frames, measure).forEach((share, at) => (shares[at]! += (share * frames.count) / count));
    out.push({
      at: Date.parse(part[part.length - 1]!.day),
      count,
      shares: shares as [number, number, number],
    });
  }
  return out;
}
