// Money: tonight and the nights after, against budgets.

import { useEffect } from "preact/hooks";
import { post } from "../../api/client";
import type { BudgetForecast, MoneyForecast } from "../../api/types";
import { onEvents } from "../../state/live";
import { clean, counted, dayName, money, nightOf, percent, timeZone } from "../../ui/format";
import { Mark } from "../../ui/mark";
import { AsOf, Money, Section, TableBehind, Time, Trouble, Waiting } from "../../ui/parts";
import { useResource } from "../../ui/resource";

const DAY = 86_400_000;
const NAMES = ["Last night", "Tonight"];

/** What so many nights cost, the first of them so many nights ago. What each job costs is not on any screen. */
export function forecastNights(ago: number, days: number, signal: AbortSignal): Promise<BudgetForecast> {
  const date = nightOf(Date.now() - ago * DAY);
  return post("/v1/budget-forecasts", {
    body: { date, days, zone: timeZone, by_job: false, max_age: 60 },
    signal,
  });
}

export function Spend(props: { version: number }) {
  const forecast = useResource(
    (signal) =>
      // From last night on: the service keeps the forecast that it makes for the first night, and the forecast
      // of tonight, with which the record compares, must stay what it was in the evening.
      forecastNights(1, 5, signal),
    [],
    props.version,
  );
  useEffect(
    () =>
      onEvents(
        (events) => events.some((event) => event.kind === "budget") && forecast.reload(),
        forecast.reload,
      ),
    [],
  );
  return (
    <Section title="Spend" class="spend" aside={forecast.data && <AsOf at={forecast.data.made_at} />}>
      {forecast.data ? (
        <>
          {forecast.error && <Trouble error={forecast.error} retry={forecast.reload} />}
          <Nights forecast={forecast.data} />
        </>
      ) : forecast.error ? (
        <Trouble error={forecast.error} retry={forecast.reload} />
      ) : (
        <Waiting>Forecasting what the nights cost…</Waiting>
      )}
    </Section>
  );
}

function Nights(props: { forecast: BudgetForecast }) {
  const { forecast } = props;
  const most = Math.max(1, ...forecast.nights.map((night) => night.cost.p95));
  return (
    <>
      <ul class="nights">
        {forecast.nights.map((night, at) => (
          <li key={night.date}>
            <span class="night-name">{NAMES[at] ?? dayName(Date.parse(night.from))}</span>
            <Bar spent={night.spent} cost={night.cost} limit={null} most={most} />
            <span class="number right">{money(at === 0 ? night.spent : night.cost.p50)}</span>
            <span class="number right muted">{at === 0 ? "spent" : `to ${money(night.cost.p95)}`}</span>
          </li>
        ))}
      </ul>
      <p class="note">
        A night is the 24 hours from noon, in {forecast.zone}. P50 to P95; the dark part is spent.
        {forecast.unknown_total > 0 &&
          ` Without ${counted(forecast.unknown_total, "job that has", "jobs that have")} no forecast yet.`}
      </p>
      <Budgets forecast={forecast} />
      <TableBehind
        label="Nights by project, as a table"
        head={["Night", "Project", "Spent", "P50", "P80", "P95"]}
        rows={() =>
          forecast.nights.flatMap((night) =>
            [{ name: "all", spent: night.spent, cost: night.cost }, ...night.projects].map((line) => [
              night.date,
              clean(line.name),
              <Money of={line.spent} />,
              <Money of={line.cost.p50} />,
              <Money of={line.cost.p80} />,
              <Money of={line.cost.p95} />,
            ]),
          )
        }
      />
    </>
  );
}

function Budgets(props: { forecast: BudgetForecast }) {
  const { forecast } = props;
  // Of the periods to come, only those that need somebody.
  const budgets = forecast.budgets.filter(
    (budget) => isPresent(budget) || (budget.threatened && Date.parse(budget.from) > Date.now()),
  );
  if (budgets.length === 0)
    return (
      <p class="note">
        No budget is set. <code>forelight budget set film 250 --per night</code> sets one.
      </p>
    );
  return (
    <>
      <ul class="budgets">
        {budgets.map((budget) => (
          <li key={`${budget.project}-${budget.period}-${budget.from}`}>
            <span>
              {clean(budget.project)}, per {budget.period === "total" ? "project" : budget.period}
              {!isPresent(budget) && `, ${dayName(Date.parse(budget.from))}`}
            </span>
            <Bar
              spent={budget.spent}
              cost={budget.cost}
              limit={budget.amount}
              most={Math.max(budget.amount, budget.cost.p95)}
            />
            <span class="number right">
              {money(budget.cost.p50)} of {money(budget.amount)}
            </span>
            <span class="right">
              <Mark
                of={budget.threatened ? "risk" : "kept"}
                word={`risk of exceeding it ${percent(budget.probability_over)}`}
              />
            </span>
          </li>
        ))}
      </ul>
      <TableBehind
        label="Budgets, as a table"
        head={["Project", "Per", "From", "Spent", "P50", "P80", "P95", "Budget", "Risk of exceeding it"]}
        rows={() =>
          budgets.map((budget) => [
            clean(budget.project),
            budget.period === "total" ? "project" : budget.period,
            <Time at={budget.from} />,
            <Money of={budget.spent} />,
            <Money of={budget.cost.p50} />,
            <Money of={budget.cost.p80} />,
            <Money of={budget.cost.p95} />,
            <Money of={budget.amount} />,
            percent(budget.probability_over),
          ])
        }
      />
    </>
  );
}

/** Spent, then P50, P80 and P95 of the whole, and the limit as a line. */
export function Bar(props: { spent: number; cost: MoneyForecast; limit: number | null; most: number }) {
  const x = (amount: number) => (Math.min(amount, props.most) / Math.max(props.most, 1)) * 1000;
  const { spent, cost, limit } = props;
  return (
    <svg
      class="money-bar"
      viewBox="0 0 1000 16"
      preserveAspectRatio="none"
      role="img"
      aria-label={`${money(spent)} spent; P50 ${money(cost.p50)}, P80 ${money(cost.p80)}, P95 ${money(cost.p95)}${
        limit === null ? "" : `; budget ${money(limit)}`
      }`}
    >
      <rect class="base" width="1000" height="16" />
      <rect class="p95" width={x(cost.p95)} y="3" height="10" />
      <rect class="p80" width={x(cost.p80)} y="3" height="10" />
      <rect class="p50" width={x(cost.p50)} y="3" height="10" />
      <rect class="spent" width={x(spent)} y="3" height="10" />
      {limit !== null && <line class="limit" x1={x(limit)} x2={x(limit)} y1="0" y2="16" />}
    </svg>
  );
}

/** Whether now lies in the period of a budget. */
function isPresent(budget: BudgetForecast["budgets"][number]): boolean {
  return Date.parse(budget.from) <= Date.now() && Date.now() < Date.parse(budget.until);
}
