// State that changes many times a second and is in the address all the same: written when it rests.

import { useEffect, useRef, useState } from "preact/hooks";
import { param, route, setQuery } from "./route";

const REST = 300;

/** A parameter of the present screen, and how to change it. `null` takes it from the address. */
export function useAddressed(name: string): [string | null, (text: string | null) => void] {
  const inAddress = param(name);
  const [text, setText] = useState(inAddress);
  const place = useRef(route.peek().path.join("/"));
  const pending = useRef<{ text: string | null; timer: ReturnType<typeof setTimeout> } | null>(null);
  const write = () => {
    const next = pending.current;
    if (!next) return;
    clearTimeout(next.timer);
    pending.current = null;
    if (route.peek().path.join("/") === place.current) setQuery({ [name]: next.text });
  };
  // A link that is opened on the same screen.
  useEffect(() => {
    if (!pending.current) setText(inAddress);
  }, [inAddress]);
  // What is shown again in a moment, such as the images of the next frame, goes on as it was.
  useEffect(() => write, []);
  const change = (next: string | null) => {
    if (pending.current) clearTimeout(pending.current.timer);
    pending.current = { text: next, timer: setTimeout(write, REST) };
    setText(next);
  };
  return [text, change];
}

/** Numbers of a parameter, such as `4_120.5_-8`; `null` if it is not that many. */
export function numbersOf(text: string | null, count: number): number[] | null {
  const parts = (text ?? "").split("_");
  const numbers = parts.map(Number);
  return parts.length === count && parts.every(Boolean) && numbers.every(Number.isFinite) ? numbers : null;
}

/** Numbers as short text: as many digits behind the point as are told, without zeros at the end. */
export function numbersText(numbers: readonly number[], digits = 1): string {
  return numbers.map((number) => String(Number(number.toFixed(digits)))).join("_");
}
