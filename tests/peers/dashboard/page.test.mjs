// What people do on the page, in Chromium, against a farm on this machine.

import assert from "node:assert/strict";
import fs from "node:fs";
import os from "node:os";
import path from "node:path";
import test from "node:test";
import {
  clearScreenshots,
  inspect,
  inspectAll,
  launch,
  noFaults,
  screens,
  show,
  visitor,
} from "./browser.mjs";
import { Farm, root, until } from "./farm.mjs";

const WORKERS = ["--workers", "2", "--threads", "1", "--preview", "cpu", "--price", "0.40"];

test("the page", { timeout: 240_000 }, async (t) => {
  const folder = fs.mkdtempSync(path.join(os.tmpdir(), "forelight-dashboard-"));
  const farm = new Farm(path.join(folder, "farm"));
  clearScreenshots();
  const browser = await launch();
  t.after(async () => {
    await browser.close();
    await farm.kill();
    fs.rmSync(folder, { recursive: true, force: true });
  });
  const page = await visitor(browser);
  let job;
  let long;

  // Each step goes on where the one before it ended.
  let broken = false;
  const step = (name, run) =>
    t.test(name, async (inner) => {
      if (broken) return inner.skip("a step before it failed");
      broken = true;
      await run();
      broken = false;
    });

  await step("refuses a wrong token in words, and signs in with a link that works once", async () => {
    await farm.start("serve");
    await page.goto(farm.address);
    await page.getByLabel("Token or link").fill("forelight_0000");
    await page.getByRole("button", { name: "Sign in" }).click();
    await page.getByText("The farm does not know this token").waitFor();
    await inspect(page, "sign-in", { phone: true });
    const link = await farm.link();
    await page.goto(link);
    await page.locator(".tonight").waitFor();
    assert.ok(!page.url().includes("code="), "the code leaves the address");
    const other = await visitor(browser);
    await other.goto(link);
    await other.getByText("This code was used already").waitFor();
    await other.context().close();
  });

  await step("explains an empty farm on every screen", async () => {
    await page.getByText("Three things to do first").waitFor();
    await inspectAll(page, farm.address, screens(null), "empty");
    noFaults(page);
  });

  await step("goes on by itself when the service was killed and came back", async () => {
    await show(page, farm.address, screens(null).tonight);
    await farm.kill();
    await page.locator(".connection.lost").waitFor();
    await farm.start("farm", ...WORKERS);
    await page.locator(".connection.live").waitFor();
    await page.getByText("done: 2").waitFor();
  });

  await step("shows a quote of the kitchen before anything is booked, then books it", async () => {
    await show(page, farm.address, screens(null).submit);
    await page.locator("input[webkitdirectory]").setInputFiles(path.join(root, "deploy/scenes/kitchen"));
    await page.getByRole("heading", { name: "What do you want?" }).waitFor();
    await page.getByLabel("Frames").fill("5-1");
    await page.getByLabel("Width").fill("48");
    await page.getByLabel("Camera samples per pixel").fill("2");
    await page.getByLabel("Bounces").fill("1");
    await inspect(page, "submit-form", { phone: true });
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
    await inspect(page, "quote", { phone: true });
    await page.getByRole("button", { name: "Book it" }).click();
    await page.locator(".job-top").waitFor();
  });

  await step("follows the job to its end without being loaded anew", async () => {
    await page.locator(".job-title .mark", { hasText: "done" }).waitFor({ timeout: 60_000 });
    await page.getByText("6 of 6", { exact: true }).waitFor();
    await page.locator(".readout").getByText("6 done").waitFor();
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

  await step("drains a node; a promise is at risk then, and the page takes the rescue", async () => {
    long = await risky(farm);
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
    await inspect(page, "promise-at-risk", { phone: true });
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
    const list = screens(job);
    await inspectAll(
      page,
      farm.address,
      { tonight: list.tonight, job: list.job, farm: list.farm, record: list.record, submit: list.submit },
      "restarted",
    );
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
    await viewer.goto(`${farm.address}/#/submit`);
    await viewer.getByText("Your role is viewer").waitFor();
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

/** A job that two nodes finish well before its deadline, and one does not. Returns its id. */
async function risky(farm) {
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
  await page.locator(".ways label", { hasText: "The deadline" }).first().click();
  await page.getByText("Cost of all jobs").waitFor();
  const act = page.getByRole("button", { name: "Make this change" });
  await until("the planner has answered", () => act.isEnabled());
  await inspect(page, "rescue-question");
  await act.click();
  await page.locator("dialog").waitFor({ state: "detached" });
}
