// The frames of a job: strip, cost band, and what can be done with a selection.

import { useEffect, useMemo, useState } from "preact/hooks";
import { get, post } from "../../api/client";
import type { FrameRow, Job, FrameStrip as StripDoc } from "../../api/types";
import { maySubmitTo } from "../../state/session";
import { param, setQuery } from "../../state/route";
import { Confirm } from "../../ui/dialog";
import { clean, counted, cpuTime, money, signedPercent, work } from "../../ui/format";
import { formatFrames, parseFrames } from "../../ui/frames";
import { glyphOf, Mark } from "../../ui/mark";
import { Choice, Section, Time, Trouble, Waiting } from "../../ui/parts";
import type { Resource } from "../../ui/resource";
import { useResource } from "../../ui/resource";
import { LongTableBehind } from "../../ui/virtual";
import { Band } from "./band";
import { fetchFrames, MOST_FETCHED } from "./fetch";
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
  const focus = (at: number | null) => {
    setCursor(at);
  };
  return (
    <Section
      title="Frames"
      aside={
        <div class="filters">
          <Choice
            label="Colour of the cells"
            value={colouring}
            options={[
              ["state", "State"],
              ["ratio", "Actual ÷ forecast"],
            ]}
            choose={(value) => setQuery({ colour: value === "ratio" ? value : null })}
          />
          <Choice
            label="Quantity"
            value={quantity}
            options={QUANTITIES}
            choose={(value) => setQuery({ in: value === "cpu_seconds" ? null : value })}
          />
        </div>
      }
    >
      <Strip
        frames={numbers}
        states={doc.states}
        ratios={ratios}
        selected={selected.indices}
        select={selected.select}
        cursor={cursor}
        setCursor={focus}
        open={(at) => setQuery({ tab: "images", frame: String(numbers[at]) })}
        describe={describe}
      />
      <p class="readout" aria-hidden="true">
        {cursor === null ? <Legend ratio={ratios !== null} states={doc.states} /> : describe(cursor)}
      </p>
      {forecast && <Band numbers={numbers} doc={doc} quantity={quantity} hover={setCursor} />}
      {strip.error && <Trouble error={strip.error} retry={strip.reload} />}
      <Selection job={job} doc={doc} numbers={numbers} selected={selected} changed={props.changed} />
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
    </Section>
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

function Legend(props: { ratio: boolean; states: string }) {
  if (props.ratio) {
    return (
      <>
        <span class="swatch cheap" /> below 0.9 <span class="swatch mid" /> 0.9 to 1.1{" "}
        <span class="swatch warn" /> to 1.3 <span class="swatch bad" /> above 1.3 times the forecast. Frames
        that are not done show their state.
      </>
    );
  }
  const counts = new Map<string, number>();
  for (const letter of props.states) counts.set(letter, (counts.get(letter) ?? 0) + 1);
  return (
    <>
      {Object.entries(STATES).map(([letter, word]) =>
        counts.has(letter) ? (
          <span class="legend" key={letter}>
            <Mark of={word} word={`${counts.get(letter)} ${word}`} />
          </span>
        ) : null,
      )}
      Double-click for images.
    </>
  );
}

interface Selected {
  indices: ReadonlySet<number>;
  text: string;
  select: (indices: Set<number>) => void;
  write: (text: string) => void;
}

/** The selection lives in the address, as frame numbers. */
function useSelection(numbers: number[]): Selected {
  const text = param("sel") ?? "";
  const indices = useMemo(() => {
    const wanted = new Set(parseFrames(text) ?? []);
    const out = new Set<number>();
    if (wanted.size) numbers.forEach((frame, at) => wanted.has(frame) && out.add(at));
    return out;
  }, [text, numbers]);
  const write = (next: string) => setQuery({ sel: next });
  return { indices, text, write, select: (next) => write(formatFrames([...next].map((at) => numbers[at]!))) };
}

type Act = "retry" | "cancel" | "fetch";

function Selection(props: {
  job: Job;
  doc: StripDoc;
  numbers: number[];
  selected: Selected;
  changed: () => void;
}) {
  const { job, doc, numbers, selected } = props;
  const [asked, setAsked] = useState<Act | null>(null);
  const [draft, setDraft] = useState(selected.text);
  useEffect(() => setDraft(selected.text), [selected.text]);
  const count = selected.indices.size;
  const letters = [...selected.indices].map((at) => doc.states[at]);
  const wrong = draft !== "" && parseFrames(draft) === null;
  const done = letters.filter((letter) => letter === "d").length;
  const open = letters.filter((letter) => letter === "w" || letter === "b" || letter === "r").length;
  const one = count === 1 ? numbers[[...selected.indices][0]!]! : null;
  return (
    <div class="selection">
      <label>
        Selected frames{" "}
        <input
          type="text"
          value={draft}
          placeholder="0-3,7"
          aria-invalid={wrong}
          onInput={(event) => {
            setDraft(event.currentTarget.value);
            if (parseFrames(event.currentTarget.value) || event.currentTarget.value === "")
              selected.write(event.currentTarget.value);
          }}
        />
      </label>
      <span class="muted">
        {wrong
          ? "Write 0-3,7."
          : count === 0
            ? "none: drag over the cells, or write numbers, to retry, cancel or fetch frames"
            : counted(count, "frame")}
      </span>
      {count > 0 && maySubmitTo(job.project) && (
        <>
          <button type="button" disabled={count === open} onClick={() => setAsked("retry")}>
            Retry…
          </button>
          <button type="button" disabled={open === 0} onClick={() => setAsked("cancel")}>
            Cancel frames…
          </button>
        </>
      )}
      {count > 0 && (
        <button type="button" disabled={done === 0} onClick={() => setAsked("fetch")}>
          Fetch…
        </button>
      )}
      {count > 0 && (
        <button type="button" class="plain" onClick={() => selected.write("")}>
          Clear
        </button>
      )}
      {one !== null && (
        <OneFrame job={job} frame={one} version={doc.states[[...selected.indices][0]!] ?? ""} />
      )}
      {asked === "retry" && (
        <Confirm
          title={`Render ${counted(count, "frame")} again?`}
          act="Retry"
          close={() => setAsked(null)}
          run={async () => {
            await post("/v1/jobs/{id}/frames/retry", {
              path: { id: job.id },
              body: { frames: selected.text },
            });
            props.changed();
          }}
        >
          <p>
            {count === 1 ? `Frame ${selected.text} is` : `Frames ${selected.text} are`} booked and rendered
            again. {done > 0 && `${counted(done, "image")} will be replaced.`} It costs about as much as
            before.
          </p>
        </Confirm>
      )}
      {asked === "cancel" && (
        <Confirm
          title={`Cancel ${counted(open, "frame")}?`}
          act="Cancel these frames"
          danger
          close={() => setAsked(null)}
          run={async () => {
            const frames = formatFrames(
              [...selected.indices]
                .filter((at) => "wbr".includes(doc.states[at] ?? ""))
                .map((at) => numbers[at]!),
            );
            await post("/v1/jobs/{id}/frames/cancel", { path: { id: job.id }, body: { frames } });
            props.changed();
          }}
        >
          <p>
            Frames that run are stopped, frames that wait are not started. Finished images stay. A retry
            brings them back.
          </p>
        </Confirm>
      )}
      {asked === "fetch" && (
        <FetchDialog
          job={job}
          frames={[...selected.indices].filter((at) => doc.states[at] === "d").map((at) => numbers[at]!)}
          close={() => setAsked(null)}
        />
      )}
    </div>
  );
}

function FetchDialog(props: { job: Job; frames: number[]; close: () => void }) {
  const [kind, setKind] = useState<"png" | "exr">("png");
  const [said, setSaid] = useState("");
  const many = props.frames.length > MOST_FETCHED;
  return (
    <Confirm
      title={`Fetch ${counted(props.frames.length, "image")}`}
      act="Fetch as one zip file"
      ready={!many}
      close={props.close}
      run={() =>
        fetchFrames(props.job, props.frames, kind, (done) =>
          setSaid(`${done} of ${props.frames.length} fetched…`),
        )
      }
    >
      <Choice
        label="Kind of image"
        value={kind}
        options={[
          ["png", "PNG, for looking at"],
          ["exr", "EXR, linear with all layers"],
        ]}
        choose={setKind}
      />
      <p>
        {many && `That is more than a browser should hold: at most ${MOST_FETCHED}. `}In a terminal, this
        fetches all images of the job:
      </p>
      <pre tabIndex={0}>
        <code>forelight submit --job {props.job.id} --out images/</code>
      </pre>
      {said && <p role="status">{said}</p>}
    </Confirm>
  );
}

function OneFrame(props: { job: Job; frame: number; version: string }) {
  const row = useResource<FrameRow>(
    (signal) =>
      get("/v1/jobs/{id}/frames/{frame}", { path: { id: props.job.id, frame: props.frame }, signal }),
    [props.job.id, props.frame, props.version],
  );
  const frame = row.data;
  if (!frame)
    return row.error ? (
      <Trouble error={row.error} retry={row.reload} />
    ) : (
      <Waiting>Asking for frame {props.frame}…</Waiting>
    );
  return (
    <div class="one-frame">
      <dl class="facts">
        <div>
          <dt>Frame {frame.frame}</dt>
          <dd>
            <Mark of={frame.state} />
            {frame.state === "leased" && ` ${(frame.progress * 100).toFixed(0)} %`}
          </dd>
        </div>
        {(frame.parts ?? 1) > 1 && (
          <div>
            <dt>Parts</dt>
            <dd>
              {frame.parts_done ?? 0} of {frame.parts} done
            </dd>
          </div>
        )}
        {frame.booked && (
          <div>
            <dt>{(frame.parts ?? 1) > 1 ? "First part booked" : "Booked"}</dt>
            <dd>
              {clean(frame.booked.node)}, <Time at={frame.booked.start} /> to <Time at={frame.booked.end} />
            </dd>
          </div>
        )}
        {frame.started && (
          <div>
            <dt>Ran</dt>
            <dd>
              <Time at={frame.started} exact />{" "}
              {frame.finished && (
                <>
                  to <Time at={frame.finished} exact />
                </>
              )}
            </dd>
          </div>
        )}
        <div>
          <dt>Attempts</dt>
          <dd>{frame.attempts}</dd>
        </div>
        {frame.actual && (
          <div>
            <dt>Peak memory</dt>
            <dd>{(frame.actual.peak_rss_bytes / 2 ** 20).toFixed(0)} MiB</dd>
          </div>
        )}
      </dl>
      {frame.error && (
        <p class="trouble">
          <span class="glyph" aria-hidden="true">
            {glyphOf("failed")}
          </span>
          {clean(frame.error)}
        </p>
      )}
      <p>
        <button
          type="button"
          class="plain"
          onClick={() => setQuery({ tab: "images", frame: String(frame.frame) })}
        >
          Its images
        </button>
        {" · "}
        <button
          type="button"
          class="plain"
          onClick={() => setQuery({ tab: "logs", frame: String(frame.frame) })}
        >
          Its log
        </button>
        {" · "}
        <button
          type="button"
          class="plain"
          onClick={() => setQuery({ tab: "why", frame: String(frame.frame) })}
        >
          Why it costs that
        </button>
      </p>
    </div>
  );
}
