// What the farm's chart tells in words of the place that somebody looks at.

import { href } from "../../state/route";
import { clean, clockTime, duration, told, zoneAt } from "../../ui/format";
import { Mark } from "../../ui/mark";
import type { Rows } from "./timeline";
import type { Hit, Spot } from "./walk";

/** What is told of the chart: of a span that keys lead to, that is held, or that lies under the pointer. */
export function Readout(props: { hit: Hit | null; pinned: Spot | null; rows: Rows; letGo: () => void }) {
  const { hit, pinned, rows } = props;
  return (
    <p class="readout chart-readout" role="status">
      {hit ? (
        <Told {...hit} jobs={rows.jobs} />
      ) : pinned ? (
        <>{rows.complete ? "The held span is not on this chart." : "Looking for the held span…"} </>
      ) : (
        <Legend />
      )}
      {pinned && (
        <button type="button" class="plain" onClick={props.letGo}>
          Let go
        </button>
      )}
    </p>
  );
}

function Legend() {
  return (
    <>
      <span class="legend">
        <span class="chip past" /> past
      </span>
      <span class="legend">
        <span class="chip running" /> running
      </span>
      <span class="legend">
        <span class="chip booked" /> booked at P50, whisker to P80
      </span>
      <span class="legend">
        <span class="chip asleep" /> asleep
      </span>
      <span class="legend">
        <span class="chip maintenance" /> maintenance
      </span>
    </>
  );
}

function Told(props: Hit & { jobs: ReadonlyMap<string, string> }) {
  const { row, span } = props;
  if (!span) {
    return (
      <>
        <strong>{clean(row.name)}</strong>: nothing here. <Mark of={row.state} />{" "}
        {row.idle_because && `It is idle: ${told(row.idle_because)}.`}
      </>
    );
  }
  const { start, end, tail } = span;
  const name = span.job_id ? (props.jobs.get(span.job_id) ?? "a job") : span.kind;
  return (
    <>
      <strong>{clean(row.name)}</strong>:{" "}
      {span.job_id ? (
        <a href={href(["jobs", span.job_id], { sel: span.frames ?? null })}>{clean(name)}</a>
      ) : (
        name
      )}
      {span.frames && `, frame${/[-,]/.test(span.frames) ? "s" : ""} ${span.frames}`}, {span.kind},{" "}
      {clockTime(start)} to {clockTime(end)}
      {tail > end && ` (P80 ${clockTime(tail)})`} {zoneAt(start)}, {duration(end - start)}.{" "}
    </>
  );
}
