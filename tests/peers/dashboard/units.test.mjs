// Parts of the page that are plain functions.

import assert from "node:assert/strict";
import path from "node:path";
import { createRequire } from "node:module";
import test from "node:test";
import { root } from "./farm.mjs";

const sources = path.join(root, "services/dashboard/src");
const { build } = createRequire(path.join(root, "services/dashboard/package.json"))("esbuild");

/** A module of the page, with what it imports. */
async function load(file) {
  const entryPoints = [path.join(sources, file)];
  const { outputFiles } = await build({ entryPoints, bundle: true, format: "esm", write: false });
  return import(`data:text/javascript;base64,${Buffer.from(outputFiles[0].contents).toString("base64")}`);
}

test("sets of frames are read and written as the API writes them", async () => {
  const { parseFrames, formatFrames } = await load("ui/frames.ts");
  for (const text of ["0", "0-47", "0,5,9-12", "3-4,9"]) assert.equal(formatFrames(parseFrames(text)), text);
  assert.equal(formatFrames([7, 2, 3, 2]), "2-3,7");
  for (const text of ["", "5-1", "a", "1,,2", "-3", "1-99999999"])
    assert.equal(parseFrames(text), null, text);
});

test("a session submits to the projects in which its role does", async () => {
  const { submitsTo } = await load("state/rights.ts");
  const both = { name: "anna", role: "submitter", projects: { film: "submitter", ads: "viewer" } };
  assert.deepEqual(
    ["film", "ads", "other"].map((project) => submitsTo(both, project)),
    [true, false, false],
  );
  assert.equal(submitsTo({ ...both, projects: { "*": "operator", ads: "viewer" } }, "film"), true);
  assert.equal(submitsTo({ name: "all", role: "submitter" }, "film"), true);
  assert.equal(submitsTo({ name: "all", role: "viewer" }, "film"), false);
  assert.equal(submitsTo(null, "film"), false);
});

test("events change the rows of jobs and nodes, and the counts, without another request", async () => {
  const { farmAfter, farmSummed, nodeAfter } = await load("state/news.ts");
  const at = "2026-11-26T20:00:00Z";
  const counts = { previewing: 0, booked: 1, rendering: 0, done: 4 };
  const row = { id: "a", name: "hero", state: "booked", frames_done: 0, deadline: at, budget: 5 };
  const farm = { jobs: [row], jobs_open_total: 1, counts: { jobs: counts, nodes: 2 } };
  assert.equal(farmAfter(farm, [{ kind: "task_progress", job_id: "a", progress: 0.5 }]), farm);
  const created = { frames_total: 3, terms: { hold: true, budget: 9 } };
  const waits = { kind: "turn", because: "waits because hero goes first" };
  const planned = { verdict: "late", eta: at, booked_cost: 7, probability: 0.2, waits };
  const booked = { kind: "plan_stored", job_id: "a", job: planned };
  const likely = { ...farm, jobs: [{ ...row, probability: 1, promise: { kept: true } }] };
  const later = {
    kind: "job_changed",
    job_id: "a",
    job: { terms: { hold: false, deadline: "2026-11-27T08:00:00Z" } },
  };
  const [moved] = farmAfter(likely, [later]).jobs;
  assert.deepEqual([moved.probability, moved.promise], [null, null], "they were of another deadline");
  assert.equal(farmAfter(farm, [booked]).jobs[0].waits, waits);
  assert.equal(farmAfter(farm, [booked, { ...booked, job: {} }]).jobs[0].waits, null);
  const after = farmAfter(farm, [
    booked,
    { kind: "job_state", job_id: "a", job_state: "rendering" },
    { kind: "task_done", job_id: "a", frames_done: 2 },
    { kind: "job_changed", job_id: "a", job: { terms: { hold: false } } },
    {
      kind: "job_created",
      job_id: "b",
      job_name: "new",
      job_state: "previewing",
      project: "film",
      job: created,
    },
  ]);
  const [old, fresh] = after.jobs;
  assert.deepEqual(
    [old.state, old.frames_done, old.verdict, old.probability, old.deadline, old.budget, old.waits],
    ["rendering", 2, "late", null, null, null, null],
  );
  assert.deepEqual(
    [fresh.name, fresh.project, fresh.hold, fresh.budget, fresh.frames_total],
    ["new", "film", true, 9, 3],
  );
  assert.deepEqual([after.jobs_open_total, after.counts.jobs.booked, after.counts.jobs.rendering], [2, 0, 1]);
  const over = farmAfter(after, [{ kind: "job_state", job_id: "a", job_state: "done" }]);
  assert.deepEqual(
    [over.jobs.map((job) => job.id), over.jobs_open_total, over.counts.jobs.done],
    [["b"], 1, 5],
  );

  const summary = {
    last_event_id: 20,
    counts: { jobs: { ...counts, rendering: 7 }, jobs_active: 9, nodes: 3 },
    node_counts: { idle: 3 },
    versions: { service: "1" },
    finish: { p50: at },
    spending: [],
  };
  const summed = farmSummed(after, summary, false);
  assert.deepEqual(
    [summed.jobs_open_total, summed.counts.jobs.rendering, summed.counts.nodes, summed.finish.p50],
    [9, 7, 3, at],
  );
  const ahead = farmSummed(after, summary, true);
  assert.deepEqual([ahead.jobs_open_total, ahead.counts.jobs.rendering, ahead.counts.nodes], [2, 1, 3]);
  const ends = { id: 20, kind: "job_state", job_id: "a", job_state: "done" };
  const known = farmAfter(summed, [ends], 20);
  assert.deepEqual([known.jobs.map((job) => job.id), known.jobs_open_total], [["b"], 9], "it is counted");
  assert.equal(farmAfter(summed, [{ ...ends, id: 21 }], 20).jobs_open_total, 8);

  const idle = { id: "n", state: "idle", activity: null };
  const leased = {
    kind: "task_leased",
    node_id: "n",
    task_id: "t",
    job_id: "a",
    job_name: "hero",
    frame: 7,
    at,
  };
  const busy = nodeAfter(idle, [leased, { kind: "task_progress", task_id: "t", progress: 0.5 }]);
  assert.deepEqual(
    [busy.state, busy.activity.job, busy.activity.frame, busy.activity.progress],
    ["working", "hero", 7, 0.5],
  );
  const late = { kind: "task_late", node_id: "n", task_id: "t", job_id: "a" };
  assert.equal(nodeAfter(busy, [late, { ...late, kind: "task_stalled" }]), busy);
  const ended = nodeAfter(busy, [{ kind: "task_done", task_id: "t", job_id: "a" }]);
  assert.deepEqual([ended.state, ended.activity], ["idle", null]);
  assert.equal(nodeAfter(busy, [{ kind: "task_done", task_id: "other" }]), busy);
});

test("thousands of events at once reach a screen in one piece, in their order", async (t) => {
  const sources = [];
  class EventSource extends EventTarget {
    constructor() {
      super();
      sources.push(this);
    }
    close() {}
  }
  Object.assign(globalThis, { EventSource, document: new EventTarget() });
  globalThis.addEventListener ??= () => {};
  globalThis.removeEventListener ??= () => {};
  t.after(() => ["EventSource", "document"].forEach((name) => delete globalThis[name]));
  const { follow, onEvents, unfollow } = await load("state/live.ts");
  const heard = [];
  onEvents((events) => heard.push(events.map((event) => event.id)));
  follow(0);
  const ids = Array.from({ length: 4_000 }, (_, at) => at + 1);
  for (const id of ids)
    sources[0].dispatchEvent(
      new MessageEvent("plan_stored", { data: JSON.stringify({ id, kind: "plan_stored", job_id: "a" }) }),
    );
  await new Promise((done) => setTimeout(done, 600));
  assert.deepEqual(heard, [ids]);
  unfollow();
});

test("a rescue by quality that fails half-way makes no second job when it is tried again", async (t) => {
  const { take } = await load("actions/jobs.ts");
  const job = {
    id: "a",
    name: "hero",
    frames: "0-9",
    settings: { spp: 64 },
    deadline: "2026-11-27T08:00:00Z",
  };
  const keys = [];
  let cancels = 0;
  t.mock.method(globalThis, "fetch", async (url, { method, headers }) => {
    if (url === "/v1/jobs/a/cancel" && ++cancels === 1) throw new TypeError("the network is gone");
    if (url === "/v1/jobs") keys.push(headers["Idempotency-Key"]);
    return Response.json(method === "GET" ? job : { id: "b" });
  });
  const rung = { quality: { width: 64, height: 36, spp: 16 } };
  await assert.rejects(take(rung, "a"), /does not answer/);
  assert.equal(await take(rung, "a"), "b");
  await take({ quality: { ...rung.quality, spp: 8 } }, "a");
  assert.equal(keys[0], keys[1]);
  assert.notEqual(keys[1], keys[2]);
});

test("amounts keep the digits that tell them apart, and are read back exactly", async () => {
  const { money, parseMoney, moneyOnAxis } = await load("ui/format.ts");
  const written = [
    [0, "0.00"],
    [12_500_000, "12.50"],
    [1_900, "0.0019"],
    [7, "0.000007"],
    [-1_900, "-0.0019"],
  ];
  for (const [micros, text] of written) assert.equal(money(micros), text);
  assert.deepEqual(["12.50", "12,5", "0.000001", "1e3", "-1", ""].map(parseMoney), [
    12_500_000,
    12_500_000,
    1,
    null,
    null,
    null,
  ]);
  assert.notEqual(moneyOnAxis(171_000, 2_000), moneyOnAxis(173_000, 2_000));
});

test("a probability that is not certain is never written as 0 % or 100 %", async () => {
  const { percent } = await load("ui/format.ts");
  assert.deepEqual(
    [0, 0.004, 0.5, 0.996, 1].map((share) => percent(share)),
    ["0 %", "< 1 %", "50 %", "> 99 %", "100 %"],
  );
});

test("texts of the service lose control characters and marks of direction, and names keep their letters", async () => {
  const { clean, sentence } = await load("ui/format.ts");
  assert.equal(clean("a\u0000b\nc\u202ed"), "a␣b␣cd");
  assert.equal(sentence("no plan can be in time"), "No plan can be in time.");
  assert.equal(sentence("wall_right, paint: 3 %"), "wall_right, paint: 3 %.");
});

test("durations and amounts have one style, whether the page or the service writes them", async () => {
  const { duration, told } = await load("ui/format.ts");
  assert.deepEqual([45_000, 75_000, 1_766_000, 1_800_000, 12_000_000, 187_200_000].map(duration), [
    "45 s",
    "1 min 15 s",
    "29 min 26 s",
    "30 min",
    "3 h 20 min",
    "2 d 4 h",
  ]);
  assert.equal(told("the deadline 28 min later: -0.0123"), "the deadline 28 min later: −0.012");
  assert.equal(told("2 h late: +1.20"), "2 h late: +1.20");
  assert.equal(told("1 h 10 min 30 s"), "1 h 10 min 30 s");
  assert.equal(told("shot-1.25 lasts 1.5 s"), "shot-1.25 lasts 1.5 s");
});

test("a line that begins with a name keeps its letters", async () => {
  const { sentence } = await load("ui/format.ts");
  assert.equal(sentence("hero ends later", true), "hero ends later.");
  assert.equal(sentence("one more node", true), "One more node.");
});

test("an instant is read from a field, unless its year has five digits", async () => {
  const { localText, timestampOf } = await load("ui/moment.tsx");
  assert.equal(Date.parse(timestampOf("2026-11-30T06:00")), new Date(2026, 10, 30, 6).getTime());
  assert.equal(timestampOf(localText(0)), new Date(0).toISOString());
  for (const text of ["12026-11-30T06:00", "275760-12-30T06:00", "", "soon"])
    assert.equal(timestampOf(text), null, text);
});

test("every frame has a cell of its own, within the strip, and is found again under its middle", async () => {
  const { layOut, cellAt } = await load("screens/job/strip-layout.ts");
  for (const count of [1, 2, 48, 300, 2_000, 10_000]) {
    for (const width of [320, 700, 1400]) {
      const layout = layOut(count, width);
      assert.ok(
        layout.perRow * layout.rows >= count && layout.left + layout.perRow * layout.cell[0] <= width + 1e-9,
        `${count} in ${width}`,
      );
      for (const index of [0, count >> 1, count - 1]) {
        const x = layout.left + ((index % layout.perRow) + 0.5) * layout.cell[0];
        const y = (Math.floor(index / layout.perRow) + 0.5) * layout.cell[1];
        assert.equal(cellAt(layout, x, y), index, `${index} of ${count} in ${width}`);
      }
    }
  }
});

test("an axis of time has few lines however long it is, and shows the ends rather than a far deadline", async () => {
  const { axisFor } = await load("ui/time-axis.ts");
  const [hour, day] = [3_600_000, 86_400_000];
  const from = Date.parse("2026-11-26T20:00:00Z");
  for (const length of [hour / 20, hour, 9 * hour, 3 * day, 40 * day, 300 * day, 4000 * day]) {
    const { ticks, to } = axisFor(from, [from + length]);
    assert.ok(to > from + length && ticks.length >= 1 && ticks.length <= 5, `${length}: ${ticks.length}`);
    assert.equal(new Set(ticks.map((tick) => tick.word)).size, ticks.length);
  }
  const near = axisFor(from, [from + hour], [from + 2 * hour, from + 300 * day]);
  assert.ok(near.to > from + 2 * hour && near.to < from + 3 * hour);
  assert.ok(axisFor(from, [], [from + 300 * day]).to > from + 300 * day, "there is nothing else to show");
});

test("coverage counts what was at or below each quantile", async () => {
  const { batches, course, projectGroups, wilson } = await load("screens/record/statistics.ts");
  const quantiles = { mean: 10, p50: 10, p80: 12, p95: 14 };
  const rows = [9, 11, 13, 15].map((actual, at) => ({
    cpu_actual: actual,
    cpu_forecast: quantiles,
    work_actual: 5,
    work_forecast: quantiles,
    finished: `2026-11-25T00:00:0${at}Z`,
    frame: at,
    job_id: "a",
  }));
  assert.deepEqual(batches(rows, "cpu", 4)[0].shares, [0.25, 0.5, 0.75]);
  const coverage = (count, p50) => ({
    count,
    cpu_hits: { p50, p80: count, p95: count },
    work_hits: { p50: count, p80: count, p95: count },
    cpu_mean_absolute_error: 0.1,
    work_mean_absolute_error: 0.2,
  });
  const projects = [
    { project: "ads", frames: coverage(3, 1), cpu_bias: 0.5 },
    { project: "film", frames: coverage(8, 2), cpu_bias: -0.5 },
  ];
  const [most] = projectGroups(projects, "cpu");
  assert.deepEqual(
    [most.name, most.frames, most.shares, most.error, most.bias],
    ["film", 8, [0.25, 1, 1], 0.1, -0.5],
  );
  // A short record is shown by its frames, a long one by its days, some of them together.
  assert.equal(course({ frames: 4, items: rows, days: [] }, "cpu")[0].count, 4);
  const days = Array.from({ length: 120 }, (_, at) => ({
    day: `2026-01-01T00:00:00.${String(at).padStart(3, "0")}Z`,
    frames: at % 2 ? coverage(10, 0) : coverage(30, 30),
  }));
  const long = course({ frames: 9_999, items: rows, days }, "cpu");
  assert.deepEqual([long.length, long[0].count, long[0].shares], [60, 40, [0.75, 1, 1]]);
  const [low, high] = wilson(8, 10);
  // Wilson's interval of 8 in 10, to three digits.
  assert.deepEqual([low.toFixed(3), high.toFixed(3)], ["0.490", "0.943"]);
});

test("keys move the crosshair by what is seen of the image, and never beside it", async () => {
  const { crossed, placeOf } = await load("screens/job/crosshair.ts");
  const room = [400, 200];
  const size = [100, 50];
  const far = { scale: 4, x: 0, y: 0 };
  assert.deepEqual(crossed(null, "ArrowLeft", far, room, size), [50, 25]);
  assert.deepEqual(crossed([50, 25], "ArrowRight", far, room, size), [52, 25]);
  assert.deepEqual(crossed([99, 1], "ArrowRight", far, room, size), [99, 1]);
  assert.deepEqual(crossed([99, 1], "ArrowUp", far, room, size), [99, 0]);
  assert.equal(crossed([50, 25], "Enter", far, room, size), null);
  // Where a pixel is large, a press moves by one. The first one leads to what is seen, not to the image's middle.
  const near = { scale: 32, x: -320, y: 0 };
  assert.deepEqual(crossed([50, 25], "ArrowDown", near, room, size), [50, 26]);
  assert.deepEqual(crossed(null, "ArrowDown", near, room, size), [16, 3]);
  assert.deepEqual(placeOf([16, 3], near), [208, 112]);
});

test("keys go through the spans of a node in time, and to the span at the same time of another node", async () => {
  const { find, showing, spotFrom, spotText, walked } = await load("screens/farm/walk.ts");
  const span = (job_id, start, end) => ({ job_id, frames: `${start}`, kind: "past", start, end, tail: end });
  const rows = [
    { node_id: "a", spans: [span("y", 20, 30), span("x", 0, 10), span("z", 40, 50)] },
    { node_id: "b", spans: [span(null, 0, 60), span("w", 22, 24)] },
    { node_id: "c", spans: [] },
  ];
  const view = { from: 0, to: 60 };
  let spot = null;
  const jobs = ["Right", "Right", "Right", "Left", "Down", "Down", "Up", "Up"].map((key) => {
    spot = walked(rows, spot, `Arrow${key}`, view, 0);
    const { row, span } = find(rows, spot);
    return `${row.node_id} ${span?.job_id ?? null}`;
  });
  assert.deepEqual(jobs, ["a y", "a z", "a z", "a y", "b null", "c null", "b null", "a y"]);
  assert.equal(walked(rows, spot, "Enter", view, 0), null);
  // Asked again, the span has other frames.
  rows[0].spans[0].frames = "20-22";
  assert.equal(find(rows, spot).span, rows[0].spans[0]);
  const far = { node: "a", job: "y", frames: "1,3", at: 5_000 };
  assert.deepEqual([spotFrom(spotText(far)), spotFrom("a"), spotFrom(null)], [far, null, null]);
  assert.deepEqual(showing(view, { from: 70, to: 80 }), { from: 23, to: 83 });
  assert.equal(showing(view, { from: 10, to: 30 }), view);
});

test("a stream of events goes on behind the last one after each break, and ends where the service says so", async (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const made = [];
  class Source extends EventTarget {
    static CLOSED = 2;
    constructor(address) {
      super();
      made.push(Object.assign(this, { address, readyState: 0 }));
    }
    close() {
      this.readyState = Source.CLOSED;
    }
    say(id) {
      this.dispatchEvent(new MessageEvent("task_done", { data: JSON.stringify({ id }) }));
    }
  }
  let status = 503;
  const page = Object.assign(new EventTarget(), { visibilityState: "visible" });
  const global = { EventSource: Source, document: page, fetch: async () => ({ status }) };
  global.addEventListener = global.removeEventListener = () => undefined;
  Object.assign(globalThis, global);
  const { openStream } = await load("state/stream.ts");
  const [taken, broken] = [[], []];
  const stream = openStream({
    address: (after) => `events?${after}`,
    kinds: ["task_done"],
    take: (event) => taken.push(event.id),
    opened: () => undefined,
    broke: (tries) => broken.push(tries),
    ends: true,
  });
  const breaks = async () => {
    made.at(-1).onerror();
    t.mock.timers.tick(4_000);
    await new Promise(setImmediate);
  };
  stream.connect();
  for (const id of [3, 4, 4, 2]) made[0].say(id);
  await breaks();
  // An error status closes it for good in a browser; it is opened anew all the same.
  await breaks();
  made.at(-1).onopen();
  await breaks();
  assert.deepEqual(
    [taken, broken],
    [
      [3, 4],
      [0, 1, 0],
    ],
  );
  assert.deepEqual(
    made.map((source) => source.address),
    ["events?null", "events?4", "events?4", "events?4"],
  );
  status = 204;
  await breaks();
  assert.deepEqual([made.length, made.at(-1).readyState], [4, Source.CLOSED]);
});
