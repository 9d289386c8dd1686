// The video of a job's frames: asked for, made, shown, fetched.

import { useEffect, useState } from "preact/hooks";
import { put, remove } from "../../api/client";
import type { Job } from "../../api/types";
import { onEvents } from "../../state/live";
import { isOver } from "../../state/news";
import { maySubmitTo } from "../../state/session";
import { bytes, counted } from "../../ui/format";
import { Confirm } from "../../ui/dialog";
import { Field, Prose } from "../../ui/parts";
import { useThrottled } from "../../ui/resource";

type Asked = "make" | "delete" | null;

export function Video(props: { job: Job; changed: () => void }) {
  const { job, changed } = props;
  const [asked, setAsked] = useState<Asked>(null);
  const reloadSoon = useThrottled(changed, 500);
  useEffect(
    () =>
      onEvents((events) => {
        if (events.some((event) => event.job_id === job.id && event.task_kind === "video")) reloadSoon();
      }, reloadSoon),
    [job.id],
  );
  const may = maySubmitTo(job.project) && !["failed", "cancelled"].includes(job.state);
  const close = () => setAsked(null);
  return (
    <div class="video">
      <State job={job} />
      {may && (
        <p class="buttons">
          <button type="button" class={job.video ? "" : "primary"} onClick={() => setAsked("make")}>
            {job.video ? "Make it again…" : "Make a video…"}
          </button>
          {job.video && (
            <button type="button" class="danger" onClick={() => setAsked("delete")}>
              Delete the video…
            </button>
          )}
        </p>
      )}
      {asked === "make" && <MakeDialog job={job} changed={changed} close={close} />}
      {asked === "delete" && (
        <Confirm
          title="Delete the video?"
          act="Delete the video"
          danger
          close={close}
          run={async () => {
            await remove("/v1/jobs/{id}/video", { path: { id: job.id } });
            changed();
          }}
        >
          <p>The images stay. The video can be made again as long as the farm has them.</p>
        </Confirm>
      )}
    </div>
  );
}

function State(props: { job: Job }) {
  const { job } = props;
  const { video } = job;
  if (!video) return <p class="note">No video is made of these frames.</p>;
  const rate = `${video.frames_per_second} frames per second`;
  if (video.file) {
    // Another file at the same address is another video for the browser.
    const source = `/v1/jobs/${job.id}/video.mp4?file=${video.file.hash.slice(0, 16)}`;
    return (
      <>
        <video
          controls
          loop
          muted
          playsInline
          preload="metadata"
          src={source}
          aria-label="Video of the job"
        />
        <p>
          {counted(video.file.frames, "frame")} at {rate}, {bytes(video.file.bytes)}.{" "}
          <a href={source} download={`${job.name.replaceAll(/[^\p{L}\p{N}._-]+/gu, "-")}.mp4`}>
            Save it as a file
          </a>
        </p>
      </>
    );
  }
  switch (video.state) {
    case "ready":
    case "leased":
      return (
        <>
          <p role="status">
            {video.state === "ready" ? "It waits for a node with ffmpeg" : "It is being encoded"}, at {rate}.
          </p>
          <progress aria-label="How far the video is" max={1} value={video.progress} />
          {video.waits && (
            <p class="note">
              <Prose text={video.waits} />
            </p>
          )}
        </>
      );
    case "failed":
      return (
        <p class="trouble">
          <span class="glyph" aria-hidden="true">
            ✕
          </span>
          <Prose text={video.error ?? "The video could not be made."} />
        </p>
      );
    default:
      return (
        <p class="note">
          {isOver(job.state)
            ? "The job ended without it."
            : `It is made when the last frame is finished, at ${rate}.`}
        </p>
      );
  }
}

function MakeDialog(props: { job: Job; changed: () => void; close: () => void }) {
  const { job } = props;
  const [rate, setRate] = useState(job.video ? String(job.video.frames_per_second) : "");
  const number = Number(rate);
  const wrong = rate.trim() !== "" && !(number >= 1 && number <= 240);
  return (
    <Confirm
      title="Make a video of the frames"
      act="Make it"
      ready={!wrong}
      close={props.close}
      run={async () => {
        const body = rate.trim() === "" ? {} : { frames_per_second: number };
        await put("/v1/jobs/{id}/video", { path: { id: job.id }, body });
        props.changed();
      }}
    >
      <p>
        {job.state === "done"
          ? "A node with ffmpeg encodes the finished frames."
          : "A node with ffmpeg encodes the frames when the last of them is finished."}
        {job.video?.file && " It replaces the present video."}
      </p>
      <Field
        label="Frames per second"
        hint="Empty: those of the scene, or 24."
        error={wrong ? "Write a number from 1 to 240." : null}
      >
        {(id) => (
          <input
            id={id}
            inputMode="decimal"
            value={rate}
            placeholder={String(job.scene.frames_per_second ?? 24)}
            onInput={(event) => setRate(event.currentTarget.value)}
          />
        )}
      </Field>
    </Confirm>
  );
}
