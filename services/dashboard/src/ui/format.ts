// Numbers, times and amounts as words. Times are in the viewer's zone; the page's head names it.

const zoneName = Intl.DateTimeFormat().resolvedOptions().timeZone;

const clock = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit" });
const clockSeconds = new Intl.DateTimeFormat("en-GB", {
  hour: "2-digit",
  minute: "2-digit",
  second: "2-digit",
});
const weekday = new Intl.DateTimeFormat("en-GB", { weekday: "short" });
const dayMonth = new Intl.DateTimeFormat("en-GB", { day: "numeric", month: "short" });
const full = new Intl.DateTimeFormat("en-GB", { dateStyle: "full", timeStyle: "long" });
const zone = new Intl.DateTimeFormat("en-GB", { timeZoneName: "short", hour: "2-digit" });

/** The viewer's time zone, such as `Europe/Berlin`. */
export const timeZone = zoneName || "UTC";

/** Its short name at an instant, such as `CET` or `GMT+1`. */
export function zoneAt(at: number): string {
  return zone.formatToParts(at).find((part) => part.type === "timeZoneName")?.value ?? timeZone;
}

/** Milliseconds since 1970 of a timestamp of the API. */
export function instant(text: string): number {
  return Date.parse(text);
}

/** The same, or nothing. */
export function maybeInstant(text: string | null | undefined): number | null {
  return text == null ? null : Date.parse(text);
}

function startOfDay(at: number): number {
  return new Date(at).setHours(0, 0, 0, 0);
}

/** `06:40`; `Thu 06:40` on another day; `3 Dec 06:40` beyond a week. */
export function clockTime(at: number, now: number = Date.now()): string {
  const days = Math.round((startOfDay(at) - startOfDay(now)) / 86_400_000);
  if (days === 0) return clock.format(at);
  if (Math.abs(days) < 7) return `${weekday.format(at)} ${clock.format(at)}`;
  return `${dayMonth.format(at)} ${clock.format(at)}`;
}

/** `06:40:12`, with the day if it is not today. */
export function exactTime(at: number, now: number = Date.now()): string {
  const today = startOfDay(at) === startOfDay(now);
  return today ? clockSeconds.format(at) : `${dayMonth.format(at)} ${clockSeconds.format(at)}`;
}

/** `Thu 26 Nov`. */
export function dayName(at: number): string {
  return `${weekday.format(at)} ${dayMonth.format(at)}`;
}

/** The date of the night that holds an instant: nights begin at noon. */
export function nightOf(at: number): string {
  const noon = new Date(at - 12 * 3_600_000);
  const two = (value: number) => String(value).padStart(2, "0");
  return `${noon.getFullYear()}-${two(noon.getMonth() + 1)}-${two(noon.getDate())}`;
}

/** Everything, for a tooltip: `Thursday, 26 November 2026 at 06:40:12 CET`. */
export function fullTime(at: number): string {
  return full.format(at);
}

/** `45 s`, `12 min`, `29 min 26 s`, `3 h 20 min`, `2 d 4 h`: the two greatest units, without zeros. */
export function duration(ms: number): string {
  const seconds = Math.round(Math.abs(ms) / 1000);
  if (seconds < 60) return `${seconds} s`;
  if (seconds < 3_600) return twoUnits(Math.floor(seconds / 60), "min", seconds % 60, "s");
  const minutes = Math.round(seconds / 60);
  const hours = Math.floor(minutes / 60);
  if (hours < 48) return twoUnits(hours, "h", minutes % 60, "min");
  return twoUnits(Math.floor(hours / 24), "d", hours % 24, "h");
}

function twoUnits(great: number, unit: string, small: number, smallUnit: string): string {
  return small === 0 ? `${great} ${unit}` : `${great} ${unit} ${small} ${smallUnit}`;
}

/** CPU time: `0.42 s`, `12.3 s`, `4.1 min`, `12.5 h`. */
export function cpuTime(seconds: number): string {
  if (seconds < 100) return `${significant(seconds, 3)} s`;
  if (seconds < 6000) return `${significant(seconds / 60, 3)} min`;
  return `${significant(seconds / 3600, 3)} h`;
}

/** A count of operations: `820 M`, `3.23 G`. */
export function work(count: number): string {
  for (const [size, unit] of [
    [1e15, "P"],
    [1e12, "T"],
    [1e9, "G"],
    [1e6, "M"],
    [1e3, "k"],
  ] as const) {
    if (count >= size) return `${significant(count / size, 3)} ${unit}`;
  }
  return significant(count, 3);
}

/** An amount in micro-units as currency: `12.50`; small ones with two significant digits, `0.0019`. */
export function money(micros: number): string {
  const amount = micros / 1e6;
  const size = Math.abs(amount);
  if (size === 0) return "0.00";
  if (size >= 10_000) return grouped(Math.round(amount));
  if (size >= 0.1) return amount.toFixed(2);
  const digits = Math.min(6, 1 - Math.floor(Math.log10(size)));
  return amount.toFixed(digits);
}

/** An amount in a field: exact, with a point and without groups. */
export function moneyField(micros: number): string {
  const [whole = "0", digits = ""] = (micros / 1e6).toFixed(6).replace(/0+$/, "").split(".");
  return `${whole}.${digits.padEnd(2, "0")}`;
}

/** An amount on an axis whose lines are so far apart: as many digits as tell them apart. */
export function moneyOnAxis(micros: number, step: number): string {
  const digits = Math.min(6, Math.max(2, -Math.floor(Math.log10(Math.max(1, step) / 1e6))));
  return (micros / 1e6).toFixed(digits);
}

/** Micro-units of an amount that a person typed, or `null`. `1,500` may be either, so it is none. */
export function parseMoney(text: string): number | null {
  const plain = text.replace(/\s/g, "");
  if (/^\d{1,3}(,\d{3})+$/.test(plain)) return null;
  const clean = plain.replace(",", ".");
  if (!/^\d+(\.\d{1,6})?$/.test(clean)) return null;
  return Math.round(Number(clean) * 1e6);
}

/** `94 %`. Never 100 % of something that is not certain. */
export function percent(share: number, digits = 0): string {
  const value = share * 100;
  if (digits === 0 && value > 99 && value < 100) return "> 99 %";
  if (digits === 0 && value > 0 && value < 1) return "< 1 %";
  return `${value.toFixed(digits)} %`;
}

/** `+4.2 %`, `−0.3 %`. */
export function signedPercent(share: number, digits = 1): string {
  const sign = share < 0 ? "−" : "+";
  return `${sign}${Math.abs(share * 100).toFixed(digits)} %`;
}

/** An integer with thin groups: `12 480`. */
export function grouped(value: number): string {
  return String(Math.round(value)).replace(/\B(?=(\d{3})+$)/g, "\u202f");
}

/** `1 job`, `3 jobs`. */
export function counted(count: number, one: string, many = `${one}s`): string {
  return `${grouped(count)} ${count === 1 ? one : many}`;
}

/** Bytes: `3.2 MiB`. */
export function bytes(size: number): string {
  for (const [step, unit] of [
    [2 ** 40, "TiB"],
    [2 ** 30, "GiB"],
    [2 ** 20, "MiB"],
    [2 ** 10, "KiB"],
  ] as const) {
    if (size >= step) return `${significant(size / step, 3)} ${unit}`;
  }
  return `${size} B`;
}

/** A number with so many significant digits, without an exponent. */
export function significant(value: number, digits: number): string {
  if (value === 0 || !Number.isFinite(value)) return "0";
  const places = Math.max(0, digits - 1 - Math.floor(Math.log10(Math.abs(value))));
  return value.toFixed(Math.min(places, 8));
}

/** A name of the API as words: `set_aside` is `set aside`. */
export function words(name: string): string {
  return name.replaceAll("_", " ");
}

const STAMP = /\d{4}-\d\d-\d\dT\d\d:\d\d(?::\d\d(?:\.\d+)?)?(?:Z|[+-]\d\d:\d\d)/g;

/** What an amount is more or less: `+1.20`, `−0.35`. */
export function signedMoney(micros: number): string {
  return `${micros < 0 ? "−" : "+"}${money(Math.abs(micros))}`;
}

/** Amounts of the service, written as the page writes them. */
function asHere(text: string): string {
  return text.replace(/(?<![^\s(])[+-]\d+\.\d{2,6}(?![\w.]| ?%)/g, (amount) =>
    signedMoney(Number(amount) * 1e6),
  );
}

/** A text of the service for people: one line, with its instants in the viewer's zone. */
export function told(text: string): string {
  const shown = asHere(clean(text));
  // Instants that minutes do not tell apart have seconds.
  const stamps = (shown.match(STAMP) ?? []).map((stamp) => Date.parse(stamp));
  const near = stamps.length > 1 && Math.max(...stamps) - Math.min(...stamps) < 5 * 60_000;
  return shown.replace(STAMP, (stamp) => {
    const at = Date.parse(stamp);
    return Number.isNaN(at) ? stamp : near ? exactTime(at) : clockTime(at);
  });
}

/** Words with which lines about jobs and nodes begin. Any other first word may be a name. */
const FIRST_WORDS =
  /^(?:a|an|all|and|at|because|every|frames?|its?|less|more|no|none|nothing|one|the|with|without)\b/;

/** The same as a sentence. A line that is `named` may begin with a name, which stays as it is written. */
export function sentence(text: string, named = false): string {
  const shown = told(text);
  const isWord = (named ? FIRST_WORDS : /^[a-z]+/).test(shown) && /^[a-z]+(?=\s)/.test(shown);
  const first = isWord ? shown.slice(0, 1).toUpperCase() + shown.slice(1) : shown;
  return /[.!?]$/.test(first) ? first : `${first}.`;
}

/** A name as one line: control characters and line breaks become a visible sign, and direction marks go. */
export function clean(name: string): string {
  return name
    .replace(/[\u0000-\u001f\u007f-\u009f]/g, "␣")
    .replace(/[\u200e\u200f\u202a-\u202e\u2066-\u2069]/g, "");
}
