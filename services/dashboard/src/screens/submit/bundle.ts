// A bundle from what was dropped: a zip file as it is, files of a folder as a new zip file.

import { Zip, ZipDeflate, ZipPassThrough } from "fflate";
import { ask, newKey } from "../../api/client";
import type { Bundle } from "../../api/types";

export interface Packed {
  name: string;
  body: Blob;
  type: "application/zip" | "application/x-blender";
}

interface Named {
  path: string;
  file: File;
}

const ALREADY_PACKED = /\.(png|jpe?g|exr|ktx2|webp|zip|gz|zst)$/i;

/** Files of a drop, folders included, with paths relative to the folder that was dropped. */
export async function droppedFiles(items: DataTransferItemList): Promise<Named[]> {
  const entries = [...items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  const out: Named[] = [];
  for (const entry of entries) await walk(entry, "", out);
  return out;
}

async function walk(entry: FileSystemEntry, prefix: string, out: Named[]): Promise<void> {
  const path = prefix + entry.name;
  if (entry.isFile) {
    out.push({
      path,
      file: await new Promise<File>((done, fail) => (entry as FileSystemFileEntry).file(done, fail)),
    });
    return;
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  for (;;) {
    // A reader hands out its entries in portions.
    const some = await new Promise<FileSystemEntry[]>((done, fail) => reader.readEntries(done, fail));
    if (some.length === 0) return;
    for (const child of some) await walk(child, `${path}/`, out);
  }
}

export function pickedFiles(list: FileList): Named[] {
  return [...list].map((file) => ({ path: file.webkitRelativePath || file.name, file }));
}

/** What is to be uploaded. Throws, with what to do, if it is no bundle. */
export async function pack(files: Named[], told: (share: number) => void): Promise<Packed> {
  if (files.length === 0) throw new Error("Nothing was dropped that can be read.");
  const only = files.length === 1 ? files[0]! : null;
  if (only && /\.zip$/i.test(only.path))
    return { name: stem(only.path), body: only.file, type: "application/zip" };
  if (only && /\.blend$/i.test(only.path))
    return { name: stem(only.path), body: only.file, type: "application/x-blender" };
  const root = commonFolder(files.map((named) => named.path));
  const inside = files.map((named) => ({ path: named.path.slice(root.length), file: named.file }));
  const scene = inside.find(
    (named) => named.path === "scene.json" || /^[^/]+\.(gltf|glb)$/i.test(named.path),
  );
  if (!scene)
    throw new Error(
      "This is no bundle: a folder with scene.json or one glTF file, a zip file of it, or a Blender file.",
    );
  const body = await zipped(inside, told);
  const name = root ? root.split("/").filter(Boolean).pop()! : stem(scene.path);
  return { name, body, type: "application/zip" };
}

const SLICE = 1 << 20;

/** A zip file, made slice by slice: the page's policy allows no workers, and the page goes on in between. */
async function zipped(files: Named[], told: (share: number) => void): Promise<Blob> {
  const parts: BlobPart[] = [];
  const zip = new Zip((error, chunk) => {
    if (error) throw error;
    parts.push(chunk as Uint8Array<ArrayBuffer>);
  });
  const all = files.reduce((sum, named) => sum + named.file.size, 0);
  let done = 0;
  for (const { path, file } of files) {
    const entry = ALREADY_PACKED.test(path) ? new ZipPassThrough(path) : new ZipDeflate(path, { level: 6 });
    zip.add(entry);
    for (let at = 0; at === 0 || at < file.size; at += SLICE) {
      const slice = new Uint8Array(await file.slice(at, at + SLICE).arrayBuffer());
      entry.push(slice, at + SLICE >= file.size);
      done += slice.length;
      told(all > 0 ? done / all : 1);
    }
  }
  zip.end();
  return new Blob(parts, { type: "application/zip" });
}

function stem(path: string): string {
  return path
    .split("/")
    .pop()!
    .replace(/\.[^.]+$/, "");
}

/** The folder that all paths share, with its slash, or nothing. */
function commonFolder(paths: string[]): string {
  const parts = paths[0]!.split("/").slice(0, -1);
  let depth = parts.length;
  for (const path of paths) {
    const other = path.split("/").slice(0, -1);
    let same = 0;
    while (same < depth && other[same] === parts[same]) same++;
    depth = same;
  }
  return depth === 0 ? "" : `${parts.slice(0, depth).join("/")}/`;
}

export async function upload(packed: Packed): Promise<Bundle> {
  const answer = await ask("/v1/bundles", {
    method: "POST",
    headers: { "Content-Type": packed.type, "Idempotency-Key": newKey() },
    body: packed.body,
  });
  return (await answer.json()) as Bundle;
}
