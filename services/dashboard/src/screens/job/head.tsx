// The head of a job's screen: how it stands, what to decide, and its facts.

import { useState } from "preact/hooks";
import type { Job } from "../../api/types";
import { isOver, neverEnds } from "../../state/news";
import { now } from "../../state/now";
import { href } from "../../state/route";
import { maySubmitTo } from "../../state/session";
import { slackWords } from "../../ui/fan";
import { clean, cpuTime, grouped, maybeInstant, percent } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { Money, Prose, Time } from "../../ui/parts";
import { RescueDialog } from "../tonight/rescue";
import { BudgetHold } from "./budget";
import { CancelDialog, ChangeDialog, PauseDialog, QuoteDialog } from "./change";
import { Paused } from "./paused";

export function JobHead(props: { job: Job; changed: () => void }) {
  const { job } = props;
  const [asked, setAsked] = useState<"change" | "pause" | "cancel" | "rescue" | "quote" | null>(null);
  const over = isOver(job.state);
  const close = () => setAsked(null);
  return (
    <header class="job-top">
      <div class="job-title">
        <h1>{clean(job.name)}</h1>
        <Mark of={job.state} />
        <span class="muted">
          {clean(job.project)} · {clean(job.scene.name)} · frames {job.frames}
          {job.renderer && ` · ${job.renderer.name} ${job.renderer.version ?? ""}`.trimEnd()}
        </span>
        <span class="spread" />
        {maySubmitTo(job.project) && (
          <span class="buttons">
            {job.state === "quoted" && (
              <a class="button primary" href={href(["submit"], { job: job.id })}>
                Look at the quote
              </a>
            )}
            {job.state === "failed" && job.plan_id == null && (
              <button type="button" class="primary" onClick={() => setAsked("quote")}>
                Go on with the quote…
              </button>
            )}
            {neverEnds(job.state) && (
              <a class="button" href={href(["submit"], { again: job.id })}>
                Submit again…
              </a>
            )}
            {!over && (
              <>
                <button type="button" onClick={() => setAsked("change")}>
                  Change terms…
                </button>
                {!job.paused && (
                  <button type="button" onClick={() => setAsked("pause")}>
                    Pause…
                  </button>
                )}
                <button type="button" class="danger" onClick={() => setAsked("cancel")}>
                  Cancel job…
                </button>
              </>
            )}
          </span>
        )}
      </div>
      <Progress job={job} />
      <JobFacts job={job} />
      {job.error && (
        <p class="trouble">
          <span class="glyph" aria-hidden="true">
            ✕
          </span>
          {clean(job.error)}
        </p>
      )}
      {!over && job.failing && (
        <p class="risk">
          <Mark of="failing" /> <Prose text={job.failing.words} />{" "}
          {job.failing.again_at && (
            <>
              It is tried again at <Time at={job.failing.again_at} exact />.{" "}
            </>
          )}
          <a href={href(["jobs", job.id], { tab: "logs", frame: job.failing.frame?.toString() })}>
            Look at the log
          </a>
        </p>
      )}
      <BudgetHold job={job} />
      <Paused job={job} changed={props.changed} />
      {!over && job.waits && !job.paused && (
        <p>
          It <Prose text={job.waits.because} bare />.
        </p>
      )}
      {job.promise && !job.promise.kept && !over && <AtRisk job={job} rescue={() => setAsked("rescue")} />}
      {!over && job.verdict && job.verdict.verdict !== "on_time" && job.verdict.reasons.length > 0 && (
        <ul class="sentences">
          {job.verdict.reasons.map((reason) => (
            <li key={reason}>
              <Prose text={reason} />
            </li>
          ))}
        </ul>
      )}
      {asked === "change" && <ChangeDialog job={job} changed={props.changed} close={close} />}
      {asked === "pause" && <PauseDialog job={job} changed={props.changed} close={close} />}
      {asked === "quote" && <QuoteDialog job={job} changed={props.changed} close={close} />}
      {asked === "cancel" && <CancelDialog job={job} changed={props.changed} close={close} />}
      {asked === "rescue" && (
        <RescueDialog jobId={job.id} name={job.name} rescue={job.promise?.rescue ?? null} close={close} />
      )}
    </header>
  );
}

function AtRisk(props: { job: Job; rescue: () => void }) {
  const { job } = props;
  const rescue = job.promise?.rescue;
  return (
    <p class="risk">
      <Mark of="risk" /> The newest plan does not keep the deadline
      {rescue ? (
        <>
          . Cheapest rescue: <Prose text={rescue.words} bare />.{" "}
        </>
      ) : (
        ". "
      )}
      {maySubmitTo(job.project) && (
        <button type="button" class="primary" onClick={props.rescue}>
          {rescue ? "Look at the rescue…" : "Look for a way out…"}
        </button>
      )}
    </p>
  );
}

function Progress(props: { job: Job }) {
  const { job } = props;
  return (
    <div
      class="progress"
      role="progressbar"
      aria-label="Share of the forecast work that is done"
      aria-valuemin={0}
      aria-valuemax={100}
      aria-valuenow={Math.round(job.progress * 100)}
    >
      <span style={{ width: `${job.progress * 100}%` }} />
    </div>
  );
}

function JobFacts(props: { job: Job }) {
  const { job } = props;
  const over = isOver(job.state);
  const eta = maybeInstant(job.finished_at ?? job.eta);
  const deadline = maybeInstant(job.deadline);
  const cost = job.live?.cost;
  const cpu = job.live?.cpu_seconds;
  return (
    <dl class="facts">
      <div>
        <dt>Frames</dt>
        <dd>
          {grouped(job.frames_done)} of {grouped(job.frames_total)}
          {job.frames_cancelled ? `, ${grouped(job.frames_cancelled)} cancelled` : ""}
        </dd>
      </div>
      <div>
        <dt>{over ? "Ended" : "Ready by"}</dt>
        <dd>
          <Time at={eta} none={over ? "–" : "not known yet"} />{" "}
          {!neverEnds(job.state) && <span class="muted">{slackWords(eta, deadline)}</span>}
        </dd>
      </div>
      <div>
        <dt>Deadline</dt>
        <dd>
          <Time at={deadline} none="none" />
        </dd>
      </div>
      <Outcome job={job} over={over} />
      <div>
        <dt>Spent</dt>
        <dd>
          <Money of={job.spent} />
        </dd>
      </div>
      {cost && !over && (
        <div>
          <dt>Expected in all, P50 to P95</dt>
          <dd>
            <Money of={cost.p50} /> to <Money of={cost.p95} />
          </dd>
        </div>
      )}
      <div>
        <dt>Budget</dt>
        <dd>
          <Money of={job.budget} none="none" />
        </dd>
      </div>
      {cpu && (
        <div>
          <dt>CPU time, quoted P50 and P80</dt>
          <dd>
            {cpuTime(cpu.quote.p50)}, {cpuTime(cpu.quote.p80)}
            {over && job.frames_done > 0 && (
              <span class="muted">
                ; {neverEnds(job.state) ? "its finished frames took" : "it took"} {cpuTime(cpu.spent)}
              </span>
            )}
          </dd>
        </div>
      )}
      <div>
        <dt>Confidence</dt>
        <dd>{job.confidence.toUpperCase()}</dd>
      </div>
    </dl>
  );
}

/** Whether it will be ready in time, or was: as promised, or else as planned. */
function Outcome(props: { job: Job; over: boolean }) {
  const { deadline, finished_at, promise, state, verdict } = props.job;
  if (state === "cancelled") return null;
  if (state === "failed") {
    if (!deadline) return null;
    const isAhead = Date.parse(deadline) > now.value;
    return (
      <div>
        <dt>{promise ? "Promise" : "In time"}</dt>
        <dd>{isAhead ? <Mark of="risk" /> : <Mark of="missed" />}</dd>
      </div>
    );
  }
  const probability = props.over ? null : (props.job.probability ?? promise?.probability ?? null);
  const sure = probability !== null && <span class="muted"> in time with {percent(probability)}</span>;
  if (promise)
    return (
      <div>
        <dt>Promise</dt>
        <dd>
          <Mark
            of={promiseWord(
              promise.kept,
              props.over ? maybeInstant(finished_at) : null,
              maybeInstant(deadline),
            )}
          />
          {sure}
        </dd>
      </div>
    );
  if (!verdict && !sure) return null;
  return (
    <div>
      <dt>{verdict ? "Plan" : "If accepted now"}</dt>
      <dd>
        {verdict && <Mark of={verdict.verdict} />}
        {sure}
      </dd>
    </div>
  );
}

/** Of a job that is done, its end says whether the promise was kept; before that, its plan does. */
function promiseWord(isPlanned: boolean, end: number | null, deadline: number | null): string {
  if (end !== null && deadline !== null) return end <= deadline ? "kept" : "missed";
  return isPlanned ? "kept" : "risk";
}
