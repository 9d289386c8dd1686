// Why the job costs what it costs: kinds of work, objects, light, and what would halve it.

import { get } from "../../api/client";
import type { Explanation, Job } from "../../api/types";
import { param, setQuery } from "../../state/route";
import { clean, cpuTime, grouped, percent, significant, work, words } from "../../ui/format";
import { Prose, Section, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";

export function Why(props: { job: Job; version: string }) {
  const frame = param("frame");
  const answer = useResource<Explanation>(
    (signal) =>
      get("/v1/jobs/{id}/explanation", {
        path: { id: props.job.id },
        query: frame === null ? {} : { frame: Number(frame) },
        signal,
      }),
    [props.job.id, frame],
    props.version,
  );
  const doc = answer.data;
  // Other renderers count no operations: their work is CPU time in microseconds.
  const amount = (value: number) =>
    props.job.renderer ? `${cpuTime(value / 1e6)} of CPU time` : `${work(value)} operations`;
  if (!doc)
    return answer.error ? (
      <Trouble error={answer.error} retry={answer.reload} />
    ) : (
      <Waiting>Asking why it costs that…</Waiting>
    );
  return (
    <>
      <p>
        {frame === null ? "All frames together" : `Frame ${frame}`}: {amount(doc.work)}.{" "}
        {frame !== null && (
          <button type="button" class="plain" onClick={() => setQuery({ frame: null })}>
            Explain all frames
          </button>
        )}
      </p>
      <ul class="sentences">
        {doc.words.map((line) => (
          <li key={line}>
            <Prose text={line} />
          </li>
        ))}
      </ul>
      <Parts of={doc} amount={amount} />
    </>
  );
}

/** The shares of the whole by object, by kind of ray and by part. */
function Parts(props: { of: Explanation; amount: (work: number) => string }) {
  const doc = props.of;
  return (
    <div class="columns">
      <Section title="Objects" level={3}>
        {doc.objects.length === 0 ? (
          <p class="note">The renderer does not say where in the image time goes.</p>
        ) : (
          <Shares
            head="Object and material"
            extra="× mean pixel"
            rows={doc.objects.slice(0, 15).map((line) => ({
              name: line.shows ? `${clean(line.shows.object)}, ${clean(line.shows.material)}` : "background",
              share: line.share,
              note: significant(line.times_mean_pixel, 2),
            }))}
          />
        )}
      </Section>
      {doc.rays.length > 0 && (
        <Section title="Light" level={3}>
          <Shares
            head="Kind of ray"
            extra="Rays"
            rows={doc.rays
              .filter((line) => line.rays > 0)
              .map((line) => ({
                name: line.category,
                share: line.share_of_work ?? line.share,
                note: work(line.rays),
              }))}
          />
        </Section>
      )}
      <Section title="Parts" level={3}>
        <Shares
          head="Part"
          extra="Work"
          rows={doc.parts.map((line) => ({
            name: words(line.part),
            share: line.share,
            note: props.amount(line.work),
          }))}
        />
      </Section>
      <Section title="What would halve it" level={3}>
        <Halving of={doc} />
      </Section>
    </div>
  );
}

function Halving(props: { of: Explanation }) {
  const { halving, camera_sample } = props.of;
  return (
    <>
      {halving.length === 0 ? (
        <p class="note">No single setting would.</p>
      ) : (
        <table class="numbers body">
          <thead>
            <tr>
              <th scope="col">Setting</th>
              <th scope="col" class="right">
                Now
              </th>
              <th scope="col" class="right">
                Then
              </th>
            </tr>
          </thead>
          <tbody>
            {halving.map((line) => (
              <tr key={line.setting}>
                <td>{settingName(line.setting)}</td>
                <td class="right">{grouped(line.from)}</td>
                <td class="right">{grouped(line.to)}</td>
              </tr>
            ))}
          </tbody>
        </table>
      )}
      {camera_sample > 0 && (
        <p class="note">
          One camera sample more in every pixel costs {percent(camera_sample, 1)} of the whole.
        </p>
      )}
    </>
  );
}

/** A setting of the API in words. */
export function settingName(name: string): string {
  const known: Record<string, string> = {
    spp: "camera samples per pixel",
    width: "width (and height in proportion)",
    "ambient-divisions": "rays of a gather",
    "ambient-bounces": "bounces",
    "cache-accuracy": "accuracy of the irradiance cache, thousandths",
    "cache-rays": "rays of a cache record",
  };
  return known[name] ?? words(name).replaceAll("-", " ");
}

function Shares(props: {
  head: string;
  extra: string;
  rows: { name: string; share: number; note: string }[];
}) {
  return (
    <table class="numbers body shares">
      <thead>
        <tr>
          <th scope="col">{props.head}</th>
          <th scope="col" class="right">
            Share
          </th>
          <th scope="col" aria-hidden="true"></th>
          <th scope="col" class="right">
            {props.extra}
          </th>
        </tr>
      </thead>
      <tbody>
        {props.rows.map((row) => (
          <tr key={row.name}>
            <td class="name-cell">{row.name}</td>
            <td class="right">{percent(row.share, 1)}</td>
            <td class="bar-cell" aria-hidden="true">
              <span class="bar" style={{ width: `${Math.max(1, row.share * 100)}%` }} />
            </td>
            <td class="right">{row.note}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}
