// Zoom and pan of an image in its box: wheel, drag, two fingers, and keys.

import { useEffect, useRef } from "preact/hooks";
import { numbersOf, numbersText, useAddressed } from "../../state/addressed";
import { isTyping } from "../../ui/keys";
import { type Pixel, placeOf } from "./crosshair";

export interface View {
  /** CSS pixels per pixel of the image. */
  scale: number;
  /** Where the image's left top corner lies in the box. */
  x: number;
  y: number;
}

export interface Zoom {
  view: View;
  /** Zooms around the crosshair, or around the middle. */
  by(factor: number): void;
  /** Moves the image until a point of the box, which may lie outside of it, is well inside. */
  reveal(x: number, y: number): void;
  /** Shows the whole image. */
  all(): void;
}

const MOST = 32;

/** What is to be seen stays so far from the edge of the box, CSS pixels. */
const EDGE = 24;

/** The view that shows the whole image in the middle of a box. */
export function fit(room: [width: number, height: number], size: [width: number, height: number]): View {
  const scale = Math.min(room[0] / size[0], room[1] / size[1]);
  return { scale, x: (room[0] - size[0] * scale) / 2, y: (room[1] - size[1] * scale) / 2 };
}

/** The view that a parameter of the address names. */
function viewOf(text: string | null, room: [width: number, height: number]): View | null {
  const numbers = numbersOf(text, 3);
  if (!numbers || numbers[0]! <= 0) return null;
  const scale = Math.min(MOST, numbers[0]!);
  return { scale, x: room[0] / 2 - numbers[1]! * scale, y: room[1] / 2 - numbers[2]! * scale };
}

/** Zoom of an image of a size in a box with that much room. Until somebody zooms, it shows the whole image. */
export function useZoom(
  box: { current: HTMLElement | null },
  room: [width: number, height: number],
  size: [width: number, height: number] | null,
  cross: Pixel | null,
): Zoom {
  // The address has the scale, and the pixel in the middle: that means the same in a box of another size.
  const [text, setText] = useAddressed("zoom");
  const whole = size ? fit(room, size) : { scale: 1, x: 0, y: 0 };
  const view = viewOf(text, room) ?? whole;
  const now = useRef({ view, whole, room, cross });
  now.current = { view, whole, room, cross };

  const all = () => setText(null);
  const choose = ({ scale, x, y }: View) => {
    const { room: there } = now.current;
    const middle = [(there[0] / 2 - x) / scale, (there[1] / 2 - y) / scale];
    // What is moved by less than a pixel of the image goes on from there.
    setText(numbersText([scale, ...middle], 3));
  };
  const around = (factor: number, x: number, y: number) => {
    const { view: old, whole: least } = now.current;
    const scale = Math.min(MOST, old.scale * factor);
    if (scale <= least.scale) return all();
    const ratio = scale / old.scale;
    return choose({ scale, x: x - (x - old.x) * ratio, y: y - (y - old.y) * ratio });
  };
  const by = (factor: number) => {
    const { view: old, room: there, cross: mark } = now.current;
    const at = mark && placeOf(mark, old);
    around(factor, ...(at ?? ([there[0] / 2, there[1] / 2] as const)));
  };
  const pan = (x: number, y: number) => {
    const { view: old, whole: least } = now.current;
    if (old.scale > least.scale) choose({ ...old, x: old.x + x, y: old.y + y });
  };

  const reveal = (x: number, y: number) => {
    const off = (at: number, length: number) => Math.min(length - EDGE, Math.max(EDGE, at)) - at;
    pan(off(x, room[0]), off(y, room[1]));
  };

  useMoves(box, size !== null, { around, by, pan, all });
  return { view, all, by, reveal };
}

/** How a view moves. */
interface Moves {
  /** Zooms around a point of the box. */
  around(factor: number, x: number, y: number): void;
  by(factor: number): void;
  pan(x: number, y: number): void;
  all(): void;
}

/** Moves by wheel, drag, two fingers, and keys. `moves` are those of when the image appeared. */
function useMoves(box: { current: HTMLElement | null }, isThere: boolean, moves: Moves): void {
  useEffect(() => {
    const target = box.current;
    if (!target) return;
    const { around, by, pan, all } = moves;
    const fingers = new Map<number, PointerEvent>();
    const wheel = (event: WheelEvent) => {
      if (!event.ctrlKey && !target.contains(document.activeElement)) return;
      event.preventDefault();
      const place = target.getBoundingClientRect();
      around(2 ** (-event.deltaY / 240), event.clientX - place.left, event.clientY - place.top);
    };
    const down = (event: PointerEvent) => {
      fingers.set(event.pointerId, event);
      target.setPointerCapture(event.pointerId);
    };
    const move = (event: PointerEvent) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      if (fingers.size === 1) pan(event.clientX - before.clientX, event.clientY - before.clientY);
      else {
        const other = [...fingers.values()].find((finger) => finger.pointerId !== event.pointerId)!;
        const place = target.getBoundingClientRect();
        const apart = (finger: PointerEvent) =>
          Math.hypot(finger.clientX - other.clientX, finger.clientY - other.clientY);
        around(
          apart(event) / Math.max(1, apart(before)),
          (event.clientX + other.clientX) / 2 - place.left,
          (event.clientY + other.clientY) / 2 - place.top,
        );
      }
      fingers.set(event.pointerId, event);
    };
    const up = (event: PointerEvent) => fingers.delete(event.pointerId);
    const press = (event: KeyboardEvent) => {
      if (isTyping(event)) return;
      if (event.key === "+" || event.key === "=") by(2);
      else if (event.key === "-") by(0.5);
      else if (event.key === "0") all();
      // With Shift, arrows move the crosshair.
      else if (event.shiftKey) return;
      else if (event.key === "ArrowLeft") pan(60, 0);
      else if (event.key === "ArrowRight") pan(-60, 0);
      else if (event.key === "ArrowUp") pan(0, 60);
      else if (event.key === "ArrowDown") pan(0, -60);
      else return;
      event.preventDefault();
    };
    target.addEventListener("wheel", wheel, { passive: false });
    target.addEventListener("pointerdown", down);
    target.addEventListener("pointermove", move);
    target.addEventListener("pointerup", up);
    target.addEventListener("pointercancel", up);
    target.addEventListener("keydown", press);
    return () => {
      target.removeEventListener("wheel", wheel);
      target.removeEventListener("pointerdown", down);
      target.removeEventListener("pointermove", move);
      target.removeEventListener("pointerup", up);
      target.removeEventListener("pointercancel", up);
      target.removeEventListener("keydown", press);
    };
  }, [isThere]);
}
