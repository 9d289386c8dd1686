// What the pointer shows is told to people without one, and a link shows somebody else the same.

import assert from "node:assert/strict";
import test from "node:test";
import { farmAndPage, inspect, noFaults, screens, show, sibling } from "./browser.mjs";
import { steps, until, WORKERS } from "./farm.mjs";

test("without a pointer", { timeout: 480_000 }, async (t) => {
  const { farm, page } = await farmAndPage(t);
  const step = steps(t);
  let job;

  await step("signs in beside a small job that is done", async () => {
    await farm.start("farm", ...WORKERS);
    job = await farm.submit(
      "kitchen",
      ...["--name", "kitchen", "--frames", "0-1", "--width", "48", "--spp", "2"],
    );
    await page.goto(await farm.link());
    await page.locator(".tonight").waitFor();
    await until("the job is done", async () => (await farm.get(`/v1/jobs/${job}`)).state === "done");
  });

  await step("keys move a crosshair over the image, which names object, material and cost", async () => {
    await show(page, farm.address, screens(job).job);
    await page.locator(".under-pointer", { hasText: "Point at the image" }).waitFor();
    await page.locator(".compare").focus();
    await page.keyboard.press("Shift+ArrowRight");
    const told = page.locator(".under-pointer");
    await told.getByText(/Pixel 24, \d+: \w+ · .* of the frame’s work/).waitFor();
    await page.keyboard.press("Shift+ArrowRight");
    await told.getByText(/Pixel 25, \d+/).waitFor();
    await inspect(page, "crosshair");
  });

  await step("keys go from node to node on the farm's chart, and hold a span", async () => {
    await show(page, farm.address, screens(null).farm);
    await page.getByRole("button", { name: "node-2" }).waitFor();
    await page.locator(".gantt").focus();
    const told = page.locator(".chart-readout");
    await page.keyboard.press("Shift+ArrowRight");
    await told.getByText(/^node-1:/).waitFor();
    await page.keyboard.press("Shift+ArrowDown");
    await told.getByText(/^node-2: kitchen, frames? .*, past/).waitFor();
    await page.keyboard.press("Enter");
    await told.getByRole("button", { name: "Let go" }).waitFor();
    await inspect(page, "chart-cursor");
  });

  await step("a link shows the held span, and zoom, place, slider and crosshair of an image", async () => {
    await until("the address has the span", () => page.url().includes("pin="));
    const chart = page.url();
    await show(page, farm.address, screens(job).job);
    await page.locator(".under-pointer", { hasText: "Point at the image" }).waitFor();
    await page.getByLabel("Where the left image ends").fill("30");
    await page.locator(".compare").focus();
    for (const key of ["Shift+ArrowUp", "+", "+", "ArrowLeft"]) await page.keyboard.press(key);
    await until("the address has all of it", () =>
      ["wipe=30", "zoom=", "pixel=24_"].every((part) => page.url().includes(part)),
    );
    const seen = (tab) =>
      tab
        .locator(".compare img")
        .last()
        .evaluate((image) => [image.style.transform, image.style.clipPath]);
    const told = await page.locator(".under-pointer").textContent();
    const other = await sibling(page);
    await other.goto(page.url());
    await other.locator(".under-pointer").getByText(told).waitFor();
    assert.deepEqual(await seen(other), await seen(page));
    assert.equal(await other.getByLabel("Where the left image ends").inputValue(), "30");
    await other.goto(chart);
    await other
      .locator(".chart-readout")
      .getByText(/^node-2: kitchen/)
      .waitFor();
    noFaults(page);
  });

  await step("a table with the numbers opens behind each chart", async () => {
    const held = await farm.submit(
      "kitchen",
      ...["--name", "held", "--frames", "0-1", "--width", "48", "--spp", "2", "--hold"],
    );
    await until("the quote is ready", async () => (await farm.get(`/v1/jobs/${held}`)).state === "quoted");
    const { tonight, record, farm: chart, job: frames, "job-estimate": estimate } = screens(job);
    const places = { tonight, record, chart, frames, estimate, price: screens(held)["job-price"] };
    const opened = [];
    for (const [place, screen] of Object.entries(places)) {
      await show(page, farm.address, screen);
      const tables = page.locator("details.behind", { hasText: "as a table" });
      await tables.first().waitFor();
      for (const table of await tables.all()) {
        const label = await table.locator("summary").textContent();
        if (!(await table.evaluate((details) => details.open))) await table.locator("summary").press("Enter");
        await table.locator("tbody tr, [aria-rowindex='2']").first().waitFor();
        opened.push(label.replace(", as a table", ""));
      }
      if (place === "frames") await inspect(page, "tables");
    }
    for (const chart of [
      "The chart",
      "Frames",
      "The estimate over time",
      "Price against deadline",
      "Reliability",
    ])
      assert.ok(opened.includes(chart), `${chart}: ${opened}`);
  });

  await step("a log is followed to its end, searched, and names its errors", async () => {
    const slow = await farm.submit(
      "kitchen",
      ...["--name", "slow", "--frames", "0", "--width", "128", "--spp", "32", "--samples", "16"],
    );
    // Beside other tests, its quote and its plan take their time.
    const job = () => farm.get(`/v1/jobs/${slow}`);
    await until("the frame is rendered", async () => (await job()).state === "rendering", 180);
    await show(page, farm.address, [`#/jobs/${slow}?tab=logs`, ".tabs"]);
    await page.getByText("followed live").waitFor();
    await page.locator(".job-title .mark", { hasText: "done" }).waitFor({ timeout: 120_000 });
    await page.getByText("followed live").waitFor({ state: "detached" });
    const lines = page.locator(".log-line");
    await lines.first().waitFor();
    const word = (await lines.first().textContent()).split(" ").pop();
    await page.getByLabel("Find").fill(word);
    await page.getByText(/^\d+ of \d+ lines?/).waitFor();
    await page.getByLabel("Find").fill("a word that no log has");
    await page.getByText("No line has these words.").waitFor();
    noFaults(page);
  });

  await step("nothing moves for who asked for less motion", async () => {
    const moving = () =>
      page.evaluate(() => {
        const waiting = Object.assign(document.createElement("p"), { className: "waiting" });
        document.body.append(waiting);
        const count = document.getAnimations().length;
        waiting.remove();
        return count;
      });
    await page.emulateMedia({ reducedMotion: "no-preference" });
    assert.equal(await moving(), 1);
    await page.emulateMedia({ reducedMotion: "reduce" });
    assert.equal(await moving(), 0);
  });

  await step("files of the page are kept for a year by their hashes, and compressed", async () => {
    const index = await (await fetch(`${farm.address}/`)).text();
    for (const [, file] of index.matchAll(/"\.\/(assets\/[^"]+\.(?:js|css))"/g)) {
      const answer = await fetch(`${farm.address}/${file}`);
      assert.match(answer.headers.get("cache-control"), /immutable, max-age=31536000/, file);
      assert.equal(answer.headers.get("content-encoding"), "gzip", file);
    }
    const again = await fetch(`${farm.address}/`);
    assert.equal(again.headers.get("cache-control"), "no-cache");
  });
});
