// The reliability diagram: how often the truth stayed at or below a quantile, against how often it should have.

import { grouped, percent } from "../../ui/format";
import { TableBehind } from "../../ui/parts";
import { LEVELS, NAMES, wilson } from "./statistics";

export interface Line {
  name: string;
  count: number;
  hits: [number, number, number];
}

const SIZE = 300;
const EDGE = 36;

/** Where a share lies, of the promised and of the observed ones. */
const place = (share: number) => EDGE + share * (SIZE - EDGE - 8);
const up = (share: number) => SIZE - EDGE - share * (SIZE - EDGE - 8);

export function Reliability(props: { lines: Line[] }) {
  const lines = props.lines.filter((line) => line.count > 0);
  return (
    <>
      <svg
        class="reliability"
        viewBox={`0 0 ${SIZE} ${SIZE}`}
        role="img"
        aria-label="Reliability: observed against promised shares. The table below has the numbers."
      >
        {[0, 0.25, 0.5, 0.75, 1].map((share) => (
          <g key={share}>
            <line class="tick" x1={place(0)} x2={place(1)} y1={up(share)} y2={up(share)} />
            <text x={EDGE - 6} y={up(share) + 4} text-anchor="end">
              {share * 100}
            </text>
          </g>
        ))}
        {LEVELS.map((level, at) => (
          <text key={level} x={place(level)} y={SIZE - EDGE + 16} text-anchor={at === 2 ? "start" : "middle"}>
            {NAMES[at]}
          </text>
        ))}
        <line class="ideal" x1={place(0)} y1={up(0)} x2={place(1)} y2={up(1)} />
        <text x={place(0.5)} y={SIZE - 4} text-anchor="middle">
          promised, %
        </text>
        <text transform={`translate(11 ${up(0.5)}) rotate(-90)`} text-anchor="middle">
          observed, %
        </text>
        {lines.map((line, index) => (
          <Points key={line.name} line={line} index={index} count={lines.length} />
        ))}
      </svg>
      <p class="note">
        {lines.map((line, index) => (
          <span key={line.name} class="legend">
            <span class={`series-key series-${index}`} aria-hidden="true">
              {index === 0 ? "●" : "■"}
            </span>{" "}
            {line.name} ({grouped(line.count)})
          </span>
        ))}
        On the diagonal, quotes are calibrated; above it they were cautious, below it too low. Whiskers: 95 %
        intervals, as if all were independent.
      </p>
      <TableBehind
        label="Reliability, as a table"
        head={["Forecasts", "Number", ...NAMES.map((name) => `at or below ${name}`)]}
        rows={() =>
          lines.map((line) => [
            line.name,
            grouped(line.count),
            ...line.hits.map((count) => {
              const [low, high] = wilson(count, line.count);
              return `${percent(count / line.count, 1)} (${percent(low)} to ${percent(high)})`;
            }),
          ])
        }
      />
    </>
  );
}

/** A kind of forecasts: beside the others, so that none covers another. */
function Points(props: { line: Line; index: number; count: number }) {
  const { line, index, count } = props;
  return (
    <g class={`series-${index}`}>
      {LEVELS.map((level, at) => {
        const [low, high] = wilson(line.hits[at]!, line.count);
        const x = place(level) + (index - (count - 1) / 2) * 5;
        const y = up(line.hits[at]! / line.count);
        return (
          <g key={level}>
            <line class="whisker" x1={x} x2={x} y1={up(low)} y2={up(high)} />
            {index === 0 ? (
              <circle cx={x} cy={y} r="4" />
            ) : (
              <rect x={x - 3.5} y={y - 3.5} width="7" height="7" />
            )}
          </g>
        );
      })}
    </g>
  );
}
