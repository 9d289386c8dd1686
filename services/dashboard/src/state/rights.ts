// What a session may do.

import type { Session } from "../api/types";

/** Whether this role submits and changes jobs. */
export const submits = (role: Session["role"] | undefined): boolean =>
  role === "operator" || role === "submitter";

/** Whether this session submits and changes jobs of this project. */
export function submitsTo(session: Session | null | undefined, project: string): boolean {
  const { role, projects } = session ?? {};
  return submits(projects ? (projects[project] ?? projects["*"]) : role);
}
