// One job: its frames, its images, why it costs what it costs, and when it will be ready.

import { useEffect, useState } from "preact/hooks";
import { get } from "../../api/client";
import type { AnswersDoc, Event, Job, FrameStrip } from "../../api/types";
import { onEvent } from "../../state/live";
import { jobAfter } from "../../state/news";
import { param, route, setQuery } from "../../state/route";
import { href } from "../../state/route";
import { maySubmitTo } from "../../state/session";
import { titled } from "../../state/tab";
import { slackWords } from "../../ui/fan";
import { clean, cpuTime, grouped, maybeInstant, percent } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { Money, Prose, Time, Trouble, Waiting } from "../../ui/parts";
import { useResource, useThrottled } from "../../ui/resource";
import { RescueDialog } from "../tonight/rescue";
import { CancelDialog, ChangeDialog } from "./change";
import { Frames, QUANTITIES } from "./frames";
import { History } from "./history";
import { Images } from "./images";
import { Ladders } from "./ladders";
import { Logs } from "./logs";
import { Price } from "./price";
import { useLiveStrip } from "./live-strip";
import { Why } from "./why";
import "../../styles/job.css";

const TABS = [
  ["images", "Images"],
  ["why", "Why it costs that"],
  ["ladders", "What accuracy costs"],
  ["estimate", "Estimate"],
  ["price", "Price and deadline"],
  ["logs", "Logs"],
] as const;

const OVER = ["done", "failed", "cancelled"];
const ANSWERED = ["quoted", "booked", "rendering"];

export function JobScreen(props: { id: string }) {
  const { id } = props;
  const job = useResource<Job>((signal) => get("/v1/jobs/{id}", { path: { id }, signal }), [id]);
  const quantity = QUANTITIES.find(([value]) => value === param("in"))?.[0] ?? "cpu_seconds";
  const strip = useResource<FrameStrip>(
    (signal) => get("/v1/jobs/{id}/strip", { path: { id }, query: { quantity }, signal }),
    [id, quantity],
  );
  const live = useLiveStrip(strip);
  const reloadSoon = useThrottled(() => {
    job.reload();
    strip.reload();
  }, 3_000);
  const reloadLater = useThrottled(() => {
    job.reload();
    strip.reload();
  }, 10_000);
  useEffect(
    () =>
      onEvent((event: Event) => {
        if (event.job_id !== id || event.kind === "task_progress") return;
        // What these say is on screen already; money and expected ends follow.
        if (event.kind === "task_leased" || event.kind === "task_done") reloadLater();
        else reloadSoon();
      }),
    [id],
  );
  useEffect(() => {
    const woken = () => document.visibilityState === "visible" && (job.reload(), strip.reload());
    document.addEventListener("visibilitychange", woken);
    return () => document.removeEventListener("visibilitychange", woken);
  }, [id]);
  useEffect(() => titled(job.data ? clean(job.data.name) : "Job"), [job.data?.name]);

  const doc = useNews(job.data);
  if (!doc)
    return job.error ? (
      <Trouble error={job.error} retry={job.reload} />
    ) : (
      <Waiting>Asking for the job…</Waiting>
    );
  const changed = () => {
    job.reload();
    strip.reload();
  };
  return (
    <div class="job">
      <JobHead job={doc} changed={changed} />
      {job.error && <Trouble error={job.error} retry={job.reload} />}
      <Frames job={doc} strip={live} quantity={quantity} changed={changed} />
      <Tabs job={doc} strip={live.data} />
    </div>
  );
}

/** The job with what events have said since it was asked for. */
function useNews(asked: Job | null): Job | null {
  const [job, setJob] = useState(asked);
  useEffect(() => setJob(asked), [asked]);
  useEffect(
    () => onEvent((event) => setJob((old) => (old && event.job_id === old.id ? jobAfter(old, event) : old))),
    [],
  );
  return job?.id === asked?.id ? job : asked;
}

function JobHead(props: { job: Job; changed: () => void }) {
  const { job } = props;
  const [asked, setAsked] = useState<"change" | "cancel" | "rescue" | null>(null);
  const over = OVER.includes(job.state);
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
            {!over && (
              <>
                <button type="button" onClick={() => setAsked("change")}>
                  Change deadline or budget…
                </button>
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
      {!over && job.waits && (
        <p>
          It <Prose text={job.waits.because} bare />.
        </p>
      )}
      {job.promise && !job.promise.kept && !over && (
        <p class="risk">
          <Mark of="risk" /> The newest plan does not keep the deadline
          {job.promise.rescue ? (
            <>
              . Cheapest rescue: <Prose text={job.promise.rescue.words} bare />.{" "}
            </>
          ) : (
            ". "
          )}
          {maySubmitTo(job.project) && (
            <button type="button" class="primary" onClick={() => setAsked("rescue")}>
              {job.promise.rescue ? "Look at the rescue…" : "Look for a way out…"}
            </button>
          )}
        </p>
      )}
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
      {asked === "cancel" && <CancelDialog job={job} changed={props.changed} close={close} />}
      {asked === "rescue" && (
        <RescueDialog jobId={job.id} name={job.name} rescue={job.promise?.rescue ?? null} close={close} />
      )}
    </header>
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
  const over = OVER.includes(job.state);
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
          <span class="muted">{slackWords(eta, deadline)}</span>
        </dd>
      </div>
      <div>
        <dt>Deadline</dt>
        <dd>
          <Time at={deadline} none="none" />
        </dd>
      </div>
      {job.promise && (
        <div>
          <dt>Promise</dt>
          <dd>
            {job.promise.kept ? <Mark of="kept" /> : <Mark of="risk" />}
            {!over && <span class="muted"> in time with {percent(job.promise.probability)}</span>}
          </dd>
        </div>
      )}
      {!job.promise && job.verdict && (
        <div>
          <dt>Plan</dt>
          <dd>
            <Mark of={job.verdict.verdict} />
          </dd>
        </div>
      )}
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
            {over && <span class="muted">; it took {cpuTime(cpu.spent)}</span>}
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

function Tabs(props: { job: Job; strip: FrameStrip | null }) {
  const { job, strip } = props;
  const tab = TABS.find(([name]) => name === param("tab"))?.[0] ?? "images";
  const over = OVER.includes(job.state);
  // The planner answers while there is something to plan; what was quoted is asked again when the job moves on.
  const version = `${job.state}-${job.plan_id ?? ""}`;
  const asks = (tab === "price" || tab === "ladders") && ANSWERED.includes(job.state);
  const answers = useResource<AnswersDoc>(
    (signal) => (asks ? get("/v1/jobs/{id}/answers", { path: { id: job.id }, signal }) : null),
    [job.id, asks, version],
  );
  const query = Object.fromEntries(route.value.query);
  return (
    <section aria-label="More about the job">
      <nav class="tabs" aria-label="More about the job">
        {TABS.map(([name, word]) => (
          <a
            key={name}
            href={href(["jobs", job.id], { ...query, tab: name })}
            aria-current={tab === name ? "true" : undefined}
            onClick={(event) => (event.preventDefault(), setQuery({ tab: name }))}
          >
            {word}
          </a>
        ))}
      </nav>
      {tab === "images" && <Images job={job} strip={strip} />}
      {tab === "why" && <Why job={job} version={job.state} />}
      {tab === "ladders" && <Ladders job={job} version={job.state} answers={answers.data} />}
      {tab === "estimate" && <History job={job} version={`${version}-${job.frames_done}`} />}
      {tab === "price" &&
        (over ? (
          <p class="note">The job is over: there is nothing left to plan.</p>
        ) : asks ? (
          <Price job={job} answers={answers} />
        ) : (
          <p class="note">The planner answers as soon as the quote is there.</p>
        ))}
      {tab === "logs" && <Logs job={job} />}
    </section>
  );
}
