//! The confidence of plans.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The probability with which a plan must keep deadline and budget.
#[derive(
    Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default, Serialize, Deserialize, ToSchema,
)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum Confidence {
    /// 50 %.
    P50,
    /// 80 %.
    #[default]
    P80,
    /// 95 %.
    P95,
}

impl Confidence {
    /// The probability, 0 to 1.
    pub const fn probability(self) -> f64 {
        match self {
            Confidence::P50 => 0.50,
            Confidence::P80 => 0.80,
            Confidence::P95 => 0.95,
        }
    }

    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Confidence::P50 => "p50",
            Confidence::P80 => "p80",
            Confidence::P95 => "p95",
        }
    }
}
