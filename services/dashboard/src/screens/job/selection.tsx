// The selected frames, and what can be done with them.

import { useEffect, useMemo, useState } from "preact/hooks";
import { post } from "../../api/client";
import type { FrameStrip as StripDoc, Job } from "../../api/types";
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
  return { indices, text, write, select: (next) => write(formatFrames([...next].map((at) => numbers[at]!))) };
}

/** States of frames that are not over: waiting, booked, running. */
const OPEN = "wbr";

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
          <button type="button" disabled={count === open.length} onClick={() => setAsked("retry")}>
            Retry…
          </button>
          <button type="button" disabled={open.length === 0} onClick={() => setAsked("cancel")}>
            Cancel frames…
          </button>
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
  const { job, doc, selected } = props;
  const count = selected.indices.size;
  const done = placesIn(doc, selected, "d").length;
  return (
    <Confirm
      title={`Render ${counted(count, "frame")} again?`}
      act="Retry"
      close={props.close}
      run={async () => {
        await post("/v1/jobs/{id}/frames/retry", { path: { id: job.id }, body: { frames: selected.text } });
        props.changed();
      }}
    >
      <p>
        {count === 1 ? `Frame ${selected.text} is` : `Frames ${selected.text} are`} booked and rendered again.{" "}
        {done > 0 && `${counted(done, "image")} will be replaced.`} It costs about as much as before.
      </p>
    </Confirm>
  );
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
        const frames = formatFrames(open.map((at) => numbers[at]!));
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
