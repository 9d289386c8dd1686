// An uncertain instant on a time axis: P50 to P80 to P95 as a narrowing bar, the deadline as a line.

import { clockTime, exactTime, duration, zoneAt } from "./format";
import type { Axis } from "./time-axis";

export interface Spread {
  p50: number | null;
  p80: number | null;
  p95: number | null;
}

const WIDTH = 1000;

export function Fan(props: {
  axis: Axis;
  spread: Spread;
  deadline: number | null;
  late?: boolean;
  label: string;
}) {
  const { axis, spread, deadline } = props;
  const x = (at: number) => Math.min(1, Math.max(0, (at - axis.from) / (axis.to - axis.from))) * WIDTH;
  const p50 = spread.p50;
  const p80 = spread.p80 ?? p50;
  const p95 = spread.p95 ?? p80;
  const beyond = p50 !== null && p50 > axis.to;
  return (
    <svg
      class={props.late ? "fan late" : "fan"}
      viewBox={`0 0 ${WIDTH} 24`}
      preserveAspectRatio="none"
      role="img"
      aria-label={props.label}
    >
      {axis.ticks.map((tick) => (
        <line key={tick.at} class="tick" x1={x(tick.at)} x2={x(tick.at)} y1="0" y2="24" />
      ))}
      {p50 !== null && !beyond && (
        <>
          <line class="lead" x1="0" x2={x(p50)} y1="12" y2="12" />
          <rect class="p95" x={x(p50)} width={Math.max(2, x(p95!) - x(p50))} y="9" height="6" />
          <rect class="p80" x={x(p50)} width={Math.max(2, x(p80!) - x(p50))} y="7" height="10" />
          <rect class="p50" x={x(p50) - 2} width="4" y="4" height="16" />
        </>
      )}
      {beyond && (
        <path class="beyond" d={`M0 12H${WIDTH - 14}M${WIDTH - 22} 5L${WIDTH - 4} 12L${WIDTH - 22} 19`} />
      )}
      {deadline !== null && deadline >= axis.from && deadline <= axis.to && (
        <line class="deadline" x1={x(deadline)} x2={x(deadline)} y1="0" y2="24" />
      )}
    </svg>
  );
}

/** The words of an axis, above the rows that share it. */
export function AxisHead(props: { axis: Axis }) {
  const { axis } = props;
  const place = (at: number) => `${(((at - axis.from) / (axis.to - axis.from)) * 100).toFixed(2)}%`;
  return (
    <div class="axis-head" aria-hidden="true">
      <span class="axis-now">now</span>
      {axis.ticks
        .filter(
          (tick) =>
            tick.at - axis.from > (axis.to - axis.from) * 0.09 &&
            axis.to - tick.at > (axis.to - axis.from) * 0.04,
        )
        .map((tick) => (
          <span key={tick.at} style={{ left: place(tick.at) }}>
            {tick.word}
          </span>
        ))}
    </div>
  );
}

/** A spread in words: `half the time by 06:10, four times in five by 06:30, 19 in 20 by 06:55 (CET)`. */
export function spreadWords(spread: Spread): string {
  if (spread.p50 === null) return "No end is known yet";
  // Ends that minutes do not tell apart have seconds.
  const last = spread.p95 ?? spread.p80 ?? spread.p50;
  const time = last > spread.p50 && last - spread.p50 < 5 * 60_000 ? exactTime : clockTime;
  const parts = [`P50 ${time(spread.p50)}`];
  if (spread.p80 !== null) parts.push(`P80 ${time(spread.p80)}`);
  if (spread.p95 !== null) parts.push(`P95 ${time(spread.p95)}`);
  return `${parts.join(", ")} ${zoneAt(spread.p50)}`;
}

/** How an end lies to a deadline: `50 min to spare`, `2 h late`. */
export function slackWords(end: number | null, deadline: number | null): string {
  if (end === null || deadline === null) return "";
  return end <= deadline ? `${duration(deadline - end)} to spare` : `${duration(end - deadline)} late`;
}
