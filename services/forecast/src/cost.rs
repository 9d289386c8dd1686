//! The cost of a pixel, and estimates of the cost of many.

use serde::{Deserialize, Serialize};

/// Number of ray categories: primary, shadow, transparent, reflected, refracted, ambient, specular.
pub const RAY_KINDS: usize = 7;

/// Index of shadow rays.
const SHADOW: usize = 1;
/// Index of rays that gather indirect light.
const AMBIENT: usize = 5;

/// Columns that are estimated side by side: work, CPU time, all rays, and the rays of each category.
pub(crate) const COLUMNS: usize = 3 + RAY_KINDS;

/// Index of the work column.
pub(crate) const WORK: usize = 0;

/// One number per column.
pub(crate) type Row = [f64; COLUMNS];

/// Adds `factor` times `other` to `row`.
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
    /// The cost of a pixel with `factor` times as many camera samples, rounded. `extra`, the work of gathered
    /// rays, is multiplied by `extra_factor` instead. Its share of CPU time is that of its work, and its rays
    /// are ambient and shadow rays.
    #[must_use]
    pub fn with_samples(&self, factor: f64, extra: u64, extra_factor: f64) -> Self {
        let share = extra.min(self.work) as f64 / self.work.max(1) as f64;
        let mixed = factor + share * (extra_factor - factor);
        // The conversion saturates at the ends of the range.
        let times = |value: u64, factor: f64| (value as f64 * factor).round() as u64;
        let mut rays = self.rays.map(|rays| times(rays, factor));
        for kind in [SHADOW, AMBIENT] {
            rays[kind] = times(self.rays[kind], mixed);
        }
        Self { work: times(self.work, mixed), cpu_nanos: times(self.cpu_nanos, mixed), rays }
    }

    /// The mean of all these costs, rounded to whole numbers. Zero if there are none.
    #[must_use]
    pub fn mean(all: &[Self]) -> Self {
        let mean = |of: &dyn Fn(&Self) -> u64| {
            let sum: u128 = all.iter().map(|cost| u128::from(of(cost))).sum();
            let count = (all.len() as u128).max(1);
            // The mean fits, because it is at most the largest of them.
            ((sum + count / 2) / count) as u64
        };
        Self {
            work: mean(&|cost| cost.work),
            cpu_nanos: mean(&|cost| cost.cpu_nanos),
            rays: std::array::from_fn(|kind| mean(&|cost| cost.rays[kind])),
        }
    }

    /// The columns, as integers wide enough for any sum over a frame.
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

/// A profiled pixel: its stratum by the preview, and its measured cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Observation {
    /// Index of the pixel's stratum.
    pub stratum: u32,
    /// Cost of tracing the pixel.
    pub cost: Cost,
}

/// One value for each kind of cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Costs<T> {
    /// Count of operations.
    pub work: T,
    /// Thread CPU time in nanoseconds.
    pub cpu_nanos: T,
    /// Rays of all categories.
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

impl Costs<f64> {
    /// The sum of both.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        Self {
            work: self.work + other.work,
            cpu_nanos: self.cpu_nanos + other.cpu_nanos,
            all_rays: self.all_rays + other.all_rays,
            rays: std::array::from_fn(|kind| self.rays[kind] + other.rays[kind]),
        }
    }

    /// This cost times `factor`.
    #[must_use]
    pub fn times(&self, factor: f64) -> Self {
        Self {
            work: self.work * factor,
            cpu_nanos: self.cpu_nanos * factor,
            all_rays: self.all_rays * factor,
            rays: self.rays.map(|rays| rays * factor),
        }
    }
}

impl From<Cost> for Costs<f64> {
    fn from(cost: Cost) -> Self {
        Self::from(cost.columns().map(|value| value as f64))
    }
}

/// An estimated total with one-sided quantiles. All four are equal if the total is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quantity {
    /// The estimate. Unbiased if every group of strata was sampled.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 80 % quantile.
    pub p80: f64,
    /// 95 % quantile.
    pub p95: f64,
    /// Estimated variance of the estimate, without inflation.
    pub variance: f64,
    /// Degrees of freedom behind the variance. Infinite where the variance is zero.
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
        // (40 · 4 + 60 · 1.5) / 100 times the cost of the pixel.
        let mixed = Cost { work: 250, cpu_nanos: 2500, rays: [16, 20, 0, 8, 0, 100, 0] };
        assert_eq!(pixel.with_samples(4.0, 60, 1.5), mixed);
        assert_eq!(Cost::default().with_samples(4.0, 60, 1.5), Cost::default());
        // An extra part of more than the whole counts as the whole.
        assert_eq!(pixel.with_samples(4.0, 1000, 1.5).work, 150);
    }
}
