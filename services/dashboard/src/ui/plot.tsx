// A plot of series, drawn by uPlot. It is one picture to a screen reader; the table behind it has the numbers.

import { useEffect, useRef } from "preact/hooks";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { clockTime, dayName, exactTime } from "./format";
import { useWidth } from "./resource";
import { colour, theme } from "./theme";

export type { Options as PlotOptions, AlignedData as PlotData } from "uplot";

/** Width of the vertical axis, CSS pixels. What is to stand above a plot begins here. */
export const LEFT = 64;

/** Writes instants of a time axis whose lines are so many seconds apart. */
function timeWords(step: number): (seconds: number) => string {
  if (step < 60) return (seconds) => exactTime(seconds * 1000);
  if (step >= 86_400) return (seconds) => dayName(seconds * 1000);
  return (seconds) => clockTime(seconds * 1000);
}

/** Axes in the page's colours. `unit` writes a value of the vertical axis. */
export function axes(
  unit: (value: number, step: number) => string,
  time: boolean,
  across?: (value: number) => string,
): uPlot.Axis[] {
  const line = { stroke: colour("line"), width: 1 };
  const common = {
    stroke: colour("muted"),
    font: "12px system-ui, sans-serif",
    grid: line,
    ticks: { ...line, size: 4 },
  };
  return [
    {
      ...common,
      size: 30,
      values: (_: uPlot, at: number[], __: number, ___: number, step: number) =>
        at.map(time ? timeWords(step) : (across ?? String)),
    },
    {
      ...common,
      size: LEFT,
      values: (_: uPlot, at: number[], __: number, ___: number, step: number) =>
        at.map((value) => unit(value, step)),
    },
  ];
}

const WHOLE = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000];

/** The same for a row of frames, by their places: lines stand only at whole ones. */
export function frameAxes(
  unit: (value: number, step: number) => string,
  name: (place: number) => string,
): uPlot.Axis[] {
  const [across, up] = axes(unit, false, name);
  return [{ ...across!, incrs: WHOLE }, up!];
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
