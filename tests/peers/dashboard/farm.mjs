// A farm in processes of its own, and requests to it that do not go through the page.

import { spawn, execFile } from "node:child_process";
import { randomUUID } from "node:crypto";
import fs from "node:fs";
import { promisify } from "node:util";
import path from "node:path";

export const root = path.resolve(
  import.meta.dirname ?? path.dirname(new URL(import.meta.url).pathname),
  "../../..",
);
const program = process.env.FORELIGHT_DASHBOARD_BIN;

/** Two workers beside the service. */
export const WORKERS = ["--workers", "2", "--threads", "1", "--preview", "cpu", "--price", "0.40"];

/** Steps of a test: each goes on where the one before it ended. */
export function steps(t) {
  let broken = false;
  return (name, run) =>
    t.test(name, async (inner) => {
      if (broken) return inner.skip("a step before it failed");
      broken = true;
      await run();
      broken = false;
    });
}

export class Farm {
  /** Starts `forelight COMMAND` on a data folder. A later start of the same farm keeps its address. */
  constructor(data) {
    this.data = data;
    this.port = 0;
  }

  async start(...args) {
    this.log = `${this.data}.log`;
    const log = fs.openSync(this.log, "a");
    this.process = spawn(program, [...args, "--data", this.data, "--listen", `127.0.0.1:${this.port}`], {
      stdio: ["ignore", "pipe", log],
    });
    let printed = "";
    this.process.stdout.on("data", (chunk) => (printed += chunk));
    // Beside other tests, the workers' calibration takes its time.
    const isUp = () => /listening on (\S+)/.test(printed) || this.failed();
    await until("the farm prints its address", isUp, 180);
    this.address = /listening on (\S+)/.exec(printed)[1];
    this.port = new URL(this.address).port;
    await until("the farm is ready", () =>
      fetch(`${this.address}/readyz`).then(
        (answer) => answer.ok,
        () => false,
      ),
    );
  }

  failed() {
    if (this.process.exitCode === null) return false;
    throw new Error(`the farm ended:\n${fs.readFileSync(this.log, "utf8").slice(-2000)}`);
  }

  /** Ends the process at once, as a crash would. */
  async kill() {
    const process = this.process;
    if (!process || process.exitCode !== null || process.signalCode !== null) return;
    const ended = new Promise((done) => process.once("exit", done));
    process.kill("SIGKILL");
    await ended;
  }

  token(role = "operator") {
    return fs.readFileSync(`${this.data}/tokens/${role}.token`, "utf8").trim();
  }

  async ask(method, place, body) {
    const answer = await fetch(this.address + place, {
      method,
      headers: {
        Authorization: `Bearer ${this.token()}`,
        ...(body ? { "Content-Type": "application/json" } : {}),
        ...(method === "POST" ? { "Idempotency-Key": randomUUID() } : {}),
      },
      body: body ? JSON.stringify(body) : undefined,
    });
    const text = await answer.text();
    if (!answer.ok) throw new Error(`${method} ${place}: ${answer.status} ${text}`);
    return text ? JSON.parse(text) : null;
  }

  get(place) {
    return this.ask("GET", place);
  }

  /** A link that signs in once. */
  async link(role = "operator") {
    const { stdout } = await promisify(execFile)(program, [
      "dashboard",
      "--print",
      "--server",
      this.address,
      "--token-file",
      `${this.data}/tokens/${role}.token`,
    ]);
    return stdout.trim().split("\n").pop();
  }

  /** Uploads a scene of the repository with the command line, and submits it. Returns the job's id. */
  async submit(scene, ...args) {
    const { stdout } = await promisify(execFile)(program, [
      "submit",
      path.join(root, "deploy/scenes", scene),
      "--server",
      this.address,
      "--token-file",
      `${this.data}/tokens/operator.token`,
      ...args,
    ]);
    return stdout.trim().split("\n").pop();
  }
}

/** Waits until `happens` is true. Fails after that many seconds, with what was waited for. */
export async function until(what, happens, seconds = 60) {
  const end = Date.now() + seconds * 1000;
  for (;;) {
    const answer = await happens();
    if (answer) return answer;
    if (Date.now() > end) throw new Error(`waited ${seconds} s: ${what}`);
    await new Promise((done) => setTimeout(done, 50));
  }
}
