// Webhooks: addresses that the farm tells of events, and what each was told.

import { useEffect, useState } from "preact/hooks";
import { get, post, remove } from "../../api/client";
import type { Schemas } from "../../api/client";
import { clean, counted, words } from "../../ui/format";
import { Confirm } from "../../ui/dialog";
import { Field, Section, Time, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";
import { SecretDialog } from "./secret";

type Webhook = Schemas["Webhook"];
type Kind = Schemas["WebhookKind"];

const KINDS: [Kind, string][] = [
  ["promise_at_risk", "a promise is at risk"],
  ["promise_safe", "it is safe again"],
  ["job_done", "a job is done"],
  ["job_failed", "a job failed"],
  ["budget", "a budget reaches a threshold"],
  ["node_set_aside", "a node is set aside"],
];

const CHAT = '{"text": "{text}"}';

export function Webhooks() {
  const list = useResource((signal) => get("/v1/webhooks", { signal }), []);
  const [adding, setAdding] = useState(false);
  const [removing, setRemoving] = useState<Webhook | null>(null);
  const [secret, setSecret] = useState<string | null>(null);
  const items = list.data?.items ?? [];
  return (
    <Section
      title="Webhooks"
      aside={
        <button type="button" class="primary" onClick={() => setAdding(true)}>
          Add a webhook…
        </button>
      }
    >
      <p class="note">
        The farm tells these addresses of promises, jobs, budgets and nodes. What is not answered is sent
        again for a day.
      </p>
      {list.error && <Trouble error={list.error} retry={list.reload} />}
      {!list.data && list.loading && <Waiting>Asking for the webhooks…</Waiting>}
      {list.data && items.length === 0 && <p>The farm tells nobody yet. A chat room is a good first one.</p>}
      {items.map((webhook) => (
        <One key={webhook.id} webhook={webhook} drop={() => setRemoving(webhook)} />
      ))}
      {adding && (
        <Add
          close={() => setAdding(false)}
          added={(webhook) => {
            setSecret(webhook.secret ?? null);
            list.reload();
          }}
        />
      )}
      {removing && (
        <Confirm
          title="Remove this webhook?"
          act="Remove it"
          danger
          run={async () => {
            await remove("/v1/webhooks/{id}", { path: { id: removing.id } });
            list.reload();
          }}
          close={() => setRemoving(null)}
        >
          <p>
            {clean(removing.url)} is told nothing more
            {removing.pending > 0 && `; ${counted(removing.pending, "message")} to it will not be sent`}.
          </p>
        </Confirm>
      )}
      {secret && (
        <SecretDialog title="The webhook’s secret" secret={secret} close={() => setSecret(null)}>
          <p>The receiver checks with it that a message is from this farm (Standard Webhooks).</p>
        </SecretDialog>
      )}
    </Section>
  );
}

function One(props: { webhook: Webhook; drop: () => void }) {
  const { webhook } = props;
  const path = { id: webhook.id };
  const told = useResource(
    (signal) => get("/v1/webhooks/{id}/deliveries", { path, query: { page_size: 20 }, signal }),
    [webhook.id],
  );
  const [error, setError] = useState<Error | null>(null);
  const items = told.data?.items ?? [];
  // What is to be sent is sent soon, or tried again: look until it is over.
  const waits = items.some((one) => one.state === "pending");
  useEffect(() => {
    if (!waits || told.loading) return undefined;
    const timer = setTimeout(told.reload, 1_000);
    return () => clearTimeout(timer);
  }, [waits, told.loading, told.reload]);
  const test = () =>
    post("/v1/webhooks/{id}/test", { path }).then(
      () => (setError(null), told.reload()),
      (failure: Error) => setError(failure),
    );
  const all = webhook.kinds.length >= KINDS.length;
  return (
    <article class="webhook">
      <h3 class="name">{clean(webhook.url)}</h3>
      <p>
        {all ? "Everything" : webhook.kinds.map(words).join(", ")}
        {webhook.project ? ` of project ${clean(webhook.project)}` : ""}.{" "}
        {webhook.pending > 0 && (
          <strong class="tone-warn">⚠ {counted(webhook.pending, "message")} to send.</strong>
        )}
      </p>
      <div class="buttons">
        <button type="button" onClick={() => void test()}>
          Send a test
        </button>
        <button type="button" class="danger" onClick={props.drop}>
          Remove…
        </button>
      </div>
      {error && <Trouble error={error} />}
      {told.error && <Trouble error={told.error} retry={told.reload} />}
      {told.data && items.length === 0 && <p class="note">It was told nothing yet.</p>}
      {items.length > 0 && (
        <div class="scroll-x" tabIndex={0} role="region" aria-label={`Deliveries to ${clean(webhook.url)}`}>
          <table class="numbers">
            <thead>
              <tr>
                {["Seen", "About", "State", "Attempts", "Last answer", "Next attempt"].map((name) => (
                  <th scope="col" key={name}>
                    {name}
                  </th>
                ))}
              </tr>
            </thead>
            <tbody>
              {items.map((one) => (
                <tr key={one.id}>
                  <td>
                    <Time at={one.created_at} exact />
                  </td>
                  <td>{words(one.kind)}</td>
                  <td>
                    <Delivered state={one.state} />
                  </td>
                  <td>{one.attempts}</td>
                  <td>{one.error ? clean(one.error) : (one.status ?? "–")}</td>
                  <td>
                    <Time at={one.next_at} exact />
                  </td>
                </tr>
              ))}
            </tbody>
          </table>
        </div>
      )}
    </article>
  );
}

function Delivered(props: { state: Schemas["DeliveryState"] }) {
  const [glyph, tone, word] = {
    pending: ["…", "warn", "to send"],
    delivered: ["✓", "good", "delivered"],
    given_up: ["✕", "bad", "given up"],
  }[props.state]!;
  return (
    <span class={`mark tone-${tone}`}>
      <span class="glyph" aria-hidden="true">
        {glyph}
      </span>
      {word}
    </span>
  );
}

function Add(props: { close: () => void; added: (webhook: Webhook) => void }) {
  const [url, setUrl] = useState("");
  const [chat, setChat] = useState(true);
  const [kinds, setKinds] = useState(new Set(KINDS.map(([kind]) => kind)));
  const [project, setProject] = useState("");
  const run = async () =>
    props.added(
      await post("/v1/webhooks", {
        body: {
          url: url.trim(),
          kinds: [...kinds],
          ...(project.trim() ? { project: project.trim() } : {}),
          ...(chat ? { template: JSON.parse(CHAT) as object } : {}),
        },
      }),
    );
  return (
    <Confirm
      title="Add a webhook"
      act="Add it"
      ready={url.trim() !== "" && kinds.size > 0}
      run={run}
      close={props.close}
    >
      <Field label="Address of the receiver">
        {(id) => (
          <input
            id={id}
            type="url"
            required
            placeholder="https://chat.example/hooks/…"
            value={url}
            onInput={(event) => setUrl(event.currentTarget.value)}
          />
        )}
      </Field>
      <fieldset>
        <legend>It is told when</legend>
        {KINDS.map(([kind, word]) => (
          <label key={kind} class="check">
            <input
              type="checkbox"
              checked={kinds.has(kind)}
              onChange={(event) => {
                const next = new Set(kinds);
                if (event.currentTarget.checked) next.add(kind);
                else next.delete(kind);
                setKinds(next);
              }}
            />{" "}
            {word}
          </label>
        ))}
      </fieldset>
      <label class="check">
        <input type="checkbox" checked={chat} onChange={(event) => setChat(event.currentTarget.checked)} />{" "}
        Send <code>{CHAT}</code>, as chat services want it
      </label>
      <Field label="Project (empty: all projects, and nodes)">
        {(id) => <input id={id} value={project} onInput={(event) => setProject(event.currentTarget.value)} />}
      </Field>
    </Confirm>
  );
}
