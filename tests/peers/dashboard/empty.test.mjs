// The page of an empty farm: signing in, what is to be done first, and a service that goes away.

import assert from "node:assert/strict";
import test from "node:test";
import { farmAndPage, inspect, inspectAll, noFaults, screens, show, visitor } from "./browser.mjs";
import { steps, WORKERS } from "./farm.mjs";

test("an empty farm", { timeout: 480_000 }, async (t) => {
  const { farm, browser, page } = await farmAndPage(t);
  const step = steps(t);

  await step("refuses a wrong token in words, and signs in with a link that works once", async () => {
    await farm.start("serve");
    await page.goto(farm.address);
    await page.getByLabel("Token or link").fill("forelight_0000");
    await page.getByRole("button", { name: "Sign in" }).click();
    await page.getByText("The farm does not know this token").waitFor();
    await inspect(page, "sign-in");
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
    await page.getByRole("button", { name: "Sign out" }).click();
    await page.locator(".head .trouble").waitFor();
    assert.equal(await page.locator(".tonight").count(), 1, "who cannot sign out is signed in");
    await farm.start("farm", ...WORKERS);
    await page.locator(".connection.live").waitFor();
    await page.getByText("done: 2").waitFor();
  });
});
