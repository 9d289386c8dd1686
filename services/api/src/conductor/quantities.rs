//! Quantities of jobs and nodes as the planner counts them.

use forelight_planner as planner;
use forelight_protocol::{Confidence, Node, Quantiles};

/// The planner counts whole units of work: here nanoseconds of a core of speed 1.
const PER_SECOND: f64 = 1e9;

pub(crate) fn confidence(confidence: Confidence) -> planner::Confidence {
    match confidence {
        Confidence::P50 => planner::Confidence::P50,
        Confidence::P80 => planner::Confidence::P80,
        Confidence::P95 => planner::Confidence::P95,
    }
}

pub(crate) fn own_confidence(confidence: planner::Confidence) -> Confidence {
    match confidence {
        planner::Confidence::P50 => Confidence::P50,
        planner::Confidence::P80 => Confidence::P80,
        planner::Confidence::P95 => Confidence::P95,
    }
}

pub(crate) fn times(quantiles: &Quantiles, factor: f64) -> Quantiles {
    let Quantiles { mean, p50, p80, p95 } = *quantiles;
    Quantiles { mean: mean * factor, p50: p50 * factor, p80: p80 * factor, p95: p95 * factor }
}

pub(crate) fn total(cpu_seconds: &Quantiles) -> planner::WorkTotal {
    let Quantiles { p50, p80, p95, .. } = *cpu_seconds;
    // At least one unit, so that no booking is empty.
    let [p50, p80, p95] = [p50, p80, p95].map(|seconds| units(seconds).max(1));
    // Rounding must not reverse quantiles.
    planner::WorkTotal { p50, p80: p80.max(p50), p95: p95.max(p80).max(p50) }
}

pub(crate) fn speed(node: &Node) -> u64 {
    units(node.speed * f64::from(node.cores)).max(1)
}

/// Seconds in the planner's unit of work, saturating.
pub(super) fn units(seconds: f64) -> u64 {
    (seconds * PER_SECOND).round() as u64
}
