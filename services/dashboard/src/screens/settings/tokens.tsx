// Bearer tokens: whose they are, what they allow, and when they were last used.

import { useCallback, useState } from "preact/hooks";
import { get, post, remove } from "../../api/client";
import type { Schemas } from "../../api/client";
import { now } from "../../state/now";
import { clean, words } from "../../ui/format";
import { Confirm } from "../../ui/dialog";
import { PAGE, usePages } from "../../ui/pages";
import { Field, Section, Time, Trouble, Waiting } from "../../ui/parts";
import { VirtualTable } from "../../ui/virtual";
import { SecretDialog } from "./secret";

type Token = Schemas["Token"];
type Role = Schemas["Role"];

const ROLES: [Role, string][] = [
  ["viewer", "reads"],
  ["submitter", "reads, and submits jobs"],
  ["operator", "does everything"],
  ["worker", "takes tasks, and reads nothing else"],
];

export function Tokens() {
  const ask = useCallback(async (token: string | null) => {
    const page = await get("/v1/tokens", {
      query: { page_size: PAGE, ...(token ? { page_token: token } : {}) },
    });
    return { items: page.items, next: page.next_page_token ?? null };
  }, []);
  const tokens = usePages(ask, () => null);
  const [making, setMaking] = useState(false);
  const [acting, setActing] = useState<{ token: Token; act: "rotate" | "revoke" } | null>(null);
  const [secret, setSecret] = useState<{ name: string; secret: string } | null>(null);
  const made = (answer: Schemas["NewToken"]) => {
    setSecret({ name: answer.token.name, secret: answer.secret });
    tokens.again();
  };
  return (
    <Section
      title="Tokens"
      aside={
        <button type="button" class="primary" onClick={() => setMaking(true)}>
          Make a token…
        </button>
      }
    >
      <p class="note">
        A token lets a person or a program in. The farm keeps only its hash, so it is shown once, when it is
        made.
      </p>
      {tokens.error && <Trouble error={tokens.error} retry={tokens.again} />}
      {tokens.items.length === 0 && tokens.loading && <Waiting>Asking for the tokens…</Waiting>}
      {tokens.items.length > 0 && (
        <VirtualTable
          region="All tokens"
          name="Tokens"
          table="set-table tokens"
          line="set-row"
          head="set-head"
          columns={["Name", "May", "Expires", "Last used", "Orders"]}
          items={tokens.items}
          height={40}
          seen={tokens.see}
          row={(token) => <Row token={token} act={(act) => setActing({ token, act })} />}
          keyOf={(token) => token.id}
        />
      )}
      {making && <Make close={() => setMaking(false)} made={made} />}
      {acting && <Act {...acting} close={() => setActing(null)} made={made} changed={() => tokens.again()} />}
      {secret && (
        <SecretDialog
          title={`The token of ${clean(secret.name)}`}
          secret={secret.secret}
          close={() => setSecret(null)}
        />
      )}
    </Section>
  );
}

/** What a token allows, in words. */
function rights(token: Token): string {
  if (!token.projects) return token.node_id ? "worker of one node" : token.role;
  return Object.entries(token.projects)
    .map(([project, role]) => `${role} in ${project === "*" ? "all other projects" : clean(project)}`)
    .join(", ");
}

function Row(props: { token: Token; act: (act: "rotate" | "revoke") => void }) {
  const { token } = props;
  const expired = token.expires_at != null && Date.parse(token.expires_at) <= now.value;
  return (
    <div role="row" class="set-row">
      <span role="cell" class="name" title={clean(token.name)}>
        {clean(token.name)} {token.kind === "service" && <span class="muted">service</span>}
      </span>
      <span role="cell" title={rights(token)}>
        {rights(token)}
      </span>
      <span role="cell">
        {expired && <strong class="tone-warn">⚠ expired </strong>}
        <Time at={token.expires_at} none="never" />
      </span>
      <span role="cell">
        <Time at={token.last_used_at} none="never used" />
      </span>
      <span role="cell" class="orders">
        <button
          type="button"
          onClick={() => props.act("rotate")}
          aria-label={`Replace: ${clean(token.name)}`}
        >
          Replace…
        </button>{" "}
        <button
          type="button"
          class="danger"
          onClick={() => props.act("revoke")}
          aria-label={`Revoke: ${clean(token.name)}`}
        >
          Revoke…
        </button>
      </span>
    </div>
  );
}

function Make(props: { close: () => void; made: (made: Schemas["NewToken"]) => void }) {
  const [name, setName] = useState("");
  const [role, setRole] = useState<Role>("viewer");
  const [project, setProject] = useState("");
  const [days, setDays] = useState("");
  const ofProject = project.trim() !== "" && (role === "viewer" || role === "submitter");
  const run = async () => {
    const expires =
      days === "" ? {} : { expires_at: new Date(Date.now() + Number(days) * 864e5).toISOString() };
    const rights = ofProject ? { projects: { [project.trim()]: role } } : { role };
    props.made(await post("/v1/tokens", { body: { name: name.trim(), ...rights, ...expires } }));
  };
  return (
    <Confirm title="Make a token" act="Make it" ready={name.trim() !== ""} run={run} close={props.close}>
      <Field label="Name of the person or program">
        {(id) => (
          <input id={id} required value={name} onInput={(event) => setName(event.currentTarget.value)} />
        )}
      </Field>
      <Field label="Role">
        {(id) => (
          <select id={id} value={role} onChange={(event) => setRole(event.currentTarget.value as Role)}>
            {ROLES.map(([value, may]) => (
              <option key={value} value={value}>
                {value}: {may}
              </option>
            ))}
          </select>
        )}
      </Field>
      {(role === "viewer" || role === "submitter") && (
        <Field label="Project (empty: all projects)" hint="It sees nothing of other projects.">
          {(id) => (
            <input id={id} value={project} onInput={(event) => setProject(event.currentTarget.value)} />
          )}
        </Field>
      )}
      <Field label="Days until it expires (empty: never)">
        {(id) => (
          <input
            id={id}
            type="number"
            min={1}
            max={36500}
            value={days}
            onInput={(event) => setDays(event.currentTarget.value)}
          />
        )}
      </Field>
    </Confirm>
  );
}

function Act(props: {
  token: Token;
  act: "rotate" | "revoke";
  close: () => void;
  made: (made: Schemas["NewToken"]) => void;
  changed: () => void;
}) {
  const { token } = props;
  const path = { id: token.id };
  if (props.act === "revoke") {
    return (
      <Confirm
        title={`Revoke the token of ${clean(token.name)}?`}
        act="Revoke it"
        danger
        run={async () => {
          await remove("/v1/tokens/{id}", { path });
          props.changed();
        }}
        close={props.close}
      >
        <p>It ends at once, with its sessions and open pages. A {words(token.role)} with it is refused.</p>
      </Confirm>
    );
  }
  return (
    <Confirm
      title={`Replace the token of ${clean(token.name)}?`}
      act="Replace it"
      run={async () => props.made(await post("/v1/tokens/{id}/rotate", { path, body: { grace_seconds: 0 } }))}
      close={props.close}
    >
      <p>
        A new token with the same rights is made, and the old one ends at once. Workers read their token file
        again, so put the new token there first: <code>forelight token rotate --grace 10m</code> leaves time
        for that.
      </p>
    </Confirm>
  );
}
