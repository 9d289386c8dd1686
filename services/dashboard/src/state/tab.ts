// The tab's title and icon tell of promises at risk, also when another tab is in front.

import { effect } from "@preact/signals";
import { atRisk } from "./farm";
import { session } from "./session";

/** What is on screen, set by the screen itself. */
export function titled(screen: string): void {
  here = screen;
  show(atRisk.peek());
}

let here = "";

export function tellTab(): void {
  effect(() => show(session.value ? atRisk.value : 0));
}

function show(risks: number): void {
  const place = here ? `${here} · forelight` : "forelight";
  document.title = risks ? `(${risks} at risk) ${place}` : place;
  const icon = document.getElementById("icon") as HTMLLinkElement | null;
  const wanted = risks ? "./favicon-risk.svg" : "./favicon.svg";
  if (icon && icon.getAttribute("href") !== wanted) icon.setAttribute("href", wanted);
}
