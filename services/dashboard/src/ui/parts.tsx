// Small parts that all screens use.

import type { ComponentChildren } from "preact";
import { useId, useState } from "preact/hooks";
import { clockTime, exactTime, fullTime, money, sentence, told } from "./format";

/** An instant in the viewer's zone, with everything in its tooltip. */
export function Time(props: { at: number | string | null | undefined; exact?: boolean; none?: string }) {
  if (props.at == null) return <span class="none">{props.none ?? "–"}</span>;
  const at = typeof props.at === "string" ? Date.parse(props.at) : props.at;
  return (
    <time dateTime={new Date(at).toISOString()} title={fullTime(at)}>
      {props.exact ? exactTime(at) : clockTime(at)}
    </time>
  );
}

/** When something was computed that goes on changing. */
export function AsOf(props: { at: string }) {
  return (
    <span class="note">
      as of <Time at={props.at} />
    </span>
  );
}

export function Money(props: { of: number | null | undefined; none?: string }) {
  if (props.of == null) return <span class="none">{props.none ?? "–"}</span>;
  return (
    <span class="number" title={`${(props.of / 1e6).toFixed(6)} of the farm's currency`}>
      {money(props.of)}
    </span>
  );
}

/**
 * A text of the service: instants in the viewer's zone, and what stands in backquotes as code. `bare`: not as a
 * sentence. `named`: it may begin with the name of a job or node.
 */
export function Prose(props: { text: string; bare?: boolean; named?: boolean }) {
  const parts = (props.bare ? told(props.text) : sentence(props.text, props.named)).split("`");
  return <>{parts.map((part, at) => (at % 2 === 1 ? <code key={at}>{part}</code> : part))}</>;
}

/** What is being done while nothing can be shown yet. Never without words. */
export function Waiting(props: { children: ComponentChildren }) {
  return (
    <p class="waiting" role="status">
      {props.children}
    </p>
  );
}

/** What went wrong, and how to try again. */
export function Trouble(props: { error: Error; retry?: () => void }) {
  return (
    <p class="trouble" role="alert">
      <span class="glyph" aria-hidden="true">
        ⚠
      </span>
      <Prose text={props.error.message} />{" "}
      {props.retry && (
        <button type="button" class="plain" onClick={props.retry}>
          Try again
        </button>
      )}
    </p>
  );
}

/** A part of a screen with its heading. */
export function Section(props: {
  title: ComponentChildren;
  aside?: ComponentChildren;
  children: ComponentChildren;
  class?: string;
  level?: 2 | 3;
}) {
  const id = useId();
  const Heading = props.level === 3 ? "h3" : "h2";
  return (
    <section aria-labelledby={id} class={props.class}>
      <div class="section-head">
        <Heading id={id}>{props.title}</Heading>
        {props.aside}
      </div>
      {props.children}
    </section>
  );
}

/** What is behind a chart. It is made when it is opened. */
export function Behind(props: { label: string; note?: string; children: ComponentChildren }) {
  const [open, setOpen] = useState(false);
  return (
    <details class="behind" open={open} onToggle={(event) => setOpen(event.currentTarget.open)}>
      <summary>{props.label}</summary>
      {open && props.children}
      {props.note && <p class="note">{props.note}</p>}
    </details>
  );
}

/** The numbers behind a chart, as a table that opens. */
export function TableBehind(props: {
  label: string;
  head: string[];
  rows: () => ComponentChildren[][];
  note?: string;
}) {
  return (
    <Behind label={props.label} note={props.note}>
      <Rows label={props.label} head={props.head} rows={props.rows} />
    </Behind>
  );
}

function Rows(props: { label: string; head: string[]; rows: () => ComponentChildren[][] }) {
  return (
    <div class="scroll-x" tabIndex={0} role="region" aria-label={props.label}>
      <table class="numbers">
        <thead>
          <tr>
            {props.head.map((name) => (
              <th scope="col" key={name}>
                {name}
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {props.rows().map((row, at) => (
            <tr key={at}>
              {row.map((cell, column) => (
                <td key={column}>{cell}</td>
              ))}
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

/**
 * A button that keeps the focus while what it began is being done: presses are ignored meanwhile, but the browser
 * takes no focus away.
 */
export function Act(props: {
  busy: boolean;
  type?: "button" | "submit";
  class?: string;
  title?: string;
  label?: string;
  /** Whether it could not be pressed anyway. */
  disabled?: boolean;
  press?: () => void;
  children: ComponentChildren;
}) {
  return (
    <button
      type={props.type ?? "button"}
      class={props.class}
      title={props.title}
      aria-label={props.label}
      aria-disabled={props.busy ? "true" : undefined}
      disabled={props.disabled ?? false}
      onClick={(event) => (props.busy ? event.preventDefault() : props.press?.())}
    >
      {props.children}
    </button>
  );
}

/** A choice of a few, as buttons: one is pressed. */
export function Choice<T extends string>(props: {
  label: string;
  value: T;
  options: readonly (readonly [value: T, word: string])[];
  choose: (value: T) => void;
}) {
  return (
    <div class="choice" role="group" aria-label={props.label}>
      {props.options.map(([value, word]) => (
        <button
          type="button"
          key={value}
          aria-pressed={props.value === value}
          onClick={() => props.choose(value)}
        >
          {word}
        </button>
      ))}
    </div>
  );
}

/** A label, a field, and what is wrong with it. */
export function Field(props: {
  label: string;
  hint?: ComponentChildren;
  error?: string | null;
  children: (id: string) => ComponentChildren;
}) {
  const id = useId();
  return (
    <div class={props.error ? "field wrong" : "field"}>
      <label for={id}>{props.label}</label>
      {props.children(id)}
      {props.hint && <p class="hint">{props.hint}</p>}
      {props.error && (
        <p class="wrong-text" role="alert">
          <Prose text={props.error} />
        </p>
      )}
    </div>
  );
}
