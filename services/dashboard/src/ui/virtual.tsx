// Long lists and tables of rows of one height: only those in view are in the document. The window scrolls, or a box.

import type { ComponentChildren } from "preact";
import { useLayoutEffect, useRef, useState } from "preact/hooks";
import { Behind } from "./parts";

const MARGIN = 12;

export function VirtualRows<T>(props: {
  /** The rows, or how many there are. */
  items: readonly T[] | { length: number };
  height: number;
  /** Role of the container, such as `rowgroup`. */
  role?: string;
  row: (item: T, at: number) => ComponentChildren;
  /** What tells a row from others, so that focus and messages stay with it when others come before it. */
  keyOf?: (item: T) => string;
  /** Is told which rows are shown, also beyond the last one that is there. */
  seen?: (first: number, last: number) => void;
  /** The box in which they scroll, if it is not the window. */
  within?: { current: HTMLElement | null };
}) {
  const element = useRef<HTMLDivElement>(null);
  const [range, setRange] = useState<[number, number]>([0, 60]);
  const count = props.items.length;
  const { height, seen, within } = props;

  useLayoutEffect(() => {
    const scroller = within?.current ?? null;
    const measure = () => {
      const box = element.current?.getBoundingClientRect();
      if (!box) return;
      const top = box.top - (scroller?.getBoundingClientRect().top ?? 0);
      const room = scroller?.clientHeight ?? innerHeight;
      const first = Math.max(0, Math.min(count, Math.floor(-top / height)) - MARGIN);
      const below = Math.max(first, Math.ceil((room - top) / height) + MARGIN);
      const last = Math.min(count, below);
      setRange((old) => (old[0] === first && old[1] === last ? old : [first, Math.max(first, last)]));
      seen?.(first, below);
    };
    measure();
    const target = scroller ?? window;
    target.addEventListener("scroll", measure, { passive: true });
    addEventListener("resize", measure);
    // What stands above the list may grow or go.
    const observer = new ResizeObserver(measure);
    observer.observe(scroller ?? document.body);
    return () => {
      observer.disconnect();
      target.removeEventListener("scroll", measure);
      removeEventListener("resize", measure);
    };
  }, [count, height, seen, within]);

  const [first, last] = range;
  return (
    <div
      ref={element}
      role={props.role as never}
      style={{ height: `${count * height}px`, position: "relative" }}
    >
      {Array.from({ length: Math.max(0, Math.min(last, count) - first) }, (_, at) => (
        <div
          key={props.keyOf?.((props.items as readonly T[])[first + at]!) ?? first + at}
          role="presentation"
          style={{
            position: "absolute",
            left: 0,
            right: 0,
            top: `${(first + at) * height}px`,
            height: `${height}px`,
          }}
        >
          {props.row((props.items as readonly T[])[first + at]!, first + at)}
        </div>
      ))}
    </div>
  );
}

/** A long table, with the names of its columns above. */
export function VirtualTable<T>(props: {
  /** Name of the region in which it scrolls sideways, and of the table. */
  region: string;
  name: string;
  /** Classes of the table, and of a row. A row of names has the class `head` as well. */
  table: string;
  line: string;
  head: string;
  columns: readonly string[];
  items: readonly T[];
  height: number;
  seen: (first: number, last: number) => void;
  row: (item: T) => ComponentChildren;
  keyOf: (item: T) => string;
}) {
  return (
    <div class="scroll-x list-box" tabIndex={0} role="region" aria-label={props.region}>
      <div role="table" aria-label={props.name} class={props.table}>
        <div role="rowgroup">
          <div role="row" class={`${props.line} ${props.head}`}>
            <Columns names={props.columns} />
          </div>
        </div>
        <VirtualRows
          role="rowgroup"
          items={props.items}
          height={props.height}
          seen={props.seen}
          row={props.row}
          keyOf={props.keyOf}
        />
      </div>
    </div>
  );
}

function Columns(props: { names: readonly string[] }) {
  return (
    <>
      {props.names.map((name) => (
        <span role="columnheader" key={name}>
          {name}
        </span>
      ))}
    </>
  );
}

const BEHIND = 24;

/** The numbers behind a chart of thousands, as a table that opens. Only rows in view are made. */
export function LongTableBehind(props: {
  label: string;
  head: readonly string[];
  count: number;
  row: (at: number) => ComponentChildren[];
  note?: string;
}) {
  return (
    <Behind label={props.label} note={props.note}>
      <LongRows {...props} />
    </Behind>
  );
}

function LongRows(props: {
  label: string;
  head: readonly string[];
  count: number;
  row: (at: number) => ComponentChildren[];
}) {
  const box = useRef<HTMLDivElement>(null);
  const columns = { gridTemplateColumns: `minmax(0, 2fr) repeat(${props.head.length - 1}, minmax(0, 1fr))` };
  return (
    <div class="scroll-x" ref={box} tabIndex={0} role="region" aria-label={props.label}>
      <div
        role="table"
        aria-label={props.label}
        aria-rowcount={props.count + 1}
        class="long-table"
        style={{ minWidth: `${props.head.length * 96}px` }}
      >
        <div role="rowgroup" class="long-head">
          <div role="row" aria-rowindex={1} class="long-row" style={columns}>
            <Columns names={props.head} />
          </div>
        </div>
        <VirtualRows
          role="rowgroup"
          items={{ length: props.count }}
          height={BEHIND}
          within={box}
          row={(_, at) => (
            <div role="row" aria-rowindex={at + 2} class="long-row" style={columns}>
              {props.row(at).map((cell, column) => (
                <span role="cell" key={column}>
                  {cell}
                </span>
              ))}
            </div>
          )}
        />
      </div>
    </div>
  );
}
