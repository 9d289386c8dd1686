// How the estimate moved from the quote to the truth, against what is booked.

import { useMemo } from "preact/hooks";
import { get } from "../../api/client";
import type { ForecastHistory, Job } from "../../api/types";
import { axes, Plot, type PlotData, quantileBand } from "../../ui/plot";
import { cpuTime, percent } from "../../ui/format";
import { TableBehind, Time, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";
import { colour } from "../../ui/theme";

export function History(props: { job: Job; version: string }) {
  const answer = useResource<ForecastHistory>(
    (signal) => get("/v1/jobs/{id}/forecast/history", { path: { id: props.job.id }, signal }),
    [props.job.id],
    props.version,
  );
  const doc = answer.data;
  if (!doc)
    return answer.error ? (
      <Trouble error={answer.error} retry={answer.reload} />
    ) : (
      <Waiting>Asking how the estimate moved…</Waiting>
    );
  return <Course of={doc} />;
}

function Course(props: { of: ForecastHistory }) {
  const doc = props.of;
  const points = useMemo(() => pointsOf(doc), [doc]);
  const data = useMemo<PlotData>(
    () => [
      points.map((point) => Date.parse(point.at) / 1000),
      points.map((point) => point.cpu_seconds.p95),
      points.map((point) => point.cpu_seconds.p80),
      points.map((point) => point.cpu_seconds.p50),
      points.map((point) => point.cpu_spent),
      points.map(() => doc.now.booked.cpu_seconds ?? null),
    ],
    [points],
  );
  const { quote, whole, factor } = doc.now.cpu_seconds;
  const alone = points.length === 1;
  return (
    <>
      <p>
        Quoted {cpuTime(quote.p50)} (P80 {cpuTime(quote.p80)}); expected now {cpuTime(whole.p50)} (P80{" "}
        {cpuTime(whole.p80)}). What is left is{" "}
        {factor === 1
          ? "as quoted"
          : factor > 1
            ? `${percent(factor - 1)} dearer than quoted`
            : `${percent(1 - factor)} cheaper than quoted`}
        .
      </p>
      <Plot
        label="Expected CPU time of the whole job over time: P50 to P95, what is spent, and what is booked. The table below has the numbers."
        height={240}
        data={data}
        options={() => options(alone)}
        shape={`history-${alone}`}
      />
      <p class="note">
        <span class="swatch p50" /> P50 <span class="swatch p80" /> to P80 <span class="swatch p95" /> to P95
        of the whole job; <span class="swatch spent" /> spent; dashed: booked. CPU time on a node of speed 1.
      </p>
      <TableBehind
        label="The estimate over time, as a table"
        head={["At", "Frames done", "P50", "P80", "P95", "Spent", "Ready by"]}
        rows={() =>
          points.map((point) => [
            <Time at={point.at} exact />,
            `${point.frames_done} of ${doc.frames_total}`,
            cpuTime(point.cpu_seconds.p50),
            cpuTime(point.cpu_seconds.p80),
            cpuTime(point.cpu_seconds.p95),
            cpuTime(point.cpu_spent),
            <Time at={point.finish} />,
          ])
        }
      />
    </>
  );
}

/** The estimates until now. */
function pointsOf(doc: ForecastHistory) {
  const { at, cpu_seconds, frames_done, finish } = doc.now;
  return [
    ...doc.points,
    { at, cpu_seconds: cpu_seconds.whole, cpu_spent: cpu_seconds.spent, frames_done, finish },
  ];
}

function options(alone: boolean) {
  const band = quantileBand(2, alone);
  return {
    legend: { show: false },
    cursor: { y: false },
    axes: axes({ words: cpuTime }),
    bands: band.bands,
    series: [
      {},
      ...band.series,
      { stroke: colour("good"), width: 1.5, fill: colour("sunk"), points: { show: alone } },
      { stroke: colour("text"), width: 1, dash: [5, 4], points: { show: alone } },
    ],
  };
}
