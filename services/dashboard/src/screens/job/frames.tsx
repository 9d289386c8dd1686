// The frames of a job: strip, cost band, and what can be done with a selection.

import { useMemo, useState } from "preact/hooks";
import type { FrameStrip as StripDoc, Job } from "../../api/types";
import { param, setQuery } from "../../state/route";
import { cpuTime, grouped, money, signedPercent, work } from "../../ui/format";
import { parseFrames } from "../../ui/frames";
import { Mark } from "../../ui/mark";
import { Choice, Section, Trouble, Waiting } from "../../ui/parts";
import type { Resource } from "../../ui/resource";
import { LongTableBehind } from "../../ui/virtual";
import { Band } from "./band";
import { Selection, useSelection } from "./selection";
import { STATES, Strip } from "./strip";

export const QUANTITIES = [
  ["cpu_seconds", "CPU time"],
  ["work", "Work"],
  ["cost", "Money"],
] as const;
export type Quantity = (typeof QUANTITIES)[number][0];

/** Writes a value of a quantity, or a dash. */
export function written(quantity: Quantity, value: number | null | undefined): string {
  if (value == null) return "–";
  return quantity === "cpu_seconds" ? cpuTime(value) : quantity === "work" ? work(value) : money(value);
}

export function Frames(props: {
  job: Job;
  strip: Resource<StripDoc>;
  quantity: Quantity;
  changed: () => void;
}) {
  const { job, strip, quantity } = props;
  const numbers = useMemo(
    () => (strip.data ? (parseFrames(strip.data.frames) ?? []) : []),
    [strip.data?.frames],
  );
  const colouring = param("colour") === "ratio" ? "ratio" : "state";
  const [cursor, setCursor] = useState<number | null>(null);
  const selected = useSelection(numbers);
  if (!strip.data)
    return strip.error ? (
      <Trouble error={strip.error} retry={strip.reload} />
    ) : (
      <Waiting>Asking for the frames…</Waiting>
    );
  const doc = strip.data;
  const forecast = doc.p50.some((value) => value !== null);
  const ratios =
    colouring === "ratio" && forecast
      ? doc.actual.map((actual, at) => (actual === null || !doc.p50[at] ? null : actual / doc.p50[at]!))
      : null;
  const describe = (at: number) => describeCell(doc, numbers, at, quantity);
  return (
    <Section title="Frames" aside={<Looks colouring={colouring} quantity={quantity} />}>
      <Strip
        frames={numbers}
        states={doc.states}
        ratios={ratios}
        selected={selected.indices}
        select={selected.select}
        cursor={cursor}
        setCursor={setCursor}
        open={(at) => setQuery({ tab: "images", frame: String(numbers[at]) })}
        describe={describe}
      />
      <p class="readout">
        <Legend ratio={ratios !== null} states={doc.states} select={selected.select} />{" "}
        <span aria-hidden="true">{cursor === null ? "Double-click for images." : describe(cursor)}</span>
      </p>
      {forecast && <Band numbers={numbers} doc={doc} quantity={quantity} hover={setCursor} />}
      {strip.error && <Trouble error={strip.error} retry={strip.reload} />}
      <Selection job={job} doc={doc} numbers={numbers} selected={selected} changed={props.changed} />
      <FramesTable doc={doc} numbers={numbers} quantity={quantity} />
    </Section>
  );
}

function Looks(props: { colouring: "ratio" | "state"; quantity: Quantity }) {
  return (
    <div class="filters">
      <Choice
        label="Colour of the cells"
        value={props.colouring}
        options={[
          ["state", "State"],
          ["ratio", "Actual ÷ forecast"],
        ]}
        choose={(value) => setQuery({ colour: value === "ratio" ? value : null })}
      />
      <Choice
        label="Quantity"
        value={props.quantity}
        options={QUANTITIES}
        choose={(value) => setQuery({ in: value === "cpu_seconds" ? null : value })}
      />
    </div>
  );
}

function FramesTable(props: { doc: StripDoc; numbers: number[]; quantity: Quantity }) {
  const { doc, numbers, quantity } = props;
  return (
    <LongTableBehind
      label="Frames, as a table"
      head={["Frame", "State", "P50", "P80", "P95", "Actual", "Actual ÷ P50 − 1"]}
      count={numbers.length}
      row={(at) => {
        const actual = doc.actual[at];
        const p50 = doc.p50[at];
        return [
          numbers[at],
          <Mark of={STATES[doc.states[at] ?? "w"]!} />,
          written(quantity, p50),
          written(quantity, doc.p80[at]),
          written(quantity, doc.p95[at]),
          written(quantity, actual),
          actual == null || !p50 ? "–" : signedPercent(actual / p50 - 1),
        ];
      }}
    />
  );
}

function describeCell(doc: StripDoc, numbers: number[], at: number, quantity: Quantity): string {
  const state = STATES[doc.states[at] ?? "w"]!;
  const parts = [`Frame ${numbers[at]}: ${state}`];
  const p50 = doc.p50[at];
  const actual = doc.actual[at];
  if (actual != null) parts.push(`cost ${written(quantity, actual)}`);
  if (p50 != null) {
    parts.push(`forecast ${written(quantity, p50)} (P50), ${written(quantity, doc.p95[at])} (P95)`);
    if (actual != null && p50 > 0) parts.push(`${signedPercent(actual / p50 - 1)} against P50`);
  }
  return parts.join("; ");
}

/** What the cells mean. Those that failed can be selected by it. */
function Legend(props: { ratio: boolean; states: string; select: (places: Set<number>) => void }) {
  if (props.ratio) {
    return (
      <>
        <span class="swatch cheap" /> below 0.9 <span class="swatch mid" /> 0.9 to 1.1{" "}
        <span class="swatch warn" /> to 1.3 <span class="swatch bad" /> above 1.3 times the forecast. Frames
        that are not done show their state.
      </>
    );
  }
  const places = new Map<string, number[]>();
  for (const [at, letter] of [...props.states].entries()) {
    const these = places.get(letter);
    if (these) these.push(at);
    else places.set(letter, [at]);
  }
  return (
    <>
      {Object.entries(STATES).map(([letter, word]) => {
        const these = places.get(letter);
        if (!these) return null;
        const mark = <Mark of={word} word={`${grouped(these.length)} ${word}`} />;
        return (
          <span class="legend" key={letter}>
            {letter === "f" ? (
              <button
                type="button"
                class="plain"
                title="Select them"
                onClick={() => props.select(new Set(these))}
              >
                {mark}
              </button>
            ) : (
              mark
            )}
          </span>
        );
      })}
    </>
  );
}
