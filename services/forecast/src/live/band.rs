//! A forecast of one number, and the arithmetic of its logarithms.

use crate::conformal::{Measure, NORMAL_95};

/// A forecast of one number: its mean and three quantiles. All are non-negative, and the quantiles ascend.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Band {
    /// Expected value.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 80 % quantile.
    pub p80: f64,
    /// 95 % quantile.
    pub p95: f64,
}

impl Band {
    /// A known number: all four are `value`.
    pub const fn known(value: f64) -> Self {
        Self { mean: value, p50: value, p80: value, p95: value }
    }

    /// Adds a known amount.
    pub(super) fn plus(self, spent: f64) -> Self {
        let Self { mean, p50, p80, p95 } = self;
        Self { mean: mean + spent, p50: p50 + spent, p80: p80 + spent, p95: p95 + spent }
    }

    /// Standard deviation of the logarithm that the quantiles imply, combined with the measure's constant.
    pub(super) fn spread(&self, measure: Measure) -> f64 {
        libm::hypot(log_ratio(self.p95, self.p50) / NORMAL_95, measure.extra_deviation())
    }
}

/// The value, or zero if it is negative or not finite.
pub(super) fn positive(value: f64) -> f64 {
    if value.is_finite() && value > 0.0 { value } else { 0.0 }
}

/// ln(a / b). Zero if either is not positive and finite.
pub(super) fn log_ratio(a: f64, b: f64) -> f64 {
    let (a, b) = (positive(a), positive(b));
    if a > 0.0 && b > 0.0 { libm::log(a) - libm::log(b) } else { 0.0 }
}
