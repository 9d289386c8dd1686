// Sets of frame numbers in the notation of the API: `0-47`, `0,5,9-12`.

/** The numbers of a set, ascending. `null` if the text is not one. */
export function parseFrames(text: string): number[] | null {
  const out = new Set<number>();
  for (const part of text.split(",")) {
    const match = /^\s*(\d{1,7})(?:\s*-\s*(\d{1,7}))?\s*$/.exec(part);
    if (!match) return null;
    const first = Number(match[1]);
    const last = match[2] === undefined ? first : Number(match[2]);
    if (last < first || last - first > 1_000_000) return null;
    for (let frame = first; frame <= last; frame++) out.add(frame);
  }
  return [...out].sort((a, b) => a - b);
}

/** The text of a set. */
export function formatFrames(frames: Iterable<number>): string {
  const sorted = [...new Set(frames)].sort((a, b) => a - b);
  const parts: string[] = [];
  for (let at = 0; at < sorted.length;) {
    let end = at;
    while (end + 1 < sorted.length && sorted[end + 1]! === sorted[end]! + 1) end++;
    parts.push(end === at ? `${sorted[at]}` : `${sorted[at]}-${sorted[end]}`);
    at = end + 1;
  }
  return parts.join(",");
}
