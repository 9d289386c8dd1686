// Images of selected frames as one zip file.

import { ask } from "../../api/client";
import type { Job } from "../../api/types";

export const MOST_FETCHED = 200;

/** Fetches the images one after another, and gives the browser a zip file of them. */
export async function fetchFrames(
  job: Job,
  frames: number[],
  kind: "png" | "exr",
  told: (done: number) => void,
): Promise<void> {
  const { Zip, ZipPassThrough } = await import("fflate");
  const parts: BlobPart[] = [];
  const zip = new Zip((error, chunk) => {
    if (error) throw error;
    parts.push(chunk as Uint8Array<ArrayBuffer>);
  });
  for (const [at, frame] of frames.entries()) {
    const answer = await ask(`/v1/jobs/${job.id}/frames/${frame}/image.${kind}`);
    // Images are compressed already.
    const file = new ZipPassThrough(`${String(frame).padStart(4, "0")}.${kind}`);
    zip.add(file);
    file.push(new Uint8Array(await answer.arrayBuffer()), true);
    told(at + 1);
  }
  zip.end();
  download(new Blob(parts, { type: "application/zip" }), `${fileName(job.name)}.zip`);
}

function fileName(name: string): string {
  return name.replace(/[^\p{L}\p{N}._-]+/gu, "-").replace(/^[-.]+|[-.]+$/g, "") || "images";
}

function download(blob: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
