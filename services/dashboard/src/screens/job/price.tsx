// Price against deadline, and what one more node, an hour, or another quality would mean.

import { useMemo } from "preact/hooks";
import type { AnswersDoc, Job, PlanEffect } from "../../api/types";
import { axes, MONEY, Plot, type PlotData } from "../../ui/plot";
import { clean, counted, duration } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { Money, Prose, Section, TableBehind, Time, Trouble, Waiting } from "../../ui/parts";
import type { Resource } from "../../ui/resource";
import { colour } from "../../ui/theme";

export function Price(props: { job: Job; answers: Resource<AnswersDoc> }) {
  const doc = props.answers.data;
  if (!doc) {
    return props.answers.error ? (
      <Trouble error={props.answers.error} retry={props.answers.reload} />
    ) : (
      <Waiting>Asking the planner. For a large farm this takes some seconds…</Waiting>
    );
  }
  return (
    <>
      <Outlook doc={doc} />
      {doc.why_not.length > 0 && (
        <Section title="Why it cannot be done as asked" level={3}>
          <ul class="sentences">
            {doc.why_not.map((line) => (
              <li key={line}>
                <Prose text={line} />
              </li>
            ))}
          </ul>
        </Section>
      )}
      {doc.ways_out.length > 0 && (
        <Section title="Ways out" level={3}>
          <Effects effects={doc.ways_out} />
        </Section>
      )}
      <Curve doc={doc} />
      <Section title="What if" level={3}>
        {doc.what_if.length ? <Effects effects={doc.what_if} /> : <p class="note">Nothing was asked.</p>}
      </Section>
      {doc.pushes_back.length > 0 && (
        <Section title="Jobs that it delays" level={3}>
          <ul class="sentences">
            {doc.pushes_back.map((job) => (
              <li key={job.job_id}>
                {clean(job.name)}: {duration(job.later_ms)} later{" "}
                {job.breaks_promise && <Mark of="risk" word="would miss its deadline" />}
              </li>
            ))}
          </ul>
        </Section>
      )}
      {(doc.left_out ?? []).map((line) => (
        <p class="note" key={line}>
          Left out: <Prose text={line} bare />
        </p>
      ))}
    </>
  );
}

export function Outlook(props: { doc: AnswersDoc }) {
  const { doc } = props;
  return (
    <div class="scroll-x" tabIndex={0} role="region" aria-label="Ends and costs by confidence">
      <table class="numbers body outlook">
        <caption class="unseen">When it is ready and what it costs, at three confidences</caption>
        <thead>
          <tr>
            <th scope="col">Confidence</th>
            <th scope="col">Ready by</th>
            <th scope="col" class="right">
              Cost
            </th>
            <th scope="col" class="right">
              At least
            </th>
          </tr>
        </thead>
        <tbody>
          {doc.outlook.map((line) => (
            <tr key={line.confidence}>
              <td>{line.confidence.toUpperCase()}</td>
              <td>
                <Time at={line.finish} none="never" />{" "}
                {line.in_time != null &&
                  (line.in_time ? <Mark of="on_time" word="in time" /> : <Mark of="late" />)}
              </td>
              <td class="right">
                <Money of={line.cost} />
              </td>
              <td class="right">
                <Money of={line.cost_at_least} />
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

function Effects(props: { effects: PlanEffect[] }) {
  return (
    <ul class="sentences">
      {props.effects.map((effect) => (
        <li key={effect.words}>
          <Prose text={effect.words} named />{" "}
          {effect.in_time ? <Mark of="on_time" word="in time" /> : <Mark of="late" />}
          {effect.moved.length > 0 && (
            <span class="muted"> Moves {counted(effect.moved.length, "other job")}.</span>
          )}
        </li>
      ))}
    </ul>
  );
}

function Curve(props: { doc: AnswersDoc }) {
  const { doc } = props;
  const data = useMemo<PlotData>(
    () => [
      doc.curve.map((offer) => Date.parse(offer.deadline) / 1000),
      doc.curve.map((offer) => offer.cost),
      doc.curve.map((offer) => offer.cost_at_least),
    ],
    [doc],
  );
  if (doc.curve.length < 2) return null;
  const options = () => ({
    legend: { show: false },
    cursor: { y: false },
    axes: axes(MONEY),
    series: [
      {},
      { stroke: colour("p50"), width: 2, points: { show: true, size: 6, fill: colour("p50") } },
      { stroke: colour("muted"), width: 1, dash: [5, 4], points: { show: false } },
    ],
  });
  return (
    <Section title="Price against deadline" level={3}>
      <Plot
        label="What the job costs for each deadline, and the bound below which no plan costs. The table below has the numbers."
        height={220}
        data={data}
        options={options}
        shape="price"
      />
      <p class="note">
        <span class="swatch p50" /> the cheapest plan found; dashed: no plan can cost less.
      </p>
      <TableBehind
        label="Price against deadline, as a table"
        head={["Deadline", "Ready by", "Cost", "At least"]}
        rows={() =>
          doc.curve.map((offer) => [
            <Time at={offer.deadline} />,
            <Time at={offer.finish} />,
            <Money of={offer.cost} />,
            <Money of={offer.cost_at_least} />,
          ])
        }
      />
    </Section>
  );
}
