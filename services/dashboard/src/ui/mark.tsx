// States as glyph and word. The glyph and the word say it; colour only helps.

import type { JobState, NodeState } from "../api/types";

export type Tone = "quiet" | "busy" | "good" | "warn" | "bad" | "plan";

const GLYPHS: Record<string, [glyph: string, tone: Tone, word: string]> = {
  previewing: ["◌", "busy", "previewing"],
  profiling: ["◍", "busy", "profiling"],
  quoted: ["?", "plan", "quoted"],
  booked: ["▢", "plan", "booked"],
  rendering: ["▶", "busy", "rendering"],
  done: ["✓", "good", "done"],
  failed: ["✕", "bad", "failed"],
  cancelled: ["⊘", "quiet", "cancelled"],
  idle: ["○", "quiet", "idle"],
  working: ["▶", "busy", "working"],
  pausing: ["‖", "warn", "pausing"],
  paused: ["‖", "warn", "paused"],
  draining: ["↓", "warn", "draining"],
  drained: ["⇣", "warn", "drained"],
  set_aside: ["✕", "bad", "set aside"],
  silent: ["⚠", "bad", "silent"],
  asleep: ["☾", "quiet", "asleep"],
  waiting: ["·", "quiet", "waiting"],
  ready: ["▢", "plan", "booked"],
  leased: ["▶", "busy", "running"],
  running: ["▶", "busy", "running"],
  risk: ["⚠", "bad", "at risk"],
  failing: ["⚠", "warn", "failing"],
  kept: ["✓", "good", "kept"],
  missed: ["✕", "bad", "missed"],
  on_time: ["✓", "good", "on time"],
  late: ["⚠", "bad", "late"],
  over_budget: ["⚠", "warn", "over budget"],
  impossible: ["✕", "bad", "impossible"],
};

export function toneOf(state: string): Tone {
  return GLYPHS[state]?.[1] ?? "quiet";
}

export function glyphOf(state: string): string {
  return GLYPHS[state]?.[0] ?? "·";
}

export function wordOf(state: string): string {
  return GLYPHS[state]?.[2] ?? state.replaceAll("_", " ");
}

/** A state: `▶ rendering`. */
export function Mark(props: { of: JobState | NodeState | string; word?: string }) {
  const state = props.of;
  return (
    <span class={`mark tone-${toneOf(state)}`}>
      <span class="glyph" aria-hidden="true">
        {glyphOf(state)}
      </span>
      {props.word ?? wordOf(state)}
    </span>
  );
}
