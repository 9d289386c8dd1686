// One node: what it is, what it does, and orders to it.

import { useEffect, useState } from "preact/hooks";
import { get, patch } from "../../api/client";
import type { Node, NodeChange } from "../../api/types";
import { refresh } from "../../state/farm";
import { onEvents } from "../../state/live";
import { isNews } from "../../state/news";
import { mayOperate } from "../../state/session";
import { Dialog } from "../../ui/dialog";
import { bytes, clean, money, moneyField, parseMoney, significant, told } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { Moment, timestampOf } from "../../ui/moment";
import { Act, Field, Time, Trouble, Waiting } from "../../ui/parts";
import { asError, useResource, useThrottled } from "../../ui/resource";
import { Activity } from "./activity";
import { Schedule, scheduleWords } from "./schedule";

export function NodeDialog(props: { id: string; close: () => void; changed: () => void }) {
  const node = useResource<Node>(
    (signal) => get("/v1/nodes/{id}", { path: { id: props.id }, signal }),
    [props.id],
  );
  const soon = useThrottled(node.reload, 1_000);
  useEffect(
    () =>
      onEvents(
        (events) => events.some((event) => isNews(event) && event.node_id === props.id) && soon(),
        soon,
      ),
    [props.id],
  );
  const [error, setError] = useState<Error | null>(null);
  const [busy, setBusy] = useState(false);
  const order: Order = async (change) => {
    setBusy(true);
    setError(null);
    try {
      await patch("/v1/nodes/{id}", { path: { id: props.id }, body: change });
      node.reload();
      props.changed();
      void refresh();
      return true;
    } catch (failure) {
      setError(asError(failure));
      return false;
    } finally {
      setBusy(false);
    }
  };
  const doc = node.data;
  return (
    <Dialog title={doc ? clean(doc.name) : "Node"} close={props.close} wide>
      {!doc &&
        (node.error ? (
          <Trouble error={node.error} retry={node.reload} />
        ) : (
          <Waiting>Asking for the node…</Waiting>
        ))}
      {doc && (
        <>
          <NodeFacts node={doc} />
          {mayOperate.value && <Orders node={doc} order={order} busy={busy} />}
          {error && <Trouble error={error} />}
          {mayOperate.value && <Terms node={doc} order={order} busy={busy} />}
        </>
      )}
      <div class="buttons">
        <button type="button" onClick={props.close}>
          Close
        </button>
      </div>
    </Dialog>
  );
}

function NodeFacts(props: { node: Node }) {
  const { node } = props;
  const what = node.capabilities;
  return (
    <>
      <dl class="facts">
        <Fact name="State">
          <Mark of={node.state ?? "idle"} />
        </Fact>
        <Fact name="Speed of a core">{significant(node.speed, 3)}</Fact>
        <Fact name="Cores">{node.cores}</Fact>
        <Fact name="Price per hour">{money(node.price_per_hour)}</Fact>
        <Fact name="Memory">{what?.memory_bytes ? bytes(what.memory_bytes) : "not known"}</Fact>
        <Fact name="Last heard">
          <Time at={node.last_seen_at} exact />
        </Fact>
        {node.power && (
          <Fact name="By its schedule">
            <Mark of={node.power.state === "asleep" ? "asleep" : "idle"} word={node.power.state} />
            {node.power.until && (
              <>
                {" "}
                until <Time at={node.power.until} />
              </>
            )}
          </Fact>
        )}
        {what?.processor && <Fact name="Processor">{clean(what.processor)}</Fact>}
        {what?.vulkan_adapter && <Fact name="Previews by">{clean(what.vulkan_adapter)}</Fact>}
        {what?.version && <Fact name="Version of its worker">{clean(what.version)}</Fact>}
        {what?.denoiser && <Fact name="Noise removed by">{clean(what.denoiser)}</Fact>}
        {what?.ffmpeg && <Fact name="Videos by">ffmpeg {clean(what.ffmpeg)}</Fact>}
        {(what?.renderers?.length ?? 0) > 0 && (
          <Fact name="Renderers">
            {what!.renderers!.map((one) => `${one.name} ${one.version}`).join(", ")}
          </Fact>
        )}
      </dl>
      {node.activity && (
        <p>
          It does the <Activity of={node.activity} />, since <Time at={node.activity.started} exact />.
        </p>
      )}
      {node.idle_reason && <p>It is idle: {told(node.idle_reason)}.</p>}
      {node.set_aside && (
        <p class="trouble">
          <span class="glyph" aria-hidden="true">
            ✕
          </span>
          Set aside: {clean(node.set_aside)}
        </p>
      )}
    </>
  );
}

function Fact(props: { name: string; children: preact.ComponentChildren }) {
  return (
    <div>
      <dt>{props.name}</dt>
      <dd>{props.children}</dd>
    </div>
  );
}

/** Gives an order. Whether it was taken. */
type Order = (change: NodeChange) => Promise<boolean>;

function Orders(props: { node: Node; order: Order; busy: boolean }) {
  const { node, order, busy } = props;
  return (
    <div class="buttons">
      {node.drain ? (
        <Act busy={busy} press={() => void order({ drain: false })}>
          Back to work
        </Act>
      ) : (
        <Act
          busy={busy}
          title="It finishes its task and takes no more"
          press={() => void order({ drain: true })}
        >
          Drain
        </Act>
      )}
      {node.pause ? (
        <Act busy={busy} press={() => void order({ pause: false })}>
          Resume
        </Act>
      ) : (
        <Act busy={busy} title="It keeps its task and stands still" press={() => void order({ pause: true })}>
          Pause
        </Act>
      )}
      {node.set_aside ? (
        <Act busy={busy} press={() => void order({ set_aside: false })}>
          Bring back
        </Act>
      ) : (
        <Act
          class="danger"
          busy={busy}
          title="It gets no tasks until it is brought back"
          press={() => void order({ set_aside: true })}
        >
          Set aside
        </Act>
      )}
      {node.task_id && (
        <Act
          class="danger"
          busy={busy}
          title="Any node may start the task again"
          press={() => void order({ cancel_task: true })}
        >
          Take its task away
        </Act>
      )}
    </div>
  );
}

function Terms(props: { node: Node; order: Order; busy: boolean }) {
  const { node, order, busy } = props;
  const [price, setPrice] = useState(moneyField(node.price_per_hour));
  const [editing, setEditing] = useState(false);
  const micros = parseMoney(price);
  return (
    <details class="terms">
      <summary>Price and schedule</summary>
      <form
        class="inline-form"
        onSubmit={(event) => {
          event.preventDefault();
          if (micros !== null) void order({ price_per_hour: micros });
        }}
      >
        <Field label="Price per hour" error={micros === null ? "Write an amount such as 0.40." : null}>
          {(id) => (
            <input
              id={id}
              inputMode="decimal"
              value={price}
              onInput={(event) => setPrice(event.currentTarget.value)}
            />
          )}
        </Field>
        <Act type="submit" busy={busy || micros === null || micros === node.price_per_hour}>
          Set the price
        </Act>
        {node.price_set && (
          <Act busy={busy} press={() => void order({ price_per_hour: null })}>
            What the node says
          </Act>
        )}
      </form>
      <p>
        Awake: {node.schedule ? scheduleWords(node.schedule) : "always"}.{" "}
        {!editing && (
          <button type="button" class="plain" onClick={() => setEditing(true)}>
            Change the schedule
          </button>
        )}
      </p>
      {editing && (
        <Schedule
          schedule={node.schedule ?? null}
          isSet={node.schedule_set ?? false}
          busy={busy}
          save={async (schedule) => {
            if (await order({ schedule })) setEditing(false);
          }}
          close={() => setEditing(false)}
        />
      )}
      <Maintenance node={node} order={order} busy={busy} />
    </details>
  );
}

/** Times at which the node is closed, whatever its schedule says. */
function Maintenance(props: { node: Node; order: Order; busy: boolean }) {
  const { node, order, busy } = props;
  const [from, setFrom] = useState("");
  const [to, setTo] = useState("");
  const start = timestampOf(from);
  const end = timestampOf(to);
  const spans = node.terms?.maintenance ?? [];
  const set = (maintenance: typeof spans) => order({ terms: { ...NO_TERMS, ...node.terms, maintenance } });
  return (
    <>
      <ul class="sentences">
        {spans.map((span) => (
          <li key={span.start}>
            Maintenance from <Time at={span.start} />{" "}
            {span.end ? (
              <>
                to <Time at={span.end} />
              </>
            ) : (
              "without end"
            )}{" "}
            <Act class="plain" busy={busy} press={() => void set(spans.filter((one) => one !== span))}>
              Remove
            </Act>
          </li>
        ))}
      </ul>
      <form
        class="inline-form"
        onSubmit={(event) => {
          event.preventDefault();
          if (start === null || (to !== "" && end === null)) return;
          void set([...spans, { start, end }]).then((done) => done && (setFrom(""), setTo("")));
        }}
      >
        <Moment label="Maintenance from" required value={from} change={setFrom} />
        <Moment label="to (empty: without end)" zoned={false} value={to} change={setTo} />
        <Act type="submit" busy={busy || from === ""}>
          Add
        </Act>
      </form>
    </>
  );
}

const NO_TERMS = {
  billing_step_seconds: 0,
  minimum_booking_seconds: 0,
  setup_seconds: 0,
  window_end: "finish",
} as const;
