// The frame strip: one cell a frame, thousands of frames. Height and sign tell a state, colour helps.

import { useEffect, useRef, useState } from "preact/hooks";
import { theme } from "../../ui/theme";
import { useWidth } from "../../ui/resource";
import { cellAt, layOut, type StripLayout } from "./strip-layout";
import { paint } from "./strip-paint";

export const STATES: Record<string, string> = {
  w: "waiting",
  b: "booked",
  r: "running",
  d: "done",
  f: "failed",
  c: "cancelled",
};

export interface StripProps {
  /** Frame numbers, ascending, and a letter of `STATES` for each. */
  frames: number[];
  states: string;
  /** Actual ÷ forecast of each frame, if the strip shows that. */
  ratios: (number | null)[] | null;
  /** Indices of selected frames. */
  selected: ReadonlySet<number>;
  select: (indices: Set<number>) => void;
  cursor: number | null;
  setCursor: (index: number | null) => void;
  open: (index: number) => void;
  /** A cell in words, for people who do not see it. */
  describe: (index: number) => string;
}

export function Strip(props: StripProps) {
  const [box, width] = useWidth<HTMLDivElement>();
  const canvas = useRef<HTMLCanvasElement>(null);
  /** Where a selection with Shift begins. */
  const anchor = useRef<number | null>(null);
  const layout = layOut(props.frames.length, width || 600);
  const { dragged, ...pointer } = useDrag(props, canvas, layout, anchor);
  const selected = dragged ?? props.selected;
  const look = theme.value;

  useEffect(() => {
    if (width > 0 && canvas.current) paint(canvas.current, layout, width, { ...props, selected });
  }, [width, look, props.states, props.ratios, selected, props.cursor, props.frames.length]);

  const move = (to: number, extend: boolean) => {
    const next = Math.min(props.frames.length - 1, Math.max(0, to));
    if (extend) {
      anchor.current ??= props.cursor ?? next;
      props.select(stretch(anchor.current, next, new Set()));
    } else anchor.current = null;
    props.setCursor(next);
  };
  const press = (event: KeyboardEvent) => {
    const now = props.cursor ?? -1;
    const steps: Record<string, number> = {
      ArrowRight: now + 1,
      ArrowLeft: Math.max(0, now - 1),
      ArrowDown: now + layout.perRow,
      ArrowUp: now - layout.perRow,
      Home: 0,
      End: props.frames.length - 1,
    };
    const to = steps[event.key];
    if (to !== undefined) move(to, event.shiftKey);
    else if (event.key === "Enter" && now >= 0) props.open(now);
    else if (event.key === " " && now >= 0) toggle(now);
    else if (event.key === "Escape") props.select(new Set());
    else if (event.key === "a" && (event.ctrlKey || event.metaKey))
      props.select(stretch(0, props.frames.length - 1, new Set()));
    else return;
    event.preventDefault();
  };
  const toggle = (index: number) => {
    const next = new Set(props.selected);
    if (!next.delete(index)) next.add(index);
    props.select(next);
  };

  return (
    <div ref={box} class="strip-box">
      <div
        class="strip"
        role="slider"
        tabIndex={0}
        aria-label="Frames"
        aria-valuemin={props.frames[0] ?? 0}
        aria-valuemax={props.frames[props.frames.length - 1] ?? 0}
        aria-valuenow={props.frames[props.cursor ?? 0] ?? 0}
        aria-valuetext={props.cursor === null ? "No frame chosen" : props.describe(props.cursor)}
        onKeyDown={press}
        {...pointer}
        onDblClick={() => props.cursor !== null && props.open(props.cursor)}
      >
        <canvas ref={canvas} style={{ width: `${width}px`, height: `${layout.rows * layout.cell[1]}px` }} />
      </div>
    </div>
  );
}

/** Selecting by drag: the cells under it become the selection when it ends. */
function useDrag(
  props: StripProps,
  canvas: { current: HTMLCanvasElement | null },
  layout: StripLayout,
  anchor: { current: number | null },
) {
  const drag = useRef<{ from: number; keep: ReadonlySet<number> } | null>(null);
  const [dragged, setDragged] = useState<ReadonlySet<number> | null>(null);
  const at = (event: PointerEvent) => {
    const place = canvas.current!.getBoundingClientRect();
    return cellAt(layout, event.clientX - place.left, event.clientY - place.top);
  };
  const end = () => {
    drag.current = null;
    setDragged(null);
  };
  return {
    dragged,
    onPointerDown(event: PointerEvent) {
      if (event.button !== 0) return;
      const index = at(event);
      const keep = event.ctrlKey || event.metaKey ? props.selected : new Set<number>();
      if (!event.shiftKey || anchor.current === null) anchor.current = index;
      drag.current = { from: anchor.current, keep };
      canvas.current!.setPointerCapture(event.pointerId);
      setDragged(stretch(drag.current.from, index, keep));
      props.setCursor(index);
    },
    onPointerMove(event: PointerEvent) {
      const index = at(event);
      if (drag.current && index !== props.cursor)
        setDragged(stretch(drag.current.from, index, drag.current.keep));
      props.setCursor(index);
    },
    onPointerUp(event: PointerEvent) {
      if (!drag.current) return;
      props.select(stretch(drag.current.from, at(event), drag.current.keep));
      end();
    },
    onPointerCancel: end,
    onPointerLeave() {
      if (drag.current === null) props.setCursor(null);
    },
  };
}

function stretch(from: number, to: number, keep: ReadonlySet<number>): Set<number> {
  const next = new Set(keep);
  for (let index = Math.min(from, to); index <= Math.max(from, to); index++) next.add(index);
  return next;
}
