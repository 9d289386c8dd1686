// Nodes × time: past as it was, running, and booked ahead at P50 with P80 ends.

import { useEffect, useLayoutEffect, useMemo, useRef, useState } from "preact/hooks";
import { now } from "../../state/farm";
import { href } from "../../state/route";
import { clean, clockTime, duration, told, zoneAt } from "../../ui/format";
import { glyphOf, Mark, toneOf, wordOf } from "../../ui/mark";
import { Trouble, Waiting } from "../../ui/parts";
import { useWidth } from "../../ui/resource";
import { theme } from "../../ui/theme";
import { chartColours, type Drawing, HEAD, type Move, paint, ROW, spanAt } from "./paint";
import type { Row, Rows, Span, Stretch } from "./timeline";

export interface ChartProps {
  rows: Rows;
  total: number;
  view: Stretch;
  setView: (view: Stretch) => void;
  reset: () => void;
  open: (node: string) => void;
  moves: readonly Move[];
  played: number;
}

const SHORTEST = 2 * 60_000;
const LONGEST = 21 * 86_400_000;

/** Zooms a stretch around an instant. */
export function zoomed(view: Stretch, factor: number, around: number): Stretch {
  const length = Math.min(LONGEST, Math.max(SHORTEST, (view.to - view.from) / factor));
  const share = (around - view.from) / (view.to - view.from);
  const from = around - share * length;
  return { from, to: from + length };
}

export function Chart(props: ChartProps) {
  const { rows, view } = props;
  const [plot, width] = useWidth<HTMLDivElement>();
  const box = useRef<HTMLDivElement>(null);
  const canvas = useRef<HTMLCanvasElement>(null);
  const [scroll, setScroll] = useState(0);
  const [boxHeight, setBoxHeight] = useState(400);
  const [under, setUnder] = useState<{ row: Row; span: Span | null } | null>(null);
  const [pinned, setPinned] = useState<{ row: Row; span: Span } | null>(null);
  const look = theme.value;
  const colours = useMemo(() => chartColours(look === "dark"), [look]);
  const count = rows.complete ? rows.items.length : Math.max(props.total, rows.items.length);
  const high = HEAD + Math.max(1, count) * ROW;

  const drawing: Drawing = {
    width,
    height: boxHeight,
    scroll,
    view,
    now: now.value,
    rows: rows.items,
    jobs: rows.jobs,
    marked: pinned?.span.job_id ?? null,
    moves: props.moves,
    played: props.played,
  };
  const latest = useRef(drawing);
  latest.current = drawing;
  const pending = useRef(0);

  useLayoutEffect(() => {
    if (!canvas.current || width === 0) return;
    // One drawing a frame, however many things changed.
    cancelAnimationFrame(pending.current);
    pending.current = requestAnimationFrame(
      () => canvas.current && paint(canvas.current, latest.current, colours),
    );
  }, [...Object.values(drawing), colours]);

  useEffect(() => {
    const target = box.current!;
    const observer = new ResizeObserver(() => setBoxHeight(target.clientHeight));
    observer.observe(target);
    return () => observer.disconnect();
  }, []);

  useEffect(
    () => rows.see(Math.floor(scroll / ROW), Math.ceil((scroll + boxHeight) / ROW)),
    [scroll, boxHeight, rows.see],
  );

  useGestures(plot, latest, props);

  const first = Math.max(0, Math.floor(scroll / ROW) - 4);
  const last = Math.min(rows.items.length, Math.ceil((scroll + boxHeight) / ROW) + 4);
  const told = pinned ?? under;
  return (
    <>
      <p class="readout chart-readout" role="status">
        {told ? <Told {...told} jobs={rows.jobs} /> : <Legend />}
        {pinned && (
          <button type="button" class="plain" onClick={() => setPinned(null)}>
            Let go
          </button>
        )}
      </p>
      <div
        class="gantt"
        ref={box}
        tabIndex={0}
        role="group"
        aria-label="Nodes and time. Arrows left and right pan, plus and minus zoom, 0 shows tonight. The view List has the same as a table."
        onScroll={(event) => setScroll(event.currentTarget.scrollTop)}
        onKeyDown={(event) => keyed(event, props)}
        style={{ height: `min(${high + 2}px, calc(100dvh - 260px))` }}
      >
        <div class="gantt-inner" style={{ height: `${high}px` }}>
          <div class="gantt-names">
            <div class="gantt-corner">Node</div>
            {rows.items.slice(first, last).map((row, at) => (
              <button
                type="button"
                key={row.node_id}
                class="gantt-name"
                style={{ top: `${HEAD + (first + at) * ROW}px`, height: `${ROW}px` }}
                onClick={() => props.open(row.node_id)}
                title={`${clean(row.name)}: ${wordOf(row.state)}${row.idle_because ? `; ${row.idle_because}` : ""}`}
              >
                <span class={`glyph tone-${toneOf(row.state)}`} aria-hidden="true">
                  {glyphOf(row.state)}
                </span>
                <span class="gantt-node">{clean(row.name)}</span>
                <span class="gantt-state">{row.state === "working" ? "" : wordOf(row.state)}</span>
              </button>
            ))}
          </div>
          <div
            class="gantt-plot"
            ref={plot}
            onPointerMove={(event) => {
              const place = canvas.current!.getBoundingClientRect();
              setUnder(spanAt(latest.current, event.clientX - place.left, event.clientY - place.top));
            }}
            onPointerLeave={() => setUnder(null)}
            onClick={(event) => {
              const place = canvas.current!.getBoundingClientRect();
              const hit = spanAt(latest.current, event.clientX - place.left, event.clientY - place.top);
              setPinned(hit?.span?.job_id ? { row: hit.row, span: hit.span } : null);
            }}
          >
            <canvas
              ref={canvas}
              aria-hidden="true"
              style={{ width: `${width}px`, height: `${boxHeight}px` }}
            />
          </div>
        </div>
      </div>
      {rows.error && <Trouble error={rows.error} retry={rows.again} />}
      {rows.loading && rows.items.length === 0 && <Waiting>Asking what the nodes do…</Waiting>}
      {rows.loading && rows.items.length > 0 && !rows.complete && (
        <p class="note">
          {rows.items.length} of {count} nodes are here; asking for more…
        </p>
      )}
    </>
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

function Told(props: { row: Row; span: Span | null; jobs: ReadonlyMap<string, string> }) {
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

function keyed(event: KeyboardEvent, props: ChartProps): void {
  const { view, setView } = props;
  const length = view.to - view.from;
  const middle = view.from + length / 2;
  if (event.key === "ArrowLeft") setView({ from: view.from - length / 6, to: view.to - length / 6 });
  else if (event.key === "ArrowRight") setView({ from: view.from + length / 6, to: view.to + length / 6 });
  else if (event.key === "+" || event.key === "=") setView(zoomed(view, 1.5, middle));
  else if (event.key === "-") setView(zoomed(view, 1 / 1.5, middle));
  else if (event.key === "0") props.reset();
  else return;
  event.preventDefault();
}

/** Wheel with Ctrl zooms, sideways pans; drag pans; two fingers zoom. */
function useGestures(
  plot: { current: HTMLDivElement | null },
  latest: { current: Drawing },
  props: ChartProps,
): void {
  const set = useRef(props.setView);
  set.current = props.setView;
  useEffect(() => {
    const target = plot.current!;
    const fingers = new Map<number, PointerEvent>();
    const perPixel = () =>
      (latest.current.view.to - latest.current.view.from) / Math.max(1, latest.current.width);
    const pan = (pixels: number) => {
      const { view } = latest.current;
      const by = pixels * perPixel();
      set.current({ from: view.from - by, to: view.to - by });
    };
    const zoom = (factor: number, clientX: number) => {
      const at = latest.current.view.from + (clientX - target.getBoundingClientRect().left) * perPixel();
      set.current(zoomed(latest.current.view, factor, at));
    };
    const wheel = (event: WheelEvent) => {
      if (event.ctrlKey || event.metaKey) zoom(2 ** (-event.deltaY / 300), event.clientX);
      else if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) pan(-event.deltaX);
      else if (event.shiftKey) pan(-event.deltaY);
      else return;
      event.preventDefault();
    };
    const down = (event: PointerEvent) => {
      if (event.pointerType === "mouse" && event.button !== 0) return;
      fingers.set(event.pointerId, event);
    };
    const move = (event: PointerEvent) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      if (event.pointerType === "mouse" && event.buttons === 0) {
        fingers.clear();
        return;
      }
      if (fingers.size === 1) pan(event.clientX - before.clientX);
      else {
        const other = [...fingers.values()].find((finger) => finger.pointerId !== event.pointerId)!;
        zoom(
          Math.max(1, Math.abs(event.clientX - other.clientX)) /
            Math.max(1, Math.abs(before.clientX - other.clientX)),
          other.clientX,
        );
      }
      fingers.set(event.pointerId, event);
    };
    const up = (event: PointerEvent) => fingers.delete(event.pointerId);
    target.addEventListener("wheel", wheel, { passive: false });
    target.addEventListener("pointerdown", down);
    addEventListener("pointermove", move);
    addEventListener("pointerup", up);
    addEventListener("pointercancel", up);
    return () => {
      target.removeEventListener("wheel", wheel);
      target.removeEventListener("pointerdown", down);
      removeEventListener("pointermove", move);
      removeEventListener("pointerup", up);
      removeEventListener("pointercancel", up);
    };
  }, []);
}
