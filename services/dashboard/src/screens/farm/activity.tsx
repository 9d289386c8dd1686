// What a node does, in words.

import type { Node } from "../../api/types";
import { href } from "../../state/route";
import { clean, percent, words } from "../../ui/format";

export function Activity(props: { of: NonNullable<Node["activity"]> }) {
  const { kind, frame, job_id, job, progress } = props.of;
  return (
    <>
      {words(kind)}
      {frame != null && ` of frame ${frame}`} of <a href={href(["jobs", job_id])}>{clean(job || "a job")}</a>,{" "}
      {percent(progress)}
    </>
  );
}
