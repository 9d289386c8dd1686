// Events change the letters and costs of the strip at once. The service is asked for the rest a little later.

import { useEffect, useMemo, useState } from "preact/hooks";
import type { Event, FrameStrip } from "../../api/types";
import { onEvents } from "../../state/live";
import { parseFrames } from "../../ui/frames";
import type { Resource } from "../../ui/resource";

const LETTER: Partial<Record<Event["kind"], string>> = {
  task_leased: "r",
  task_done: "d",
  // Whether it is tried again, the service says a little later.
  task_failed: "b",
  result_refused: "b",
  lease_expired: "b",
  lease_released: "b",
  lease_lost: "b",
};

interface Change {
  letter: string;
  cost: Event["cost"];
}

export function useLiveStrip(strip: Resource<FrameStrip>): Resource<FrameStrip> {
  const doc = strip.data;
  const [changes, setChanges] = useState<ReadonlyMap<number, Change>>(new Map());
  const places = useMemo(
    () => new Map((doc ? (parseFrames(doc.frames) ?? []) : []).map((frame, at) => [frame, at])),
    [doc?.frames],
  );
  // An answer of the service knows more than the events before it.
  useEffect(() => setChanges(new Map()), [doc]);
  useEffect(
    () =>
      onEvents((events) => {
        const news = new Map<number, Change>();
        for (const event of events) {
          const letter = LETTER[event.kind];
          const mine = doc && event.job_id === doc.job_id && event.task_kind === "render";
          const at = mine && letter && event.frame != null ? places.get(event.frame) : undefined;
          if (at !== undefined) news.set(at, { letter: letter!, cost: event.cost });
        }
        if (news.size > 0) setChanges((old) => new Map([...old, ...news]));
      }),
    [doc, places],
  );
  const data = useMemo(() => (doc && changes.size > 0 ? changed(doc, changes) : doc), [doc, changes]);
  return { ...strip, data };
}

function changed(doc: FrameStrip, changes: ReadonlyMap<number, Change>): FrameStrip {
  const states = [...doc.states];
  const actual = [...doc.actual];
  for (const [at, { letter, cost }] of changes) {
    states[at] = letter;
    if (letter !== "d") actual[at] = null;
    // Money is known to the service alone.
    else if (cost && doc.quantity !== "cost") actual[at] = cost[doc.quantity];
  }
  return { ...doc, states: states.join(""), actual };
}
