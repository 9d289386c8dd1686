// What people do to jobs, nodes and settings on the page, in Chromium, against a farm on this machine. Each
// act is checked through the API, and each question that the page asks with axe.

import assert from "node:assert/strict";
import fs from "node:fs";
import net from "node:net";
import path from "node:path";
import { createRequire } from "node:module";
import test from "node:test";
import { farmAndPage, inspect, noFaults, screens, show, sibling } from "./browser.mjs";
import { root, steps, until, WORKERS } from "./farm.mjs";

const { unzipSync } = createRequire(path.join(root, "services/dashboard/package.json"))("fflate");
const kitchen = path.join(root, "deploy/scenes/kitchen");
const ZONE = "Europe/Berlin";
const HOUR = 3_600_000;

test("what people do on a farm", { timeout: 480_000 }, async (t) => {
  const { farm, page } = await farmAndPage(t);
  const step = steps(t);
  const job = (id) => farm.get(`/v1/jobs/${id}`);
  const node = async (name) => (await farm.get("/v1/nodes")).items.find((one) => one.name === name);
  const dialog = page.locator("dialog");
  const press = (name, where = page) => where.getByRole("button", { name, exact: true }).click();
  const gone = () => dialog.waitFor({ state: "detached" });
  /** The job in the address of the Submit screen, once it is another one. */
  const quoted = async (before = null) => {
    const id = await until("another job is quoted", () => {
      const now = new URL(page.url().replace("#/", "")).searchParams.get("job");
      return now !== before && now;
    });
    await page.getByRole("button", { name: "Book it" }).waitFor();
    return id;
  };
  let small;
  let long;
  let finer;

  await step("takes a folder that is dropped, and quotes it again for a noise and with a budget", async () => {
    await farm.start("farm", ...WORKERS);
    long = await farm.submit("kitchen", ...SMALL, "--name", "long", "--frames", "0-11", "--hold");
    await page.goto(await farm.link());
    await page.locator(".tonight").waitFor();
    await show(page, farm.address, screens(null).submit);
    await drop(page, ".drop", kitchen);
    await page.getByRole("heading", { name: "What do you want?" }).waitFor();
    await page.getByLabel("Name").fill("small");
    await page.getByLabel("Frames").fill("0-3");
    await page.getByLabel("Width").fill("48");
    await page.getByLabel("Camera samples per pixel").fill("1");
    await page.getByLabel("Bounces").fill("0");
    await page.getByLabel("Make a video").check();
    await press("Get a quote");
    const first = await quoted();
    await press("Change it");
    await page.getByRole("heading", { name: "Change small" }).waitFor();
    await page.getByLabel("Budget").fill("1.25");
    await page.getByLabel("Noise at most").fill("40");
    await press("Get a quote");
    await page.getByText("from 4 camera samples on").waitFor();
    await page.getByLabel("Camera samples per pixel").fill("");
    await press("Get a quote");
    small = await quoted(first);
    await page.getByText("noise at most 40 %").waitFor();
    const { budget, bundle, error_target, state } = await job(small);
    assert.deepEqual([budget, state, (await job(first)).state], [1_250_000, "quoted", "cancelled"]);
    assert.equal(error_target.ppm, 400_000);
    const { scene } = await job(long);
    assert.equal((await job(small)).scene.digest, scene.digest, "all files of the folder arrived");
    assert.equal(bundle.id, (await job(first)).bundle.id);
    await press("Book it");
    await page.locator(".job-title .mark", { hasText: "done" }).waitFor();
  });

  await step("fetches selected frames as one zip file", async () => {
    await page.getByLabel("Selected frames").fill("1-2");
    await press("Fetch…");
    await page.getByRole("button", { name: /^EXR/ }).click();
    await inspect(page, "fetch-question");
    const [file] = await Promise.all([page.waitForEvent("download"), press("Fetch as one zip file")]);
    assert.equal(file.suggestedFilename(), "small.zip");
    const files = unzipSync(fs.readFileSync(await file.path()));
    assert.deepEqual(Object.keys(files), ["0001.exr", "0002.exr"]);
    for (const [name, bytes] of Object.entries(files)) {
      const place = `/v1/jobs/${small}/frames/${parseInt(name)}/image.exr`;
      const answer = await page.request.get(farm.address + place);
      assert.ok(Buffer.from(bytes).equals(await answer.body()), place);
    }
    await gone();
  });

  await step("plays the video of the frames, and has it made at another rate", async () => {
    await page.getByRole("link", { name: "Video", exact: true }).click();
    const video = page.locator("video");
    const shown = (seconds) =>
      until("the video can be played", () =>
        video.evaluate(
          (of, seconds) =>
            Math.abs(of.duration - seconds) < 0.001 &&
            of.readyState >= 2 && [of.videoWidth, of.videoHeight],
          seconds,
        ),
      );
    await video.waitFor();
    // Four frames at the scene's rate. An odd height is made even.
    assert.deepEqual(await shown(4 / 24), [48, 28]);
    await press("Make it again…");
    await dialog.getByLabel("Frames per second").fill("8");
    await inspect(page, "video-question");
    await press("Make it");
    await gone();
    assert.deepEqual(await shown(4 / 8), [48, 28]);
    await inspect(page, "job-video");
    const [file] = await Promise.all([
      page.waitForEvent("download"),
      page.getByRole("link", { name: "Save it as a file" }).click(),
    ]);
    assert.equal(file.suggestedFilename(), "small.mp4");
    await press("Delete the video…");
    await press("Delete the video");
    await gone();
    await page.getByText("No video is made of these frames.").waitFor();
    assert.equal((await job(small)).video, undefined);
  });

  await step("asks for a rung of the accuracy ladder as a new job", async () => {
    await until("the long job is quoted", async () => (await job(long)).state === "quoted");
    await show(page, farm.address, screens(long)["job-accuracy"]);
    await press("Submit…", page.getByRole("row", { name: /^4 spp/ }));
    await dialog.getByRole("checkbox").check();
    await inspect(page, "rung-question");
    await press("Get its quote");
    finer = await quoted();
    const [before, made] = [await job(long), await job(finer)];
    assert.deepEqual(made.settings, { ...before.settings, spp: 4 });
    assert.deepEqual([made.frames, made.bundle.id], [before.frames, before.bundle.id]);
    assert.deepEqual([made.state, before.state], ["quoted", "quoted"], "the other one is still there");
  });

  await step("gives a node a schedule", async () => {
    const quote = page.url();
    await show(page, farm.address, screens(null).farm);
    await page.getByRole("button", { name: /node-1/ }).click();
    await inspect(page, "node");
    await dialog.getByText("Price and schedule").click();
    await press("Change the schedule", dialog);
    // It sleeps now, so that what is booked stays booked.
    const [from, to] = [2, 11].map((hours) => berlin(Date.now() + hours * HOUR));
    await dialog.getByLabel("from", { exact: true }).fill(from);
    await dialog.getByLabel("to", { exact: true }).fill(to);
    await inspect(page, "node-schedule");
    await press("Set the schedule", dialog);
    await dialog.getByText(`Awake: every day ${from} to ${to} (Europe/Berlin)`).waitFor();
    const { schedule } = await node("node-1");
    assert.deepEqual(
      [schedule.zone, schedule.windows.map((one) => [one.from, one.until])],
      ["Europe/Berlin", [[from, to]]],
    );
    await farm.ask("PATCH", `/v1/nodes/${(await node("node-2")).id}`, { schedule });
    await press("Close", dialog);
    await gone();
    await page.goto(quote);
  });

  await step("books the rung in the place of the other job", async () => {
    // What is still read moves the button.
    for (const text of ["Reading the quote…", "Asking the planner…"]) {
      await page.getByText(text).waitFor({ state: "detached" });
    }
    await press("Book it");
    await page.locator(".job-top").waitFor();
    await until("it is booked instead", async () => {
      const [made, before] = [await job(finer), await job(long)];
      return made.state === "booked" && before.state === "cancelled";
    });
    assert.ok((await farm.get("/v1/bookings")).items.length > 0);
  });

  await step("cancels selected frames", async () => {
    await page.getByLabel("Selected frames").fill("8-11");
    await press("Cancel frames…");
    await inspect(page, "cancel-frames-question");
    await press("Cancel these frames");
    await gone();
    await page.locator(".readout").getByText("4 cancelled").waitFor();
    const frames = await Promise.all(
      [7, 8, 11].map((frame) => farm.get(`/v1/jobs/${finer}/frames/${frame}`)),
    );
    assert.deepEqual(
      frames.map((frame) => frame.state === "cancelled"),
      [false, true, true],
    );
  });

  await step("changes deadline and budget, and says what that would mean before it is done", async () => {
    await press("Change terms…");
    await dialog.getByRole("cell", { name: "P95" }).waitFor();
    // Before the nodes are awake.
    await dialog.getByLabel("Deadline").fill(minutes(Date.now() + HOUR));
    await dialog.getByText("late").first().waitFor();
    await inspect(page, "change-question-late");
    const later = Math.floor((Date.now() + 10 * HOUR) / 60_000) * 60_000;
    await dialog.getByLabel("Deadline").fill(minutes(later));
    await dialog.getByText("in time").first().waitFor();
    await dialog.getByLabel("Budget").fill("2,50");
    assert.deepEqual([(await job(finer)).deadline, (await job(finer)).budget], [null, null]);
    await dialog.getByLabel("Deadline").evaluate((field) => {
      field.value = "12026-11-30T06:00";
      field.dispatchEvent(new Event("input", { bubbles: true }));
    });
    await dialog.getByText("a year of four digits").waitFor();
    assert.equal(await dialog.getByRole("button", { name: "Change and plan anew" }).isEnabled(), false);
    await dialog.getByLabel("Deadline").fill(minutes(later));
    await press("Change and plan anew");
    await gone();
    const changed = await job(finer);
    assert.deepEqual([Date.parse(changed.deadline), changed.budget], [later, 2_500_000]);
    await page.locator(".facts").getByText("2.50").waitFor();
    await show(page, farm.address, screens(finer)["job-price"]);
    await inspect(page, "job-price");
  });

  await step("leaves alone what a colleague changes while the question is open", async () => {
    await press("Change terms…");
    await dialog.getByRole("cell", { name: "P95" }).waitFor();
    const deadline = new Date(Math.floor((Date.now() + 12 * HOUR) / 60_000) * 60_000).toISOString();
    await farm.ask("PATCH", `/v1/jobs/${finer}`, { deadline });
    await dialog.getByText("Somebody changed the job meanwhile").waitFor();
    await dialog.getByLabel("Budget").fill("3.00");
    await press("Change and plan anew");
    await gone();
    const changed = await job(finer);
    assert.deepEqual([Date.parse(changed.deadline), changed.budget], [Date.parse(deadline), 3_000_000]);
  });

  await step("pauses a job, and has it planned anew", async () => {
    await press("Pause…");
    await dialog.getByText("Its deadline is at risk until it is resumed").waitFor();
    await inspect(page, "pause-question");
    await press("Pause the job");
    await gone();
    const mark = page.locator(".job-top .mark", { hasText: "paused" });
    await mark.waitFor();
    await inspect(page, "job-paused");
    assert.equal((await job(finer)).paused, true);
    await until("it has no end", async () => (await job(finer)).eta == null);
    await press("Resume…");
    await press("Resume the job");
    await gone();
    await mark.waitFor({ state: "detached" });
    await until("it is planned anew", async () => {
      const { eta, paused, waits } = await job(finer);
      return !paused && eta != null && waits?.kind !== "paused";
    });
  });

  await step("tells of an order that failed after its question was closed", async () => {
    const answers = [];
    await page.route("**/cancel", (route) => answers.push(() => route.abort()));
    await press("Cancel job…");
    await press("Cancel the job");
    await dialog.getByText("You can close this. The request continues").waitFor();
    await page.keyboard.press("Escape");
    await gone();
    await press("Change terms…");
    await until("the order is under way", () => answers.length === 1);
    answers[0]();
    await page.locator(".failed-late", { hasText: "failed: The service does not answer" }).waitFor();
    await dialog.getByRole("heading", { name: /^Change/ }).waitFor();
    await page.unroute("**/cancel");
    // Selecting text and letting go beside the question is no wish to close it.
    const field = await dialog.getByLabel("Budget").boundingBox();
    await page.mouse.move(field.x + 40, field.y + 10);
    await page.mouse.down();
    await page.mouse.move(4, field.y + 10);
    await page.mouse.up();
    assert.equal(await dialog.count(), 1);
    await page.mouse.click(4, 4);
    await gone();
    await press("Dismiss");
  });

  await step("pauses a node, drains it, and takes it back", async () => {
    await show(page, farm.address, screens(null).farm);
    await page.getByRole("button", { name: /node-2/ }).click();
    const orders = [
      ["Pause", "pause", true],
      ["Resume", "pause", false],
      ["Drain", "drain", true],
      ["Back to work", "drain", false],
      ["Drain", "drain", true],
    ];
    for (const [name, order, given] of orders) {
      await dialog.getByRole("button", { name, exact: true }).press("Enter");
      await until(`${name} is done`, async () => (await node("node-2"))[order] === given);
      const isInside = await dialog.evaluate((box) => box.contains(document.activeElement));
      assert.ok(isInside, `the focus stays in the question after ${name}`);
    }
    await press("Close", dialog);
    await gone();
  });

  await step("plays what a new plan changed", async () => {
    const { plan_id: plan, frames } = await until("a plan moves frames", async () => {
      const [newest] = (await farm.get("/v1/plans")).items;
      const difference = await farm.get(`/v1/plans/${newest.id}/difference`);
      return difference.frames.length > 0 && difference;
    });
    await show(page, farm.address, [`#/farm?plan=${plan}`, ".plan-words"]);
    const chosen = page.locator(".plans select");
    await until("the plan of the address is chosen", async () => (await chosen.inputValue()) === plan);
    await inspect(page, "plan-difference");
    const picture = () => page.locator(".gantt canvas").evaluate((canvas) => canvas.toDataURL());
    const before = await picture();
    await page.getByRole("button", { name: `Play ${frames.length} moves` }).click();
    await until("the moves are drawn", async () => (await picture()) !== before);
    await page.getByRole("button", { name: `Play ${frames.length} moves` }).waitFor();
  });

  await step("cancels a job", async () => {
    await show(page, farm.address, screens(finer).job);
    await press("Cancel job…");
    await inspect(page, "cancel-question");
    await press("Cancel the job");
    await page.locator(".job-title .mark", { hasText: "cancelled" }).waitFor();
    assert.equal((await job(finer)).state, "cancelled");
    await page.getByLabel("Selected frames").fill("0");
    await page.getByRole("button", { name: "Clear" }).waitFor();
    assert.equal(await page.getByRole("button", { name: "Retry…" }).count(), 0, "it would be refused");
    noFaults(page);
  });

  await step("asks before it changes settings, in words that everybody can read", async () => {
    const inTabs = [questionsOfTokens, questionsOfWebhooks, questionsOfRetention, addingNodes].map(
      async (ask) => {
        const tab = await sibling(page);
        await ask(tab, farm);
        await tab.close();
      },
    );
    await Promise.all(inTabs);
    await show(page, farm.address, screens(null).keys);
    await inspect(page, "keys");
    noFaults(page);
  });

  await step("catches up by itself after the network was away", async () => {
    const line = await cable(t, farm.port);
    await show(page, line.address, screens(small).job);
    await page.locator(".connection.live").waitFor();
    line.cut();
    await page.locator(".connection.lost").waitFor();
    await farm.ask("POST", `/v1/jobs/${small}/frames/retry`, { frames: "1" });
    line.mend();
    await page.locator(".connection.live").waitFor();
    await page.locator(".readout").getByText("1 booked").waitFor();
    noFaults(page);
  });
});

/** Presses a button that opens a question, waits for it, and inspects it. */
async function asked(tab, button, name) {
  await tab.getByRole("button", { name: button }).first().click();
  await tab.locator("dialog").waitFor();
  await inspect(tab, name);
}

/** Presses a button of the question, and waits until it is gone or another one. */
async function answer(tab, button) {
  const title = await tab.locator("dialog h2").textContent();
  await tab.locator("dialog").getByRole("button", { name: button, exact: true }).click();
  await tab.getByRole("heading", { name: title, exact: true }).waitFor({ state: "detached" });
}

async function questionsOfTokens(tab, farm) {
  const names = async () => (await farm.get("/v1/tokens")).items.map((token) => token.name);
  await show(tab, farm.address, screens(null).tokens);
  await asked(tab, "Make a token…", "token-question");
  await tab.getByLabel("Name of the person or program").fill("berta");
  await answer(tab, "Make it");
  await inspect(tab, "secret");
  const secret = await tab.locator(".secret").textContent();
  await answer(tab, "I have kept it");
  assert.ok((await names()).includes("berta"));
  await asked(tab, "Replace: berta", "replace-question");
  await answer(tab, "Replace it");
  assert.notEqual(await tab.locator(".secret").textContent(), secret);
  const row = tab.locator(".set-row", { hasText: "berta" }).locator(".orders");
  const clipped = await row.evaluate((cell) => cell.scrollWidth - cell.clientWidth);
  assert.ok(clipped <= 0, `the orders to a token are ${clipped} pixels wider than their column`);
  const old = { headers: { Authorization: `Bearer ${secret.trim()}` } };
  assert.equal((await fetch(`${farm.address}/v1/dashboard`, old)).status, 401);
  await answer(tab, "I have kept it");
}

async function questionsOfWebhooks(tab, farm) {
  const hooks = async () => (await farm.get("/v1/webhooks")).items;
  await show(tab, farm.address, screens(null).webhooks);
  await asked(tab, "Add a webhook…", "webhook-question");
  await tab.getByLabel("Address of the receiver").fill("http://127.0.0.1:9/nobody");
  await tab.getByLabel("a job failed").uncheck();
  await answer(tab, "Add it");
  await inspect(tab, "webhook-secret");
  await answer(tab, "I have kept it");
  const [hook] = await hooks();
  assert.equal(hook.url, "http://127.0.0.1:9/nobody");
  assert.ok(hook.kinds.includes("job_done") && !hook.kinds.includes("job_failed"));
  await asked(tab, "Remove…", "remove-webhook-question");
  await answer(tab, "Remove it");
  assert.deepEqual(await hooks(), []);
}

async function questionsOfRetention(tab, farm) {
  const rule = async (kind, project) =>
    (await farm.get("/v1/retention")).items.find((one) => one.kind === kind && one.project === project)?.days;
  const plans = async () => (await farm.get("/v1/plans")).items.map((plan) => plan.id);
  const before = await plans();
  await show(tab, farm.address, screens(null).kept);
  await asked(tab, "Change: plans", "retention-question");
  await tab.getByLabel("Days").fill("0");
  await answer(tab, "Set it");
  await asked(tab, "A rule for a project…", "retention-of-project-question");
  await tab.getByRole("textbox", { name: "Project" }).fill("deafult");
  await tab.getByLabel("Days").fill("90");
  await tab.getByRole("button", { name: "Set it" }).click();
  await tab.getByText('there is no project "deafult"').waitFor();
  await tab.getByRole("textbox", { name: "Project" }).fill("default");
  await answer(tab, "Set it");
  assert.deepEqual([await rule("plans"), await rule("images", "default")], [0, 90]);
  await tab.getByRole("button", { name: "What would be deleted now?" }).click();
  await asked(tab, "Delete it now…", "delete-question");
  await answer(tab, "Delete it");
  const after = await plans();
  assert.ok(after.length < before.length, `${before.length} plans, then ${after.length}`);
  assert.equal(after[0], before[0], "the newest plan stays");
}

async function addingNodes(tab, farm) {
  await show(tab, farm.address, screens(null).farm);
  await asked(tab, "Add a node…", "add-node");
  await tab.getByLabel("Name of the machine").fill("rack-8");
  await tab.getByRole("button", { name: "Make its token" }).click();
  await tab.getByText("Then start the worker there").waitFor();
  await inspect(tab, "node-token");
  await answer(tab, "Done");
}

/** A way to a port of this machine that can be cut and mended, as a network that comes and goes. */
async function cable(t, port) {
  const open = new Set();
  let whole = true;
  const server = net.createServer((near) => {
    if (!whole) return near.destroy();
    const far = net.connect(port, "127.0.0.1");
    for (const [one, other] of [
      [near, far],
      [far, near],
    ]) {
      open.add(one);
      one.pipe(other);
      one.on("error", () => other.destroy());
      one.on("close", () => (open.delete(one), other.destroy()));
    }
  });
  const cut = () => {
    whole = false;
    for (const socket of open) socket.destroy();
  };
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  t.after(() => (cut(), server.close()));
  return { address: `http://127.0.0.1:${server.address().port}`, cut, mend: () => (whole = true) };
}

const SMALL = ["--width", "48", "--spp", "2", "--ambient-bounces", "1"];

/** The time of day at an instant, where the pages of the tests are. */
function berlin(at) {
  return new Date(at).toLocaleTimeString("en-GB", {
    timeZone: ZONE,
    hour: "2-digit",
    minute: "2-digit",
  });
}

/** An instant in the zone of the tests' pages, as a field takes it: `2026-03-01T20:30`. */
function minutes(at) {
  const day = new Date(at).toLocaleDateString("sv-SE", { timeZone: ZONE });
  return `${day}T${berlin(at)}`;
}

/** Drops a file or folder of this machine, as a file manager would. */
async function drop(page, selector, file) {
  const box = await page.locator(selector).boundingBox();
  const place = { x: box.x + box.width / 2, y: box.y + box.height / 2 };
  const data = { items: [], files: [file], dragOperationsMask: 1 };
  const session = await page.context().newCDPSession(page);
  for (const type of ["dragEnter", "dragOver", "drop"])
    await session.send("Input.dispatchDragEvent", { type, ...place, data });
  await session.detach();
}
