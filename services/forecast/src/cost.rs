//! What a pixel cost, and what is said about the cost of many.

use serde::{Deserialize, Serialize};

/// Number of ray categories: primary, shadow, transparent, reflected, refracted, ambient, specular, in this
/// order (Gillibrand et al. 2006).
pub const RAY_KINDS: usize = 7;

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
    /// So many times the cost, to the nearest whole number: of a pixel with `factor` times as many camera samples.
    #[must_use]
    pub fn times(&self, factor: f64) -> Self {
        // Saturates at the ends of the range, as float to integer does.
        let times = |value: u64| (value as f64 * factor).round() as u64;
        Self { work: times(self.work), cpu_nanos: times(self.cpu_nanos), rays: self.rays.map(times) }
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
