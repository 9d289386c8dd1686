// Says that a job is paused, and has it go on.

import { useState } from "preact/hooks";
import type { Job } from "../../api/types";
import { maySubmitTo } from "../../state/session";
import { Mark } from "../../ui/mark";
import { PauseDialog } from "./change";

export function Paused(props: { job: Job; changed: () => void }) {
  const { job } = props;
  const [asked, setAsked] = useState(false);
  if (!job.paused) return null;
  return (
    <>
      <p class="risk">
        <Mark of="paused" /> Nothing more of it is started until it is resumed.{" "}
        {maySubmitTo(job.project) && (
          <button type="button" onClick={() => setAsked(true)}>
            Resume…
          </button>
        )}
      </p>
      {asked && <PauseDialog job={job} changed={props.changed} close={() => setAsked(false)} />}
    </>
  );
}
