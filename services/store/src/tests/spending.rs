//! Sums of many payments, which the database makes.

use forelight_protocol::{BudgetPeriod, BudgetRequest, Money, NodeChange};

use super::*;

/// Prices and times at which rounding and overflow would show: from nothing to the highest price of a node.
const PRICES: [i64; 6] = [0, 1, 3_599, 7_200_001, 25_000_007, 1_000_000_000_000];
const MICROS: [i64; 6] = [0, 1, 999_999, 3_600_000_000, 3_600_000_001, 40 * 86_400_000_000 + 7];

#[tokio::test]
async fn sums_of_the_database_are_those_of_the_ledgers_lines() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-35"), node.id, at(0)).await;
    let mut now = at(10);
    let mut ends = Vec::new();
    for (price, micros) in PRICES.into_iter().flat_map(|price| MICROS.map(|micros| (price, micros))) {
        let change = NodeChange { price_per_hour: Some(Some(Money(price))), ..NodeChange::default() };
        farm.store.change_node(node.id, &change, now).await.unwrap();
        let lease = farm.claim(node.id, now).await.unwrap();
        now = now.plus_micros(micros);
        farm.commit(&lease, now).await;
        ends.push(now);
    }
    let project = farm.store.job(job).await.unwrap().project;
    let lines = farm.store.ledger(at(0), now.plus_micros(1)).await.unwrap();
    assert_eq!(lines.len(), ends.len());
    let mut connection = farm.store.readers().acquire().await.unwrap();
    for from in [at(0)].into_iter().chain(ends.into_iter().map(|end| end.plus_micros(-1))) {
        let sums = crate::budgets::ledger::spent_by_project(&mut connection, from, now).await.unwrap();
        let expected: i64 = lines.iter().map(|line| line.cost_within(from, now).0).sum();
        let found = sums.get(&project).copied().unwrap_or_default();
        assert_eq!(found, Money(expected), "since {from:?}");
    }
    drop(connection);
    let budget = BudgetRequest {
        project,
        period: BudgetPeriod::Total,
        amount: Money(1),
        zone: "UTC".to_owned(),
        thresholds: Vec::new(),
    };
    let budget = farm.store.set_budget(&budget, now).await.unwrap();
    assert_eq!(budget.spent.0, lines.iter().map(|line| line.cost_within(at(0), now).0).sum::<i64>());
}
