// The quote of a job on hold: how it is made, what it says, and the three things that can be done with it.

import { useEffect, useState } from "preact/hooks";
import { cancelJob } from "../../actions/jobs";
import { get, post } from "../../api/client";
import type { AnswersDoc, Explanation, ForecastDoc, Job } from "../../api/types";
import { onEvents } from "../../state/live";
import { isNews } from "../../state/news";
import { now } from "../../state/now";
import { go, href, param } from "../../state/route";
import { bytes, clean, counted, cpuTime, percent, words, work } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { AsOf, Money, Prose, Section, Trouble, Waiting } from "../../ui/parts";
import { asError, useResource, useThrottled } from "../../ui/resource";
import { BudgetHold } from "../job/budget";
import { Paused } from "../job/paused";
import { useTasks } from "../job/tasks";
import { When } from "./when";

export function Quote(props: { id: string; edit: (job: Job) => void }) {
  const { id } = props;
  const job = useResource<Job>((signal) => get("/v1/jobs/{id}", { path: { id }, signal }), [id]);
  const soon = useThrottled(job.reload, 400);
  useEffect(
    () => onEvents((events) => events.some((event) => isNews(event) && event.job_id === id) && soon(), soon),
    [id],
  );
  const doc = job.data;
  if (!doc)
    return job.error ? (
      <Trouble error={job.error} retry={job.reload} />
    ) : (
      <Waiting>Asking for the job…</Waiting>
    );
  return (
    <>
      <h1>
        Quote for {clean(doc.name)} <Mark of={doc.state} />
      </h1>
      <p class="muted">
        {counted(doc.frames_total, "frame")} of {clean(doc.scene.name)}, {settingsWords(doc)}.
        {doc.plan_id ? "" : " Nothing is booked before you accept."}
      </p>
      <Paused job={doc} changed={job.reload} />
      <Making job={doc} />
      {(doc.state === "quoted" || doc.plan_id) && <Ready job={doc} edit={props.edit} />}
      {doc.state === "failed" && (
        <Trouble error={new Error(`The quote failed: ${clean(doc.error ?? "the job’s log says why")}`)} />
      )}
      {doc.state === "cancelled" && (
        <p>
          It was dropped. <a href={href(["submit"])}>Submit another one</a>
        </p>
      )}
      {(doc.state === "previewing" || doc.state === "profiling") && (
        <div class="buttons">
          <Drop job={doc} done={job.reload} />
        </div>
      )}
    </>
  );
}

function settingsWords(job: Job): string {
  const settings = job.settings as Record<string, number | string | undefined>;
  const parts = job.renderer ? [`${job.renderer.name} ${job.renderer.version ?? ""}`.trim()] : [];
  if (settings["width"] && settings["height"]) parts.push(`${settings["width"]} × ${settings["height"]}`);
  const samples = settings["spp"] ?? settings["samples"];
  if (job.error_target) parts.push(`noise at most ${job.error_target.ppm / 1e4} %`);
  else if (samples) parts.push(`${samples} samples per pixel`);
  if (job.denoise) parts.push("noise removed");
  return parts.join(", ") || "settings of the scene";
}

const STEPS = ["previewing", "profiling", "quoted"] as const;

/** Whether a job is a quote, or on its way to one. */
export const isQuote = (state: Job["state"]) => STEPS.some((step) => step === state);

const STEP_WORDS: Record<(typeof STEPS)[number], [name: string, does: string]> = {
  previewing: ["Preview", "which object and material every pixel of every frame shows"],
  profiling: ["Profile", "a few pixels of a few frames are traced and measured"],
  quoted: ["Quote", "what all frames will cost, and how sure that is"],
};

/** The way to the quote, with what is being done now. */
function Making(props: { job: Job }) {
  const { job } = props;
  const { tasks } = useTasks(job.id);
  const previewed = usePreviewed(job);
  const at = STEPS.indexOf(job.state as (typeof STEPS)[number]);
  const reached = at < 0 ? (job.state === "cancelled" || job.state === "failed" ? -1 : STEPS.length) : at;
  if (reached < 0) return null;
  const profiles = tasks.filter((task) => task.kind === "profile");
  const measured = profiles.filter((task) => task.state === "done").flatMap((task) => task.frame ?? []);
  return (
    <ol class="steps" aria-label="The way to the quote">
      {STEPS.map((step, index) => {
        const done = reached > index || job.state === "quoted" || reached === STEPS.length;
        const busy = reached === index && job.state !== "quoted";
        return (
          <li
            key={step}
            class={done ? "step-done" : busy ? "step-busy" : "step-open"}
            aria-current={busy ? "step" : undefined}
          >
            <Mark of={done ? "done" : busy ? step : "waiting"} word={STEP_WORDS[step][0]} />
            <span class="under">
              {step === "previewing" && busy && previewed > 0
                ? `${previewed} of ${counted(job.frames_total, "frame")} so far`
                : step === "profiling" && profiles.length > 0
                  ? `${done ? "" : `${measured.length} of `}${counted(profiles.length, "frame")} measured${done ? "" : " so far"}`
                  : STEP_WORDS[step][1]}
            </span>
            {step === "profiling" && <Previews job={job} frames={measured} />}
          </li>
        );
      })}
      {job.waits && at >= 0 && job.state !== "quoted" && !job.paused && (
        <li class="muted">
          It <Prose text={job.waits.because} bare />.
        </li>
      )}
    </ol>
  );
}

/** How many frames are previewed so far, as the worker reports it. */
function usePreviewed(job: Job): number {
  const [share, setShare] = useState(0);
  useEffect(
    () =>
      onEvents((events) => {
        for (const event of events)
          if (event.job_id === job.id && event.task_kind === "preview" && event.progress != null)
            setShare(event.progress);
      }),
    [job.id],
  );
  return Math.floor(share * job.frames_total);
}

/** The ID previews of frames. Renderers that do not tell objects apart draw none, nor does Cycles with adaptive
 * sampling. */
function Previews(props: { job: Job; frames: readonly number[] }) {
  const [missing, setMissing] = useState<readonly number[]>([]);
  return (
    <span class="previews">
      {props.frames
        .filter((frame) => !missing.includes(frame))
        .map((frame) => (
          <img
            key={frame}
            src={`/v1/jobs/${props.job.id}/frames/${frame}/preview.png`}
            alt={`ID preview of frame ${frame}`}
            title={`ID preview of frame ${frame}: a colour for each object and material`}
            decoding="async"
            onError={() => setMissing((old) => [...old, frame])}
          />
        ))}
    </span>
  );
}

const MINUTE = 60_000;

function Ready(props: { job: Job; edit: (job: Job) => void }) {
  const { job } = props;
  const quote = useResource<ForecastDoc>(
    (signal) => get("/v1/jobs/{id}/forecast", { path: { id: job.id }, signal }),
    [job.id],
  );
  const held = job.state === "quoted";
  // Time and every plan of another job change what could be booked.
  const answers = useResource<AnswersDoc>(
    (signal) => get("/v1/jobs/{id}/answers", { path: { id: job.id }, signal }),
    [job.id, job.deadline, job.budget],
    held ? Math.floor(now.value / MINUTE) : 0,
  );
  const anew = useThrottled(answers.reload, 3_000);
  useEffect(() => {
    if (!held) return undefined;
    return onEvents((events) => events.some((event) => event.kind === "plan_stored") && anew(), anew);
  }, [held]);
  const why = useResource<Explanation>(
    (signal) => get("/v1/jobs/{id}/explanation", { path: { id: job.id }, signal }),
    [job.id],
  );
  const [state, setState] = useState<{ busy: boolean; error: Error | null }>({ busy: false, error: null });
  const accept = async () => {
    setState({ busy: true, error: null });
    try {
      await post("/v1/jobs/{id}/accept", { path: { id: job.id }, body: {} });
    } catch (failure) {
      return setState({ busy: false, error: asError(failure) });
    }
    // It is booked now, whatever becomes of the job that it replaces: that one shows its state itself.
    const replaces = param("replaces");
    if (replaces) await cancelJob(replaces).catch(() => undefined);
    return go(["jobs", job.id]);
  };
  return (
    <>
      {quote.data ? (
        <Numbers quote={quote.data} own={!job.renderer} />
      ) : quote.error ? (
        <Trouble error={quote.error} retry={quote.reload} />
      ) : (
        <Waiting>Reading the quote…</Waiting>
      )}
      <Section
        title="When it would be ready, and for how much"
        aside={answers.data && <AsOf at={answers.data.at} />}
      >
        {answers.data ? (
          <>
            {answers.error && <Trouble error={answers.error} retry={answers.reload} />}
            <BudgetHold job={job} />
            {job.budget_hold && <p>If the budget held nothing:</p>}
            <When job={job} doc={answers.data} />
          </>
        ) : answers.error ? (
          <Trouble error={answers.error} retry={answers.reload} />
        ) : (
          <Waiting>Asking the planner…</Waiting>
        )}
      </Section>
      {why.data && (
        <Section title="Why it costs that">
          <ul class="sentences">
            {why.data.words.slice(0, 4).map((line) => (
              <li key={line}>
                <Prose text={line} />
              </li>
            ))}
          </ul>
          <p>
            <a href={href(["jobs", job.id], { tab: "why" })}>All of it</a>,{" "}
            <a href={href(["jobs", job.id], { tab: "ladders" })}>and what accuracy costs</a>
          </p>
        </Section>
      )}
      {state.error && <Trouble error={state.error} />}
      {held ? (
        <div class="buttons decide">
          <button type="button" class="primary" disabled={state.busy} onClick={() => void accept()}>
            {state.busy ? "Booking…" : "Book it"}
          </button>
          <button type="button" disabled={state.busy} onClick={() => props.edit(job)}>
            Change it
          </button>
          <Drop job={job} done={() => go(["submit"])} />
        </div>
      ) : (
        <p>
          It was booked. <a href={href(["jobs", job.id])}>To the job</a>
        </p>
      )}
    </>
  );
}

function Numbers(props: { quote: ForecastDoc; own: boolean }) {
  const { quote, own } = props;
  const { cpu_seconds: cpu, work: operations } = quote.total;
  const rows: [string, string, string, string, string][] = [
    ["CPU time", cpuTime(cpu.mean), cpuTime(cpu.p50), cpuTime(cpu.p80), cpuTime(cpu.p95)],
  ];
  if (operations.mean > 0)
    rows.push([
      "Work",
      work(operations.mean),
      work(operations.p50),
      work(operations.p80),
      work(operations.p95),
    ]);
  return (
    <Section title="What all frames cost">
      <div class="scroll-x" tabIndex={0} role="region" aria-label="Cost of all frames">
        <table class="numbers body outlook">
          <thead>
            <tr>
              <th scope="col">
                <span class="unseen">Quantity</span>
              </th>
              {["Expected", "P50", "P80", "P95"].map((name) => (
                <th scope="col" class="right" key={name}>
                  {name}
                </th>
              ))}
            </tr>
          </thead>
          <tbody>
            {quote.cost && (
              <tr>
                <th scope="row">Money</th>
                {[quote.cost.mean, quote.cost.p50, quote.cost.p80, quote.cost.p95].map((amount, at) => (
                  <td class="right" key={at}>
                    <Money of={amount} />
                  </td>
                ))}
              </tr>
            )}
            {rows.map(([name, ...values]) => (
              <tr key={name}>
                <th scope="row">{name}</th>
                {values.map((value, at) => (
                  <td class="right" key={at}>
                    {value}
                  </td>
                ))}
              </tr>
            ))}
          </tbody>
        </table>
      </div>
      <p class="note">
        It rests on {own ? <>{counted(quote.profiled.pixels, "pixel")} of </> : "a few samples of "}
        {counted(quote.profiled.frames.length, "frame")}, and making it cost{" "}
        {percent(quote.spent.fraction_of_forecast, 1)} of the job{own && "; these pixels are kept"}.{" "}
        {quote.calibrated
          ? "The quantiles are calibrated on past jobs."
          : "The quantiles rest on sampling alone: too few jobs are finished to calibrate them."}
        {quote.storage &&
          ` Until it is deleted, it takes ${bytes(quote.storage.file_bytes)} of files and ${bytes(quote.storage.database_bytes)} of the database.`}
        {(quote.effects?.length ?? 0) > 0 && ` Effects: ${quote.effects!.map(words).join(", ")}.`}
      </p>
    </Section>
  );
}

function Drop(props: { job: Job; done: () => void }) {
  const [busy, setBusy] = useState(false);
  const [error, setError] = useState<Error | null>(null);
  return (
    <>
      <button
        type="button"
        class="danger"
        disabled={busy}
        onClick={() => {
          setBusy(true);
          cancelJob(props.job.id).then(props.done, (failure: unknown) => {
            setBusy(false);
            setError(asError(failure));
          });
        }}
      >
        {busy ? "Dropping…" : "Drop it"}
      </button>
      {error && <Trouble error={error} />}
    </>
  );
}
