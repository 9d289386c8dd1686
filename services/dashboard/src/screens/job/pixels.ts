// What each pixel of a finished frame shows, and what it cost: from the layers of its EXR file.

import { ask } from "../../api/client";
import { openExr, type ExrFile } from "./exr";

export interface Pixels {
  width: number;
  height: number;
  /** Object and material of a pixel, and the shares of both in the frame's cost. */
  at(x: number, y: number): Shown | null;
}

export interface Shown {
  object: string | null;
  material: string | null;
  /** Share of the whole frame's work that pixels of this object caused, if the renderer counts work. */
  objectShare: number | null;
  /** Work of this pixel over that of the mean pixel. */
  timesMean: number | null;
}

interface Layer {
  ids: Uint32Array;
  names: Map<number, string>;
}

export async function readPixels(job: string, frame: number, signal: AbortSignal): Promise<Pixels> {
  const answer = await ask(`/v1/jobs/${job}/frames/${frame}/image.exr`, { signal });
  const file = openExr(new Uint8Array(await answer.arrayBuffer()));
  const has = (name: string) => file.channels.some((channel) => channel.name === name);
  const wanted = ["CryptoObject00.R", "CryptoMaterial00.R", "cost.work"].filter(has);
  const channels = file.read(wanted);
  const objects = layer(file, channels, "CryptoObject");
  const materials = layer(file, channels, "CryptoMaterial");
  const bits = channels.get("cost.work");
  const work = bits ? new Float32Array(bits.buffer) : null;
  const { shares, mean } = sharesOf(objects, work);
  return {
    width: file.width,
    height: file.height,
    at(x, y) {
      if (x < 0 || y < 0 || x >= file.width || y >= file.height) return null;
      const index = y * file.width + x;
      const id = objects?.ids[index];
      const material = materials?.ids[index];
      return {
        object: (id !== undefined && objects?.names.get(id)) || null,
        material: (material !== undefined && materials?.names.get(material)) || null,
        objectShare: id === undefined ? null : (shares.get(id) ?? null),
        timesMean: work && mean > 0 ? work[index]! / mean : null,
      };
    },
  };
}

/** The layer of the ids that cover most of each pixel, with its manifest. */
function layer(file: ExrFile, channels: Map<string, Uint32Array>, name: string): Layer | null {
  const ids = channels.get(`${name}00.R`);
  if (!ids) return null;
  const names = new Map<number, string>();
  for (const [key, value] of file.texts) {
    if (!key.startsWith("cryptomatte/") || !key.endsWith("/name") || value !== name) continue;
    const manifest = file.texts.get(key.replace(/name$/, "manifest"));
    if (!manifest) continue;
    for (const [thing, hash] of Object.entries(JSON.parse(manifest) as Record<string, string>))
      names.set(parseInt(hash, 16), thing);
  }
  return { ids, names };
}

function sharesOf(
  objects: Layer | null,
  work: Float32Array | null,
): { shares: Map<number, number>; mean: number } {
  const shares = new Map<number, number>();
  if (!work) return { shares, mean: 0 };
  let total = 0;
  for (let index = 0; index < work.length; index++) {
    total += work[index]!;
    if (objects) shares.set(objects.ids[index]!, (shares.get(objects.ids[index]!) ?? 0) + work[index]!);
  }
  for (const [id, sum] of shares) shares.set(id, total > 0 ? sum / total : 0);
  return { shares, mean: total / Math.max(1, work.length) };
}
