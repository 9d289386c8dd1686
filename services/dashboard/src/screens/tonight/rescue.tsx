// Taking a rescue: first what the plan would change, then one button.

import { canTake, take, whatToDo } from "../../actions/jobs";
import { useMemo, useState } from "preact/hooks";
import { get, post } from "../../api/client";
import type { Job, PlanEffect } from "../../api/types";
import { refresh } from "../../state/farm";
import { mayOperate } from "../../state/session";
import { go, href } from "../../state/route";
import { Confirm, Dialog } from "../../ui/dialog";
import { clean, counted, duration, signedMoney } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { Prose, Time, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";

/** The cheapest rescue of a job, and other ways out that its plan knows. */
export function RescueDialog(props: {
  jobId: string;
  name: string;
  rescue: PlanEffect | null;
  close: () => void;
}) {
  const { jobId } = props;
  const job = useResource<Job>((signal) => get("/v1/jobs/{id}", { path: { id: jobId }, signal }), [jobId]);
  // New plans change the rescue of the job. What is offered here stays until somebody asks again.
  const [first, setFirst] = useState(props.rescue);
  const ways = useMemo(
    () => waysOut(first ?? job.data?.promise?.rescue ?? null, job.data?.verdict?.ways_out ?? []),
    [first, job.data],
  );
  const [chosen, setChosen] = useState<string | null>(null);
  const way = ways.find((one) => keyOf(one) === chosen) ?? ways[0] ?? null;
  const effect = useResource(
    (signal) =>
      way ? post("/v1/plans/what-if", { body: { change: way.change, job_id: jobId }, signal }) : null,
    [jobId, way && keyOf(way)],
  );
  const again = () => {
    setFirst(null);
    setChosen(null);
    job.reload();
    effect.reload();
  };
  const title = `Rescue ${clean(props.name)}`;
  if (!way) {
    return (
      <Dialog title={title} close={props.close}>
        {job.loading ? (
          <Waiting>Asking for ways out…</Waiting>
        ) : (
          <NoWay jobId={jobId} waits={job.data?.waits?.because ?? null} close={props.close} />
        )}
        {job.error && <Trouble error={job.error} retry={job.reload} />}
        <div class="buttons">
          <button type="button" onClick={props.close}>
            Leave it
          </button>
        </div>
      </Dialog>
    );
  }
  const isPossible = canTake(way.change);
  const isLate = effect.data?.effect.in_time === false;
  return (
    <Confirm
      title={title}
      act="Make this change"
      ready={isPossible && effect.data !== null && !isLate && !effect.loading && !job.loading}
      close={props.close}
      run={async () => {
        const look = await take(way.change, jobId);
        await refresh();
        return look;
      }}
      next={(look) => look !== jobId && go(["jobs", look])}
    >
      <fieldset class="ways">
        <legend>{ways.length > 1 ? "Ways out, the cheapest first" : "The way out"}</legend>
        {ways.map((one) => (
          <label key={keyOf(one)}>
            <input type="radio" name="way" checked={one === way} onChange={() => setChosen(keyOf(one))} />{" "}
            <Prose text={one.words} named />
          </label>
        ))}
      </fieldset>
      <h3>What it would change</h3>
      {effect.loading && <Waiting>Asking the planner…</Waiting>}
      {effect.error && <Trouble error={effect.error} retry={effect.reload} />}
      {isLate && (
        <p class="tone-bad" role="status">
          This no longer keeps the deadline.{" "}
          <button type="button" class="plain" onClick={again}>
            Ask for ways out again
          </button>
        </p>
      )}
      <Effect effect={effect.data?.effect ?? way} />
      {effect.data && effect.data.words.length > 0 && (
        <>
          <h3>All that the plan changes</h3>
          <ul class="sentences long" tabIndex={0}>
            {effect.data.words.map((line) => (
              <li key={line}>
                <Prose text={line} named />
              </li>
            ))}
          </ul>
        </>
      )}
      {"quality" in way.change && (
        <p class="note">
          Its frames that are finished are kept with the old job, and rendered again in the new one.
        </p>
      )}
      {!isPossible && <ByHand change={way.change} close={props.close} />}
    </Confirm>
  );
}

/** What a person has to do, since the service cannot. */
function ByHand(props: { change: PlanEffect["change"]; close: () => void }) {
  return (
    <p>
      <strong>{whatToDo(props.change)}</strong>{" "}
      {mayOperate.value ? (
        <a href={href(["farm"], { add: "1" })} onClick={props.close}>
          To the Farm screen
        </a>
      ) : (
        "An operator can do this."
      )}
    </p>
  );
}

function NoWay(props: { jobId: string; waits: string | null; close: () => void }) {
  return (
    <p>
      No change is known that would keep the deadline.{" "}
      {props.waits && (
        <>
          The job <Prose text={props.waits} bare />.{" "}
        </>
      )}
      <a href={href(["jobs", props.jobId], { tab: "price" })} onClick={props.close}>
        Why, and what each deadline costs
      </a>
    </p>
  );
}

const keyOf = (way: PlanEffect) => JSON.stringify(way.change);

/** The rescue first, and each change once that keeps the deadline. */
function waysOut(rescue: PlanEffect | null, others: readonly PlanEffect[]): PlanEffect[] {
  const all = rescue ? [rescue, ...others] : [...others];
  const seen = new Set<string>();
  return all.filter((way) => {
    const key = keyOf(way);
    return way.in_time && !seen.has(key) && seen.add(key);
  });
}

/** What a change would do, as a list. */
export function Effect(props: { effect: PlanEffect }) {
  const { effect } = props;
  return (
    <>
      <dl class="facts">
        <div>
          <dt>Ready by</dt>
          <dd>
            <Time at={effect.finish} none="never" /> <Mark of={effect.in_time ? "on_time" : "late"} />
          </dd>
        </div>
        <div>
          <dt>Cost of all jobs</dt>
          <dd>
            {effect.added_cost === 0 ? (
              "no change"
            ) : (
              <span class="number">{signedMoney(effect.added_cost)}</span>
            )}
          </dd>
        </div>
      </dl>
      {effect.moved.length > 0 ? (
        <>
          <h3>{counted(effect.moved.length, "other job")} would move by more than a minute</h3>
          <ul class="plain-list">
            {effect.moved.map((job) => (
              <li key={job.job_id}>
                {clean(job.name)}: {duration(job.later_ms)} {job.later_ms < 0 ? "earlier" : "later"}{" "}
                {job.breaks_promise && <Mark of="risk" word="would miss its deadline" />}
              </li>
            ))}
          </ul>
        </>
      ) : (
        <p class="note">No other job would move by more than a minute.</p>
      )}
    </>
  );
}
