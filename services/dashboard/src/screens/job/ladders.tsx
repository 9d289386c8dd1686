// What accuracy costs: qualities around the job's own, each with time, error, money and the chance to be ready.

import { useState } from "preact/hooks";
import { submitAgain } from "../../actions/jobs";
import { get } from "../../api/client";
import type { AccuracyDoc, AccuracyRung, AnswersDoc, Job } from "../../api/types";
import { maySubmitTo } from "../../state/session";
import { go } from "../../state/route";
import { Confirm } from "../../ui/dialog";
import { clean, cpuTime, percent, work } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { Money, Prose, Section, Time, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";

const NAMES: Record<AccuracyRung["ladder"], string> = {
  ambient: "Camera samples, gathered light",
  path: "Camera samples, path tracing",
  cached_samples: "Camera samples, irradiance cache",
  cache: "Accuracy of the irradiance cache",
  divisions: "Rays of a gather",
  resolution: "Image size",
};

export function Ladders(props: { job: Job; version: string; answers: AnswersDoc | null }) {
  const { job, answers } = props;
  const ladders = useResource<AccuracyDoc>(
    (signal) => get("/v1/jobs/{id}/accuracy", { path: { id: job.id }, signal }),
    [job.id],
    props.version,
  );
  const [chosen, setChosen] = useState<AccuracyRung | null>(null);
  const doc = ladders.data;
  if (job.renderer)
    return (
      <p class="note">
        Other qualities are priced for forelight’s own renderer alone. Submit the scene again with other
        samples to compare quotes: nothing is booked before you accept one.
      </p>
    );
  if (!doc)
    return ladders.error ? (
      <Trouble error={ladders.error} retry={ladders.reload} />
    ) : (
      <Waiting>Asking what accuracy costs…</Waiting>
    );
  const kinds = [...new Set(doc.rungs.map((rung) => rung.ladder))];
  return (
    <>
      <p class="note">
        Time is CPU time of {doc.frames === 1 ? "one frame" : "all frames"} on a node of speed 1. The error is
        the root mean square against the converged image, as a share of its mean
        {isDenoised(doc.rungs) && ", before and after denoising; time includes denoising"}.{" "}
        {doc.calibrated
          ? "Quantiles are calibrated on past jobs."
          : "Quantiles rest on sampling alone; they are not calibrated yet."}
      </p>
      {kinds.map((kind) => (
        <Section title={NAMES[kind]} level={3} key={kind}>
          <Ladder
            rungs={doc.rungs.filter((rung) => rung.ladder === kind)}
            answers={answers}
            deadline={job.deadline != null}
            maySubmit={maySubmitTo(job.project)}
            choose={setChosen}
          />
        </Section>
      ))}
      {doc.missing.map((line) => (
        <p class="note" key={line.ladder + line.reason}>
          {NAMES[line.ladder]}: <Prose text={line.reason} bare />.
        </p>
      ))}
      {doc.rungs.length === 0 && (
        <p class="note">
          No ladders were measured for this job. <code>forelight submit --ladders</code> measures them with
          the quote.
        </p>
      )}
      {chosen && <SubmitRung job={job} rung={chosen} close={() => setChosen(null)} />}
    </>
  );
}

interface Rungs {
  rungs: AccuracyRung[];
  answers: AnswersDoc | null;
  /** Whether the job has a deadline. */
  deadline: boolean;
  maySubmit: boolean;
  choose: (rung: AccuracyRung) => void;
}

function isDenoised(rungs: AccuracyRung[]): boolean {
  return rungs.some((rung) => rung.denoised_error);
}

function Ladder(props: Rungs) {
  const most = Math.max(...props.rungs.map((rung) => rung.cpu_seconds.p95));
  const denoised = isDenoised(props.rungs);
  return (
    <div class="scroll-x" tabIndex={0} role="region" aria-label={`Rungs: ${NAMES[props.rungs[0]!.ladder]}`}>
      <table class="numbers body">
        <thead>
          <tr>
            <th scope="col">Quality</th>
            <th scope="col" class="right">
              CPU P50
            </th>
            <th scope="col">to P95</th>
            <th scope="col" class="right">
              Error
            </th>
            <th scope="col">5 % to 95 %</th>
            {denoised && (
              <>
                <th scope="col" class="right">
                  Denoised
                </th>
                <th scope="col">5 % to 95 %</th>
              </>
            )}
            <th scope="col" class="right">
              Cost
            </th>
            <th scope="col">Ready by</th>
            {props.deadline && (
              <th scope="col" class="right">
                In time
              </th>
            )}
            <th scope="col">
              <span class="unseen">Submit</span>
            </th>
          </tr>
        </thead>
        <tbody>
          {props.rungs.map((rung, at) => (
            <Rung key={at} {...props} rung={rung} most={most} denoised={denoised} />
          ))}
        </tbody>
      </table>
    </div>
  );
}

/** `most`: the P95 of the dearest rung, seconds. */
function Rung(props: Omit<Rungs, "rungs"> & { rung: AccuracyRung; most: number; denoised: boolean }) {
  const { rung, most } = props;
  const offer = offerOf(rung, props.answers);
  return (
    <tr class={rung.asked_for ? "asked" : ""}>
      <td>
        {rungName(rung)} {rung.asked_for && <strong>(this job)</strong>}{" "}
        {rung.worth_taking && (
          <span class="note" title="No other quality is both cheaper and better">
            worth taking
          </span>
        )}
      </td>
      <td class="right">{cpuTime(rung.cpu_seconds.p50)}</td>
      <td>
        <span class="rung-bar" title={`P80 ${cpuTime(rung.cpu_seconds.p80)}, work ${work(rung.work.p50)}`}>
          <span class="bar soft" style={{ width: `${(rung.cpu_seconds.p95 / most) * 100}%` }} />
          <span class="bar" style={{ width: `${(rung.cpu_seconds.p50 / most) * 100}%` }} />
        </span>{" "}
        {cpuTime(rung.cpu_seconds.p95)}
      </td>
      <ErrorCells of={rung.error} />
      {props.denoised && <ErrorCells of={rung.denoised_error} />}
      <td class="right">
        <Money of={offer?.cost} />
      </td>
      <td>
        {offer ? (
          <>
            <Time at={offer.finish} none="never" />{" "}
            {offer.fits ? <Mark of="on_time" word="fits" /> : <Mark of="late" word="does not fit" />}
          </>
        ) : (
          <span class="none">–</span>
        )}
      </td>
      {props.deadline && (
        <td class="right">{offer?.probability == null ? "–" : percent(offer.probability)}</td>
      )}
      <td>
        {!rung.asked_for && props.maySubmit && (
          <button type="button" onClick={() => props.choose(rung)}>
            Submit…
          </button>
        )}
      </td>
    </tr>
  );
}

function ErrorCells(props: { of: AccuracyRung["error"] }) {
  const error = props.of;
  return (
    <>
      <td class="right">{error ? percent(error.p50, 1) : "–"}</td>
      <td>{error ? `${percent(error.p05, 1)} to ${percent(error.p95, 1)}` : "–"}</td>
    </>
  );
}

function offerOf(rung: AccuracyRung, answers: AnswersDoc | null) {
  const wanted = rung.settings;
  return answers?.qualities.find(
    ({ settings }) =>
      settings.width === wanted.width &&
      settings.height === wanted.height &&
      settings.spp === wanted.spp &&
      settings.integrator === wanted.integrator &&
      settings.cache === wanted.cache &&
      settings.cache_accuracy === wanted.cache_accuracy &&
      settings.ambient_divisions === wanted.ambient_divisions,
  );
}

function rungName(rung: AccuracyRung): string {
  const { settings } = rung;
  switch (rung.ladder) {
    case "resolution":
      return `${settings.width} × ${settings.height}`;
    case "cache":
      return `${((settings.cache_accuracy ?? 200) / 1000).toFixed(2)}, ${settings.cache_rays ?? 768} rays`;
    case "divisions":
      return `${settings.ambient_divisions} rays`;
    default:
      return `${settings.spp} spp`;
  }
}

function SubmitRung(props: { job: Job; rung: AccuracyRung; close: () => void }) {
  const { job, rung } = props;
  const [replace, setReplace] = useState(false);
  return (
    <Confirm
      title={`Submit ${rungName(rung)} as a new job?`}
      act="Get its quote"
      close={props.close}
      run={() => submitAgain(job, rung.settings, { hold: true })}
      next={(made) => go(["submit"], { job: made.id, ...(replace ? { replaces: job.id } : {}) })}
    >
      <p>
        The same frames, deadline and budget, with this quality: about {cpuTime(rung.cpu_seconds.p50)} of CPU
        time (P95 {cpuTime(rung.cpu_seconds.p95)}). You see its own quote first; nothing is booked before you
        accept it.
      </p>
      <label>
        <input
          type="checkbox"
          checked={replace}
          onChange={(event) => setReplace(event.currentTarget.checked)}
        />{" "}
        Cancel {clean(job.name)} when the new job is booked
      </label>
    </Confirm>
  );
}
