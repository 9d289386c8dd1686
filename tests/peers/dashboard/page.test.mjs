// What people do on the page, in Chromium, against a farm on this machine.

import assert from "node:assert/strict";
import fs from "node:fs";
import http from "node:http";
import path from "node:path";
import test from "node:test";
import { farmAndPage, inspect, inspectAll, noFaults, screens, show, sibling, visitor } from "./browser.mjs";
import { root, steps, until, WORKERS } from "./farm.mjs";

test("a working farm", { timeout: 480_000 }, async (t) => {
  const { folder, farm, browser, page } = await farmAndPage(t);
  let job;
  let held;
  let long;

  const step = steps(t);

  await step("signs in", async () => {
    await farm.start("farm", ...WORKERS);
    await page.goto(await farm.link());
    await page.locator(".tonight").waitFor();
  });

  await step("shows a quote of the kitchen before anything is booked, then books it", async () => {
    await show(page, farm.address, screens(null).submit);
    await page.locator("input[webkitdirectory]").setInputFiles(path.join(root, "deploy/scenes/kitchen"));
    await page.getByRole("heading", { name: "What do you want?" }).waitFor();
    await page.getByLabel("Frames").fill("5-1");
    await page.getByLabel("Width").fill("48");
    await page.getByLabel("Camera samples per pixel").fill("2");
    await page.getByLabel("Bounces").fill("1");
    await inspect(page, "submit-form");
    await page.getByRole("button", { name: "Get a quote" }).click();
    await page.getByText("ends before it starts").waitFor();
    await page.getByLabel("Frames").fill("0-5");
    await page.getByLabel("Name").fill("kitchen-night");
    await page.getByLabel("Budget").fill("5");
    await page.getByRole("button", { name: "Get a quote" }).click();
    await page.getByRole("button", { name: "Book it" }).waitFor();
    await page.getByText("Ready by").first().waitFor();
    job = new URL(page.url().replace("#/", "")).searchParams.get("job");
    assert.deepEqual(
      [(await farm.get(`/v1/jobs/${job}`)).state, (await farm.get("/v1/bookings")).items.length],
      ["quoted", 0],
    );
    await inspect(page, "quote");
    await page.getByRole("button", { name: "Book it" }).click();
    await page.locator(".job-top").waitFor();
  });

  await step("asks for the renderer of a Blender file, and says what its quote waits for", async () => {
    const scene = path.join(folder, "shot.blend");
    fs.writeFileSync(scene, "BLENDER-v500 and no more");
    const other = await sibling(page);
    await show(other, farm.address, screens(null).submit);
    await other.locator("input[accept]").setInputFiles(scene);
    await other.getByLabel("Renderer").waitFor();
    assert.equal(await other.getByLabel("Renderer").inputValue(), "cycles");
    await other.getByLabel("Renderer").fill("cycles 5.0");
    await other.getByRole("button", { name: "Get a quote" }).click();
    await other.getByText(/no node .* cycles 5\.0/).waitFor();
    await other.getByRole("button", { name: "Drop it" }).click();
    await other.getByText("It was dropped").waitFor();
    await other.close();
  });

  await step("follows the job to its end without being loaded anew", async () => {
    await page.locator(".job-title .mark", { hasText: "done" }).waitFor({ timeout: 60_000 });
    await page.getByText("6 of 6", { exact: true }).waitFor();
    await page.locator(".readout").getByText("6 done").waitFor();
    // Its quote is made during the next steps.
    held = hold(farm);
    const picture = page.locator(".compare img").last();
    await picture.waitFor();
    assert.ok((await picture.evaluate((image) => image.decode().then(() => image.naturalWidth))) === 48);
  });

  await step("names object and material under the pointer", async () => {
    const box = await page.locator(".compare").boundingBox();
    await page.locator(".compare").scrollIntoViewIfNeeded();
    await page.locator(".compare").hover({ position: { x: box.width * 0.6, y: box.height * 0.9 } });
    await page
      .locator(".under-pointer")
      .getByText(/Pixel \d+, \d+: \w+ · .* of the frame’s work/)
      .waitFor();
  });

  await step("renders a frame again", async () => {
    await page.getByLabel("Selected frames").fill("2");
    await page.getByText("Attempts").waitFor();
    const before = (await farm.get(`/v1/jobs/${job}/frames/2`)).attempts;
    await page.getByRole("button", { name: "Retry…" }).click();
    await inspect(page, "retry-question");
    await page.getByRole("button", { name: "Retry", exact: true }).click();
    await until("frame 2 is rendered again", async () => {
      const frame = await farm.get(`/v1/jobs/${job}/frames/2`);
      return frame.state === "done" && frame.attempts > before;
    });
    await page.locator(".job-title .mark", { hasText: "done" }).waitFor();
    noFaults(page);
  });

  await step("tells of a job that failed before its deadline, and offers to submit it again", async () => {
    await show(page, farm.address, screens(null).tonight);
    await page.getByText("No promise is at risk").waitFor();
    const broken = await failing(farm, job);
    await page.getByText("1 job failed, before the deadline").waitFor();
    await until("the title tells of it", async () => /1 at risk/.test(await page.title()));
    assert.match(await page.locator("#icon").getAttribute("href"), /risk/);
    await page.getByRole("link", { name: /1 job failed/ }).click();
    await page.locator(".job-row", { hasText: "broken" }).getByRole("link").click();
    await page.locator(".job-title .mark", { hasText: "failed" }).waitFor();
    const facts = await page.locator(".job-top .facts").innerText();
    assert.match(facts, /at risk/);
    assert.doesNotMatch(facts, /to spare|kept|took/);
    await page.getByLabel("Selected frames").fill("0-3,900");
    await page.getByText("1 frame", { exact: true }).waitFor();
    assert.equal(await page.getByRole("button", { name: "Retry…" }).count(), 0, "it was never booked");
    await inspect(page, "failed-job");
    await page.getByRole("link", { name: "Submit again…" }).click();
    await page.getByRole("heading", { name: "What do you want?" }).waitFor();
    assert.equal(await page.getByLabel("Name").inputValue(), "broken");
    await farm.ask("DELETE", `/v1/jobs/${broken}`);
    await show(page, farm.address, screens(null).tonight);
    await page.reload();
    await page.getByText("No promise is at risk").waitFor();
    noFaults(page);
  });

  await step("shows what events say without asking again", async () => {
    await show(page, farm.address, screens(null).tonight);
    await page.route("**/v1/dashboard", (route) => route.abort());
    const small = ["--frames", "0", "--width", "16", "--spp", "1", "--samples", "16"];
    const quoted = await farm.submit("corridor", "--name", "told-by-events", "--hold", ...small);
    const row = page.locator(".job-row", { hasText: "told-by-events" });
    await row.getByText("quoted").waitFor({ timeout: 120_000 });
    await page.unroute("**/v1/dashboard");
    await farm.ask("POST", `/v1/jobs/${quoted}/cancel`);
    await row.waitFor({ state: "detached" });
  });

  await step("drains a node; a promise is at risk then, and the page takes the rescue", async () => {
    long = await risky(farm, await held);
    await show(page, farm.address, screens(null).nodes);
    await page.getByRole("button", { name: "Drain: node-2" }).click();
    await page.locator(".node-row", { hasText: "node-2" }).getByText(/drain/i).first().waitFor();
    await until(
      "node-2 drains",
      async () => (await farm.get("/v1/nodes")).items.find((node) => node.name === "node-2").drain,
    );
    await show(page, farm.address, screens(null).tonight);
    await page.getByText("1 promise at risk").waitFor({ timeout: 60_000 });
    assert.match(await page.title(), /1 at risk/);
    assert.match(await page.locator("#icon").getAttribute("href"), /risk/);
    await inspect(page, "promise-at-risk");
    const before = (await farm.get(`/v1/jobs/${long}`)).deadline;
    await rescue(page);
    await until("the deadline is later", async () => (await farm.get(`/v1/jobs/${long}`)).deadline > before);
    // Whether that is enough depends on how busy this machine is.
  });

  await step("shows a working farm on every screen", async () => {
    const budget = { project: "film", amount: 20_000, period: "night", zone: "Europe/Berlin" };
    await farm.ask("POST", "/v1/budgets", budget);
    await inspectAll(page, farm.address, screens(job), "working");
    noFaults(page);
  });

  await step("makes and revokes a token, and tells a webhook", async () => {
    const told = [];
    const receiver = http.createServer((request, response) => {
      let body = "";
      request.on("data", (part) => (body += part));
      request.on("end", () => (told.push(JSON.parse(body)), response.writeHead(204).end()));
    });
    await new Promise((done) => receiver.listen(0, "127.0.0.1", done));
    t.after(() => receiver.close());
    await show(page, farm.address, screens(null).tokens);
    await page.getByRole("button", { name: "Make a token" }).click();
    await page.getByLabel("Name of the person or program").fill("anna");
    await page.getByRole("button", { name: "Make it" }).click();
    const token = (await page.locator(".secret").textContent()).trim();
    const asAnna = () =>
      fetch(`${farm.address}/v1/dashboard`, { headers: { Authorization: `Bearer ${token}` } });
    assert.equal((await asAnna()).status, 200);
    await page.getByRole("button", { name: "I have kept it" }).click();
    await page.getByRole("button", { name: "Revoke: anna" }).click();
    await inspect(page, "revoke-question");
    await page.getByRole("button", { name: "Revoke it" }).click();
    await page.getByRole("button", { name: "Revoke: anna" }).waitFor({ state: "detached" });
    assert.equal((await asAnna()).status, 401);

    await show(page, farm.address, screens(null).webhooks);
    await page.getByRole("button", { name: "Add a webhook" }).click();
    await page.getByLabel("Address of the receiver").fill(`http://127.0.0.1:${receiver.address().port}/`);
    await page.getByRole("button", { name: "Add it" }).click();
    await page.getByRole("button", { name: "I have kept it" }).click();
    await page.getByRole("button", { name: "Send a test" }).click();
    await page.getByText("delivered").first().waitFor();
    // The farm goes on meanwhile, and tells of promises too.
    const tests = told.filter(({ text }) => text.startsWith("a test"));
    assert.deepEqual(tests, [{ text: "a test: this webhook of forelight works" }]);

    await show(page, farm.address, screens(null).kept);
    await page.getByRole("button", { name: "Change: logs", exact: true }).click();
    await page.getByLabel("Days").fill("12");
    await page.getByRole("button", { name: "Set it" }).click();
    await page.getByRole("cell", { name: "12 days" }).waitFor();
    await page.getByRole("button", { name: "What would be deleted now?" }).click();
    await page.getByText(/Now it would delete/).waitFor();

    await show(page, farm.address, screens(null).audit);
    await page.getByRole("cell", { name: "token revoked" }).first().waitFor();
    await page.getByRole("cell", { name: "retention set" }).first().waitFor();
    const submitted = page.getByRole("row", { name: /job submitted.*kitchen-night/ });
    await submitted.getByRole("button", { name: "job submitted" }).press("Enter");
    await page.getByRole("cell", { name: "frames: 0-5" }).waitFor();
    await inspect(page, "audit-entry");
    await submitted.getByRole("link", { name: "kitchen-night" }).click();
    await page.getByRole("heading", { name: "kitchen-night" }).waitFor();
    noFaults(page);
  });

  await step("clears title and icon when no promise is at risk any more", async () => {
    await show(page, farm.address, screens(null).tonight);
    await farm.ask("POST", `/v1/jobs/${long}/cancel`);
    await page.getByText("No promise is at risk").waitFor();
    await until("the title is clear", async () => !/at risk/.test(await page.title()));
    assert.doesNotMatch(await page.locator("#icon").getAttribute("href"), /risk/);
  });

  await step("shows every screen after the service was killed and came back", async () => {
    await farm.kill();
    await farm.start("farm", ...WORKERS);
    await inspectAll(page, farm.address, screens(job), "restarted");
    await page.locator(".connection.live").waitFor();
    noFaults(page);
  });

  await step("offers a viewer nothing that would be refused, and shows any name as text", async () => {
    const name = '<img src=x onerror="document.title=1"> \u202egnp.exe ' + "w".repeat(120);
    await farm.submit(
      "corridor",
      "--name",
      name,
      "--frames",
      "0",
      "--width",
      "16",
      "--spp",
      "1",
      "--samples",
      "16",
    );
    const viewer = await visitor(browser);
    await viewer.goto(await farm.link("viewer"));
    await viewer.locator(".tonight").waitFor();
    await viewer.getByText("<img src=x onerror=").first().waitFor();
    const over = await viewer.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.ok(over <= 0, `a long name makes the page ${over} pixels too wide`);
    await show(viewer, farm.address, screens(job).job);
    assert.equal(await viewer.getByRole("button", { name: /Cancel|Change|Retry/ }).count(), 0);
    await show(viewer, farm.address, screens(job).nodes);
    assert.equal(await viewer.getByRole("button", { name: /Drain|Pause|Add a node/ }).count(), 0);
    assert.equal(await viewer.getByRole("link", { name: "Settings" }).count(), 0);
    for (const screen of ["submit", "settings"]) {
      await viewer.goto(`${farm.address}/#/${screen}`);
      await viewer.getByRole("heading", { name: new RegExp(screen, "i") }).waitFor();
      await viewer.getByText("Your role is viewer").waitFor();
    }
    noFaults(viewer);
    await viewer.context().close();
  });

  await step("says so when a session is over, and signs out", async () => {
    const other = await visitor(browser);
    await other.goto(await farm.link());
    await other.locator(".tonight").waitFor();
    await other.context().clearCookies();
    await other.goto(`${farm.address}/#/record`);
    await other.getByText("Your session is over").waitFor();
    await other.context().close();
    await page.getByRole("button", { name: "Sign out" }).click();
    await page.getByLabel("Token or link").waitFor();
    const answer = await page.request.get(`${farm.address}/v1/dashboard`);
    assert.equal(answer.status(), 401);
  });
});

/** A long job on hold, once it is quoted. Returns its id. */
async function hold(farm) {
  const id = await farm.submit(
    "kitchen",
    "--name",
    "hero-shot",
    "--frames",
    "0-47",
    "--width",
    "96",
    "--spp",
    "24",
    "--ambient-bounces",
    "1",
    "--hold",
    "--project",
    "film",
  );
  await until("the long job is quoted", async () => (await farm.get(`/v1/jobs/${id}`)).state === "quoted");
  return id;
}

/** Submits a frame of a job again, with a limit that no task keeps. Returns its id. */
async function failing(farm, job) {
  const { bundle, settings } = await farm.get(`/v1/jobs/${job}`);
  const deadline = new Date(Date.now() + 3_600_000).toISOString();
  const terms = { name: "broken", frames: "0", samples: 16, limits: { wall_ms: 1 }, deadline };
  return (await farm.ask("POST", "/v1/jobs", { bundle, settings, ...terms })).id;
}

/** Accepts a job that two nodes finish well before its deadline, and one does not. Returns its id. */
async function risky(farm, id) {
  const { outlook, at } = await farm.get(`/v1/jobs/${id}/answers`);
  const finish = Date.parse(outlook.find((line) => line.confidence === "p95").finish);
  const length = finish - Date.parse(at);
  await farm.ask("POST", `/v1/jobs/${id}/accept`, {
    deadline: new Date(Date.now() + length * 1.35).toISOString(),
  });
  await until("it is booked in time", async () => (await farm.get(`/v1/jobs/${id}`)).promise?.kept);
  return id;
}

/** Takes the rescue that moves the deadline. */
async function rescue(page) {
  await page.getByRole("button", { name: /Look (at the rescue|for a way out)/ }).click();
  const act = page.getByRole("button", { name: "Make this change" });
  const again = page.getByRole("button", { name: "Ask for ways out again" });
  await until("a later deadline is kept", async () => {
    await page.locator(".ways label", { hasText: "The deadline" }).first().click();
    await page.getByText("Cost of all jobs").waitFor();
    await until("the planner has answered", async () => (await act.isEnabled()) || (await again.count()) > 0);
    if (await act.isEnabled()) return true;
    // The farm went on since the plan that found it.
    await again.click();
    return false;
  });
  await inspect(page, "rescue-question");
  await act.click();
  await page.locator("dialog").waitFor({ state: "detached" });
}
