//! What a pixel cost, and what is said about the cost of many.

use serde::{Deserialize, Serialize};

/// Number of ray categories: primary, shadow, transparent, reflected, refracted, ambient, specular, in this
/// order (Gillibrand et al. 2006).
pub const RAY_KINDS: usize = 7;

/// Indices of shadow rays and of those that gather indirect light.
const SHADOW: usize = 1;
const AMBIENT: usize = 5;

/// Columns that are estimated side by side: work, CPU time, all rays, and the rays of each category.
pub(crate) const COLUMNS: usize = 3 + RAY_KINDS;

/// Index of the work column.
pub(crate) const WORK: usize = 0;

/// One number for each column.
pub(crate) type Row = [f64; COLUMNS];

/// Adds `factor` times another row.
pub(crate) fn add_scaled(row: &mut Row, factor: f64, other: &Row) {
    for (value, other) in row.iter_mut().zip(other) {
        *value += factor * other;
    }
}

/// Measured cost of one pixel, or of the fixed part of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cost {
    /// Deterministic count of operations.
    pub work: u64,
    /// Thread CPU time in nanoseconds.
    pub cpu_nanos: u64,
    /// Rays by category, in the order of [`RAY_KINDS`].
    pub rays: [u64; RAY_KINDS],
}

impl Cost {
    /// What a pixel costs with `factor` times as many camera samples, to the nearest whole number. Of its work `extra` is not in proportion to
    /// them: that is multiplied by `extra_factor`. It is in gathered rays and what comes with them, so its share of the time is that of
    /// the work, and its rays are ambient and shadow rays.
    #[must_use]
    pub fn with_samples(&self, factor: f64, extra: u64, extra_factor: f64) -> Self {
        let share = extra.min(self.work) as f64 / self.work.max(1) as f64;
        let mixed = factor + share * (extra_factor - factor);
        // Saturates at the ends of the range, as float to integer does.
        let times = |value: u64, factor: f64| (value as f64 * factor).round() as u64;
        let mut rays = self.rays.map(|rays| times(rays, factor));
        for kind in [SHADOW, AMBIENT] {
            rays[kind] = times(self.rays[kind], mixed);
        }
        Self { work: times(self.work, mixed), cpu_nanos: times(self.cpu_nanos, mixed), rays }
    }

    /// The mean of some, to the nearest whole number; nothing of none.
    #[must_use]
    pub fn mean(all: &[Self]) -> Self {
        let mean = |of: &dyn Fn(&Self) -> u64| {
            let sum: u128 = all.iter().map(|cost| u128::from(of(cost))).sum();
            let count = (all.len() as u128).max(1);
            // No more than the largest of them.
            ((sum + count / 2) / count) as u64
        };
        Self {
            work: mean(&|cost| cost.work),
            cpu_nanos: mean(&|cost| cost.cpu_nanos),
            rays: std::array::from_fn(|kind| mean(&|cost| cost.rays[kind])),
        }
    }

    /// The columns as integers wide enough for any sum over a frame.
    pub(crate) fn columns(&self) -> [u128; COLUMNS] {
        let mut columns = [0; COLUMNS];
        columns[0] = u128::from(self.work);
        columns[1] = u128::from(self.cpu_nanos);
        for (column, &rays) in columns[3..].iter_mut().zip(&self.rays) {
            *column = u128::from(rays);
        }
        columns[2] = columns[3..].iter().sum();
        columns
    }
}

/// A profiled pixel: the stratum that the preview saw there, and what tracing it cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Observation {
    /// Index of the pixel's stratum.
    pub stratum: u32,
    /// What the pixel cost.
    pub cost: Cost,
}

/// One value of type `T` for each kind of cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Costs<T> {
    /// Operations.
    pub work: T,
    /// Thread CPU time in nanoseconds.
    pub cpu_nanos: T,
    /// Rays of all categories together.
    pub all_rays: T,
    /// Rays by category, in the order of [`RAY_KINDS`].
    pub rays: [T; RAY_KINDS],
}

impl<T: Copy> From<[T; COLUMNS]> for Costs<T> {
    fn from(columns: [T; COLUMNS]) -> Self {
        let [work, cpu_nanos, all_rays, rays @ ..] = columns;
        Costs { work, cpu_nanos, all_rays, rays }
    }
}

/// An estimated total with its one-sided quantiles. A total of which everything is known has all of them equal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quantity {
    /// The estimate; unbiased where every group of strata was sampled.
    pub mean: f64,
    /// The total is as likely above as below this.
    pub p50: f64,
    /// The total stays below this in four cases of five.
    pub p80: f64,
    /// The total stays below this in nineteen cases of twenty.
    pub p95: f64,
    /// Estimated variance of the estimate, before any inflation.
    pub variance: f64,
    /// Degrees of freedom behind the variance; infinite where the variance is zero.
    pub degrees_of_freedom: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_in_proportion_to_the_samples_grows_by_a_factor_of_its_own() {
        let pixel = Cost { work: 100, cpu_nanos: 1000, rays: [4, 8, 0, 2, 0, 40, 0] };
        assert_eq!(pixel.with_samples(1.0, 60, 1.0), pixel);
        let four_times = Cost { work: 400, cpu_nanos: 4000, rays: [16, 32, 0, 8, 0, 160, 0] };
        assert_eq!(pixel.with_samples(4.0, 0, 1.5), four_times);
        // 40 · 4 + 60 · 1.5 of 100.
        let mixed = Cost { work: 250, cpu_nanos: 2500, rays: [16, 20, 0, 8, 0, 100, 0] };
        assert_eq!(pixel.with_samples(4.0, 60, 1.5), mixed);
        assert_eq!(Cost::default().with_samples(4.0, 60, 1.5), Cost::default());
        // More than all is all.
        assert_eq!(pixel.with_samples(4.0, 1000, 1.5).work, 150);
    }
}
