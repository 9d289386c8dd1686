// A plot of series, drawn by uPlot. It is one picture to a screen reader; the table behind it has the numbers.

import { useEffect, useRef } from "preact/hooks";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { clockTime, dayName, exactTime, moneyOnAxis } from "./format";
import { useWidth } from "./resource";
import { colour, theme } from "./theme";

export type { Options as PlotOptions, AlignedData as PlotData } from "uplot";

const FONT = "12px system-ui, sans-serif";
const TICK = 4;
const GAP = 5;

/** Steps between lines where nothing is smaller than one: 1, 2, 5, 10, 20 and so on. */
const WHOLE = Array.from({ length: 15 }, (_, power) => [1, 2, 5].map((digit) => digit * 10 ** power)).flat();

/** What a vertical axis counts. */
interface Unit {
  /** Writes a value of an axis whose lines are so far apart. */
  words: (value: number, step: number) => string;
  /** Steps that lines may have, if not all. */
  incrs?: number[];
}

/** Money in micro-units, of which there are no parts. */
export const MONEY: Unit = { words: moneyOnAxis, incrs: WHOLE };

/** The width of the longest label, CSS pixels. */
function widest(plot: uPlot, labels: readonly string[]): number {
  plot.ctx.font = FONT;
  return Math.max(0, ...labels.map((label) => plot.ctx.measureText(label).width));
}

/** The width that a vertical axis needs for its labels, CSS pixels. */
function room(plot: uPlot, labels: string[] | null): number {
  return TICK + 2 * GAP + widest(plot, labels ?? []);
}

/** How far lines of a horizontal axis must lie apart for their labels, CSS pixels. */
function apart(
  plot: uPlot,
  from: number,
  to: number,
  across: ((value: number) => string) | undefined,
): number {
  // Labels of other days are longer, so both ends are measured, and what lies between them.
  const words = across ?? timeWords((to - from) / MOST_LINES);
  return Math.max(LEAST_APART, 4 * GAP + widest(plot, [from, (from + to) / 2, to].map(words)));
}

/** Writes instants of a time axis whose lines are so many seconds apart. */
function timeWords(step: number): (seconds: number) => string {
  if (step < 60) return (seconds) => exactTime(seconds * 1000);
  if (step >= 86_400) return (seconds) => dayName(seconds * 1000);
  return (seconds) => clockTime(seconds * 1000);
}

/** A horizontal axis of time has about so many lines. */
const MOST_LINES = 12;
const LEAST_APART = 50;

/** Axes in the page's colours. `across` writes a value of the horizontal axis, if it is not time. */
export function axes(unit: Unit, across?: (value: number) => string): uPlot.Axis[] {
  const line = { stroke: colour("line"), width: 1 };
  const common = {
    stroke: colour("muted"),
    font: FONT,
    grid: line,
    ticks: { ...line, size: TICK },
    gap: GAP,
  };
  return [
    {
      ...common,
      size: 30,
      space: (plot: uPlot, _: number, from: number, to: number) => apart(plot, from, to, across),
      values: (_: uPlot, at: number[], __: number, ___: number, step: number) =>
        at.map(across ?? timeWords(step)),
    },
    {
      ...common,
      size: room,
      ...(unit.incrs && { incrs: unit.incrs }),
      values: (_: uPlot, at: number[], __: number, ___: number, step: number) =>
        at.map((value) => unit.words(value, step)),
    },
  ];
}

/** The same for a row of frames by their places, which begins at `left`: lines stand only at whole ones. */
export function frameAxes(unit: Unit, name: (place: number) => string, left: number): uPlot.Axis[] {
  const [across, up] = axes(unit, name);
  return [
    { ...across!, incrs: WHOLE },
    { ...up!, size: left },
  ];
}

/**
 * A band of forecasts: to P95, to P80, and the line of P50. They are the first three series. A line needs two
 * places: one that is `alone` is a point of each colour.
 */
export function quantileBand(width: number, alone = false) {
  const series = (name: "p50" | "p80" | "p95", width: number) => ({
    stroke: colour(name),
    width,
    points: { show: alone, size: 12, fill: colour(name), stroke: colour("line") },
  });
  return {
    bands: [
      { series: [1, 2] as [number, number], fill: colour("p95") },
      { series: [2, 3] as [number, number], fill: colour("p80") },
    ],
    series: [series("p95", 1), series("p80", 1), series("p50", width)],
  };
}

export function Plot(props: {
  label: string;
  height: number;
  data: uPlot.AlignedData;
  /** Everything but size. Called anew when `shape` or the theme changes. */
  options: () => Omit<uPlot.Options, "width" | "height">;
  shape: string;
  /** Called with the index under the pointer. */
  hover?: (index: number | null) => void;
  click?: (index: number) => void;
}) {
  const [box, width] = useWidth<HTMLDivElement>();
  const plot = useRef<uPlot | null>(null);
  const latest = useRef(props);
  latest.current = props;
  const look = theme.value;

  useEffect(() => {
    if (!box.current || width === 0) return;
    const options = props.options();
    const made = new uPlot(
      {
        ...options,
        width,
        height: props.height,
        hooks: {
          ...options.hooks,
          setCursor: [(self) => latest.current.hover?.(self.cursor.idx ?? null)],
        },
      },
      props.data,
      box.current,
    );
    const click = () => {
      const index = made.cursor.idx;
      if (index != null) latest.current.click?.(index);
    };
    made.over.addEventListener("click", click);
    plot.current = made;
    return () => {
      made.destroy();
      plot.current = null;
    };
  }, [props.shape, look, width === 0]);

  useEffect(() => plot.current?.setData(props.data), [props.data]);
  useEffect(() => {
    if (plot.current && width > 0) plot.current.setSize({ width, height: props.height });
  }, [width, props.height]);

  return <div ref={box} class="plot" role="img" aria-label={props.label} />;
}
