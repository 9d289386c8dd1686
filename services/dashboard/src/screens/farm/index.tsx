// The farm: nodes and time, as a chart and as a list.

import { computed } from "@preact/signals";
import { useEffect, useMemo, useState } from "preact/hooks";
import type { NodeState } from "../../api/types";
import { farm, farmError, refresh } from "../../state/farm";
import { href, param, setQuery } from "../../state/route";
import { mayOperate, seesAll } from "../../state/session";
import { titled } from "../../state/tab";
import { clean, counted, grouped } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { Choice, Time, Trouble } from "../../ui/parts";
import { LongTableBehind } from "../../ui/virtual";
import { AddNode } from "./add";
import { Chart } from "./chart";
import { NodeList } from "./list";
import { NodeDialog } from "./node";
import { Plans, type Playing } from "./plans";
import { useShown } from "./shown";
import { type Rows, type Stretch, useTimeline, zoomed } from "./timeline";
import { inView } from "./walk";
import "../../styles/farm.css";

// Events change jobs many times a second. What this screen shows of the document changes more rarely. The chart and
// the list do not wait for the document.
const nodeCounts = computed(() => farm.value?.node_counts);
const total = computed(() => farm.value?.counts.nodes ?? null);
const versions = computed(() => farm.value?.versions);

export function FarmScreen() {
  useEffect(() => titled("Farm"), []);
  if (total.value === null && farmError.value)
    return <Trouble error={farmError.value} retry={() => void refresh()} />;
  return <Nodes />;
}

function Nodes() {
  const list = param("view") === "list";
  const state = knownState(param("state"));
  const search = param("search") ?? "";
  const node = param("node");
  const [version, setVersion] = useState(0);
  const { asleep = 0, ...states } = nodeCounts.value ?? {};
  const counts = (Object.entries(states) as [NodeState, number][]).filter(([, count]) => count > 0);
  return (
    <div class="farm">
      <div class="section-head">
        <h1>Farm</h1>
        <div class="filters">
          <Choice
            label="View"
            value={list ? "list" : "chart"}
            options={[
              ["chart", "Chart"],
              ["list", "List"],
            ]}
            choose={(value) => setQuery({ view: value === "list" ? value : null, sort: null })}
          />
          <label>
            Search{" "}
            <input
              type="search"
              id="search"
              value={search}
              placeholder="name of a node"
              onInput={(event) => setQuery({ search: event.currentTarget.value })}
            />
          </label>
          {mayOperate.value && (
            <button type="button" onClick={() => setQuery({ add: "1" })}>
              Add a node…
            </button>
          )}
        </div>
      </div>
      <div class="states" role="group" aria-label="Only nodes in this state">
        <button type="button" aria-pressed={state === ""} onClick={() => setQuery({ state: null })}>
          all {total.value !== null && grouped(total.value)}
        </button>
        {counts.map(([name, count]) => (
          <button
            type="button"
            key={name}
            aria-pressed={state === name}
            onClick={() => setQuery({ state: state === name ? null : name })}
          >
            <Mark of={name} /> {grouped(count)}
          </button>
        ))}
        {asleep > 0 && <Mark of="asleep" word={`${grouped(asleep)} of them asleep`} />}
      </div>
      {total.value !== 0 && <Versions />}
      {total.value === 0 ? (
        <NoNodes />
      ) : list ? (
        <NodeList state={state} search={search} version={version} open={(id) => setQuery({ node: id })} />
      ) : (
        <ChartView
          state={state}
          search={search}
          total={state || search ? 0 : (total.value ?? 0)}
          version={version}
        />
      )}
      {node && (
        <NodeDialog
          id={node}
          close={() => setQuery({ node: null })}
          changed={() => setVersion((n) => n + 1)}
        />
      )}
      {param("add") && mayOperate.value && <AddNode close={() => setQuery({ add: null })} />}
    </div>
  );
}

/** The states. The compiler checks that none is missing. */
const STATES: Record<NodeState, true> = {
  idle: true,
  working: true,
  pausing: true,
  paused: true,
  draining: true,
  drained: true,
  set_aside: true,
  silent: true,
};

/** A state that the address names, or all. */
function knownState(name: string | null): NodeState | "" {
  return name !== null && Object.hasOwn(STATES, name) ? (name as NodeState) : "";
}

/** Which versions run, and whether they differ: during an upgrade, some nodes are behind. */
function Versions() {
  const { service, workers } = versions.value ?? { service: "", workers: [] };
  const others = workers.filter((line) => line.version !== service);
  if (!service) return null;
  return (
    <p class="note">
      Service {service}
      {others.length === 0
        ? ", as all workers."
        : `; ${others.map((line) => `${counted(line.nodes, "worker")} ${line.version ? clean(line.version) : "of unknown version"}`).join(", ")}.`}
    </p>
  );
}

function NoNodes() {
  return (
    <section aria-label="No nodes">
      <p>
        The farm has no nodes, so nothing can be rendered.{" "}
        {mayOperate.value
          ? "“Add a node” above makes a one-time token and shows the command for the machine."
          : "An operator can add some."}
      </p>
      <p>
        For a trial, <code>forelight farm --workers 2</code> runs the service and two workers on one machine.{" "}
        <a href={href(["tonight"])}>The first three things to do</a>
      </p>
    </section>
  );
}

function ChartView(props: { state: NodeState | ""; search: string; total: number; version: number }) {
  const [view, setView, reset] = useShown();
  const [playing, setPlaying] = useState<Playing>({ moves: [], played: 0 });
  const rows = useTimeline(view, props.state, props.search);
  useEffect(() => {
    if (props.version > 0) rows.again();
  }, [props.version]);
  const length = view.to - view.from;
  const middle = view.from + length / 2;
  return (
    <>
      <div class="chart-tools">
        <span class="choice" role="group" aria-label="Time">
          <button
            type="button"
            aria-label="Earlier"
            onClick={() => setView({ from: view.from - length / 3, to: view.to - length / 3 })}
          >
            ‹
          </button>
          <button
            type="button"
            aria-label="Later"
            onClick={() => setView({ from: view.from + length / 3, to: view.to + length / 3 })}
          >
            ›
          </button>
          <button type="button" aria-label="Zoom out" onClick={() => setView(zoomed(view, 1 / 1.6, middle))}>
            −
          </button>
          <button type="button" aria-label="Zoom in" onClick={() => setView(zoomed(view, 1.6, middle))}>
            +
          </button>
          <button type="button" onClick={reset}>
            Tonight
          </button>
        </span>
        {seesAll.value && <Plans rows={rows.items} play={setPlaying} />}
      </div>
      <Chart
        rows={rows}
        total={props.total}
        view={view}
        setView={setView}
        reset={reset}
        open={(id) => setQuery({ node: id })}
        moves={playing.moves}
        played={playing.played}
      />
      <SpanTable rows={rows} view={view} />
    </>
  );
}

/** What is in the chart's time. */
function SpanTable(props: { rows: Rows; view: Stretch }) {
  const { rows, view } = props;
  const spans = useMemo(
    () => rows.items.flatMap((row) => inView(row, view).map((span) => ({ row, span }))),
    [rows.items, view],
  );
  return (
    <LongTableBehind
      label="The chart, as a table"
      head={["Node", "Does", "Job", "Frames", "From", "To", "P80"]}
      note={`What is in the chart's time, of the ${rows.items.length} nodes that are loaded.`}
      count={spans.length}
      row={(at) => {
        const { row, span } = spans[at]!;
        return [
          clean(row.name),
          span.kind,
          span.job_id ? (
            <a href={href(["jobs", span.job_id])}>{clean(rows.jobs.get(span.job_id) ?? "a job")}</a>
          ) : (
            "–"
          ),
          span.frames ?? "–",
          <Time at={span.start} exact />,
          <Time at={span.end} exact />,
          <Time at={span.tail > span.end ? span.tail : null} exact />,
        ];
      }}
    />
  );
}
