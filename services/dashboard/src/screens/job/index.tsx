// One job: its frames, its images, why it costs what it costs, and when it will be ready.

import { useEffect, useState } from "preact/hooks";
import { get } from "../../api/client";
import type { AnswersDoc, Job, FrameStrip } from "../../api/types";
import { onEvents } from "../../state/live";
import { isNews, isOver, jobAfter } from "../../state/news";
import { href, param, route, setQuery } from "../../state/route";
import { titled } from "../../state/tab";
import { clean } from "../../ui/format";
import { Trouble, Waiting } from "../../ui/parts";
import { useResource, useThrottled } from "../../ui/resource";
import { Frames, QUANTITIES } from "./frames";
import { JobHead } from "./head";
import { History } from "./history";
import { Images } from "./images";
import { Ladders } from "./ladders";
import { Logs } from "./logs";
import { Price } from "./price";
import { useLiveStrip } from "./live-strip";
import { Video } from "./video";
import { Why } from "./why";
import "../../styles/job.css";

const TABS = [
  ["images", "Images"],
  ["video", "Video"],
  ["why", "Why it costs that"],
  ["ladders", "What accuracy costs"],
  ["estimate", "Estimate"],
  ["price", "Price and deadline"],
  ["logs", "Logs"],
] as const;

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
  const reload = () => {
    job.reload();
    strip.reload();
  };
  const reloadSoon = useThrottled(reload, 3_000);
  const reloadLater = useThrottled(reload, 10_000);
  useEffect(
    () =>
      onEvents((events) => {
        for (const event of events) {
          if (event.job_id !== id || !isNews(event)) continue;
          // What these say is on screen already; money and expected ends follow.
          if (event.kind === "task_leased" || event.kind === "task_done") reloadLater();
          else reloadSoon();
        }
      }, reloadSoon),
    [id],
  );
  useEffect(() => {
    const woken = () => document.visibilityState === "visible" && reload();
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
  return (
    <div class="job">
      <JobHead job={doc} changed={reload} />
      {job.error && <Trouble error={job.error} retry={job.reload} />}
      <Frames job={doc} strip={live} quantity={quantity} changed={reload} />
      <Tabs job={doc} strip={live.data} changed={reload} />
    </div>
  );
}

/** The job with what events have said since it was asked for. */
function useNews(asked: Job | null): Job | null {
  const [job, setJob] = useState(asked);
  useEffect(() => setJob(asked), [asked]);
  useEffect(
    () =>
      onEvents((events) =>
        setJob((old) => {
          const mine = events.filter((event) => event.job_id === old?.id);
          return old && mine.reduce((job, event) => jobAfter(job, event), old);
        }),
      ),
    [],
  );
  return job?.id === asked?.id ? job : asked;
}

function Tabs(props: { job: Job; strip: FrameStrip | null; changed: () => void }) {
  const { job, strip } = props;
  const tab = TABS.find(([name]) => name === param("tab"))?.[0] ?? "images";
  const over = isOver(job.state);
  // The planner answers while there is something to plan; what was quoted is asked again when the job moves on.
  const version = `${job.state}-${job.plan_id ?? ""}`;
  const asks = (tab === "price" || tab === "ladders") && ANSWERED.includes(job.state);
  const answers = useResource<AnswersDoc>(
    (signal) => (asks ? get("/v1/jobs/{id}/answers", { path: { id: job.id }, signal }) : null),
    [job.id, asks],
    version,
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
      {tab === "video" && <Video job={job} changed={props.changed} />}
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
