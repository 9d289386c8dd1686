// A crosshair on an image that keys move: what the pointer shows, for people without one.

import type { View } from "./zoom";

export type Pixel = readonly [x: number, y: number];
type Room = readonly [width: number, height: number];

/** How far one press moves it on the screen, CSS pixels. Where a pixel is larger, it moves by one pixel. */
const STEP = 8;

const WAYS: Record<string, Pixel> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, -1],
  ArrowDown: [0, 1],
};

/** The pixel that a key leads to. The first press leads to the middle of what is seen. `null`: not its key. */
export function crossed(at: Pixel | null, key: string, view: View, room: Room, size: Room): Pixel | null {
  const way = WAYS[key];
  if (!way) return null;
  const inside = (value: number, axis: 0 | 1) => Math.min(size[axis] - 1, Math.max(0, Math.floor(value)));
  if (!at)
    return [inside((room[0] / 2 - view.x) / view.scale, 0), inside((room[1] / 2 - view.y) / view.scale, 1)];
  const step = Math.max(1, Math.round(STEP / view.scale));
  return [inside(at[0] + way[0] * step, 0), inside(at[1] + way[1] * step, 1)];
}

/** Where the middle of a pixel lies in the box. */
export function placeOf([x, y]: Pixel, view: View): Pixel {
  return [view.x + (x + 0.5) * view.scale, view.y + (y + 0.5) * view.scale];
}
