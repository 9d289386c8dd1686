// Logs of a job's tasks: followed while they run, searchable, errors marked.

import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { get } from "../../api/client";
import type { Job, TaskLog } from "../../api/types";
import { param, setQuery } from "../../state/route";
import { clean, counted, exactTime, fullTime, words } from "../../ui/format";
import { glyphOf, Mark, wordOf } from "../../ui/mark";
import { Trouble, Waiting } from "../../ui/parts";
import { type Resource, useResource } from "../../ui/resource";
import { VirtualRows } from "../../ui/virtual";
import { useTasks, type Task } from "./tasks";

const FOLLOW = 2_000;
const LISTED = 400;
/** Height of a line, CSS pixels, and the room of its time and level, letters. */
const LINE = 20;
const PREFIX = 24;

export function Logs(props: { job: Job }) {
  const { tasks, error } = useTasks(props.job.id);
  const frame = param("frame");
  const chosen = param("task");
  const ordered = useMemo(() => [...tasks].sort(worstFirst), [tasks]);
  const wanted = ordered.filter((task) => frame === null || task.frame === Number(frame));
  const listed = wanted.length ? wanted : ordered;
  const task = listed.find((one) => one.id === chosen) ?? listed[0] ?? null;
  // A link shows this one, and no task that fails meanwhile takes its place. Tasks come in portions: the one that
  // a link names may come later.
  useEffect(() => {
    if (task && chosen === null) setQuery({ task: task.id });
  }, [task?.id, chosen]);
  if (error) return <Trouble error={new Error(error)} />;
  if (tasks.length === 0)
    return <Waiting>Reading the job’s events. No task was handed out yet, if none appears…</Waiting>;
  return (
    <>
      <div class="filters">
        <label>
          Task{" "}
          <select value={task?.id ?? ""} onChange={(event) => setQuery({ task: event.currentTarget.value })}>
            {listed.slice(0, LISTED).map((one) => (
              <option key={one.id} value={one.id}>
                {glyphOf(one.state)} {taskName(one)}: {wordOf(one.state)}
              </option>
            ))}
          </select>
        </label>
        <OfFrame frame={frame} />
        <span class="muted">
          {listed.length > LISTED && `The first ${LISTED} are listed; write a frame for others. `}
          {frame === null
            ? counted(tasks.length, "task")
            : `${counted(wanted.length, "task")} of frame ${frame}`}
          {frame !== null && (
            <>
              {" "}
              <button type="button" class="plain" onClick={() => setQuery({ frame: null, task: null })}>
                All tasks
              </button>
            </>
          )}
        </span>
      </div>
      {frame !== null && wanted.length === 0 && (
        <p class="note">Frame {frame} was not handed out yet. Another task is shown.</p>
      )}
      {task && <Log task={task} key={task.id} />}
    </>
  );
}

/** Tasks of one frame alone: so each of many thousands can be reached. */
function OfFrame(props: { frame: string | null }) {
  const [draft, setDraft] = useState(props.frame ?? "");
  useEffect(() => setDraft(props.frame ?? ""), [props.frame]);
  return (
    <label>
      Frame{" "}
      <input
        type="text"
        inputMode="numeric"
        size={6}
        value={draft}
        placeholder="any"
        aria-invalid={!/^\d*$/.test(draft)}
        onInput={(event) => {
          const text = event.currentTarget.value.trim();
          setDraft(text);
          if (/^\d*$/.test(text)) setQuery({ frame: text, task: null });
        }}
      />
    </label>
  );
}

/** Failed ones first, then running ones, then the newest. */
function worstFirst(a: Task, b: Task): number {
  const rank = (task: Task) => ["failed", "running", "done", "waiting"].indexOf(task.state);
  return rank(a) - rank(b) || b.at.localeCompare(a.at);
}

function taskName(task: Task): string {
  const part = task.part === null ? "" : ` ${task.part + 1}`;
  const frame = task.frame === null ? "" : ` of frame ${task.frame}`;
  return words(task.kind) + part + frame;
}

function Log(props: { task: Task }) {
  const { task } = props;
  const search = param("find") ?? "";
  const { log, lines } = useFollowed(task);
  const box = useRef<HTMLDivElement>(null);
  const atEnd = useRef(true);
  useEffect(() => {
    if (atEnd.current && box.current) box.current.scrollTop = box.current.scrollHeight;
  }, [lines.length]);
  const found = useMemo(
    () => lines.filter((line) => line.text.toLowerCase().includes(search.toLowerCase())),
    [lines, search],
  );
  const rows = useMemo(() => withAttempts(found), [found]);
  const longest = useMemo(() => found.reduce((most, line) => Math.max(most, line.text.length), 0), [found]);
  const errors = useMemo(() => lines.filter((line) => line.level === "error").length, [lines]);
  return (
    <>
      <div class="filters">
        <label>
          Find{" "}
          <input
            type="search"
            id="search"
            value={search}
            onInput={(event) => setQuery({ find: event.currentTarget.value })}
          />
        </label>
        <span class="muted" role="status">
          {search ? `${found.length} of ${counted(lines.length, "line")}` : counted(lines.length, "line")}
          {errors > 0 && <span class="tone-bad"> · {counted(errors, "error")}</span>} ·{" "}
          <Mark of={task.state} />
          {task.state === "running" && " · followed live"}
        </span>
      </div>
      {log.error && <Trouble error={log.error} retry={log.reload} />}
      <div
        class="log"
        ref={box}
        tabIndex={0}
        role="region"
        aria-label={`Log of ${taskName(task)}`}
        onScroll={(event) => {
          const { scrollTop, clientHeight, scrollHeight } = event.currentTarget;
          atEnd.current = scrollTop + clientHeight > scrollHeight - 8;
        }}
      >
        {found.length === 0 && (
          <p class="note">
            {log.loading
              ? "Reading the log…"
              : search
                ? "No line has these words."
                : "The task has written nothing."}
          </p>
        )}
        <div style={{ minWidth: `${longest + PREFIX}ch` }}>
          <VirtualRows
            items={rows}
            height={LINE}
            within={box}
            row={(row) =>
              typeof row === "number" ? <div class="attempt">Attempt {row}</div> : <Line of={row} />
            }
          />
        </div>
      </div>
    </>
  );
}

/** The log of a task, which is asked again while it runs. Its lines stay on screen meanwhile. */
function useFollowed(task: Task): { log: Resource<TaskLog>; lines: readonly LogLine[] } {
  const [round, setRound] = useState(0);
  const log = useResource<TaskLog>(
    (signal) => get("/v1/tasks/{id}/log", { path: { id: task.id }, signal }),
    [task.id, task.state, round],
  );
  useEffect(() => {
    if (task.state !== "running") return undefined;
    const timer = setInterval(() => document.visibilityState === "visible" && setRound((n) => n + 1), FOLLOW);
    return () => clearInterval(timer);
  }, [task.state]);
  const kept = useRef<TaskLog | null>(null);
  if (log.data) kept.current = log.data;
  return { log, lines: kept.current?.lines ?? NONE };
}

type LogLine = TaskLog["lines"][number];

const NONE: LogLine[] = [];

/** The lines, with the number of each attempt before its first one. */
function withAttempts(lines: readonly LogLine[]): (LogLine | number)[] {
  return lines.flatMap((line, at) =>
    line.attempt === lines[at - 1]?.attempt ? [line] : [line.attempt, line],
  );
}

function Line(props: { of: LogLine }) {
  const { level, at, text } = props.of;
  return (
    <div class={`log-line level-${level}`}>
      <time dateTime={at} title={fullTime(Date.parse(at))}>
        {exactTime(Date.parse(at))}
      </time>{" "}
      {level !== "info" && <strong>{level === "error" ? "✕ error: " : "⚠ warning: "}</strong>}
      {clean(text)}
    </div>
  );
}
