// Changing a job's deadline, budget, confidence and priority; pausing and cancelling it; going on with its quote.

import { useState } from "preact/hooks";
import { cancelJob, changeJob } from "../../actions/jobs";
import { get, post } from "../../api/client";
import type { AnswersDoc, Job, JobChange } from "../../api/types";
import { Confirm } from "../../ui/dialog";
import { clean, clockTime, counted, grouped, money, moneyField, parseMoney } from "../../ui/format";
import { localText, Moment, timestampOf } from "../../ui/moment";
import { Choice, Field, Prose, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";
import { Outlook } from "./price";

export const CONFIDENCES = [
  ["p50", "P50: half the time"],
  ["p80", "P80: four in five"],
  ["p95", "P95: 19 in 20"],
] as const;

/** The terms of a job, as the fields show them. */
function termsOf(job: Job) {
  return {
    deadline: job.deadline ? localText(Date.parse(job.deadline)) : "",
    budget: job.budget == null ? "" : moneyField(job.budget),
    confidence: job.confidence,
    priority: String(job.priority),
  };
}

type Terms = ReturnType<typeof termsOf>;

export function ChangeDialog(props: { job: Job; changed: () => void; close: () => void }) {
  const { job } = props;
  const [before] = useState(() => termsOf(job));
  // What nobody wrote in stays what the job has, also when somebody else changes that meanwhile.
  const [written, setWritten] = useState<Partial<Terms>>({});
  const present = termsOf(job);
  const { deadline, budget, confidence, priority } = { ...present, ...written };
  const write = (part: Partial<Terms>) => setWritten((old) => ({ ...old, ...part }));
  const micros = budget.trim() === "" ? null : parseMoney(budget);
  const wrong = budget.trim() !== "" && micros === null;
  const rank = /^[-−]?\d{1,4}$/.test(priority.trim()) ? Number(priority.trim().replace("−", "-")) : NaN;
  const isNoRank = !(Math.abs(rank) <= 1000);
  const until = deadline === present.deadline ? (job.deadline ?? null) : timestampOf(deadline);
  const isNoTime = deadline !== "" && until === null;
  const change: JobChange = {
    ...(deadline === present.deadline ? {} : { deadline: until }),
    ...(budget === present.budget ? {} : { budget: micros }),
    ...(confidence === present.confidence ? {} : { confidence }),
    ...(rank === job.priority || isNoRank ? {} : { priority: rank }),
  };
  return (
    <Confirm
      title={`Change ${clean(job.name)}`}
      act="Change and plan anew"
      ready={!wrong && !isNoTime && !isNoRank && Object.keys(change).length > 0}
      wide
      close={props.close}
      run={async () => {
        await changeJob(job.id, change);
        props.changed();
      }}
    >
      <div class="columns">
        <Moment
          label="Deadline"
          hint="Empty: no deadline."
          value={deadline}
          change={(text) => write({ deadline: text })}
        />
        <Field
          label="Budget"
          hint="Empty: no budget."
          error={wrong ? "Write an amount such as 12.50." : null}
        >
          {(id) => (
            <input
              id={id}
              inputMode="decimal"
              value={budget}
              onInput={(event) => write({ budget: event.currentTarget.value })}
            />
          )}
        </Field>
        <Field
          label="Priority"
          hint="The greatest goes first, and may move others past their deadlines."
          error={isNoRank ? "Write a whole number from -1000 to 1000." : null}
        >
          {(id) => (
            <input
              id={id}
              inputMode="numeric"
              value={priority}
              onInput={(event) => write({ priority: event.currentTarget.value })}
            />
          )}
        </Field>
      </div>
      <Choice
        label="Confidence"
        value={confidence}
        options={CONFIDENCES}
        choose={(value) => write({ confidence: value })}
      />
      <Meanwhile job={job} before={before} present={present} />
      <h3>What that would mean</h3>
      <Meaning job={job} deadline={until} budget={micros} wrong={wrong || isNoTime} />
    </Confirm>
  );
}

/** What somebody else changed since the question was opened. */
function Meanwhile(props: { job: Job; before: Terms; present: Terms }) {
  const { job, before, present } = props;
  const said = [
    before.deadline !== present.deadline &&
      `its deadline is ${job.deadline ? clockTime(Date.parse(job.deadline)) : "none"}`,
    before.budget !== present.budget && `its budget is ${job.budget == null ? "none" : money(job.budget)}`,
    before.confidence !== present.confidence && `its confidence is ${job.confidence.toUpperCase()}`,
    before.priority !== present.priority && `its priority is ${job.priority}`,
  ].filter((line) => line !== false);
  return (
    <p role="status" class={said.length > 0 ? "tone-warn" : "unseen"}>
      {said.length > 0 &&
        `Somebody changed the job meanwhile: ${said.join(", ")}. Only what you write here is changed.`}
    </p>
  );
}

/** What the planner says of other terms. It is not asked about what cannot be read. */
function Meaning(props: { job: Job; deadline: string | null; budget: number | null; wrong: boolean }) {
  const { job, deadline, budget, wrong } = props;
  const answers = useResource<AnswersDoc>(
    (signal) =>
      wrong
        ? null
        : get("/v1/jobs/{id}/answers", {
            path: { id: job.id },
            query: { ...(deadline ? { deadline } : {}), ...(budget === null ? {} : { budget }) },
            signal,
          }),
    [job.id, deadline, budget, wrong],
  );
  // The planner is asked about other terms than the job's; it cannot be asked about none.
  const without = [
    deadline === null && job.deadline != null && "deadline",
    budget === null && !wrong && job.budget != null && "budget",
  ].filter((term) => term !== false);
  return (
    <>
      {without.length > 0 && (
        <p class="note">
          These numbers still count with the present {without.join(" and ")}. The job is planned without it
          once you change it.
        </p>
      )}
      {answers.data ? (
        <>
          <Outlook doc={answers.data} />
          {answers.data.why_not.map((line) => (
            <p key={line}>
              <Prose text={line} />
            </p>
          ))}
          {answers.data.pushes_back.length > 0 && (
            <p>It delays {answers.data.pushes_back.map((moved) => clean(moved.name)).join(", ")}.</p>
          )}
        </>
      ) : answers.error ? (
        <Trouble error={answers.error} />
      ) : (
        <Waiting>Asking the planner…</Waiting>
      )}
    </>
  );
}

/** Tries again what failed of a quote. */
export function QuoteDialog(props: { job: Job; changed: () => void; close: () => void }) {
  const { job } = props;
  return (
    <Confirm
      title={`Go on with the quote of ${clean(job.name)}?`}
      act="Go on"
      close={props.close}
      run={async () => {
        await post("/v1/jobs/{id}/frames/retry", { path: { id: job.id }, body: { frames: job.frames } });
        props.changed();
      }}
    >
      <p>What failed is tried again. What was measured is kept.</p>
    </Confirm>
  );
}

export function PauseDialog(props: { job: Job; changed: () => void; close: () => void }) {
  const { job } = props;
  // What is asked stays what was asked, also when somebody else answers it meanwhile.
  const [paused] = useState(!job.paused);
  return (
    <Confirm
      title={paused ? `Pause ${clean(job.name)}?` : `Let ${clean(job.name)} go on?`}
      act={paused ? "Pause the job" : "Resume the job"}
      close={props.close}
      run={async () => {
        await changeJob(job.id, { paused });
        props.changed();
      }}
    >
      {paused ? (
        <p>
          What is being rendered goes on, and nothing more is started. Its nodes are free for other jobs.{" "}
          {job.deadline && "Its deadline is at risk until it is resumed."}
        </p>
      ) : (
        <p>It is planned anew, with its deadline and priority.</p>
      )}
    </Confirm>
  );
}

export function CancelDialog(props: { job: Job; changed: () => void; close: () => void }) {
  const { job } = props;
  const left = job.frames_total - job.frames_done - (job.frames_cancelled ?? 0);
  return (
    <Confirm
      title={`Cancel ${clean(job.name)}?`}
      act="Cancel the job"
      danger
      close={props.close}
      run={async () => {
        await cancelJob(job.id);
        props.changed();
      }}
    >
      <p>
        {grouped(left)} of {counted(job.frames_total, "frame")} {left === 1 ? "is" : "are"} left. Running ones
        are stopped. Finished images stay.
      </p>
    </Confirm>
  );
}
