// Requests to the public API. Addresses, parameters and answers are typed by `openapi.yaml`.

import { sentence } from "../ui/format";
import type { components, paths } from "./schema";

export type Schemas = components["schemas"];

type Json<R> = R extends { content: { "application/json": infer T } } ? T : never;
type Answers<O> = O extends { responses: infer R } ? R : never;
type Ok<O> = Json<Answers<O>[200 & keyof Answers<O>]> | Json<Answers<O>[201 & keyof Answers<O>]>;
type Operation<P extends keyof paths, M extends string> = M extends keyof paths[P] ? paths[P][M] : never;
type Query<O> = O extends { parameters: { query?: infer Q } } ? Q : never;
type Place<O> = O extends { parameters: { path: infer Q } } ? Q : undefined;
type Body<O> = O extends { requestBody?: { content: { "application/json": infer B } } } ? B : undefined;

type WithMethod<M extends string> = {
  [P in keyof paths]: M extends keyof paths[P]
    ? paths[P][M] extends { responses: object }
      ? P
      : never
    : never;
}[keyof paths];

export interface Request<O> {
  path?: Place<O>;
  query?: Query<O>;
  body?: Body<O>;
  /** Repeats with the same key are done once. Needed by every POST that creates. */
  key?: string;
  signal?: AbortSignal;
}

/** A refusal of the service, or no answer at all (status 0). */
export class Refused extends Error {
  readonly status: number;
  readonly problem: Schemas["Problem"] | null;

  constructor(status: number, problem: Schemas["Problem"] | null, detail: string) {
    super(detail);
    this.status = status;
    this.problem = problem;
  }

  /** The field of the request that is wrong, such as `/frames`. */
  get pointer(): string | null {
    return this.problem?.pointer ?? null;
  }
}

/** What answers tell: whether the service was reached, and whether it knows who asks. */
export const hooks = {
  heard() {},
  unheard() {},
  signedOut() {},
  /** Number of times that somebody signed in. A refusal of a request from before says nothing of the session. */
  signedIn: 0,
};

/** The address of a route with its parameters. */
export function address(path: string, place?: object, query?: object): string {
  let out = path;
  for (const [name, value] of Object.entries(place ?? {})) {
    out = out.replace(`{${name}}`, encodeURIComponent(String(value)));
  }
  const search = new URLSearchParams();
  for (const [name, value] of Object.entries(query ?? {})) {
    if (value !== undefined && value !== null && value !== "") search.set(name, String(value));
  }
  const text = search.toString();
  return text ? `${out}?${text}` : out;
}

/** `fetch` with the project's errors. */
export async function ask(url: string, init: RequestInit = {}): Promise<Response> {
  const { signedIn } = hooks;
  let response: Response;
  try {
    response = await fetch(url, { credentials: "same-origin", ...init });
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    hooks.unheard();
    throw new Refused(0, null, "The service does not answer. What is shown may be old.");
  }
  hooks.heard();
  if (response.ok) return response;
  const problem = await readProblem(response);
  const detail = problem?.detail ?? `The service answered ${response.status}.`;
  if (response.status === 401 && signedIn === hooks.signedIn) hooks.signedOut();
  throw new Refused(response.status, problem, readable(detail));
}

async function readProblem(response: Response): Promise<Schemas["Problem"] | null> {
  try {
    return (await response.json()) as Schemas["Problem"];
  } catch {
    return null;
  }
}

/** Positions in a body that the page wrote tell nobody anything. */
function readable(detail: string): string {
  return sentence(detail.replace(/ at line \d+ column \d+$/, ""));
}

async function call(method: string, path: string, request: Request<never>): Promise<unknown> {
  const headers: Record<string, string> = { Accept: "application/json" };
  const init: RequestInit = { method, headers };
  if (request.body !== undefined) {
    headers["Content-Type"] = "application/json";
    init.body = JSON.stringify(request.body);
  }
  if (request.key) headers["Idempotency-Key"] = request.key;
  if (request.signal) init.signal = request.signal;
  const response = await ask(address(path, request.path, request.query), init);
  // Some answers have no body.
  const text = await response.text();
  return text === "" ? undefined : JSON.parse(text);
}

export function get<P extends WithMethod<"get"> & string>(
  path: P,
  request: Request<Operation<P, "get">> = {},
): Promise<Ok<Operation<P, "get">>> {
  return call("GET", path, request as Request<never>) as Promise<Ok<Operation<P, "get">>>;
}

export function post<P extends WithMethod<"post"> & string>(
  path: P,
  request: Request<Operation<P, "post">> = {},
): Promise<Ok<Operation<P, "post">>> {
  return call("POST", path, request as Request<never>) as Promise<Ok<Operation<P, "post">>>;
}

export function put<P extends WithMethod<"put"> & string>(
  path: P,
  request: Request<Operation<P, "put">> = {},
): Promise<Ok<Operation<P, "put">>> {
  return call("PUT", path, request as Request<never>) as Promise<Ok<Operation<P, "put">>>;
}

export function patch<P extends WithMethod<"patch"> & string>(
  path: P,
  request: Request<Operation<P, "patch">> = {},
): Promise<Ok<Operation<P, "patch">>> {
  return call("PATCH", path, request as Request<never>) as Promise<Ok<Operation<P, "patch">>>;
}

export function remove<P extends WithMethod<"delete"> & string>(
  path: P,
  request: Request<Operation<P, "delete">> = {},
): Promise<Ok<Operation<P, "delete">>> {
  return call("DELETE", path, request as Request<never>) as Promise<Ok<Operation<P, "delete">>>;
}

/** A new idempotency key. `randomUUID` needs a secure context, which a studio's service may not have. */
export function newKey(): string {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
