// The time that the farm's chart shows, and how it is in the address.

import { useCallback, useEffect, useRef, useState } from "preact/hooks";
import { farm } from "../../state/farm";
import { now } from "../../state/now";
import { param, setQuery } from "../../state/route";
import type { Stretch } from "./timeline";
import { showing, type Spot, spotFrom } from "./walk";

const HOUR = 3_600_000;
const REST = 400;

/** From a little ago until the farm finishes. If nothing is booked, what was done lately. */
function tonight(): Stretch {
  const at = now.peek();
  const end = farm.peek()?.finish?.p95;
  if (!end) return { from: at - 2 * HOUR, to: at + HOUR };
  const ahead = Math.min(14 * 24 * HOUR, Math.max(HOUR / 12, (Date.parse(end) - at) * 1.1));
  return { from: at - ahead * 0.4, to: at + ahead };
}

/** The same, moved until a held span is in it. */
function tonightWith(held: Spot | null): Stretch {
  return held ? showing(tonight(), { from: held.at, to: held.at }) : tonight();
}

/** The stretch that parameters of the address name. */
function stretchOf(from: string | null, to: string | null): Stretch | null {
  const [start, end] = [Number(from) * 1000, Number(to) * 1000];
  return Number.isFinite(start) && Number.isFinite(end) && start > 0 && end > start
    ? { from: start, to: end }
    : null;
}

/** A stretch as parameters of the address: whole seconds. */
function inSeconds(view: Stretch): { from: string; to: string } {
  return { from: String(Math.round(view.from / 1000)), to: String(Math.round(view.to / 1000)) };
}

/** What the chart shows, how to change it, and how to get back to tonight. */
export function useShown(): [view: Stretch, setView: (next: Stretch) => void, reset: () => void] {
  const from = param("from");
  const to = param("to");
  const [view, setView] = useState(() => stretchOf(from, to) ?? tonightWith(spotFrom(param("pin"))));
  const settled = useRef(view);
  const reset = useCallback(() => {
    setView(tonight());
    setQuery({ from: null, to: null });
  }, []);
  // The address follows when the view rests, so that a link shows the same.
  useEffect(() => {
    if (view === settled.current) return undefined;
    const timer = setTimeout(() => {
      settled.current = view;
      setQuery(inSeconds(view));
    }, REST);
    return () => clearTimeout(timer);
  }, [view]);
  // A link that is opened on the same screen.
  useEffect(() => {
    const linked = stretchOf(from, to);
    const known = inSeconds(settled.current);
    if (!linked || (known.from === from && known.to === to)) return;
    settled.current = linked;
    setView(linked);
  }, [from, to]);
  return [view, setView, reset];
}
