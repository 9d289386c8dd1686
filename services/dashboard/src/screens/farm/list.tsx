// The nodes as a table: the same as the chart shows, and orders to each.

import { useCallback, useEffect, useState } from "preact/hooks";
import { get, patch } from "../../api/client";
import type { Node, NodeChange, NodeState } from "../../api/types";
import { refresh } from "../../state/farm";
import { onEvents } from "../../state/live";
import { nodeAfter } from "../../state/news";
import { param, setQuery } from "../../state/route";
import { mayOperate } from "../../state/session";
import { bytes, clean, counted, money, significant } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { PAGE, type Pages, usePages } from "../../ui/pages";
import { Act, Trouble, Waiting } from "../../ui/parts";
import { asError, useThrottled } from "../../ui/resource";
import { VirtualTable } from "../../ui/virtual";
import { Activity } from "./activity";

const SORTS = [
  ["name", "Name"],
  ["speed", "Speed"],
  ["price", "Price"],
] as const;

export function NodeList(props: {
  state: NodeState | "";
  search: string;
  /** Grows when a node was changed elsewhere. */
  version: number;
  open: (id: string) => void;
}) {
  const { state, search, version } = props;
  const sort = SORTS.find(([value]) => value === param("sort"))?.[0] ?? "name";
  const ask = useCallback(
    async (token: string | null) => {
      const page = await get("/v1/nodes", {
        query: {
          page_size: PAGE,
          sort,
          ...(state ? { state } : {}),
          ...(search ? { search } : {}),
          ...(token ? { page_token: token } : {}),
        },
      });
      return { items: page.items, next: page.next_page_token ?? null };
    },
    [sort, state, search],
  );
  const listed = usePages(ask, () => null);
  const again = useThrottled(listed.again, 3_000);
  useEffect(() => {
    if (version > 0) listed.again();
  }, [version]);
  useNews(listed, again);
  const changed = (node: Node) => listed.change((one) => (one.id === node.id ? node : one));

  if (listed.items.length === 0) {
    if (listed.error) return <Trouble error={listed.error} retry={listed.again} />;
    return listed.loading ? (
      <Waiting>Asking for the nodes…</Waiting>
    ) : (
      <p class="note">No node is like that.</p>
    );
  }
  return (
    <>
      <div class="filters">
        <label>
          Sort{" "}
          <select value={sort} onChange={(event) => setQuery({ sort: event.currentTarget.value })}>
            {SORTS.map(([value, word]) => (
              <option key={value} value={value}>
                {word}
              </option>
            ))}
          </select>
        </label>
      </div>
      <VirtualTable
        region="Nodes"
        name="Nodes"
        table="node-table"
        line="node-row"
        head="node-head"
        columns={["State", "Name", "Speed", "Cores", "Price/h", "Memory", "Does", "Orders"]}
        items={listed.items}
        height={36}
        seen={listed.see}
        row={(node) => <Row node={node} open={props.open} changed={changed} />}
        keyOf={(node) => node.id}
      />
      <p class="note">
        {counted(listed.items.length, "node")} shown{listed.complete ? "" : ", more below"}.{" "}
        {listed.loading && "Asking…"}
      </p>
      {listed.error && <Trouble error={listed.error} retry={listed.again} />}
    </>
  );
}

function Row(props: { node: Node; open: (id: string) => void; changed: (node: Node) => void }) {
  const { node } = props;
  const [busy, setBusy] = useState(false);
  const [error, setError] = useState<string | null>(null);
  const order = async (change: NodeChange) => {
    setBusy(true);
    try {
      props.changed(await patch("/v1/nodes/{id}", { path: { id: node.id }, body: change }));
      setError(null);
      void refresh();
    } catch (failure) {
      setError(asError(failure).message);
    }
    setBusy(false);
  };
  return (
    <div role="row" class="node-row">
      <span role="cell">
        <Mark of={node.state ?? "idle"} />
      </span>
      <span role="cell">
        <button type="button" class="plain name" onClick={() => props.open(node.id)}>
          {clean(node.name)}
        </button>
      </span>
      <span role="cell" class="right">
        {significant(node.speed, 3)}
      </span>
      <span role="cell" class="right">
        {node.cores}
      </span>
      <span role="cell" class="right">
        {money(node.price_per_hour)}
      </span>
      <span role="cell" class="right">
        {node.capabilities?.memory_bytes ? bytes(node.capabilities.memory_bytes) : "–"}
      </span>
      <span role="cell" class="does" title={node.idle_reason ?? ""}>
        {error ? <span class="tone-bad">{error}</span> : <Does node={node} />}
      </span>
      <span role="cell" class="orders">
        {mayOperate.value && (
          <>
            <Act
              busy={busy}
              press={() => void order({ drain: !node.drain })}
              label={`${node.drain ? "Undrain" : "Drain"}: ${clean(node.name)}`}
            >
              {node.drain ? "Undrain" : "Drain"}
            </Act>{" "}
            <Act
              busy={busy}
              press={() => void order({ pause: !node.pause })}
              label={`${node.pause ? "Resume" : "Pause"}: ${clean(node.name)}`}
            >
              {node.pause ? "Resume" : "Pause"}
            </Act>
          </>
        )}
      </span>
    </div>
  );
}

function Does(props: { node: Node }) {
  const { node } = props;
  if (node.activity) return <Activity of={node.activity} />;
  if (node.set_aside) return <>set aside: {clean(node.set_aside)}</>;
  if (node.idle_reason) return <span class="muted">{clean(node.idle_reason)}</span>;
  return <span class="none">{node.task_id ? "a task" : "nothing"}</span>;
}

/** What events say of the listed nodes' tasks. What they do not say is asked for. */
function useNews(listed: Pages<Node>, again: () => void): void {
  const { change } = listed;
  useEffect(
    () =>
      onEvents((events) => {
        const told = events.filter((event) => /^(task_|lease_)/.test(event.kind) && event.task_id);
        if (told.length > 0) change((node) => nodeAfter(node, told));
        if (events.some((event) => event.kind.startsWith("node_"))) again();
      }, again),
    [change, again],
  );
}
