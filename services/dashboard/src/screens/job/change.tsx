// Changing a job's deadline, confidence and budget; and cancelling it.

import { useState } from "preact/hooks";
import { cancelJob, changeJob } from "../../actions/jobs";
import { get } from "../../api/client";
import type { AnswersDoc, Confidence, Job } from "../../api/types";
import { Confirm } from "../../ui/dialog";
import { clean, moneyField, parseMoney, timeZone } from "../../ui/format";
import { Choice, Field, Prose, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";
import { Outlook } from "./price";

export const CONFIDENCES = [
  ["p50", "P50: half the time"],
  ["p80", "P80: four in five"],
  ["p95", "P95: 19 in 20"],
] as const;

/** The text of a `datetime-local` field, in the viewer's zone. */
export function localText(at: number): string {
  const local = new Date(at - new Date(at).getTimezoneOffset() * 60_000);
  return local.toISOString().slice(0, 16);
}

export function ChangeDialog(props: { job: Job; changed: () => void; close: () => void }) {
  const { job } = props;
  const before = {
    deadline: job.deadline ? localText(Date.parse(job.deadline)) : "",
    budget: job.budget == null ? "" : moneyField(job.budget),
  };
  const [deadline, setDeadline] = useState(before.deadline);
  const [budget, setBudget] = useState(before.budget);
  const [confidence, setConfidence] = useState<Confidence>(job.confidence);
  const micros = budget.trim() === "" ? null : parseMoney(budget);
  const wrong = budget.trim() !== "" && micros === null;
  const until = deadline === "" ? null : new Date(deadline).toISOString();
  const same = deadline === before.deadline && budget === before.budget && confidence === job.confidence;
  return (
    <Confirm
      title={`Change ${clean(job.name)}`}
      act="Change and plan anew"
      ready={!wrong && !same}
      wide
      close={props.close}
      run={async () => {
        await changeJob(job.id, {
          ...(deadline === before.deadline ? {} : { deadline: until }),
          ...(budget === before.budget ? {} : { budget: micros }),
          ...(confidence === job.confidence ? {} : { confidence }),
        });
        props.changed();
      }}
    >
      <div class="columns">
        <Field label={`Deadline (${timeZone})`} hint="Empty: no deadline.">
          {(id) => (
            <input
              id={id}
              type="datetime-local"
              value={deadline}
              onInput={(event) => setDeadline(event.currentTarget.value)}
            />
          )}
        </Field>
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
              onInput={(event) => setBudget(event.currentTarget.value)}
            />
          )}
        </Field>
      </div>
      <Choice label="Confidence" value={confidence} options={CONFIDENCES} choose={setConfidence} />
      <h3>What that would mean</h3>
      <Meaning job={job} deadline={until} budget={micros} wrong={wrong} />
    </Confirm>
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

export function CancelDialog(props: { job: Job; changed: () => void; close: () => void }) {
  const { job } = props;
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
        {job.frames_total - job.frames_done - (job.frames_cancelled ?? 0)} of {job.frames_total} frames are
        left. Running ones are stopped. Finished images stay.
      </p>
    </Confirm>
  );
}
