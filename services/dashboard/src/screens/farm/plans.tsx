// What a new plan changed: in words, and played on the chart.

import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { get } from "../../api/client";
import type { PlanDifference } from "../../api/types";
import { now } from "../../state/now";
import { param, setQuery } from "../../state/route";
import { clockTime, counted, sentence, told } from "../../ui/format";
import { Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";
import { lessMotion } from "../../ui/theme";
import type { Move } from "./paint";
import type { Row } from "./timeline";

const PLAYED_MS = 2_200;

export interface Playing {
  moves: readonly Move[];
  played: number;
}

/** The moves of a difference, on the rows that are shown. */
function movesOf(difference: PlanDifference, rows: readonly Row[]): Move[] {
  const places = new Map(rows.map((row, at) => [row.node_id, at]));
  const out: Move[] = [];
  for (const move of difference.frames) {
    const before = move.before ? places.get(move.before.node_id) : undefined;
    const after = move.after ? places.get(move.after.node_id) : undefined;
    if (before === undefined && after === undefined) continue;
    out.push({
      row: after ?? before!,
      rowBefore: before ?? after!,
      from:
        move.before && before !== undefined
          ? [Date.parse(move.before.start), Date.parse(move.before.end)]
          : null,
      to:
        move.after && after !== undefined ? [Date.parse(move.after.start), Date.parse(move.after.end)] : null,
      job: move.job_id,
    });
  }
  return out.filter((move) => move.from || move.to);
}

/** Plays moves on the chart. Another plan ends it. */
function usePlay(
  moves: readonly Move[],
  chosen: string | null,
  shown: (playing: Playing) => void,
): [playing: boolean, play: () => void] {
  const [playing, setPlaying] = useState(false);
  const frame = useRef(0);
  const ending = useRef<ReturnType<typeof setTimeout> | undefined>(undefined);
  const show = useRef(shown);
  show.current = shown;

  useEffect(() => {
    cancelAnimationFrame(frame.current);
    clearTimeout(ending.current);
    setPlaying(false);
    show.current({ moves: [], played: 0 });
  }, [chosen]);
  useEffect(() => () => cancelAnimationFrame(frame.current), []);

  const play = () => {
    cancelAnimationFrame(frame.current);
    clearTimeout(ending.current);
    const end = (after: number) => {
      ending.current = setTimeout(() => show.current({ moves: [], played: 0 }), after);
    };
    if (lessMotion()) {
      show.current({ moves, played: 1 });
      end(PLAYED_MS);
      return;
    }
    setPlaying(true);
    const begin = performance.now();
    const step = (at: number) => {
      const played = Math.min(1, Math.max(0, at - begin - 300) / PLAYED_MS);
      show.current({ moves, played });
      if (played < 1) frame.current = requestAnimationFrame(step);
      else {
        setPlaying(false);
        end(1_500);
      }
    };
    frame.current = requestAnimationFrame(step);
  };
  return [playing, play];
}

export function Plans(props: { rows: readonly Row[]; play: (playing: Playing) => void }) {
  const version = Math.floor(now.value / 20_000);
  const chosen = param("plan");
  // A link may name a plan that is newer than the list.
  const plans = useResource(
    (signal) => get("/v1/plans", { query: { page_size: 30 }, signal }),
    [chosen],
    version,
  );
  const difference = useResource<PlanDifference>(
    (signal) => (chosen ? get("/v1/plans/{id}/difference", { path: { id: chosen }, signal }) : null),
    [chosen],
  );
  const moves = useMemo(
    () => (difference.data ? movesOf(difference.data, props.rows) : []),
    [difference.data, props.rows],
  );
  const [playing, play] = usePlay(moves, chosen, props.play);
  const items = plans.data?.items ?? [];
  return (
    <div class="plans">
      <label>
        Plan{" "}
        <select value={chosen ?? ""} onChange={(event) => setQuery({ plan: event.currentTarget.value })}>
          <option value="">choose one to see what it changed</option>
          {items.map((plan) => (
            <option key={plan.id} value={plan.id} selected={plan.id === chosen}>
              {clockTime(Date.parse(plan.created_at))}: {told(plan.causes?.[0] ?? "a job was quoted")}
            </option>
          ))}
        </select>
      </label>
      {plans.loading && !plans.data && <Waiting>Asking for the plans…</Waiting>}
      {plans.error && <Trouble error={plans.error} retry={plans.reload} />}
      {chosen && difference.loading && !difference.data && <Waiting>Asking what the plan changed…</Waiting>}
      {chosen && difference.error && <Trouble error={difference.error} retry={difference.reload} />}
      {difference.data && (
        <>
          <button type="button" onClick={play} disabled={moves.length === 0}>
            {playing ? "Playing…" : `Play ${counted(moves.length, "move")}`}
          </button>
          {(difference.data.frames_left_out ?? 0) > 0 && (
            <p class="note">
              {counted(difference.data.frames_left_out!, "more frame")} moved, which the chart does not play.
            </p>
          )}
          <PlanWords words={difference.data.words} />
        </>
      )}
    </div>
  );
}

const FIRST = 3;

function PlanWords(props: { words: string[] }) {
  const rest = props.words.slice(FIRST).map(told);
  return (
    <div class="plan-words">
      <p>{sentence(props.words.slice(0, FIRST).join("; "), true)}</p>
      {rest.length > 0 && (
        <details>
          <summary>{counted(rest.length, "more change")}</summary>
          <ul class="sentences">
            {rest.map((line) => (
              <li key={line}>{line}</li>
            ))}
          </ul>
        </details>
      )}
    </div>
  );
}
