// Submit: a bundle, what is wanted, and a quote before anything is booked.

import { useEffect, useRef, useState } from "preact/hooks";
import { cancelJob } from "../../actions/jobs";
import { get, newKey, post, Refused } from "../../api/client";
import type { Bundle, Job } from "../../api/types";
import { go, param } from "../../state/route";
import { maySubmit, session } from "../../state/session";
import { titled } from "../../state/tab";
import { bytes, clean, counted, percent } from "../../ui/format";
import { Trouble, Waiting } from "../../ui/parts";
import { asError, useResource } from "../../ui/resource";
import { droppedFiles, pack, pickedFiles, upload } from "./bundle";
import { type Draft, draftFor, draftOf, fieldOf, requestOf, type Wrong } from "./draft";
import { Fields } from "./form";
import { isQuote, Quote } from "./quote";
import "../../styles/job.css";
import "../../styles/submit.css";

interface Wanted {
  bundle: Job["bundle"];
  /** The scene, unless its renderer has to find out first. */
  scene: Bundle["scene"];
  own: boolean;
  draft: Draft;
  /** The job on hold that this one replaces. */
  instead: string | null;
}

export function SubmitScreen() {
  useEffect(() => titled("Submit"), []);
  const quoted = param("job");
  const again = param("again");
  const [wanted, setWanted] = useState<Wanted | null>(null);
  if (!maySubmit.value) {
    return (
      <div class="submit">
        <h1>Submit</h1>
        <p>
          Your role is {session.value?.role}: it may look at everything and submit nothing. Sign in with a
          token of the role submitter or operator.
        </p>
      </div>
    );
  }
  return (
    <div class="submit">
      {quoted ? (
        <Quote
          id={quoted}
          key={quoted}
          edit={(job) => {
            setWanted({ ...wantedOf(job), instead: job.id });
            go(["submit"], { replaces: param("replaces") });
          }}
        />
      ) : wanted ? (
        <Form wanted={wanted} back={() => (setWanted(null), go(["submit"]))} change={setWanted} />
      ) : again ? (
        <Again id={again} got={setWanted} />
      ) : (
        <Pick
          got={(bundle) =>
            setWanted({
              bundle: { id: bundle.id },
              scene: bundle.scene,
              own: bundle.scene.width > 0,
              draft: draftFor(bundle),
              instead: null,
            })
          }
        />
      )}
    </div>
  );
}

/** What was wanted of a job, to be changed and asked for once more. */
function wantedOf(job: Job): Wanted {
  return {
    bundle: job.bundle,
    scene: job.scene,
    own: !job.renderer,
    draft: draftOf(job),
    instead: null,
  };
}

/** A job that is over, as the beginning of another one. */
function Again(props: { id: string; got: (wanted: Wanted) => void }) {
  const { id } = props;
  const job = useResource<Job>((signal) => get("/v1/jobs/{id}", { path: { id }, signal }), [id]);
  useEffect(() => {
    if (!job.data) return;
    const wanted = wantedOf(job.data);
    const isPast = job.data.deadline != null && Date.parse(job.data.deadline) <= Date.now();
    props.got(isPast ? { ...wanted, draft: { ...wanted.draft, deadline: "" } } : wanted);
  }, [job.data]);
  return job.error ? (
    <Trouble error={job.error} retry={job.reload} />
  ) : (
    <Waiting>Asking for the job…</Waiting>
  );
}

function Pick(props: { got: (bundle: Bundle) => void }) {
  const [state, setState] = useState<{ busy: string | null; error: Error | null }>({
    busy: null,
    error: null,
  });
  const [over, setOver] = useState(false);
  const take = async (files: ReturnType<typeof pickedFiles> | Promise<ReturnType<typeof pickedFiles>>) => {
    try {
      setState({ busy: "Packing the files…", error: null });
      const packed = await pack(await files, (share) =>
        setState({ busy: `Packing the files: ${percent(share)}…`, error: null }),
      );
      setState({
        busy: `Uploading ${packed.name}, ${bytes(packed.body.size)}. The service loads the scene before it answers…`,
        error: null,
      });
      props.got(await upload(packed));
    } catch (failure) {
      setState({ busy: null, error: asError(failure) });
    }
  };
  return (
    <>
      <h1>Submit</h1>
      <p>You see what it will cost, and how sure that is, before anything is booked.</p>
      <div
        class={over ? "drop over" : "drop"}
        onDragOver={(event) => {
          event.preventDefault();
          setOver(true);
        }}
        onDragLeave={() => setOver(false)}
        onDrop={(event) => {
          event.preventDefault();
          setOver(false);
          if (event.dataTransfer) void take(droppedFiles(event.dataTransfer.items));
        }}
      >
        {state.busy ? (
          <Waiting>{state.busy}</Waiting>
        ) : (
          <Pickers take={(files) => void take(pickedFiles(files))} />
        )}
      </div>
      {state.error && <Trouble error={state.error} />}
      <p class="note">
        In a terminal, the same is <code>forelight submit BUNDLE --frames 0-47 --deadline 2h --hold</code>,
        and then <code>forelight accept JOB</code>.
      </p>
    </>
  );
}

/** What can be dropped, and buttons that pick it. */
function Pickers(props: { take: (files: FileList) => void }) {
  return (
    <>
      <p>
        <strong>Drop a bundle here</strong>: a folder with <code>scene.json</code> or one glTF file, a zip
        file of it, or a Blender file.
      </p>
      <div class="buttons">
        <label class="button">
          Pick a file
          <input
            type="file"
            class="unseen"
            accept=".zip,.blend,.glb"
            onChange={(event) => event.currentTarget.files && props.take(event.currentTarget.files)}
          />
        </label>
        <label class="button">
          Pick a folder
          <input
            type="file"
            class="unseen"
            {...{ webkitdirectory: true }}
            onChange={(event) => event.currentTarget.files && props.take(event.currentTarget.files)}
          />
        </label>
      </div>
    </>
  );
}

/** Cancels a job that is still a quote. Somebody else may have booked it meanwhile. */
async function cancelQuote(id: string): Promise<void> {
  const { state } = await get("/v1/jobs/{id}", { path: { id } });
  if (isQuote(state)) await cancelJob(id);
}

function Form(props: { wanted: Wanted; back: () => void; change: (wanted: Wanted) => void }) {
  const { wanted } = props;
  const { draft, scene } = wanted;
  const [state, setState] = useState<{
    busy: boolean;
    error: Error | null;
    wrong: Wrong;
  }>({ busy: false, error: null, wrong: {} });
  // Who presses again after a lost answer gets the same job, and not a second one.
  const attempt = useRef({ content: "", key: "" });
  const submit = async (event: Event) => {
    event.preventDefault();
    const { request, wrong } = requestOf(draft, wanted.bundle, wanted.own ? scene : null);
    if (Object.keys(wrong).length) {
      setState({ busy: false, error: null, wrong });
      return;
    }
    setState({ busy: true, error: null, wrong: {} });
    try {
      const content = JSON.stringify([request, wanted.instead]);
      if (attempt.current.content !== content) attempt.current = { content, key: newKey() };
      const job = await post("/v1/jobs", { body: request, key: attempt.current.key });
      if (wanted.instead) await cancelQuote(wanted.instead);
      go(["submit"], { job: job.id, replaces: param("replaces") });
    } catch (failure) {
      const field = failure instanceof Refused ? fieldOf(failure.pointer) : null;
      setState({
        busy: false,
        error: field ? null : asError(failure),
        wrong: field ? { [field]: asError(failure).message } : {},
      });
    }
  };
  return (
    <>
      <h1>{wanted.instead ? `Change ${clean(draft.name)}` : "What do you want?"}</h1>
      <p class="muted">
        {clean(scene.name)}
        {scene.triangles > 0 &&
          `: ${counted(scene.triangles, "triangle")}, ${counted(scene.objects, "object")}, ${counted(scene.materials, "material")}, ${counted(scene.frames, "frame")}, ${scene.width} × ${scene.height}`}
        {!wanted.own && ". Its renderer tells more once it has looked at it."}{" "}
        {!wanted.instead && (
          <button type="button" class="plain" onClick={props.back}>
            Another bundle
          </button>
        )}
      </p>
      <form onSubmit={submit}>
        <Fields
          draft={draft}
          scene={wanted.own ? scene : null}
          own={wanted.own}
          wrong={state.wrong}
          change={(part) => props.change({ ...wanted, draft: { ...draft, ...part } })}
        />
        {state.error && <Trouble error={state.error} />}
        <div class="buttons">
          <button type="submit" class="primary" disabled={state.busy}>
            {state.busy ? "Asking for a quote…" : "Get a quote"}
          </button>
          <span class="muted">Nothing is booked yet.</span>
        </div>
      </form>
    </>
  );
}
