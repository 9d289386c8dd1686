// One frame of a job: how it is, where it is booked or ran, and what else there is about it.

import { get } from "../../api/client";
import type { FrameRow, Job } from "../../api/types";
import { setQuery } from "../../state/route";
import { clean, significant } from "../../ui/format";
import { glyphOf, Mark } from "../../ui/mark";
import { Time, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";

export function OneFrame(props: { job: Job; frame: number; version: string }) {
  const row = useResource<FrameRow>(
    (signal) =>
      get("/v1/jobs/{id}/frames/{frame}", { path: { id: props.job.id, frame: props.frame }, signal }),
    [props.job.id, props.frame],
    props.version,
  );
  const frame = row.data;
  if (!frame)
    return row.error ? (
      <Trouble error={row.error} retry={row.reload} />
    ) : (
      <Waiting>Asking for frame {props.frame}…</Waiting>
    );
  return (
    <div class="one-frame">
      <Facts of={frame} />
      {frame.error && (
        <p class="trouble">
          <span class="glyph" aria-hidden="true">
            {glyphOf("failed")}
          </span>
          {clean(frame.error)}
        </p>
      )}
      <p>
        <FrameTab tab="images" frame={frame.frame} word="Its images" />
        {" · "}
        <FrameTab tab="logs" frame={frame.frame} word="Its log" />
        {" · "}
        <FrameTab tab="why" frame={frame.frame} word="Why it costs that" />
      </p>
    </div>
  );
}

function Facts(props: { of: FrameRow }) {
  const frame = props.of;
  return (
    <dl class="facts">
      <div>
        <dt>Frame {frame.frame}</dt>
        <dd>
          <Mark of={frame.state} />
          {frame.state === "leased" && ` ${(frame.progress * 100).toFixed(0)} %`}
        </dd>
      </div>
      {(frame.parts ?? 1) > 1 && (
        <div>
          <dt>Parts</dt>
          <dd>
            {frame.parts_done ?? 0} of {frame.parts} done
          </dd>
        </div>
      )}
      {frame.booked && (
        <div>
          <dt>{(frame.parts ?? 1) > 1 ? "First part booked" : "Booked"}</dt>
          <dd>
            {clean(frame.booked.node)}, <Time at={frame.booked.start} /> to <Time at={frame.booked.end} />
          </dd>
        </div>
      )}
      {frame.started && (
        <div>
          <dt>Ran</dt>
          <dd>
            <Time at={frame.started} exact />{" "}
            {frame.finished && (
              <>
                to <Time at={frame.finished} exact />
              </>
            )}
          </dd>
        </div>
      )}
      <div>
        <dt>Attempts</dt>
        <dd>{frame.attempts}</dd>
      </div>
      {frame.actual && (
        <div>
          <dt>Peak memory</dt>
          <dd>{(frame.actual.peak_rss_bytes / 2 ** 20).toFixed(0)} MiB</dd>
        </div>
      )}
      {frame.actual?.denoised && (
        <div>
          <dt>Error, denoised</dt>
          <dd>
            {noise(frame.actual.denoised.error)}, in place of {noise(frame.actual.denoised.noisy)}
          </dd>
        </div>
      )}
    </dl>
  );
}

const noise = (error: { p50: number }) => `${significant(error.p50 * 100, 2)} %`;

function FrameTab(props: { tab: string; frame: number; word: string }) {
  return (
    <button
      type="button"
      class="plain"
      onClick={() => setQuery({ tab: props.tab, frame: String(props.frame) })}
    >
      {props.word}
    </button>
  );
}
