// The palette for what is drawn on a canvas, which style sheets do not reach.

import { signal } from "@preact/signals";

const dark = matchMedia("(prefers-color-scheme: dark)");

/** Changes when the viewer's theme does. Reading it subscribes. */
export const theme = signal(dark.matches ? "dark" : "light");

dark.addEventListener("change", () => (theme.value = dark.matches ? "dark" : "light"));

/** A colour of the style sheet, such as `accent`. */
export function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** Whether the viewer asked for less motion. */
export function lessMotion(): boolean {
  return matchMedia("(prefers-reduced-motion: reduce)").matches;
}
