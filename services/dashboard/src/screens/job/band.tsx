// The cost of each frame: the forecast as a band, P50 to P80 to P95, and what frames really cost as points.

import { useMemo } from "preact/hooks";
import type uPlot from "uplot";
import type { FrameStrip } from "../../api/types";
import { frameAxes, MONEY, Plot, quantileBand } from "../../ui/plot";
import { colour } from "../../ui/theme";
import { type Quantity, written } from "./frames";
import { MARGINS } from "./strip-layout";

export function Band(props: {
  numbers: number[];
  doc: FrameStrip;
  quantity: Quantity;
  hover: (index: number | null) => void;
}) {
  const { numbers, doc, quantity } = props;
  const data = useMemo<uPlot.AlignedData>(
    () => [numbers.map((_, at) => at), doc.p95, doc.p80, doc.p50, doc.actual],
    [numbers, doc],
  );
  const few = numbers.length < 90;
  const many = numbers.length > 1500;
  const alone = numbers.length === 1;
  const options = () => {
    const band = quantileBand(many ? 1 : 2, alone);
    return {
      padding: [8, MARGINS.right, 0, 0] as [number, number, number, number],
      scales: {
        // Each frame has the width of its cell in the strip.
        x: {
          time: false,
          range: (_: uPlot, least: number, most: number): [number, number] =>
            alone ? [-0.5, 0.5] : [least - 0.5, most + 0.5],
        },
        y: { range: (_: uPlot, __: number, most: number): [number, number] => [0, most * 1.06 || 1] },
      },
      legend: { show: false },
      cursor: { y: false, drag: { x: true, y: false }, points: { size: 7 } },
      axes: frameAxes(
        quantity === "cost" ? MONEY : { words: (value) => written(quantity, value) },
        (at) => String(numbers[at] ?? ""),
        MARGINS.left,
      ),
      bands: band.bands,
      series: [
        {},
        ...band.series,
        {
          stroke: colour("text"),
          width: 0,
          paths: () => null,
          // Thousands of points let the band shine through.
          points: {
            show: true,
            size: few ? 6 : many ? 2 : 3,
            fill: colour("text") + (many ? "50" : ""),
            stroke: colour("surface"),
            width: few ? 1 : 0,
          },
        },
      ],
    };
  };
  return (
    <>
      <Plot
        label="Forecast cost of each frame as a band from P50 to P95, and actual costs as points. The table below has the numbers."
        height={180}
        data={data}
        options={options}
        shape={`${quantity}-${few}-${alone}`}
        hover={props.hover}
      />
      <p class="note">
        <span class="swatch p50" /> P50 <span class="swatch p80" /> to P80 <span class="swatch p95" /> to P95{" "}
        <span class="dot" /> actual. CPU time is that of a node of speed 1. Drag to zoom, double-click for
        all.
      </p>
    </>
  );
}
