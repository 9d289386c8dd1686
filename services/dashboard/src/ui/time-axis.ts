// Axes of time: which time they show, where they have lines, and the words of these.

import { clockTime, dayName } from "./format";

export interface Tick {
  at: number;
  word: string;
}

const DAY = 86_400_000;
const WEEK = 7 * DAY;
const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 180, 360, 720, 1440, 2880, 10080].map(
  (minutes) => minutes * 60_000,
);

/** At most so many lines, at round times of the viewer's clock. Days other than that of `now` are named. */
export function ticks(from: number, to: number, most: number, now: number = from): Tick[] {
  const least = (to - from) / most;
  const step = STEPS.find((size) => size >= least) ?? Math.ceil(least / WEEK) * WEEK;
  const offset = new Date(from).getTimezoneOffset() * 60_000;
  const out: Tick[] = [];
  for (let at = Math.ceil((from - offset) / step) * step + offset; at < to; at += step)
    out.push({ at, word: step < DAY ? clockTime(at, now) : dayName(at) });
  return out;
}

export interface Axis {
  from: number;
  to: number;
  /** Where lines are drawn, and their words. */
  ticks: Tick[];
}

/** A deadline this many times as far away as the last end is not on the axis: nobody could see the ends beside it. */
const FAR = 3;

/** An axis that shows this share of the ends, and the deadlines that are not far from them. Later ones are beyond it. */
export function axisFor(from: number, ends: number[], deadlines: number[] = [], share = 1): Axis {
  const reachOf = (instants: number[]) => {
    const ahead = instants.filter((at) => at > from).sort((a, b) => a - b);
    return ahead[Math.min(ahead.length - 1, Math.floor(ahead.length * share))] ?? null;
  };
  const end = reachOf(ends);
  const near = deadlines.filter((at) => end === null || at - from <= FAR * (end - from));
  const reach = Math.max(end ?? 0, reachOf(near) ?? 0) || from + 3_600_000;
  const to = from + Math.max(3 * 60_000, (reach - from) * 1.08);
  return { from, to, ticks: ticks(from, to, 5) };
}
