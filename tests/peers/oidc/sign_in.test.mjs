// People sign in through a real OpenID Connect provider.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { start } from "./provider.mjs";

const folder = mkdtempSync(join(tmpdir(), "forelight-oidc-"));
let farm, provider, service, operator;

/** A port that is free now. */
function freePort() {
  return new Promise((done) => {
    const server = createServer().listen(0, "127.0.0.1", () => {
      const { port } = server.address();
      server.close(() => done(port));
    });
  });
}

/** Cookies of a browser, by site and name. */
class Browser {
  cookies = new Map();

  async get(address, options = {}) {
    const url = new URL(address);
    const cookies = [...this.cookies]
      .filter(([key]) => key.startsWith(`${url.port} `))
      .map(([key, value]) => `${key.split(" ")[1]}=${value}`);
    const headers = { cookie: cookies.join("; "), ...options.headers };
    const answer = await fetch(url, { ...options, headers, redirect: "manual" });
    for (const line of answer.headers.getSetCookie()) {
      const [, name, value] = /^([^=]+)=([^;]*)/.exec(line);
      this.cookies.set(`${url.port} ${name}`, value);
    }
    return answer;
  }

  /** Follows redirects until an address begins with `end`, which is not asked for. */
  async follow(address, end) {
    for (let step = 0; step < 12; step += 1) {
      const answer = await this.get(address);
      assert.ok([302, 303].includes(answer.status), `${address}: ${answer.status} ${await answer.text()}`);
      address = new URL(answer.headers.get("location"), address).href;
      if (address.startsWith(end)) return address;
    }
    throw new Error("too many redirects");
  }

  /** Goes to the provider and back to the service: the address with the code. */
  toCallback() {
    return this.follow(`${farm}/v1/sign-in/begin`, `${farm}/v1/sign-in/callback`);
  }

  async signIn() {
    const answer = await this.get(await this.toCallback());
    assert.equal(answer.status, 303, await answer.text());
    assert.equal(answer.headers.get("location"), "/");
    return (await this.get(`${farm}/v1/sessions/current`)).json();
  }
}

async function asOperator(method, path, body) {
  const headers = { authorization: `Bearer ${operator}`, "content-type": "application/json" };
  const answer = await fetch(farm + path, { method, headers, body: body && JSON.stringify(body) });
  assert.ok(answer.ok, `${path}: ${answer.status}`);
  return answer.status === 204 ? null : answer.json();
}

before(async () => {
  const port = await freePort();
  farm = `http://127.0.0.1:${port}`;
  provider = await start(`${farm}/v1/sign-in/callback`);
  writeFileSync(join(folder, "secret"), "a-secret-of-the-service\n", { mode: 0o600 });
  writeFileSync(
    join(folder, "sign-in.toml"),
    `name = "the studio"
issuer = "${provider.issuer}"
client_id = "forelight"
client_secret_file = "${join(folder, "secret")}"

[[grants]]
group = "wranglers"
role = "operator"

[[grants]]
group = "film"
role = "submitter"
project = "film"
`,
  );
  const data = join(folder, "data");
  const words = ["serve", "--data", data, "--listen", `127.0.0.1:${port}`];
  const more = ["--public-url", farm, "--sign-in", join(folder, "sign-in.toml")];
  service = spawn(process.env.FORELIGHT_BIN, [...words, ...more], { stdio: ["ignore", "ignore", "inherit"] });
  for (let tries = 0; ; tries += 1) {
    const ready = await fetch(`${farm}/readyz`).catch(() => null);
    if (ready?.ok) break;
    assert.ok(tries < 600, "the service does not become ready");
    await new Promise((done) => setTimeout(done, 100));
  }
  // The token files are written just after the service is ready.
  for (let tries = 0; !operator; tries += 1) {
    try {
      operator = readFileSync(join(data, "tokens/operator.token"), "utf8").trim();
    } catch {
      assert.ok(tries < 600, "the service writes no tokens");
      await new Promise((done) => setTimeout(done, 100));
    }
  }
  await asOperator("POST", "/v1/projects", { project: "film", share: 1 });
});

after(() => {
  service?.kill();
  provider?.stop();
  rmSync(folder, { recursive: true, force: true });
});

test("groups become roles, and the person is named", async () => {
  assert.deepEqual(await (await fetch(`${farm}/v1/sign-in`)).json(), { provider: "the studio" });
  provider.state.person = "anna";
  const session = await new Browser().signIn();
  assert.equal(session.name, "anna@studio.example");
  assert.deepEqual(session.projects, { film: "submitter" });
  provider.state.person = "omar";
  const other = await new Browser().signIn();
  assert.equal(other.role, "operator");
  assert.equal(other.projects, undefined);
  const audit = await asOperator("GET", "/v1/audit?action=session_begun");
  const names = audit.items.map((entry) => entry.actor);
  assert.deepEqual(names.slice(0, 2), ["omar@studio.example", "anna@studio.example"]);
});

test("whoever is in no group with a role is known and refused", async () => {
  provider.state.person = "zoe";
  const browser = new Browser();
  const answer = await browser.get(await browser.toCallback());
  assert.equal(answer.status, 403);
  assert.match((await answer.json()).detail, /zoe@studio.example is known/);
  assert.equal((await browser.get(`${farm}/v1/sessions/current`)).status, 401);
});

test("a sign-in belongs to the browser that began it, and is used up", async () => {
  provider.state.person = "anna";
  const browser = new Browser();
  const callback = await browser.toCallback();
  assert.equal((await new Browser().get(callback)).status, 401, "another browser");
  assert.equal((await browser.get(callback)).status, 303);
  const again = new Browser();
  again.cookies = new Map(browser.cookies);
  assert.equal((await again.get(callback)).status, 401, "the same code again");
  const forged = await browser.toCallback();
  const wrong = new URL(forged);
  wrong.searchParams.set("code", "made-up");
  assert.equal((await browser.get(wrong.href)).status, 401, "a code that the provider does not know");
  const gone = await new Browser().get(`${farm}/v1/sign-in/callback?error=access_denied`);
  assert.equal(gone.status, 401, "the person changed his mind");
});

test("a person's token is listed, and revoking it ends his sessions", async () => {
  provider.state.person = "anna";
  const [first, second] = [new Browser(), new Browser()];
  await first.signIn();
  await second.signIn();
  const current = (browser) => browser.get(`${farm}/v1/sessions/current`).then((answer) => answer.status);
  assert.equal(await current(first), 401, "a new sign-in replaces the one before, with its groups");
  assert.equal(await current(second), 200);
  const { items } = await asOperator("GET", "/v1/tokens?page_size=200");
  const own = items.filter((token) => token.name === "anna@studio.example");
  assert.equal(own.length, 1);
  await asOperator("DELETE", `/v1/tokens/${own[0].id}`);
  assert.equal(await current(second), 401);
});
