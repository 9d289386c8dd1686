// The forecast of the nights to come beside what the nights before really cost.

import type { BudgetForecast } from "../../api/types";
import { counted, dayName, money, percent } from "../../ui/format";
import { Money, Prose, Section, TableBehind, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";
import { Bar, forecastNights } from "../tonight/spend";

const BEFORE = 6;
const AHEAD = 4;

export function Nights() {
  const answer = useResource<BudgetForecast>((signal) => forecastNights(BEFORE, BEFORE + AHEAD, signal), []);
  const doc = answer.data;
  return (
    <Section title="Nights">
      {doc ? (
        <Table doc={doc} />
      ) : answer.error ? (
        <Trouble error={answer.error} retry={answer.reload} />
      ) : (
        <Waiting>Adding up the nights…</Waiting>
      )}
    </Section>
  );
}

function Table(props: { doc: BudgetForecast }) {
  const { doc } = props;
  const most = Math.max(1, ...doc.nights.map((night) => Math.max(night.cost.p95, night.spent)));
  const record = doc.track_record;
  const now = Date.now();
  return (
    <>
      <ul class="nights">
        {doc.nights.map((night) => {
          const past = Date.parse(night.until) <= now;
          return (
            <li key={night.date} class={past ? "past-night" : ""}>
              <span class="night-name">
                {Date.parse(night.from) <= now && !past ? "Tonight" : dayName(Date.parse(night.from))}
              </span>
              <Bar
                spent={night.spent}
                cost={past ? { p50: night.spent, p80: night.spent, p95: night.spent } : night.cost}
                limit={null}
                most={most}
              />
              <span class="number right">{money(past ? night.spent : night.cost.p50)}</span>
              <span class="number right muted">{past ? "spent" : `to ${money(night.cost.p95)}`}</span>
            </li>
          );
        })}
      </ul>
      <p class="note">
        <Prose text={recordWords(record)} />
      </p>
      <TableBehind
        label="Nights, as a table"
        head={["Night", "Spent", "P50", "P80", "P95"]}
        rows={() =>
          doc.nights.map((night) => [
            night.date,
            <Money of={night.spent} />,
            <Money of={night.cost.p50} />,
            <Money of={night.cost.p80} />,
            <Money of={night.cost.p95} />,
          ])
        }
      />
    </>
  );
}

function recordWords(record: BudgetForecast["track_record"]): string {
  if (record.nights === 0) {
    return "No night was forecast before it began yet. `forelight budget`, run every evening, keeps forecasts for comparison.";
  }
  const [p50, p80, p95] = [record.within_p50, record.within_p80, record.within_p95].map((nights) =>
    percent(nights / record.nights),
  );
  const [were, they] = record.nights === 1 ? ["was", "it"] : ["were", "they"];
  return `Of ${counted(record.nights, "night")} that ${were} forecast before ${they} began, ${p50} cost at most P50, ${p80} at most P80, ${p95} at most P95.`;
}
