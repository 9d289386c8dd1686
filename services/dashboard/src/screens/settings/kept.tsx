// How long the farm keeps what it has made, and what is past its time.

import { useState } from "preact/hooks";
import { get, post } from "../../api/client";
import type { Schemas } from "../../api/client";
import { bytes, clean, counted, grouped, sentence, words } from "../../ui/format";
import { Confirm } from "../../ui/dialog";
import { Field, Section, Time, Trouble, Waiting } from "../../ui/parts";
import { asError, useResource } from "../../ui/resource";

type Rule = Schemas["RetentionRule"];
type Pruned = Schemas["Pruned"];

const ABOUT: Partial<Record<Rule["kind"], string>> = {
  images: "and previews and cost maps, from the end of their job",
  profiles: "and irradiance caches, from the end of their job",
  scenes: "that were uploaded, from the end of the last job that used them",
  logs: "from when their lines were written",
  events: "from when they happened",
  plans: "from when they were made; the newest one stays",
  jobs: "with all that is left of them, from their end; their cost stays in the books",
};

const OF_PROJECTS: Rule["kind"][] = ["images", "profiles", "jobs"];

export function Kept() {
  const rules = useResource((signal) => get("/v1/retention", { signal }), []);
  const [changing, setChanging] = useState<Rule | null>(null);
  const past = usePast();
  const last = rules.data?.last;
  return (
    <Section
      title="How long things are kept"
      aside={
        <button type="button" onClick={() => setChanging({ kind: "images", project: "", days: 30 })}>
          A rule for a project…
        </button>
      }
    >
      {rules.error && <Trouble error={rules.error} retry={rules.reload} />}
      {!rules.data && rules.loading && <Waiting>Asking how long things are kept…</Waiting>}
      {rules.data && <Rules rules={rules.data.items} change={setChanging} />}
      <p>
        {last ? (
          <>
            Every night the farm deletes what is past its time: last at <Time at={last.at} />,{" "}
            {prunedWords(last)}.
          </>
        ) : (
          "Every night the farm deletes what is past its time. It has deleted nothing yet."
        )}
      </p>
      <PastItsTime past={past} deleted={rules.reload} />
      {changing && (
        <Change
          rule={changing}
          close={() => setChanging(null)}
          changed={() => (rules.reload(), past.forget())}
        />
      )}
    </Section>
  );
}

function Rules(props: { rules: readonly Rule[]; change: (rule: Rule) => void }) {
  return (
    <div class="scroll-x" tabIndex={0} role="region" aria-label="Rules">
      <table class="rules">
        <thead>
          <tr>
            {["What", "Project", "Kept", ""].map((name) => (
              <th scope="col" key={name}>
                {name || <span class="unseen">Change</span>}
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {props.rules.map((rule) => (
            <tr key={`${rule.project ?? ""} ${rule.kind}`}>
              <th scope="row">
                {words(rule.kind)} <span class="muted">{ABOUT[rule.kind]}</span>
              </th>
              <td>{rule.project ? clean(rule.project) : "all"}</td>
              <td>{keptWords(rule)}</td>
              <td>
                <button
                  type="button"
                  onClick={() => props.change(rule)}
                  aria-label={`Change: ${words(rule.kind)}${rule.project ? ` of ${clean(rule.project)}` : ""}`}
                >
                  Change…
                </button>
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

/** What is past its time. */
interface Past {
  looked: Pruned | null;
  looking: boolean;
  error: Error | null;
  look: () => Promise<void>;
  forget: () => void;
}

function usePast(): Past {
  const [looked, setLooked] = useState<Pruned | null>(null);
  const [looking, setLooking] = useState(false);
  const [error, setError] = useState<Error | null>(null);
  const look = async () => {
    setLooking(true);
    try {
      setLooked(await post("/v1/prune", { body: { dry_run: true } }));
      setError(null);
    } catch (failure) {
      setError(asError(failure));
    }
    setLooking(false);
  };
  return { looked, looking, error, look, forget: () => setLooked(null) };
}

/** What would be deleted now, and deleting it without waiting for the night. */
function PastItsTime(props: { past: Past; deleted: () => void }) {
  const { looked, looking, error, look, forget } = props.past;
  const [deleting, setDeleting] = useState(false);
  return (
    <>
      <div class="buttons">
        <button type="button" disabled={looking} onClick={() => void look()}>
          {looking ? "Looking…" : "What would be deleted now?"}
        </button>
        {looked && deletes(looked) && (
          <button type="button" class="danger" onClick={() => setDeleting(true)}>
            Delete it now…
          </button>
        )}
      </div>
      {looked && <p role="status">Now it would delete {prunedWords(looked)}.</p>}
      {error && <Trouble error={error} />}
      {deleting && looked && (
        <Confirm
          title="Delete it now?"
          act="Delete it"
          danger
          run={async () => {
            await post("/v1/prune", { body: { dry_run: false } });
            forget();
            props.deleted();
          }}
          close={() => setDeleting(false)}
        >
          <p>This deletes {prunedWords(looked)}. It cannot be undone.</p>
        </Confirm>
      )}
    </>
  );
}

function keptWords(rule: Rule): string {
  return rule.days == null ? "for ever" : counted(rule.days, "day");
}

/** Whether anything is past its time. */
function deletes(pruned: Pruned): boolean {
  return pruned.items.some((item) => item.number > 0) || pruned.deleted.bytes > 0;
}

/** What was or would be deleted: `12 images of jobs, 300 events; files of 3.2 GiB`. */
function prunedWords(pruned: Pruned): string {
  const kinds = pruned.items
    .filter((item) => item.number > 0)
    .map((item) => {
      const ofJobs = OF_PROJECTS.includes(item.kind) && item.kind !== "jobs";
      return ofJobs
        ? `${words(item.kind)} of ${counted(item.number, "job")}`
        : `${grouped(item.number)} ${words(item.kind)}`;
    });
  const freed = pruned.items.reduce((sum, item) => sum + item.bytes, 0) + pruned.deleted.bytes;
  return `${kinds.join(", ") || "nothing"}${freed > 0 ? `; files of ${bytes(freed)}` : ""}`;
}

function Change(props: { rule: Rule; close: () => void; changed: () => void }) {
  const { rule } = props;
  const isNew = rule.project === "";
  const [project, setProject] = useState("");
  const [kind, setKind] = useState(rule.kind);
  const [days, setDays] = useState(rule.days == null ? "" : String(rule.days));
  const of = isNew ? project.trim() : rule.project;
  const run = async () => {
    const body = { kind, ...(of ? { project: of } : {}), ...(days === "" ? {} : { days: Number(days) }) };
    await post("/v1/retention", { body });
    props.changed();
  };
  return (
    <Confirm
      title={isNew ? "A rule for a project" : `How long ${words(kind)} are kept${of ? `: ${clean(of)}` : ""}`}
      act="Set it"
      ready={!isNew || project.trim() !== ""}
      run={run}
      close={props.close}
    >
      {isNew && (
        <>
          <Field label="Project">
            {(id) => (
              <input
                id={id}
                required
                value={project}
                onInput={(event) => setProject(event.currentTarget.value)}
              />
            )}
          </Field>
          <Field label="What">
            {(id) => (
              <select
                id={id}
                value={kind}
                onChange={(event) => setKind(event.currentTarget.value as Rule["kind"])}
              >
                {OF_PROJECTS.map((one) => (
                  <option key={one} value={one}>
                    {words(one)}
                  </option>
                ))}
              </select>
            )}
          </Field>
        </>
      )}
      <Field label="Days (empty: for ever)" hint={ABOUT[kind] && sentence(`${words(kind)} ${ABOUT[kind]}`)}>
        {(id) => (
          <input
            id={id}
            type="number"
            min={0}
            max={36500}
            value={days}
            onInput={(event) => setDays(event.currentTarget.value)}
          />
        )}
      </Field>
    </Confirm>
  );
}
