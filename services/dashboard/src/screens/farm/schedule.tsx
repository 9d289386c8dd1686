// The weekly windows in which a node is awake.

import { useState } from "preact/hooks";
import type { Node } from "../../api/types";
import { timeZone } from "../../ui/format";
import { Act } from "../../ui/parts";

type Calendar = NonNullable<Node["schedule"]>;
type Window = Calendar["windows"][number];

const DAYS = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"] as const;
const SHORT: Record<(typeof DAYS)[number], string> = {
  mon: "Mon",
  tue: "Tue",
  wed: "Wed",
  thu: "Thu",
  fri: "Fri",
  sat: "Sat",
  sun: "Sun",
};

/** `Mon, Tue 20:00 to 08:00 (Europe/Berlin)`. */
export function scheduleWords(schedule: Calendar): string {
  const windows = schedule.windows.map((window) => {
    const days =
      window.days?.length && window.days.length < 7
        ? window.days.map((day) => SHORT[day]).join(", ")
        : "every day";
    return window.from === window.until ? `${days}, all day` : `${days} ${window.from} to ${window.until}`;
  });
  return `${windows.join("; ")} (${schedule.zone})`;
}

export function Schedule(props: {
  schedule: Calendar | null;
  /** Whether an operator has set it, so that the node's own is another one. */
  isSet: boolean;
  busy: boolean;
  save: (schedule: Calendar | null) => Promise<void>;
  close: () => void;
}) {
  const [windows, setWindows] = useState<Window[]>(
    props.schedule?.windows ?? [{ days: [], from: "20:00", until: "08:00" }],
  );
  const zone = props.schedule?.zone ?? timeZone;
  return (
    <form
      class="schedule"
      onSubmit={(event) => {
        event.preventDefault();
        void props.save({ zone, windows });
      }}
    >
      {windows.map((window, at) => (
        <WindowField
          key={at}
          window={window}
          number={at + 1}
          change={(next) => setWindows(windows.map((one, index) => (index === at ? next : one)))}
          remove={windows.length > 1 ? () => setWindows(windows.filter((_, index) => index !== at)) : null}
        />
      ))}
      <p class="note">
        No day chosen means every day. Times are those of {zone}. A window may end on the next day.
      </p>
      <div class="buttons">
        <Act type="submit" class="primary" busy={props.busy}>
          Set the schedule
        </Act>
        <button
          type="button"
          onClick={() => setWindows([...windows, { days: [], from: "00:00", until: "00:00" }])}
        >
          Add a window
        </button>
        {props.isSet && (
          <Act busy={props.busy} press={() => void props.save(null)}>
            What the node says
          </Act>
        )}
        <button type="button" onClick={props.close}>
          Leave it
        </button>
      </div>
    </form>
  );
}

function WindowField(props: {
  window: Window;
  number: number;
  change: (window: Window) => void;
  /** The last one cannot be removed. */
  remove: (() => void) | null;
}) {
  const { window, change } = props;
  return (
    <fieldset>
      <legend class="unseen">Window {props.number}</legend>
      {DAYS.map((day) => (
        <label key={day}>
          <input
            type="checkbox"
            checked={window.days?.includes(day) ?? false}
            onChange={(event) => {
              const days = new Set(window.days ?? []);
              if (event.currentTarget.checked) days.add(day);
              else days.delete(day);
              change({ ...window, days: DAYS.filter((one) => days.has(one)) });
            }}
          />{" "}
          {SHORT[day]}
        </label>
      ))}
      <label>
        from{" "}
        <input
          type="time"
          required
          value={window.from}
          onInput={(event) => change({ ...window, from: event.currentTarget.value })}
        />
      </label>
      <label>
        to{" "}
        <input
          type="time"
          required
          value={window.until}
          onInput={(event) => change({ ...window, until: event.currentTarget.value })}
        />
      </label>
      {props.remove && (
        <button type="button" class="plain" onClick={props.remove}>
          Remove
        </button>
      )}
    </fieldset>
  );
}
