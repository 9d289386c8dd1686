// A farm of 5,000 nodes and 2,000 open jobs, one of 10,000 frames. Its documents are made here, in the place of
// a service: only the page is tested. Times are printed, not asserted.

import assert from "node:assert/strict";
import fs from "node:fs";
import http from "node:http";
import path from "node:path";
import test from "node:test";
import { launch, noFaults, visitor } from "./browser.mjs";
import { root, until } from "./farm.mjs";
import { drawn, frames, memory, scrollChart, scrollTonight, zoomChart } from "./measure.mjs";

const NODES = 5_000;
const JOBS = 2_000;
const FRAMES = 10_000;
const HOUR = 3_600_000;
const now = Date.now();
const iso = (at) => new Date(at).toISOString();
const id = (number) => `01a20000-0000-7000-8000-${String(number).padStart(12, "0")}`;
/** Numbers that look random and are the same in each run. */
const spread = (number) => ((number * 2_654_435_761) >>> 0) / 2 ** 32;

const jobs = Array.from({ length: JOBS }, (_, at) => {
  const end = now + spread(at) * 14 * HOUR;
  const kept = at >= 8;
  return {
    id: id(at),
    name: `sh${String(10 * at).padStart(5, "0")}_lighting_v${at % 30}`,
    project: ["film", "shorts"][at % 2],
    state: "rendering",
    frames_total: at === 0 ? FRAMES : 100,
    frames_done: 40,
    progress: 0.4,
    deadline: iso(end + (kept ? HOUR : -HOUR)),
    eta: iso(end),
    verdict: kept ? "on_time" : "late",
    finish: { p50: iso(end), p80: iso(end + HOUR / 4), p95: iso(end + HOUR / 2) },
    promise: { kept, probability: kept ? 0.97 : 0.2, since: iso(now), finish: iso(end) },
    cost: { mean: 4e6, p50: 4e6, p80: 5e6, p95: 6e6 },
    booked_cost: 5e6,
    budget: 9e6,
  };
});

const counts = {
  idle: 1_000,
  working: 3_950,
  pausing: 0,
  paused: 0,
  draining: 25,
  drained: 0,
  set_aside: 25,
  silent: 0,
  asleep: 0,
};
const dashboard = {
  at: iso(now),
  last_event_id: 1,
  jobs: jobs.slice(0, 200),
  jobs_open_total: JOBS,
  nodes: [],
  bookings: [],
  events: [],
  node_counts: counts,
  spending: [],
  finish: jobs[5].finish,
  track_frames: 0,
  track_work_hits: { p50: 0, p80: 0, p95: 0 },
  counts: {
    jobs: {
      previewing: 0,
      profiling: 0,
      quoted: 0,
      booked: 0,
      rendering: JOBS,
      done: 0,
      failed: 0,
      cancelled: 0,
    },
    jobs_active: JOBS,
    jobs_done: 0,
    jobs_failed: 0,
    jobs_cancelled: 0,
    nodes: NODES,
    nodes_alive: NODES,
    tasks: { waiting: 0, ready: 0, leased: 0, done: 0, failed: 0, cancelled: 0 },
  },
};

function job(at) {
  return {
    ...jobs[at],
    verdict: null,
    bundle: { id: id(1) },
    confidence: "p80",
    created_at: iso(now),
    frames: `0-${FRAMES - 1}`,
    scene: {
      digest: "",
      name: "seq",
      frames: FRAMES,
      width: 1920,
      height: 1080,
      objects: 1,
      materials: 1,
      triangles: 1,
    },
    settings: { width: 1920, height: 1080, spp: 64 },
    samples: 256,
    priority: 0,
    live: null,
    plan_id: id(9),
  };
}

function strip() {
  const places = Array.from({ length: FRAMES }, (_, at) => at);
  const p50 = places.map((at) => Math.round(400 + 80 * Math.sin(at / 300)) / 10);
  return {
    job_id: id(0),
    quantity: "cpu_seconds",
    frames: `0-${FRAMES - 1}`,
    p50,
    p80: p50.map((value) => value * 1.1),
    p95: p50.map((value) => value * 1.2),
    states: places.map((at) => (at < 6_000 ? "d" : at < 6_050 ? "r" : "b")).join(""),
    actual: p50.map((value, at) => (at < 6_000 ? value * (0.9 + 0.2 * spread(at)) : null)),
  };
}

function page(items, query, size) {
  const from = Number(query.get("page_token") ?? 0);
  return {
    items: items(from, size),
    ...(from + size < NODES ? { next_page_token: String(from + size) } : {}),
  };
}

function timeline(query) {
  const node = (at) => ({
    node_id: id(at),
    name: `rack-${String(at).padStart(4, "0")}`,
    state: "working",
    speed: 1,
    price_per_hour: 400_000,
    spans: Array.from({ length: 24 }, (_, span) => {
      const start = now + (span - 12) * HOUR * (0.8 + 0.2 * spread(at));
      const kind = span < 12 ? "past" : span === 12 ? "running" : "booked";
      return {
        job_id: id((at * 7 + span) % 300),
        frames: "3-9",
        kind,
        start: iso(start),
        end: iso(start + 0.7 * HOUR),
      };
    }),
  });
  const items = (from, size) =>
    Array.from({ length: Math.min(size, NODES - from) }, (_, at) => node(from + at));
  return {
    ...page(items, query, Number(query.get("page_size"))),
    jobs: jobs.slice(0, 300).map(({ id, name }) => ({ id, name })),
  };
}

const answers = {
  "/v1/sessions/current": () => ({ role: "viewer", name: "test" }),
  "/v1/dashboard": () => dashboard,
  "/v1/jobs": (query) => {
    const from = Number(query.get("page_token") ?? 0);
    const items = Array.from({ length: Math.min(100, JOBS - from) }, (_, at) => job(from + at));
    return { items, ...(from + 100 < JOBS ? { next_page_token: String(from + 100) } : {}) };
  },
  "/v1/timeline": timeline,
  "/v1/plans": () => ({ items: [] }),
  [`/v1/jobs/${id(0)}`]: () => job(0),
  [`/v1/jobs/${id(0)}/strip`]: strip,
};

/** Serves the built page and the documents. */
async function serve() {
  const types = {
    ".html": "text/html",
    ".js": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
  };
  const server = http.createServer((request, response) => {
    const url = new URL(request.url, "http://127.0.0.1");
    const answer = answers[url.pathname];
    const file = path.join(
      root,
      "services/dashboard/dist",
      url.pathname === "/" ? "index.html" : url.pathname,
    );
    if (answer)
      response.setHeader("Content-Type", "application/json").end(JSON.stringify(answer(url.searchParams)));
    else if (url.pathname.startsWith("/v1/") || !fs.existsSync(file)) response.writeHead(404).end();
    else response.setHeader("Content-Type", types[path.extname(file)]).end(fs.readFileSync(file));
  });
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  return server;
}

test("a large farm is shown by few elements, in little memory", { timeout: 480_000 }, async (t) => {
  const server = await serve();
  const browser = await launch();
  t.after(async () => {
    await browser.close();
    server.close();
  });
  const address = `http://127.0.0.1:${server.address().port}`;
  const view = await visitor(browser);
  const tell = (what, times) => t.diagnostic(`${what}: ${frames(times)}`);
  const elements = (selector) => view.locator(selector).count();

  await view.goto(`${address}/#/tonight`);
  await view.locator(".job-row .name").first().waitFor();
  const begun = await view.evaluate(
    () => performance.getEntriesByName("first-contentful-paint")[0].startTime,
  );
  t.diagnostic(`first paint of content after ${begun.toFixed(0)} ms`);
  tell("scrolling Tonight", await scrollTonight(view));
  assert.ok((await elements(".job-row")) < 80, "rows out of view are not in the document");
  await until("the last job is reached by scrolling", async () => {
    await view.evaluate(() => scrollTo(0, document.documentElement.scrollHeight));
    return (await elements(`.job-row:has-text("sh${10 * (JOBS - 1)}")`)) > 0;
  });
  assert.ok((await elements(".job-row")) < 80, "nor are they at the end of the list");

  await view.goto(`${address}/#/farm`);
  await view.locator(".gantt-name").first().waitFor();
  tell("scrolling the chart", await scrollChart(view));
  assert.ok((await elements(".gantt-name")) < 80, "nodes out of view are not in the document");
  tell("zooming the chart", await zoomChart(view));

  await view.goto(`${address}/#/jobs/${id(0)}`);
  const cells = view.locator(".strip");
  await cells.waitFor();
  assert.equal(await cells.getAttribute("aria-valuemax"), String(FRAMES - 1));
  const box = await cells.boundingBox();
  tell(
    "selecting frames",
    await drawn(view, async () => {
      await view.mouse.move(box.x + 40, box.y + 20);
      await view.mouse.down();
      await view.mouse.move(box.x + box.width / 2, box.y + box.height / 2, { steps: 40 });
      await view.mouse.up();
    }),
  );
  assert.match(new URL(view.url().replace("#/", "")).searchParams.get("sel"), /^\d+-\d+$/);

  const kept = await memory(view);
  t.diagnostic(`memory of the tab: ${(kept / 1e6).toFixed(0)} MB`);
  assert.ok(kept < 150e6, `${kept} bytes`);
  noFaults(view);
});
