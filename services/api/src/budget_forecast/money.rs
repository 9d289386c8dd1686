//! Money over time, and its quantiles.

use forelight_protocol::{Money, MoneyForecast, Timestamp};

/// A node's time to be paid for.
pub(super) struct Paid {
    pub price: Money,
    pub from: Timestamp,
    pub until: Timestamp,
}

impl Paid {
    /// Cost of its part between two instants.
    pub(super) fn within(&self, from: Timestamp, until: Timestamp) -> i64 {
        let time = self.until.min(until).micros_since(self.from.max(from));
        self.price.for_micros_at_hourly_rate(time.max(0)).0
    }
}

/// Adds to a scenario's sum. `sums` is allocated on the first addition.
pub(super) fn add(sums: &mut Vec<i64>, scenarios: usize, scenario: usize, cost: i64) {
    sums.resize(scenarios, 0);
    sums[scenario] = sums[scenario].saturating_add(cost);
}

pub(super) fn sum(amounts: impl Iterator<Item = Money>) -> Money {
    Money(amounts.fold(0i64, |sum, amount| sum.saturating_add(amount.0)))
}

/// The smallest of the sorted values that at least this percentage of them do not exceed. `None` without
/// values.
pub(super) fn at(sorted: &[i64], per_cent: usize) -> Option<i64> {
    sorted.get((sorted.len() * per_cent).div_ceil(100).saturating_sub(1)).copied()
}

pub(super) fn quantiles(sorted: &[i64], spent: i64) -> MoneyForecast {
    let value = |per_cent| Money(spent.saturating_add(at(sorted, per_cent).unwrap_or(0)));
    MoneyForecast { p50: value(50), p80: value(80), p95: value(95) }
}
