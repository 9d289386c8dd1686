// How long a job of a large farm waits for its new plan: `tests/farm_size.sh` runs it. Everything is printed,
// and nothing is asserted.
//
//   node plans.mjs ADDRESS DATA

import fs from "node:fs";

const [address, data] = process.argv.slice(2);
const token = fs.readFileSync(`${data}/tokens/operator.token`, "utf8").trim();
const TURNS = 4;
/** After a plan, the service rests four times as long as it took. */
const RESTS = 5;
const LONGEST = 60_000;
const DAY = 86_400_000;

async function ask(path, change) {
  const headers = { authorization: `Bearer ${token}`, "content-type": "application/json" };
  const method = change ? "PATCH" : "GET";
  const answer = await fetch(`${address}${path}`, { method, headers, body: JSON.stringify(change) });
  if (!answer.ok) throw new Error(`${method} ${path}: ${answer.status} ${await answer.text()}`);
  return await answer.json();
}

const pause = (ms) => new Promise((done) => setTimeout(done, ms));

const jobs = (await ask(`/v1/jobs?open=true&sort=risk&page_size=${TURNS}`)).items;
const plans = [];
const others = [];
let rest = 10_000;
for (const [turn, job] of jobs.entries()) {
  await pause(rest);
  const planned = async () => (await ask(`/v1/jobs/${job.id}`)).plan_id;
  const before = await planned();
  const begun = performance.now();
  await ask(`/v1/jobs/${job.id}`, { deadline: new Date(Date.now() + (turn + 2) * DAY).toISOString() });
  for (let now = before; now === before; await pause(25)) {
    const asked = performance.now();
    if (asked - begun > LONGEST) throw new Error(`no new plan for ${job.name}`);
    now = await planned();
    others.push(performance.now() - asked);
  }
  const took = performance.now() - begun;
  rest = RESTS * took;
  plans.push(`${(took / 1e3).toFixed(1)} s`);
}
others.sort((a, b) => a - b);
const [median, longest] = [others[Math.floor(others.length / 2)], others[others.length - 1]];
console.log(`a job gets a new deadline; the new plan is there after ${plans.join(", ")}`);
console.log(
  `${others.length} requests meanwhile: median ${median.toFixed(0)} ms, longest ${longest.toFixed(0)} ms`,
);
