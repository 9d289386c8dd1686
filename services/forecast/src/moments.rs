//! Means and variances that stay accurate for costs with a large offset, and sums with error compensation.

use crate::cost::{COLUMNS, Cost, Row};

/// Count, exact sum, and sum of squared deviations of every column. Deviations follow Welford (1962), since
/// E\[x²\] − E\[x\]² would lose all digits. Sums are integers, so the total of a complete sample is exact.
#[derive(Clone, Debug, Default)]
pub(crate) struct Moments {
    pub count: u64,
    sum: [u128; COLUMNS],
    running_mean: Row,
    deviations: Row,
    largest: [u128; COLUMNS],
}

impl Moments {
    /// Adds one pixel.
    pub fn push(&mut self, cost: &Cost) {
        self.count += 1;
        let count = self.count as f64;
        for (column, value) in cost.columns().into_iter().enumerate() {
            self.sum[column] += value;
            self.largest[column] = self.largest[column].max(value);
            let value = value as f64;
            let before = value - self.running_mean[column];
            self.running_mean[column] += before / count;
            self.deviations[column] += before * (value - self.running_mean[column]);
        }
    }

    /// Merges two sets of pixels (Chan, Golub, LeVeque 1979).
    pub fn merge(&mut self, other: &Moments) {
        if other.count == 0 {
            return;
        }
        if self.count == 0 {
            self.clone_from(other);
            return;
        }
        let (own, its) = (self.count as f64, other.count as f64);
        let both = own + its;
        for column in 0..COLUMNS {
            let apart = other.running_mean[column] - self.running_mean[column];
            self.running_mean[column] += apart * its / both;
            self.deviations[column] += other.deviations[column] + apart * apart * own * its / both;
            self.sum[column] += other.sum[column];
            self.largest[column] = self.largest[column].max(other.largest[column]);
        }
        self.count += other.count;
    }

    /// The exact sum of a column, rounded once.
    pub fn sum(&self, column: usize) -> f64 {
        self.sum[column] as f64
    }

    /// Mean of a column. Zero without pixels.
    pub fn mean(&self, column: usize) -> f64 {
        if self.count == 0 { 0.0 } else { self.sum(column) / self.count as f64 }
    }

    /// The largest value less the mean.
    pub fn reach(&self, column: usize) -> f64 {
        (self.largest[column] as f64 - self.mean(column)).max(0.0)
    }

    /// Sum of squared deviations from the mean.
    pub fn deviations(&self, column: usize) -> f64 {
        self.deviations[column]
    }

    /// Sample variance with the divisor n − 1. `None` for fewer than two pixels.
    pub fn variance(&self, column: usize) -> Option<f64> {
        (self.count >= 2).then(|| self.deviations[column] / (self.count - 1) as f64)
    }
}

/// A sum with Neumaier's compensation (Neumaier 1974): its error does not grow with the number of terms.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sum {
    total: f64,
    lost: f64,
}

impl Sum {
    /// Adds one term.
    pub fn add(&mut self, term: f64) {
        let total = self.total + term;
        self.lost += if self.total.abs() >= term.abs() {
            (self.total - total) + term
        } else {
            (term - total) + self.total
        };
        self.total = total;
    }

    /// The sum so far.
    pub fn value(&self) -> f64 {
        self.total + self.lost
    }
}

/// Compensated sum of the terms, in their order.
pub(crate) fn sum(terms: impl IntoIterator<Item = f64>) -> f64 {
    let mut sum = Sum::default();
    terms.into_iter().for_each(|term| sum.add(term));
    sum.value()
}

#[cfg(test)]
mod tests {
    use super::{Moments, sum};
    use crate::cost::Cost;

    fn moments(works: impl IntoIterator<Item = u64>) -> Moments {
        let mut moments = Moments::default();
        works.into_iter().for_each(|work| moments.push(&Cost { work, ..Cost::default() }));
        moments
    }

    #[test]
    fn a_tiny_variance_on_a_large_offset_is_found() {
        let offset = 1_000_000_000_000_000;
        let found = moments((0..1000).map(|i| offset + i % 2)).variance(0).expect("a thousand values");
        let true_variance = 0.25 * 1000.0 / 999.0;
        assert!((found - true_variance).abs() < 1e-9, "{found}");
    }

    #[test]
    fn merging_equals_pushing_one_by_one() {
        let mut left = moments([3, 9, 1_000_000]);
        left.merge(&moments([5, 5]));
        let all = moments([3, 9, 1_000_000, 5, 5]);
        assert_eq!(left.sum(0), all.sum(0));
        let (merged, direct) = (left.variance(0).unwrap_or(0.0), all.variance(0).unwrap_or(1.0));
        assert!((merged / direct - 1.0).abs() < 1e-12);
        let mut empty = Moments::default();
        empty.merge(&all);
        assert_eq!(empty.count, 5);
    }

    #[test]
    fn sums_of_the_largest_integers_are_exact() {
        let found = moments([u64::MAX, u64::MAX, 1]);
        assert_eq!(found.sum(0), (2.0 * u64::MAX as f64) + 1.0);
    }

    #[test]
    fn cancelling_terms_leave_the_small_ones() {
        let terms = (0..100_000).flat_map(|_| [1e16, 1.0, -1e16]);
        assert_eq!(sum(terms), 100_000.0);
    }
}
