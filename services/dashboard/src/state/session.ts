// Who is signed in. The session is a cookie that scripts cannot read; the API says whom it stands for.

import { computed, signal } from "@preact/signals";
import { get, hooks, post, Refused, remove } from "../api/client";
import type { Session } from "../api/types";
import { submits, submitsTo } from "./rights";

/** `undefined` until the service has answered. */
export const session = signal<Session | null | undefined>(undefined);

/** Why the last session ended, if it did not end by signing out. */
export const ended = signal<string | null>(null);

/** Whether jobs of some project may be submitted and changed. */
export const maySubmit = computed(() => submits(session.value?.role));

/** Whether jobs of this project may be submitted and changed. */
export const maySubmitTo = (project: string): boolean => submitsTo(session.value, project);

/** Whether the session sees what belongs to all projects. */
export const seesAll = computed(() => {
  const projects = session.value?.projects;
  return !projects || "*" in projects;
});

/** Whether nodes may be changed. */
export const mayOperate = computed(() => session.value?.role === "operator");

hooks.signedOut = () => {
  if (!session.peek()) return;
  session.value = null;
  ended.value = "Your session is over. Sign in again; what you were looking at is kept in the address.";
};

/** Asks the service who is signed in. */
export async function recall(): Promise<void> {
  try {
    session.value = await get("/v1/sessions/current");
  } catch (error) {
    if (!(error instanceof Refused) || error.status !== 401) throw error;
    // Somebody may have signed in while the service was asked.
    if (session.peek() === undefined) session.value = null;
  }
}

/** Signs in with a one-time code or a token. */
export async function signIn(secret: { code: string } | { token: string }): Promise<void> {
  const signed = await post("/v1/sessions", { body: secret });
  hooks.signedIn++;
  session.value = signed;
  ended.value = null;
}

export async function signOut(): Promise<void> {
  await remove("/v1/sessions/current");
  session.value = null;
  ended.value = null;
}
