//! One-sided quantiles from a mean and a variance.

use serde::{Deserialize, Serialize};

use crate::cost::Quantity;
use crate::moments::sum;
use crate::student;

/// The factor by which intervals are widened.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Factor on the log-standard deviation behind every quantile.
    pub inflation: f64,
    /// Whether the factor was measured on past jobs.
    pub calibrated: bool,
}

impl Calibration {
    /// No past jobs. The factor 1.3 stands for what the formulas omit when costs have no heavy tail.
    pub const NONE: Calibration = Calibration { inflation: 1.3, calibrated: false };
}

/// An independent part of a variance, with its degrees of freedom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Part {
    pub variance: f64,
    pub degrees_of_freedom: f64,
}

/// Variance of a sum of independent parts, with v² / Σ (v_i² / df_i) degrees of freedom (Satterthwaite 1946).
pub(crate) fn combined(parts: &[Part]) -> Part {
    let variance = sum(parts.iter().map(|part| part.variance));
    let denominator = sum(parts
        .iter()
        .filter(|part| part.variance > 0.0)
        .map(|part| part.variance / variance * (part.variance / variance) / part.degrees_of_freedom));
    Part {
        variance,
        degrees_of_freedom: if denominator > 0.0 { (1.0 / denominator).max(1.0) } else { f64::INFINITY },
    }
}

/// Standard deviation of the logarithm of a lognormal quantity with this mean and variance: √ln(1 + v / m²).
pub(crate) fn log_deviation(mean: f64, variance: f64) -> f64 {
    if mean > 0.0 && variance > 0.0 { libm::sqrt(libm::log1p(variance / mean / mean)) } else { 0.0 }
}

/// Mean and quantiles by a log-t interval: mean · exp(t · inflation · σ), with σ from [`log_deviation`]. They
/// equal the mean if nothing is uncertain.
pub(crate) fn quantity(mean: f64, part: Part, calibration: Calibration) -> Quantity {
    let sigma = log_deviation(mean, part.variance) * calibration.inflation;
    let at = |p: f64| {
        if sigma > 0.0 {
            mean * libm::exp(sigma * student::quantile(p, part.degrees_of_freedom))
        } else {
            mean
        }
    };
    Quantity {
        mean,
        p50: mean,
        p80: at(0.80),
        p95: at(0.95),
        variance: part.variance,
        degrees_of_freedom: part.degrees_of_freedom,
    }
}
