// The page on a farm of thousands of nodes, in Chromium, against the service: `tests/farm_size.sh` runs it.
// Everything is printed, and nothing is asserted.
//
//   node size.mjs ADDRESS DATA

import { execFileSync } from "node:child_process";
import fs from "node:fs";
import { launch, visitor } from "./browser.mjs";
import { drawn, frames, memory, scrollChart, scrollTonight, zoomChart } from "./measure.mjs";

const [address, data] = process.argv.slice(2);
const tell = (what, value) => console.log(`${what.padEnd(48)} ${value}`);

/** A link that signs in once. */
function link() {
  const token = `${data}/tokens/viewer.token`;
  const args = ["dashboard", "--print", "--server", address, "--token-file", token];
  return execFileSync(process.env.FORELIGHT_DASHBOARD_BIN, args, { encoding: "utf8" })
    .trim()
    .split("\n")
    .pop();
}

/** Loads a screen anew, and returns when its content was painted, milliseconds after the load began. */
async function painted(view, hash, content) {
  await view.goto("about:blank");
  await view.goto(`${address}/${hash}`, { waitUntil: "commit" });
  return await view.evaluate(
    (content) =>
      new Promise((done) => {
        const look = () => {
          if (!document.querySelector(content)) return requestAnimationFrame(look);
          requestAnimationFrame(() => setTimeout(() => done(performance.now())));
        };
        look();
      }),
    content,
  );
}

const browser = await launch();
const view = await visitor(browser);
const session = await view.context().newCDPSession(view);
await session.send("Network.enable");
const asked = new Map();
session.on("Network.responseReceived", ({ requestId, response, type }) =>
  asked.set(requestId, { url: new URL(response.url), type }),
);
/** The largest document of each path: bytes as sent, and how long it took. */
const documents = new Map();
const begun = new Map();
session.on("Network.requestWillBeSent", ({ requestId, timestamp }) => begun.set(requestId, timestamp));
session.on("Network.loadingFinished", ({ requestId, encodedDataLength, timestamp }) => {
  const { url, type } = asked.get(requestId) ?? {};
  if (!url?.pathname.startsWith("/v1/") || type === "EventSource") return;
  const path = url.pathname.replace(/[0-9a-f-]{36}/, "{id}");
  const before = documents.get(path) ?? { bytes: 0, ms: [] };
  before.bytes = Math.max(before.bytes, encodedDataLength);
  before.ms.push(1e3 * (timestamp - begun.get(requestId)));
  documents.set(path, before);
});

await view.goto(link());
await view.locator(".job-row .name").first().waitFor();
for (const [name, hash, content] of [
  ["Tonight", "#/tonight", ".job-row .name"],
  ["Farm", "#/farm", ".gantt-name"],
]) {
  const times = [];
  for (let turn = 0; turn < 5; turn++) times.push(await painted(view, hash, content));
  tell(`${name}: content is painted after`, times.map((time) => `${time.toFixed(0)} ms`).join(", "));
}

await painted(view, "#/tonight", ".job-row .name");
tell("Tonight, watched for 10 s", frames(await drawn(view, () => view.waitForTimeout(10_000))));
tell("Tonight, scrolled", frames(await scrollTonight(view)));
tell("Tonight, memory of the tab", `${((await memory(view)) / 1e6).toFixed(0)} MB`);
await painted(view, "#/farm", ".gantt-name");
tell("Farm, watched for 10 s", frames(await drawn(view, () => view.waitForTimeout(10_000))));
for (let turn = 0; turn < 3; turn++) {
  tell("Farm, scrolled", frames(await scrollChart(view)));
  tell("Farm, zoomed", frames(await zoomChart(view)));
}
tell("Farm, memory of the tab", `${((await memory(view)) / 1e6).toFixed(0)} MB`);
await painted(view, "#/farm?view=list", ".node-table .node-row");
tell("Nodes, scrolled", frames(await scrollTonight(view)));
await view.waitForTimeout(30_000);
tell("After a while, memory of the tab", `${((await memory(view)) / 1e6).toFixed(0)} MB`);

for (const [path, { bytes, ms }] of [...documents].sort()) {
  ms.sort((a, b) => a - b);
  const [median, longest] = [ms[Math.floor(ms.length / 2)], ms[ms.length - 1]];
  const size = `${(bytes / 1024).toFixed(1)} KiB`.padStart(10);
  tell(
    `GET ${path}`,
    `${size}, ${ms.length} times, median ${median.toFixed(0)} ms, longest ${longest.toFixed(0)} ms`,
  );
}
if (view.faults.length) tell("faults", view.faults.join("; "));
await browser.close();
