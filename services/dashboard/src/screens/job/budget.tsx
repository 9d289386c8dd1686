// What the budget of a job's project is expected to hold back.

import type { Job } from "../../api/types";
import { Mark } from "../../ui/mark";
import { Prose } from "../../ui/parts";

export function BudgetHold(props: { job: Job }) {
  const hold = props.job.budget_hold;
  if (!hold) return null;
  return (
    <p class="risk">
      <Mark of="over_budget" word="budget" /> <Prose text={hold.because} />
    </p>
  );
}
