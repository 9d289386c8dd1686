// When a quoted job would be ready, and for how much.

import type { AnswersDoc, Job } from "../../api/types";
import { AxisHead, Fan, slackWords, spreadWords } from "../../ui/fan";
import { clean, instant, maybeInstant, percent } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { Money, Prose, TableBehind, Time } from "../../ui/parts";
import { axisFor } from "../../ui/time-axis";
import { Outlook } from "../job/price";

export function When(props: { job: Job; doc: AnswersDoc }) {
  const { job, doc } = props;
  const finish = (confidence: string) =>
    maybeInstant(doc.outlook.find((line) => line.confidence === confidence)?.finish);
  const spread = { p50: finish("p50"), p80: finish("p80"), p95: finish("p95") };
  const deadline = maybeInstant(job.deadline);
  const ends = [spread.p95, spread.p50].filter((at) => at !== null);
  const axis = axisFor(instant(doc.at), ends, deadline === null ? [] : [deadline]);
  const line = doc.outlook.find((one) => one.confidence === job.confidence);
  return (
    <>
      <Lead job={job} line={line} probability={doc.probability ?? null} />
      {spread.p50 !== null && (
        <>
          <AxisHead axis={axis} />
          <Fan
            axis={axis}
            spread={spread}
            deadline={deadline}
            label={spreadWords(spread)}
            late={line?.in_time === false}
          />
        </>
      )}
      <Outlook doc={doc} />
      {doc.why_not.map((reason) => (
        <p key={reason}>
          <Prose text={reason} />
        </p>
      ))}
      {doc.ways_out.length > 0 && (
        <ul class="sentences">
          {doc.ways_out.map((way) => (
            <li key={way.words}>
              <Prose text={way.words} named />
            </li>
          ))}
        </ul>
      )}
      {doc.pushes_back.length > 0 && (
        <p>
          <Mark of="over_budget" word="It delays" />{" "}
          {doc.pushes_back
            .map((moved) => `${clean(moved.name)}${moved.breaks_promise ? " past its deadline" : ""}`)
            .join(", ")}
          .
        </p>
      )}
      {doc.qualities.length > 1 && <Qualities of={doc.qualities} />}
    </>
  );
}

/** When the job is ready at its own confidence, what it costs then, and whether that fits. */
function Lead(props: {
  job: Job;
  line: AnswersDoc["outlook"][number] | undefined;
  probability: number | null;
}) {
  const { job, line, probability } = props;
  const deadline = maybeInstant(job.deadline);
  const over = job.budget != null && line !== undefined && line.cost > job.budget;
  return (
    <p class="lead-words">
      {line?.finish ? (
        <>
          Ready by <Time at={line.finish} /> at {job.confidence.toUpperCase()}
          {deadline !== null && <> ({slackWords(instant(line.finish), deadline)})</>}, for{" "}
          <Money of={line.cost} />
          {job.budget != null && (
            <>
              {" "}
              of a budget of <Money of={job.budget} />
            </>
          )}
          .{" "}
          {line.in_time === false ? (
            <Mark of="late" word="misses its deadline" />
          ) : over ? (
            <Mark of="over_budget" />
          ) : (
            <Mark of="on_time" word="fits" />
          )}
          {probability !== null && <> Probability of the deadline: {percent(probability)}.</>}
        </>
      ) : (
        "No plan finishes it."
      )}
    </p>
  );
}

function Qualities(props: { of: AnswersDoc["qualities"] }) {
  return (
    <TableBehind
      label="Other qualities, as a table"
      head={["Size", "Samples", "Error", "Ready by", "In time", "Cost", ""]}
      rows={() =>
        props.of.map((offer) => [
          `${offer.settings.width} × ${offer.settings.height}`,
          offer.settings.spp,
          offer.error ? percent(offer.error.p50, 1) : "–",
          <Time at={offer.finish} none="never" />,
          offer.probability == null ? "–" : percent(offer.probability),
          <Money of={offer.cost} />,
          offer.asked_for ? "as asked" : offer.fits ? "fits" : "does not fit",
        ])
      }
    />
  );
}
