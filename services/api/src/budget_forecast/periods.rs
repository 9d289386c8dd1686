//! Periods of budgets, and their expected cost.

use forelight_protocol::{Budget, BudgetOutlook, Money, Timestamp};

use super::basis::Basis;
use super::money::{quantiles, sum};

/// A budget or deadline is threatened if the probability of missing it exceeds this.
pub(super) const THREATENED: f64 = 0.2;

pub(super) struct Period<'a> {
    pub budget: &'a Budget,
    pub from: Timestamp,
    pub until: Timestamp,
    spent: i64,
    pub to_come: Vec<i64>,
}

pub(super) fn periods(basis: &Basis, scenarios: usize) -> Vec<Period<'_>> {
    let Some(last) = basis.nights.last() else { return Vec::new() };
    let mut periods = Vec::new();
    for budget in &basis.budgets {
        let mut at = basis.nights[0].from;
        while at < last.until
            && let Some((from, until)) = budget.period.bounds(&budget.zone, at)
        {
            let of_project = basis.ledger.iter().filter(|line| line.project == budget.project);
            let spent = sum(of_project.map(|line| line.cost_within(from, until.min(basis.now))));
            periods.push(Period { budget, from, until, spent: spent.0, to_come: vec![0; scenarios] });
            at = until;
        }
    }
    periods
}

pub(super) fn outlook(period: Period) -> BudgetOutlook {
    let Period { budget, from, until, spent, mut to_come } = period;
    to_come.sort_unstable();
    let over = to_come.iter().filter(|&&sum| sum.saturating_add(spent) > budget.amount.0).count();
    let probability_over = over as f64 / to_come.len().max(1) as f64;
    BudgetOutlook {
        project: budget.project.clone(),
        period: budget.period,
        from,
        until,
        amount: budget.amount,
        spent: Money(spent),
        cost: quantiles(&to_come, spent),
        probability_over,
        threatened: probability_over > THREATENED,
    }
}
