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
});
