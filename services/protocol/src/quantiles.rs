//! Forecasts of single numbers, as quantiles.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{Confidence, Money};

/// A forecast of one number: its mean and its 50 %, 80 % and 95 % quantiles.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct Quantiles {
    /// Expected value.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 80 % quantile.
    pub p80: f64,
    /// 95 % quantile.
    pub p95: f64,
}

impl Quantiles {
    /// A known number: all four values are `value`.
    pub const fn known(value: f64) -> Self {
        Self { mean: value, p50: value, p80: value, p95: value }
    }

    /// The quantile at a confidence.
    pub const fn at(&self, confidence: Confidence) -> f64 {
        match confidence {
            Confidence::P50 => self.p50,
            Confidence::P80 => self.p80,
            Confidence::P95 => self.p95,
        }
    }

    /// The sum of two numbers with the same error, because both are based on the same measurements.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        let [a, b] = [self, other];
        Self { mean: a.mean + b.mean, p50: a.p50 + b.p50, p80: a.p80 + b.p80, p95: a.p95 + b.p95 }
    }

    /// What is left after `spent` is subtracted. Never negative.
    #[must_use]
    pub fn less(&self, spent: f64) -> Self {
        let left = |amount: f64| (amount - spent).max(0.0);
        let Self { mean, p50, p80, p95 } = *self;
        Self { mean: left(mean), p50: left(p50), p80: left(p80), p95: left(p95) }
    }

    /// The same in money, at `price` micro-units per unit.
    pub fn in_money(&self, price: f64) -> MoneyQuantiles {
        let money = |amount: f64| Money((amount * price).round() as i64);
        let Self { mean, p50, p80, p95 } = *self;
        MoneyQuantiles { mean: money(mean), p50: money(p50), p80: money(p80), p95: money(p95) }
    }
}

/// A forecast of an amount: its mean and its 50 %, 80 % and 95 % quantiles.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct MoneyQuantiles {
    /// Expected value.
    pub mean: Money,
    /// Median.
    pub p50: Money,
    /// 80 % quantile.
    pub p80: Money,
    /// 95 % quantile.
    pub p95: Money,
}

impl MoneyQuantiles {
    /// The same, but at least `spent`.
    #[must_use]
    pub fn at_least(&self, spent: Money) -> Self {
        let Self { mean, p50, p80, p95 } = *self;
        Self { mean: mean.max(spent), p50: p50.max(spent), p80: p80.max(spent), p95: p95.max(spent) }
    }

    /// The same plus a known amount.
    #[must_use]
    pub fn plus(&self, known: Money) -> Self {
        let sum = |amount: Money| Money(amount.0.saturating_add(known.0));
        let Self { mean, p50, p80, p95 } = *self;
        Self { mean: sum(mean), p50: sum(p50), p80: sum(p80), p95: sum(p95) }
    }
}
