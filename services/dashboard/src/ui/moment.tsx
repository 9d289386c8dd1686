// Instants that a person types, in the viewer's zone.

import type { ComponentChildren } from "preact";
import { timeZone } from "./format";
import { Field } from "./parts";

/** What a field says of a text that is no instant. */
export const NOT_A_TIME = "Write a date and a time, with a year of four digits.";

const LAST = "9999-12-31T23:59";

/** The text of a `datetime-local` field. */
export function localText(at: number): string {
  const local = new Date(at - new Date(at).getTimezoneOffset() * 60_000);
  return local.toISOString().slice(0, 16);
}

/** The timestamp of such a text, or `null` if it is none. */
export function timestampOf(text: string): string | null {
  const at = /^\d{4}-/.test(text) ? new Date(text) : null;
  return at === null || Number.isNaN(at.getTime()) ? null : at.toISOString();
}

/** A field for an instant. */
export function Moment(props: {
  /** Its label, before the zone. */
  label: string;
  /** Whether the label names the zone. */
  zoned?: boolean;
  hint?: ComponentChildren;
  value: string;
  /** What is wrong with it, besides that it may be no instant. */
  error?: string | null;
  required?: boolean;
  change: (text: string) => void;
}) {
  const isWrong = props.value !== "" && timestampOf(props.value) === null;
  return (
    <Field
      label={props.zoned === false ? props.label : `${props.label} (${timeZone})`}
      hint={props.hint}
      error={isWrong ? NOT_A_TIME : (props.error ?? null)}
    >
      {(id) => (
        <input
          id={id}
          type="datetime-local"
          max={LAST}
          required={props.required ?? false}
          value={props.value}
          onInput={(event) => props.change(event.currentTarget.value)}
        />
      )}
    </Field>
  );
}
