// What the pointer does on the farm's chart besides pointing.

import { useEffect, useRef } from "preact/hooks";
import type { Drawing } from "./paint";
import { type Stretch, zoomed } from "./timeline";

/** Wheel with Ctrl zooms, sideways pans; drag pans; two fingers zoom. */
export function useGestures(
  plot: { current: HTMLDivElement | null },
  latest: { current: Drawing },
  setView: (view: Stretch) => void,
): void {
  const set = useRef(setView);
  set.current = setView;
  useEffect(() => {
    const target = plot.current!;
    const fingers = new Map<number, PointerEvent>();
    const perPixel = () =>
      (latest.current.view.to - latest.current.view.from) / Math.max(1, latest.current.width);
    const pan = (pixels: number) => {
      const { view } = latest.current;
      const by = pixels * perPixel();
      set.current({ from: view.from - by, to: view.to - by });
    };
    const zoom = (factor: number, clientX: number) => {
      const at = latest.current.view.from + (clientX - target.getBoundingClientRect().left) * perPixel();
      set.current(zoomed(latest.current.view, factor, at));
    };
    const wheel = (event: WheelEvent) => {
      if (event.ctrlKey || event.metaKey) zoom(2 ** (-event.deltaY / 300), event.clientX);
      else if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) pan(-event.deltaX);
      else if (event.shiftKey) pan(-event.deltaY);
      else return;
      event.preventDefault();
    };
    const down = (event: PointerEvent) => {
      if (event.pointerType === "mouse" && event.button !== 0) return;
      fingers.set(event.pointerId, event);
    };
    const move = (event: PointerEvent) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      if (event.pointerType === "mouse" && event.buttons === 0) {
        fingers.clear();
        return;
      }
      if (fingers.size === 1) pan(event.clientX - before.clientX);
      else {
        const other = [...fingers.values()].find((finger) => finger.pointerId !== event.pointerId)!;
        zoom(
          Math.max(1, Math.abs(event.clientX - other.clientX)) /
            Math.max(1, Math.abs(before.clientX - other.clientX)),
          other.clientX,
        );
      }
      fingers.set(event.pointerId, event);
    };
    const up = (event: PointerEvent) => fingers.delete(event.pointerId);
    target.addEventListener("wheel", wheel, { passive: false });
    target.addEventListener("pointerdown", down);
    addEventListener("pointermove", move);
    addEventListener("pointerup", up);
    addEventListener("pointercancel", up);
    return () => {
      target.removeEventListener("wheel", wheel);
      target.removeEventListener("pointerdown", down);
      removeEventListener("pointermove", move);
      removeEventListener("pointerup", up);
      removeEventListener("pointercancel", up);
    };
  }, []);
}
