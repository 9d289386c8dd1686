// Who did what, when, and from where: newest first.

import { useCallback } from "preact/hooks";
import { get } from "../../api/client";
import type { Schemas } from "../../api/client";
import { param, setQuery } from "../../state/route";
import { clean, words } from "../../ui/format";
import { PAGE, usePages } from "../../ui/pages";
import { Section, Time, Trouble, Waiting } from "../../ui/parts";
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
          columns={["When", "Who", "From", "Did", "With", "Project"]}
          items={entries.items}
          height={32}
          seen={entries.see}
          row={(entry) => <Row entry={entry} />}
          keyOf={(entry) => String(entry.id)}
        />
      )}
      <p class="note">Entries never change. Point at what was done to see what was asked for.</p>
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

function Row(props: { entry: Entry }) {
  const { entry } = props;
  const detail = entry.detail ? clean(JSON.stringify(entry.detail)) : undefined;
  return (
    <div role="row" class="set-row">
      <span role="cell">
        <Time at={entry.at} exact />
      </span>
      <span role="cell" class="name" title={clean(entry.actor)}>
        {clean(entry.actor)} {entry.role && <span class="muted">{entry.role}</span>}
      </span>
      <span role="cell">{entry.from ?? "–"}</span>
      <span role="cell" title={detail}>
        {words(entry.action)}
      </span>
      <span role="cell" title={clean(entry.target)}>
        <code>{clean(entry.target)}</code>
      </span>
      <span role="cell">{entry.project ? clean(entry.project) : "–"}</span>
    </div>
  );
}
