// The selected frames, and what can be done with them.

import { useEffect, useMemo, useState } from "preact/hooks";
import { post } from "../../api/client";
import type { FrameStrip as StripDoc, Job } from "../../api/types";
import { isOver } from "../../state/news";
import { param, setQuery } from "../../state/route";
import { maySubmitTo } from "../../state/session";
import { Confirm } from "../../ui/dialog";
import { counted } from "../../ui/format";
import { formatFrames, parseFrames } from "../../ui/frames";
import { Choice } from "../../ui/parts";
import { fetchFrames, MOST_FETCHED } from "./fetch";
import { OneFrame } from "./one-frame";

interface Selected {
  indices: ReadonlySet<number>;
  text: string;
  select: (indices: Set<number>) => void;
  write: (text: string) => void;
}

/** The selection lives in the address, as frame numbers. */
export function useSelection(numbers: number[]): Selected {
  const text = param("sel") ?? "";
  const indices = useMemo(() => {
    const wanted = new Set(parseFrames(text) ?? []);
    const out = new Set<number>();
    if (wanted.size) numbers.forEach((frame, at) => wanted.has(frame) && out.add(at));
    return out;
  }, [text, numbers]);
  const write = (next: string) => setQuery({ sel: next });
  return { indices, text, write, select: (next) => write(framesAt(numbers, next)) };
}

/** States of frames that are not over: waiting, booked, running. */
const OPEN = "wbr";

/** Whether frames of a job can be rendered again: none of a cancelled one, nor of one that was never booked. */
const canRetry = (job: Job) => job.state !== "cancelled" && (job.state !== "failed" || job.plan_id != null);

/** The frames at these places, as text for people and for the API. */
const framesAt = (numbers: number[], places: Iterable<number>) =>
  formatFrames(Array.from(places, (at) => numbers[at]!));

/** Places of the selected frames that are in one of these states. */
function placesIn(doc: StripDoc, selected: Selected, states: string): number[] {
  return [...selected.indices].filter((at) => states.includes(doc.states[at] ?? "-"));
}

interface Asked {
  job: Job;
  doc: StripDoc;
  numbers: number[];
  selected: Selected;
  changed: () => void;
}

type Act = "retry" | "cancel" | "fetch";

export function Selection(props: Asked) {
  const { job, doc, numbers, selected } = props;
  const [asked, setAsked] = useState<Act | null>(null);
  const [draft, setDraft] = useState(selected.text);
  useEffect(() => setDraft(selected.text), [selected.text]);
  const count = selected.indices.size;
  const wrong = draft !== "" && parseFrames(draft) === null;
  const done = placesIn(doc, selected, "d");
  const open = placesIn(doc, selected, OPEN);
  const failed = [...doc.states].flatMap((state, at) => (state === "f" ? [at] : []));
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
      {count === 0 && failed.length > 0 && canRetry(job) && maySubmitTo(job.project) && (
        <button
          type="button"
          onClick={() => {
            selected.select(new Set(failed));
            setAsked("retry");
          }}
        >
          Retry {counted(failed.length, "failed frame")}…
        </button>
      )}
      {count > 0 && maySubmitTo(job.project) && (
        <>
          {canRetry(job) && (
            <button type="button" disabled={count === open.length} onClick={() => setAsked("retry")}>
              Retry…
            </button>
          )}
          {!isOver(job.state) && (
            <button type="button" disabled={open.length === 0} onClick={() => setAsked("cancel")}>
              Cancel frames…
            </button>
          )}
        </>
      )}
      {count > 0 && (
        <button type="button" disabled={done.length === 0} onClick={() => setAsked("fetch")}>
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
      {asked === "retry" && <RetryDialog {...props} close={() => setAsked(null)} />}
      {asked === "cancel" && <CancelDialog {...props} close={() => setAsked(null)} />}
      {asked === "fetch" && (
        <FetchDialog job={job} frames={done.map((at) => numbers[at]!)} close={() => setAsked(null)} />
      )}
    </div>
  );
}

function RetryDialog(props: Asked & { close: () => void }) {
  const { job, doc, numbers, selected } = props;
  const count = selected.indices.size;
  const frames = framesAt(numbers, selected.indices);
  const done = placesIn(doc, selected, "d").length;
  const stopped = job.state === "failed" ? stoppedBeside(job, doc, selected) : 0;
  return (
    <Confirm
      title={`Render ${counted(count, "frame")} again?`}
      act="Retry"
      close={props.close}
      run={async () => {
        await post("/v1/jobs/{id}/frames/retry", { path: { id: job.id }, body: { frames } });
        props.changed();
      }}
    >
      <p>
        {count === 1 ? `Frame ${frames}` : `Frames ${frames}`}
        {stopped > 0 && ` and the ${counted(stopped, "frame")} that stopped with the job`}{" "}
        {count + stopped === 1 ? "is" : "are"} booked and rendered again.{" "}
        {done > 0 && `${counted(done, "image")} will be replaced. `}
        {stopped === 0 && "It costs about as much as before."}
      </p>
    </Confirm>
  );
}

/** Number of frames beside the selected ones that a job left when it failed: all but those taken out of it. */
function stoppedBeside(job: Job, doc: StripDoc, selected: Selected): number {
  const left = [...doc.states].filter((letter) => letter !== "d").length - (job.frames_cancelled ?? 0);
  return Math.max(0, left - placesIn(doc, selected, "wbrfc").length);
}

function CancelDialog(props: Asked & { close: () => void }) {
  const { job, doc, numbers, selected } = props;
  const open = placesIn(doc, selected, OPEN);
  return (
    <Confirm
      title={`Cancel ${counted(open.length, "frame")}?`}
      act="Cancel these frames"
      danger
      close={props.close}
      run={async () => {
        const frames = framesAt(numbers, open);
        await post("/v1/jobs/{id}/frames/cancel", { path: { id: job.id }, body: { frames } });
        props.changed();
      }}
    >
      <p>
        Frames that run are stopped, frames that wait are not started. Finished images stay. A retry brings
        them back.
      </p>
    </Confirm>
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
