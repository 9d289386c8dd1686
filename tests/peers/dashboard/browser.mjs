// Chromium with the page, rules of accessibility, and screenshots.

import assert from "node:assert/strict";
import fs from "node:fs";
import os from "node:os";
import path from "node:path";
import { createRequire } from "node:module";
import { chromium } from "playwright-core";
import { Farm, root } from "./farm.mjs";

const axe = fs.readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const shots = path.join(root, "target/dashboard-screenshots");
fs.mkdirSync(shots, { recursive: true });

export function launch() {
  return chromium.launch({ executablePath: process.env.CHROMIUM, args: ["--no-sandbox", "--disable-gpu"] });
}

/** A browser profile of its own, whose scripts' errors and refusals by the page's policy fail the test. */
export async function visitor(browser) {
  const context = await browser.newContext({
    viewport: { width: 1440, height: 900 },
    timezoneId: "Europe/Berlin",
    locale: "en-GB",
  });
  return await watched(await context.newPage(), []);
}

/** A farm that is not started yet, and a page of a browser. Both are gone after the test, with the farm's folder. */
export async function farmAndPage(t) {
  const folder = fs.mkdtempSync(path.join(os.tmpdir(), "forelight-dashboard-"));
  const farm = new Farm(path.join(folder, "farm"));
  const browser = await launch();
  t.after(async () => {
    await browser.close();
    await farm.kill();
    fs.rmSync(folder, { recursive: true, force: true });
  });
  return { folder, farm, browser, page: await visitor(browser) };
}

/** Another tab of the same profile. */
export async function sibling(page) {
  return watched(await page.context().newPage(), page.faults);
}

function watched(page, faults) {
  page.setDefaultTimeout(60_000);
  page.faults = faults;
  page.on("pageerror", (error) => faults.push(error.stack ?? String(error)));
  page.on(
    "console",
    (message) => /Content Security Policy/.test(message.text()) && faults.push(message.text()),
  );
  return page;
}

export function noFaults(page) {
  assert.deepEqual(page.faults, []);
}

/** The screens of the page by name, for a farm with these jobs. */
export function screens(job) {
  return {
    tonight: ["#/tonight", ".tonight .summary"],
    farm: ["#/farm", ".gantt, .farm code"],
    nodes: ["#/farm?view=list", ".node-table, .farm code"],
    record: ["#/record", ".record .nights"],
    submit: ["#/submit", ".drop"],
    tokens: ["#/settings", ".tokens .set-row:not(.set-head)"],
    webhooks: ["#/settings?part=webhooks", ".settings .primary"],
    kept: ["#/settings?part=kept", ".rules tbody tr"],
    audit: ["#/settings?part=audit", ".settings .filters"],
    keys: ["#/keys", ".keys"],
    ...(job && {
      job: [`#/jobs/${job}`, ".strip"],
      "job-why": [`#/jobs/${job}?tab=why`, ".sentences"],
      "job-accuracy": [`#/jobs/${job}?tab=ladders`, "[aria-label^=Rungs]"],
      "job-estimate": [`#/jobs/${job}?tab=estimate`, "[aria-label^='Expected CPU time']"],
      "job-price": [`#/jobs/${job}?tab=price`, ".outlook, .tabs ~ .note"],
      "job-logs": [`#/jobs/${job}?tab=logs`, ".log"],
    }),
  };
}

/** Shows a screen of the signed-in page, and waits until its content is there. */
export async function show(page, address, [hash, content]) {
  await page.goto(`${address}/${hash}`);
  await page.locator(content).first().waitFor();
  await page
    .waitForFunction(() => document.querySelectorAll("main .waiting").length === 0)
    .catch(() => undefined);
}

/** Waits until what changed is on screen, also what is drawn after a change of size is seen. */
async function drawnTwice(page) {
  await page.evaluate(
    () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done)))),
  );
}

/** Checks the present view with axe in both themes, and keeps what it looks like there and on a phone. */
export async function inspect(page, name) {
  const fullPage = (await page.locator("dialog").count()) === 0;
  const shoot = (kind) => page.screenshot({ path: path.join(shots, `${name}-${kind}.png`), fullPage });
  for (const theme of ["light", "dark"]) {
    await page.emulateMedia({ colorScheme: theme });
    await drawnTwice(page);
    if (!(await page.evaluate(() => "axe" in window))) await page.evaluate(axe);
    const { violations } = await page.evaluate(() => window.axe.run({ resultTypes: ["violations"] }));
    const told = violations.map(
      (one) => `${one.id}: ${one.nodes.map((node) => node.target.join(" ")).join(", ")}`,
    );
    assert.deepEqual(told, [], `axe, ${name}, ${theme}`);
    await shoot(theme);
    await page.setViewportSize({ width: 390, height: 844 });
    await drawnTwice(page);
    const over = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.ok(over <= 0, `${name} is ${over} pixels wider than a phone`);
    await shoot(`${theme}-phone`);
    await page.setViewportSize({ width: 1440, height: 900 });
  }
  await page.emulateMedia({ colorScheme: "light" });
}

/** Tabs in which screens are inspected at the same time. */
const TABS = 3;

/** Shows and inspects screens by name, in tabs of the page's session. */
export async function inspectAll(page, address, list, state) {
  const left = Object.entries(list);
  const inTab = async () => {
    const tab = await sibling(page);
    for (let next = left.shift(); next; next = left.shift()) {
      const [name, screen] = next;
      await show(tab, address, screen);
      await inspect(tab, `${state}-${name}`);
    }
    await tab.close();
  };
  await Promise.all(Array.from({ length: TABS }, inTab));
}
