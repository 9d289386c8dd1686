// The address holds what is on screen, so that a link shows it to somebody else: `#/jobs/ID?tab=images`.

import { signal } from "@preact/signals";

export interface Route {
  /** The parts of the path: `["jobs", ID]`. */
  path: string[];
  query: URLSearchParams;
}

export const route = signal<Route>(parse(location.hash));

function parse(hash: string): Route {
  const text = hash.replace(/^#\/?/, "");
  const cut = text.indexOf("?");
  const path = cut < 0 ? text : text.slice(0, cut);
  const parts = path.split("/").filter(Boolean).map(decode);
  return {
    path: parts.length ? parts : ["tonight"],
    query: new URLSearchParams(cut < 0 ? "" : text.slice(cut + 1)),
  };
}

function decode(part: string): string {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

addEventListener("hashchange", () => {
  route.value = parse(location.hash);
});

/** The link to a screen. */
export function href(path: string[], query: Record<string, string | null | undefined> = {}): string {
  const search = new URLSearchParams();
  for (const [name, value] of Object.entries(query)) if (value) search.set(name, value);
  const text = search.toString();
  return `#/${path.map(encodeURIComponent).join("/")}${text ? `?${text}` : ""}`;
}

/** Goes to a screen. */
export function go(path: string[], query: Record<string, string | null | undefined> = {}): void {
  location.hash = href(path, query);
}

/** Changes parameters of the present screen, without a new entry in the history. */
export function setQuery(changes: Record<string, string | null | undefined>): void {
  const { path, query } = route.peek();
  const next = new URLSearchParams(query);
  for (const [name, value] of Object.entries(changes)) {
    if (value) next.set(name, value);
    else next.delete(name);
  }
  if (next.toString() === query.toString()) return;
  history.replaceState(null, "", href(path, Object.fromEntries(next)));
  route.value = { path, query: next };
}

/** A parameter of the present screen. Reading it subscribes. */
export function param(name: string): string | null {
  return route.value.query.get(name);
}
