// Reads single channels of an OpenEXR file: scan lines, uncompressed or ZIP, as renderers write them here.
// Source: "OpenEXR File Layout" (openexr.com).

import { unzlibSync } from "fflate";

export interface Channel {
  name: string;
  /** 0: u32, 1: half, 2: float. */
  kind: number;
}

export interface ExrFile {
  width: number;
  height: number;
  channels: Channel[];
  /** Text attributes of the header, such as manifests of Cryptomatte. */
  texts: Map<string, string>;
  /** Reads the bits of channels as u32 values, row by row; halves become floats first. */
  read(names: string[]): Map<string, Uint32Array>;
}

const LINES: Record<number, number> = { 0: 1, 2: 1, 3: 16 };
const SIZES = [4, 2, 4];

export function openExr(bytes: Uint8Array): ExrFile {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (view.getUint32(0, true) !== 20000630)
    throw new Error("The image is not an OpenEXR file, so it names no objects.");
  const flags = view.getUint32(4, true) >>> 8;
  if ((flags & ~4) !== 0)
    throw new Error("This OpenEXR file has tiles or several parts, which the page does not read.");
  const header = readHeader(bytes, view);
  const lines = LINES[header.compression];
  if (lines === undefined)
    throw new Error("This OpenEXR file has a compression that the page does not read.");
  const { width, height, top, channels } = header;
  const read = (names: string[]) => {
    const out = new Map(names.map((name) => [name, new Uint32Array(width * height)]));
    const blocks = Math.ceil(height / lines);
    for (let block = 0; block < blocks; block++) {
      const at = Number(view.getBigUint64(header.end + block * 8, true));
      const first = view.getInt32(at, true) - top;
      const size = view.getInt32(at + 4, true);
      const count = Math.min(lines, height - first);
      const rowSize = channels.reduce((sum, channel) => sum + SIZES[channel.kind]! * width, 0);
      const raw = unpack(bytes.subarray(at + 8, at + 8 + size), header.compression, rowSize * count);
      scatter(raw, first, count, width, channels, out);
    }
    return out;
  };
  return { width, height, channels, texts: header.texts, read };
}

function readHeader(bytes: Uint8Array, view: DataView) {
  const decoder = new TextDecoder();
  let at = 8;
  const text = () => {
    const end = bytes.indexOf(0, at);
    const out = decoder.decode(bytes.subarray(at, end));
    at = end + 1;
    return out;
  };
  const header = {
    width: 0,
    height: 0,
    top: 0,
    compression: 0,
    channels: [] as Channel[],
    texts: new Map<string, string>(),
    end: 0,
  };
  for (;;) {
    const name = text();
    if (name === "") break;
    const type = text();
    const size = view.getInt32(at, true);
    at += 4;
    const next = at + size;
    if (name === "compression") header.compression = bytes[at]!;
    else if (name === "dataWindow") {
      header.top = view.getInt32(at + 4, true);
      header.width = view.getInt32(at + 8, true) - view.getInt32(at, true) + 1;
      header.height = view.getInt32(at + 12, true) - header.top + 1;
    } else if (name === "channels") {
      while (bytes[at] !== 0) {
        const channel = text();
        header.channels.push({ name: channel, kind: view.getInt32(at, true) });
        at += 16;
      }
    } else if (type === "string") header.texts.set(name, decoder.decode(bytes.subarray(at, next)));
    at = next;
  }
  header.end = at;
  return header;
}

/** Undoes ZIP: inflate, add up differences, and join the halves into which bytes were sorted. */
function unpack(packed: Uint8Array, compression: number, size: number): Uint8Array {
  if (compression === 0 || packed.length === size) return packed;
  const data = unzlibSync(packed);
  for (let at = 1; at < data.length; at++) data[at] = (data[at - 1]! + data[at]! - 128) & 255;
  const out = new Uint8Array(data.length);
  const half = Math.ceil(data.length / 2);
  for (let at = 0; at < half; at++) {
    out[2 * at] = data[at]!;
    if (2 * at + 1 < data.length) out[2 * at + 1] = data[half + at]!;
  }
  return out;
}

function scatter(
  raw: Uint8Array,
  first: number,
  count: number,
  width: number,
  channels: Channel[],
  out: Map<string, Uint32Array>,
): void {
  const view = new DataView(raw.buffer, raw.byteOffset, raw.byteLength);
  let at = 0;
  for (let row = first; row < first + count; row++) {
    for (const channel of channels) {
      const target = out.get(channel.name);
      const size = SIZES[channel.kind]!;
      if (target) {
        for (let x = 0; x < width; x++) {
          target[row * width + x] =
            size === 4 ? view.getUint32(at + 4 * x, true) : halfBits(view.getUint16(at + 2 * x, true));
        }
      }
      at += size * width;
    }
  }
}

const scratch = new DataView(new ArrayBuffer(4));

/** The bits of a half as those of a float. */
function halfBits(half: number): number {
  const exponent = (half >> 10) & 31;
  const fraction = half & 1023;
  const size =
    exponent === 0
      ? fraction * 2 ** -24
      : exponent === 31
        ? Infinity
        : (1 + fraction / 1024) * 2 ** (exponent - 15);
  scratch.setFloat32(0, half & 0x8000 ? -size : size);
  return scratch.getUint32(0);
}
