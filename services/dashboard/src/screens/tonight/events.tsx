// What happened lately, newest first.

import type { Event } from "../../api/types";
import { happened } from "../../state/happened";
import { href } from "../../state/route";
import { clean, told, words } from "../../ui/format";
import { type Tone } from "../../ui/mark";
import { Section, Time } from "../../ui/parts";

const MARKS: Record<(typeof happened.value)[number]["kind"], [glyph: string, tone: Tone]> = {
  job_created: ["+", "plan"],
  job_state: ["→", "busy"],
  job_changed: ["→", "quiet"],
  forecast_ready: ["≈", "plan"],
  job_off_forecast: ["⚠", "warn"],
  job_on_forecast: ["✓", "good"],
  plan_stored: ["▤", "plan"],
  task_failed: ["✕", "bad"],
  result_refused: ["✕", "bad"],
  lease_expired: ["⚠", "warn"],
  node_registered: ["+", "quiet"],
  node_changed: ["→", "quiet"],
  node_set_aside: ["✕", "bad"],
  node_removed: ["−", "quiet"],
  budget: ["⚠", "warn"],
  engine_state: ["→", "quiet"],
  job_promise_at_risk: ["⚠", "bad"],
  job_promise_safe: ["✓", "good"],
  submission_lost: ["⚠", "warn"],
  artifact_damaged: ["⚠", "bad"],
};

export function Events() {
  const told = happened.value.slice(0, 14);
  return (
    <Section title="What happened" class="happened">
      {told.length === 0 ? (
        <p class="note">Nothing yet.</p>
      ) : (
        <ol class="events">
          {told.map((event) => {
            const [glyph, tone] = MARKS[event.kind];
            return (
              <li key={event.id}>
                <span class="number muted">
                  <Time at={event.at} />
                </span>
                <span class={`glyph tone-${tone}`} aria-hidden="true">
                  {glyph}
                </span>
                <span class="event-words">
                  {event.job_id && event.job_name && (
                    <>
                      <a href={href(["jobs", event.job_id])}>{clean(event.job_name)}</a>{" "}
                    </>
                  )}
                  {eventWords(event)}
                </span>
              </li>
            );
          })}
        </ol>
      )}
    </Section>
  );
}

/** An event in words, which go on after the name of its job. */
export function eventWords(event: Event): string {
  const message = event.message ? told(event.message) : "";
  switch (event.kind) {
    case "job_created":
      return "was submitted";
    case "job_state":
      return event.job_state ? `is ${words(event.job_state)}` : message;
    case "forecast_ready":
      return "has its quote";
    case "node_registered":
      return message ? `${message} joined` : "a node joined";
    case "node_changed":
      return event.node_state ? `${message} is ${words(event.node_state)}` : `${message} changed`;
    case "node_removed":
      return `${message} was removed`;
    case "plan_stored":
      return message ? `planned anew: ${message}` : "was planned";
    default:
      return message || words(event.kind);
  }
}
