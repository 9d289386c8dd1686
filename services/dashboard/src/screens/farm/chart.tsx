// Nodes × time: past as it was, running, and booked ahead at P50 with P80 ends.

import { useEffect, useLayoutEffect, useMemo, useRef, useState } from "preact/hooks";
import { now } from "../../state/now";
import { useAddressed } from "../../state/addressed";
import { go } from "../../state/route";
import { clean } from "../../ui/format";
import { glyphOf, toneOf, wordOf } from "../../ui/mark";
import { Trouble, Waiting } from "../../ui/parts";
import { isTyping } from "../../ui/keys";
import { PAGE } from "../../ui/pages";
import { useWidth } from "../../ui/resource";
import { theme } from "../../ui/theme";
import { useGestures } from "./gestures";
import { chartColours, type Drawing, HEAD, type Move, paint, ROW, spanAt } from "./paint";
import { Readout } from "./readout";
import { type Row, type Rows, type Stretch, zoomed } from "./timeline";
import { find, type Hit, type Spot, showing, spotFrom, spotOf, spotText, walked } from "./walk";

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

export function Chart(props: ChartProps) {
  const { rows, view } = props;
  const [plot, width] = useWidth<HTMLDivElement>();
  const [box, height] = useHeight();
  const canvas = useRef<HTMLCanvasElement>(null);
  const [scroll, setScroll] = useState(0);
  const [under, setUnder] = useState<Hit | null>(null);
  const pin = useHeld(rows);
  const { pinned, held, hold } = pin;
  const walk = useWalk(props, box, scroll);
  const count = rows.complete ? rows.items.length : Math.max(props.total, rows.items.length);
  const high = HEAD + Math.max(1, count) * ROW;
  const drawing = usePainted(canvas, {
    width,
    height,
    scroll,
    view,
    now: now.value,
    rows: rows.items,
    jobs: rows.jobs,
    marked: pinned?.job ?? null,
    cursor: walk.hit && { row: rows.items.indexOf(walk.hit.row), span: walk.hit.span, at: walk.spot!.at },
    moves: props.moves,
    played: props.played,
  });
  useEffect(
    () => rows.see(Math.floor(scroll / ROW), Math.ceil((scroll + height) / ROW)),
    [scroll, height, rows.see],
  );
  useGestures(plot, drawing, props.setView);
  useSought(rows, pinned, held, box);
  const hitAt = (event: MouseEvent) => {
    const place = canvas.current!.getBoundingClientRect();
    return spanAt(drawing.current, event.clientX - place.left, event.clientY - place.top);
  };
  return (
    <>
      <Readout hit={walk.hit ?? held ?? under} pinned={pinned} rows={rows} letGo={() => hold(null)} />
      <div
        class="gantt"
        ref={box}
        tabIndex={0}
        role="group"
        aria-label="Nodes and time. Arrows left and right pan, plus and minus zoom, 0 shows tonight. Arrows with Shift go from span to span and from node to node, Enter holds one. The view List has the same as a table."
        onScroll={(event) => setScroll(event.currentTarget.scrollTop)}
        onKeyDown={(event) => pressed(event, props, walk, pin)}
        style={{ height: `min(${high + 2}px, calc(100dvh - 260px))` }}
      >
        <div class="gantt-inner" style={{ height: `${high}px` }}>
          <Names rows={rows.items} from={scroll} to={scroll + height} open={props.open} />
          <div
            class="gantt-plot"
            ref={plot}
            onPointerMove={(event) => {
              // Browsers also say that the pointer moved where the page did.
              if (event.movementX !== 0 || event.movementY !== 0) walk.end();
              setUnder(hitAt(event));
            }}
            onPointerLeave={() => setUnder(null)}
            onClick={(event) => hold(hitAt(event))}
          >
            <canvas ref={canvas} aria-hidden="true" style={{ width: `${width}px`, height: `${height}px` }} />
          </div>
        </div>
      </div>
      <Asking rows={rows} count={count} />
    </>
  );
}

/** The names of the nodes between two heights of the chart, and of some more above and below. */
function Names(props: { rows: readonly Row[]; from: number; to: number; open: (node: string) => void }) {
  const first = Math.max(0, Math.floor(props.from / ROW) - 4);
  const last = Math.min(props.rows.length, Math.ceil(props.to / ROW) + 4);
  return (
    <div class="gantt-names">
      <div class="gantt-corner">Node</div>
      {props.rows.slice(first, last).map((row, at) => (
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
  );
}

/** What is still asked for, or went wrong. */
function Asking(props: { rows: Rows; count: number }) {
  const { rows, count } = props;
  return (
    <>
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

/** Paints at most once a frame, however many things changed. Returns what is painted. */
function usePainted(canvas: { current: HTMLCanvasElement | null }, drawing: Drawing): { current: Drawing } {
  const look = theme.value;
  const colours = useMemo(() => chartColours(look === "dark"), [look]);
  const latest = useRef(drawing);
  latest.current = drawing;
  const pending = useRef(0);
  useLayoutEffect(() => {
    if (!canvas.current || drawing.width === 0) return;
    cancelAnimationFrame(pending.current);
    pending.current = requestAnimationFrame(
      () => canvas.current && paint(canvas.current, latest.current, colours),
    );
  }, [...Object.values(drawing), colours]);
  return latest;
}

/** The height of the box that the chart scrolls in. */
function useHeight(): [{ current: HTMLDivElement | null }, number] {
  const box = useRef<HTMLDivElement>(null);
  const [height, setHeight] = useState(400);
  useEffect(() => {
    const target = box.current!;
    const observer = new ResizeObserver(() => setHeight(target.clientHeight));
    observer.observe(target);
    return () => observer.disconnect();
  }, []);
  return [box, height];
}

interface Held {
  /** The held span as the address names it. */
  pinned: Spot | null;
  /** The same on the chart, if it is there. */
  held: Hit | null;
  /** Holds the job's span at a place of the chart, or none. */
  hold: (hit: Hit | null) => void;
}

function useHeld(rows: Rows): Held {
  const [pin, setPin] = useAddressed("pin");
  const pinned = useMemo(() => spotFrom(pin), [pin]);
  const held = useMemo(() => pinned && find(rows.items, pinned), [pinned, rows.items]);
  const hold = (hit: Hit | null) =>
    setPin(
      hit?.span?.job_id ? spotText(spotOf(hit.row, hit.span, (hit.span.start + hit.span.end) / 2)) : null,
    );
  return { pinned, held, hold };
}

/** What a key does. */
function pressed(event: KeyboardEvent, props: ChartProps, walk: Walk, { held, hold }: Held): void {
  // Buttons of the nodes have keys of their own.
  if (isTyping(event)) return;
  const isHere = event.target === event.currentTarget;
  const job = isHere && event.key === "Enter" ? walk.hit?.span?.job_id : null;
  if (event.shiftKey && walk.press(event.key)) event.preventDefault();
  else if (event.shiftKey && event.key.startsWith("Arrow")) return;
  else if (job && held?.span === walk.hit!.span) go(["jobs", job], { sel: walk.hit!.span!.frames ?? null });
  else if (job) hold(walk.hit);
  else if (event.key === "Escape") {
    walk.end();
    hold(null);
  } else if (keyed(event.key, props)) event.preventDefault();
}

/** What a key does to the view. */
function keyed(key: string, props: ChartProps): boolean {
  const { view, setView } = props;
  const length = view.to - view.from;
  const middle = view.from + length / 2;
  if (key === "ArrowLeft") setView({ from: view.from - length / 6, to: view.to - length / 6 });
  else if (key === "ArrowRight") setView({ from: view.from + length / 6, to: view.to + length / 6 });
  else if (key === "+" || key === "=") setView(zoomed(view, 1.5, middle));
  else if (key === "-") setView(zoomed(view, 1 / 1.5, middle));
  else if (key === "0") props.reset();
  else return false;
  return true;
}

interface Walk {
  spot: Spot | null;
  hit: Hit | null;
  /** Whether it was a key that leads somewhere. */
  press: (key: string) => boolean;
  end: () => void;
}

/** The span that keys lead to. It is brought into view. */
function useWalk(props: ChartProps, box: { current: HTMLElement | null }, scroll: number): Walk {
  const { items } = props.rows;
  const [spot, setSpot] = useState<Spot | null>(null);
  const hit = useMemo(() => spot && find(items, spot), [spot, items]);
  const press = (key: string) => {
    const next = walked(items, spot, key, props.view, Math.ceil(scroll / ROW));
    const there = next && find(items, next);
    if (!next || !there) return false;
    setSpot(next);
    if (there.span) {
      const view = showing(props.view, { from: there.span.start, to: there.span.end });
      if (view !== props.view) props.setView(view);
    }
    reveal(box.current!, items.indexOf(there.row));
    return true;
  };
  return { spot, hit, press, end: () => setSpot(null) };
}

/** A link may hold a span of a node further down: more nodes are asked for until it is there, and it is shown. */
function useSought(
  rows: Rows,
  pinned: Spot | null,
  held: Hit | null,
  box: { current: HTMLElement | null },
): void {
  const sought = useRef(pinned !== null);
  useEffect(() => {
    if (!sought.current) return;
    if (pinned && !held && !rows.complete) return rows.see(0, rows.items.length + PAGE);
    sought.current = false;
    if (held) reveal(box.current!, rows.items.indexOf(held.row));
  }, [pinned, held, rows.items, rows.complete]);
}

/** Scrolls a row of the chart into view. */
function reveal(box: HTMLElement, row: number): void {
  const top = row * ROW;
  const room = box.clientHeight - HEAD - ROW;
  if (box.scrollTop > top) box.scrollTop = top;
  else if (box.scrollTop < top - room) box.scrollTop = top - room;
}
