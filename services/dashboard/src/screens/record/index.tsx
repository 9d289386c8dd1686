// The record: how often quotes were right.

import { useEffect, useMemo } from "preact/hooks";
import { get } from "../../api/client";
import type { TrackRecord } from "../../api/types";
import { onEvents } from "../../state/live";
import { param, setQuery } from "../../state/route";
import { titled } from "../../state/tab";
import { axes, Plot, type PlotData } from "../../ui/plot";
import { clean, counted, grouped, percent, signedPercent } from "../../ui/format";
import { Choice, Section, TableBehind, Time, Trouble, Waiting } from "../../ui/parts";
import { useResource, useThrottled } from "../../ui/resource";
import { colour } from "../../ui/theme";
import { Nights } from "./nights";
import { type Line, Reliability } from "./reliability";
import { course, type Group, LEVELS, type Measure, NAMES, projectGroups } from "./statistics";
import "../../styles/record.css";

export function RecordScreen() {
  useEffect(() => titled("Record"), []);
  const answer = useResource(
    (signal) => get("/v1/forecasts/track-record", { query: { page_size: 200 }, signal }),
    [],
  );
  const later = useThrottled(answer.reload, 60_000);
  useEffect(
    () => onEvents((events) => events.some((event) => event.kind === "task_done") && later(), later),
    [],
  );
  const measure: Measure = param("in") === "work" ? "work" : "cpu";
  const asked = answer.data;
  return (
    <div class="record">
      <div class="section-head">
        <h1>How often quotes were right</h1>
        <Choice
          label="Quantity"
          value={measure}
          options={[
            ["cpu", "CPU time"],
            ["work", "Work"],
          ]}
          choose={(value) => setQuery({ in: value === "cpu" ? null : value })}
        />
      </div>
      {!asked &&
        (answer.error ? (
          <Trouble error={answer.error} retry={answer.reload} />
        ) : (
          <Waiting>Reading the track record…</Waiting>
        ))}
      {asked && asked.frames === 0 && (
        <p>
          No frame with a quote is finished yet. As soon as one is, this screen compares quote and truth: how
          often the truth stayed at or below P50, P80 and P95, and how large the error was.
        </p>
      )}
      {asked && asked.frames > 0 && <Shown record={asked} measure={measure} />}
      <Nights />
    </div>
  );
}

function Shown(props: { record: TrackRecord; measure: Measure }) {
  const { record, measure } = props;
  const frameHits = measure === "cpu" ? record.cpu_hits : record.work_hits;
  const error = measure === "cpu" ? record.cpu_mean_absolute_error : record.work_mean_absolute_error;
  const bias = measure === "cpu" ? record.cpu_bias : record.work_bias;
  const kinds = record.kinds ?? [];
  const lines: Line[] = [
    { name: "frames", count: record.frames, hits: [frameHits.p50, frameHits.p80, frameHits.p95] },
  ];
  const jobs = kinds.reduce(
    (sum, kind) => {
      const hit = measure === "cpu" ? kind.jobs.cpu_hits : kind.jobs.work_hits;
      return {
        name: "whole jobs",
        count: sum.count + kind.jobs.count,
        hits: [sum.hits[0] + hit.p50, sum.hits[1] + hit.p80, sum.hits[2] + hit.p95] as Line["hits"],
      };
    },
    { name: "whole jobs", count: 0, hits: [0, 0, 0] } as Line,
  );
  if (jobs.count) lines.push(jobs);
  return (
    <>
      <p class="lead-words">
        Of {counted(record.frames, "finished frame")}, {percent(frameHits.p80 / record.frames)} cost at most
        what was quoted at P80.
        {error != null && ` The mean error is ${percent(error, 1)}`}
        {bias != null &&
          `; in sum quotes were ${bias > 0 ? "too high" : "too low"} by ${percent(Math.abs(bias), 1)}`}
        .
      </p>
      <div class="columns">
        <Section title="Reliability">
          <Reliability lines={lines} />
        </Section>
        <Section title="Coverage over time">
          <Coverage record={record} measure={measure} />
        </Section>
      </div>
      <Section title="By renderer and kind of job">
        <Kinds record={record} measure={measure} />
      </Section>
      <Section title="By project">
        <Groups of={projectGroups(record.projects ?? [], measure)} name="Project" />
      </Section>
    </>
  );
}

function Coverage(props: { record: TrackRecord; measure: Measure }) {
  const { record, measure } = props;
  const parts = useMemo(() => course(record, measure), [record, measure]);
  const data = useMemo<PlotData>(
    () => [
      parts.map((part) => part.at / 1000),
      ...LEVELS.map((_, at) => parts.map((part) => part.shares[at]!)),
      ...LEVELS.map((level) => parts.map(() => level)),
    ],
    [parts],
  );
  const days = record.items.length < record.frames;
  if (parts.length < 2) return <p class="note">Too few frames for a course over time.</p>;
  const names = ["p50", "p80", "muted"] as const;
  const options = () => ({
    legend: { show: false },
    cursor: { y: false },
    scales: { y: { range: (): [number, number] => [0, 1.02] } },
    axes: axes({ words: (value) => `${Math.round(value * 100)} %` }),
    series: [
      {},
      ...names.map((name) => ({
        stroke: colour(name),
        width: 2,
        points: { show: true, size: 5, fill: colour(name) },
      })),
      ...names.map((name) => ({ stroke: colour(name), width: 1, dash: [3, 4], points: { show: false } })),
    ],
  });
  return (
    <>
      <Plot
        label="Share of frames at or below P50, P80 and P95, over time. The table below has the numbers."
        height={260}
        data={data}
        options={options}
        shape={`coverage-${measure}`}
      />
      <p class="note">
        <span class="swatch p50" /> P50 <span class="swatch p80" /> P80 <span class="swatch grey" /> P95;
        dashed: where they should be. A point is{" "}
        {days ? "a day or more, in UTC" : `about ${counted(parts[0]!.count, "frame")}`}.
      </p>
      <TableBehind
        label="Coverage over time, as a table"
        head={["Until", "Frames", ...NAMES]}
        rows={() =>
          parts.map((part) => [
            <Time at={part.at} />,
            part.count,
            ...part.shares.map((share) => percent(share)),
          ])
        }
      />
    </>
  );
}

function Kinds(props: { record: TrackRecord; measure: Measure }) {
  const { measure } = props;
  const kinds = props.record.kinds ?? [];
  const rows = kinds.map((kind): Group & { jobs: number; calibrated: boolean } => {
    const { frames } = kind;
    const hit = measure === "cpu" ? frames.cpu_hits : frames.work_hits;
    const error = measure === "cpu" ? frames.cpu_mean_absolute_error : frames.work_mean_absolute_error;
    const count = Math.max(1, frames.count);
    return {
      name: `${clean(kind.renderer ?? "renderer not known")}, ${kind.feature_class ?? "any light"}`,
      frames: frames.count,
      jobs: kind.jobs.count,
      calibrated: kind.calibrated,
      shares: [hit.p50 / count, hit.p80 / count, hit.p95 / count],
      error: error ?? 0,
      bias: 0,
    };
  });
  return (
    <div class="scroll-x" tabIndex={0} role="region" aria-label="Table by renderer and kind of job">
      <table class="numbers body">
        <thead>
          <tr>
            <th scope="col">Renderer, light</th>
            <th scope="col">Quantiles</th>
            <th scope="col" class="right">
              Jobs
            </th>
            <th scope="col" class="right">
              Frames
            </th>
            <th scope="col">Mean error</th>
            {NAMES.map((name) => (
              <th scope="col" class="right" key={name}>
                ≤ {name}
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {rows.map((row) => (
            <tr key={row.name + String(row.calibrated)}>
              <td>{row.name}</td>
              <td>{row.calibrated ? "calibrated on past jobs" : "sampling alone"}</td>
              <td class="right">{grouped(row.jobs)}</td>
              <td class="right">{grouped(row.frames)}</td>
              <td>
                <ErrorBar error={row.error} />
              </td>
              {row.shares.map((share, at) => (
                <td class="right" key={at}>
                  {percent(share)}
                </td>
              ))}
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

function Groups(props: { of: Group[]; name: string }) {
  return (
    <div class="scroll-x" tabIndex={0} role="region" aria-label={`Table by ${props.name}`}>
      <table class="numbers body">
        <thead>
          <tr>
            <th scope="col">{props.name}</th>
            <th scope="col" class="right">
              Frames
            </th>
            <th scope="col">Mean error</th>
            <th scope="col" class="right">
              Bias
            </th>
            {NAMES.map((name) => (
              <th scope="col" class="right" key={name}>
                ≤ {name}
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {props.of.map((group) => (
            <tr key={group.name}>
              <td>{clean(group.name)}</td>
              <td class="right">{grouped(group.frames)}</td>
              <td>
                <ErrorBar error={group.error} />
              </td>
              <td class="right">{signedPercent(group.bias)}</td>
              {group.shares.map((share, at) => (
                <td class="right" key={at}>
                  {percent(share)}
                </td>
              ))}
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

/** An error as number and length; a bar of full length is 50 %. */
function ErrorBar(props: { error: number }) {
  return (
    <span class="error-bar">
      <span class="number">{percent(props.error, 1)}</span>
      <span class="bar" aria-hidden="true" style={{ width: `${Math.min(100, props.error * 200)}px` }} />
    </span>
  );
}
