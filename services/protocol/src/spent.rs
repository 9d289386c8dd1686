//! Cost in work and CPU time, as measured by a worker.

use crate::SpentOnForecast;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Cost in work and CPU time.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Spent {
    /// Deterministic count of operations.
    pub work: u64,
    /// CPU time over all threads in nanoseconds.
    pub cpu_nanos: u64,
}

impl Spent {
    /// The sum of both. Saturating.
    #[must_use]
    pub const fn plus(self, other: Self) -> Self {
        Self {
            work: self.work.saturating_add(other.work),
            cpu_nanos: self.cpu_nanos.saturating_add(other.cpu_nanos),
        }
    }

    /// What is left without `other`. At least zero.
    #[must_use]
    pub const fn less(self, other: Self) -> Self {
        Self {
            work: self.work.saturating_sub(other.work),
            cpu_nanos: self.cpu_nanos.saturating_sub(other.cpu_nanos),
        }
    }

    /// CPU time of a renderer that counts no work. Its work is its CPU time in microseconds.
    pub const fn uncounted(cpu_nanos: u64) -> Self {
        Self { work: cpu_nanos / 1000, cpu_nanos }
    }

    /// The cost of a quote that forecasts so much work.
    pub fn on_forecast(self, work: f64) -> SpentOnForecast {
        SpentOnForecast {
            work: self.work,
            cpu_seconds: self.cpu_nanos as f64 * 1e-9,
            fraction_of_forecast: if work > 0.0 { self.work as f64 / work } else { 0.0 },
        }
    }

    /// The mean. `None` if there are none.
    pub fn mean(all: impl ExactSizeIterator<Item = Self>) -> Option<Self> {
        let count = u64::try_from(all.len()).ok().filter(|&count| count > 0)?;
        let sum: Self = all.sum();
        Some(Self { work: sum.work / count, cpu_nanos: sum.cpu_nanos / count })
    }

    /// Converts a cost that a node of this speed measured to a node of speed 1.
    #[must_use]
    pub fn at_speed_one(self, speed: f64) -> Self {
        Self { cpu_nanos: at_speed_one(self.cpu_nanos, speed), ..self }
    }
}

impl std::iter::Sum for Spent {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), Self::plus)
    }
}

/// Converts CPU time that a node of this speed measured to a node of speed 1. In nanoseconds.
pub fn at_speed_one(cpu_nanos: u64, speed: f64) -> u64 {
    // The conversion saturates at the ends of the range.
    (cpu_nanos as f64 * speed).round() as u64
}
