// Who did what, when, and from where: newest first.

import { useCallback, useMemo } from "preact/hooks";
import { get } from "../../api/client";
import type { Schemas } from "../../api/client";
import { farm } from "../../state/farm";
import { href, param, setQuery } from "../../state/route";
import { clean, money, told, words } from "../../ui/format";
import { PAGE, usePages } from "../../ui/pages";
import { Section, Time, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";
import { VirtualTable } from "../../ui/virtual";

type Entry = Schemas["AuditEntry"];
type Action = Schemas["AuditAction"];

/** Every action, as the compiler checks. */
const ACTIONS: Record<Action, true> = {
  job_submitted: true,
  job_changed: true,
  job_accepted: true,
  job_cancelled: true,
  job_deleted: true,
  job_left_out: true,
  job_counted: true,
  frames_retried: true,
  frames_cancelled: true,
  bundle_uploaded: true,
  node_joined: true,
  node_changed: true,
  node_removed: true,
  join_token_created: true,
  token_created: true,
  token_changed: true,
  token_rotated: true,
  token_revoked: true,
  session_begun: true,
  session_ended: true,
  project_set: true,
  retention_set: true,
  audit_pruned: true,
  quota_set: true,
  budget_set: true,
  budget_removed: true,
  webhook_added: true,
  webhook_removed: true,
};

export function Audit() {
  const who = param("who") ?? "";
  const about = param("about") ?? "";
  const action = (Object.keys(ACTIONS) as Action[]).find((one) => one === param("action")) ?? "";
  const ask = useCallback(
    async (token: string | null) => {
      const page = await get("/v1/audit", {
        query: {
          page_size: PAGE,
          ...(who ? { actor: who } : {}),
          ...(about ? { project: about } : {}),
          ...(action ? { action } : {}),
          ...(token ? { page_token: token } : {}),
        },
      });
      return { items: page.items, next: page.next_page_token ?? null };
    },
    [who, about, action],
  );
  const entries = usePages(ask, () => null);
  const open = param("entry");
  const lines = useMemo(() => linesOf(entries.items, open), [entries.items, open]);
  const names = useNames(entries.items);
  return (
    <Section title="Audit" aside={<Filters who={who} about={about} action={action} again={entries.again} />}>
      {entries.error && <Trouble error={entries.error} retry={entries.again} />}
      {entries.items.length === 0 &&
        (entries.loading ? (
          <Waiting>Asking who did what…</Waiting>
        ) : (
          <p class="note">Nobody did anything like that.</p>
        ))}
      {entries.items.length > 0 && (
        <VirtualTable
          region="Who did what"
          name="Audit"
          table="set-table audit"
          line="set-row"
          head="set-head"
          columns={["When", "Did", "With", "Who", "From", "Project"]}
          items={lines}
          height={32}
          seen={entries.see}
          row={(line) =>
            line.detail ? (
              <DetailRow detail={line.detail} />
            ) : (
              <Row entry={line.entry} names={names} isOpen={String(line.entry.id) === open} />
            )
          }
          keyOf={({ entry, detail }) => `${entry.id} ${detail?.name ?? ""}`}
        />
      )}
      <p class="note">Entries never change. Press what was done to see what was asked for.</p>
    </Section>
  );
}

function Filters(props: { who: string; about: string; action: Action | ""; again: () => void }) {
  return (
    <div class="filters">
      <label>
        Who{" "}
        <input
          type="search"
          id="search"
          value={props.who}
          placeholder="name of a token"
          onChange={(event) => setQuery({ who: event.currentTarget.value })}
        />
      </label>
      <label>
        Project{" "}
        <input
          type="search"
          value={props.about}
          onChange={(event) => setQuery({ about: event.currentTarget.value })}
        />
      </label>
      <label>
        What{" "}
        <select value={props.action} onChange={(event) => setQuery({ action: event.currentTarget.value })}>
          <option value="">everything</option>
          {Object.keys(ACTIONS).map((one) => (
            <option key={one} value={one}>
              {words(one)}
            </option>
          ))}
        </select>
      </label>
      <button type="button" onClick={props.again}>
        Ask again
      </button>
      <a href="/v1/audit/export?format=csv" download>
        All as CSV
      </a>
    </div>
  );
}

interface Detail {
  name: string;
  value: string;
}

/** A line of the table: an entry, or a part of what was asked for in the one that is open. */
interface Line {
  entry: Entry;
  detail: Detail | null;
}

function linesOf(entries: readonly Entry[], open: string | null): Line[] {
  return entries.flatMap((entry) => [
    { entry, detail: null },
    ...(String(entry.id) === open ? detailsOf(entry).map((detail) => ({ entry, detail })) : []),
  ]);
}

const AMOUNTS = ["amount", "budget", "price_per_hour"];

function detailsOf(entry: Entry): Detail[] {
  return Object.entries(entry.detail ?? {}).map(([name, value]: [string, unknown]) => ({
    name: words(name),
    value:
      typeof value === "string"
        ? told(value)
        : typeof value === "number" && AMOUNTS.includes(name)
          ? money(value)
          : clean(JSON.stringify(value)),
  }));
}

/** Names of jobs, nodes and others by their ids, as far as the page knows them. */
function useNames(entries: readonly Entry[]): ReadonlyMap<string, string> {
  const jobs = useResource((signal) => get("/v1/jobs", { query: { page_size: PAGE }, signal }), []);
  const doc = farm.value;
  return useMemo(() => {
    const names = new Map<string, string>();
    for (const { target, detail } of entries) {
      const { name } = (detail ?? {}) as { name?: unknown };
      if (typeof name === "string") names.set(target, name);
    }
    for (const one of [...(jobs.data?.items ?? []), ...(doc?.jobs ?? []), ...(doc?.nodes ?? [])])
      names.set(one.id, one.name);
    return names;
  }, [entries, jobs.data, doc?.jobs, doc?.nodes]);
}

/** The screen of what an action was done with, if there is one. */
function placeOf({ action, target }: Entry): string | null {
  if (action === "job_deleted" || action === "node_removed") return null;
  if (/^(job|frames)_/.test(action)) return href(["jobs", target]);
  if (action.startsWith("node_")) return href(["farm"], { view: "list", node: target });
  if (/^(join_)?token_/.test(action)) return href(["settings"]);
  if (action.startsWith("webhook_")) return href(["settings"], { part: "webhooks" });
  if (action === "retention_set") return href(["settings"], { part: "kept" });
  return null;
}

function Row(props: { entry: Entry; names: ReadonlyMap<string, string>; isOpen: boolean }) {
  const { entry, names, isOpen } = props;
  const name = names.get(entry.target);
  const target = name === undefined ? <code>{clean(entry.target)}</code> : clean(name);
  const place = placeOf(entry);
  return (
    <div role="row" class="set-row">
      <span role="cell">
        <Time at={entry.at} exact />
      </span>
      <span role="cell">
        {Object.keys(entry.detail ?? {}).length > 0 ? (
          <button
            type="button"
            class="plain"
            aria-expanded={isOpen}
            onClick={() => setQuery({ entry: isOpen ? null : String(entry.id) })}
          >
            <span aria-hidden="true">{isOpen ? "▾" : "▸"} </span>
            {words(entry.action)}
          </button>
        ) : (
          words(entry.action)
        )}
      </span>
      <span role="cell" title={clean(entry.target)}>
        {place === null ? target : <a href={place}>{target}</a>}
      </span>
      <span role="cell" class="name" title={clean(entry.actor)}>
        {clean(entry.actor)} {entry.role && <span class="muted">{entry.role}</span>}
      </span>
      <span role="cell">{entry.from ?? "–"}</span>
      <span role="cell">{entry.project ? clean(entry.project) : "–"}</span>
    </div>
  );
}

/** A part of what was asked for. */
function DetailRow(props: { detail: Detail }) {
  const { name, value } = props.detail;
  return (
    <div role="row" class="set-row detail-row">
      <span role="cell" aria-colspan={6} tabIndex={0}>
        <span class="muted">{name}:</span> {value}
      </span>
    </div>
  );
}
