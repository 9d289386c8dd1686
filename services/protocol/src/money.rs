//! Money.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// An amount in micro-units (millionths) of the farm's one currency. Prices are micro-units per node hour.
#[derive(
    Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default, Serialize, Deserialize, ToSchema,
)]
#[serde(transparent)]
#[schema(value_type = i64, example = 1_250_000)]
pub struct Money(pub i64);

impl Money {
    /// The amount in micro-units.
    pub const fn micro_units(self) -> i64 {
        self.0
    }

    /// What `micros` microseconds cost at this price per hour, rounded up to the next micro-unit; saturating.
    pub fn for_micros_at_hourly_rate(self, micros: i64) -> Money {
        const MICROS_PER_HOUR: i128 = 3_600_000_000;
        let exact = i128::from(self.0) * i128::from(micros);
        let rounded_up =
            exact.div_euclid(MICROS_PER_HOUR) + i128::from(exact.rem_euclid(MICROS_PER_HOUR) != 0);
        Money(rounded_up.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_an_hour_costs_half_the_hourly_rate_and_a_moment_costs_one() {
        assert_eq!(Money(2_000_000).for_micros_at_hourly_rate(1_800_000_000), Money(1_000_000));
        assert_eq!(Money(2_000_000).for_micros_at_hourly_rate(1), Money(1));
        assert_eq!(Money(0).for_micros_at_hourly_rate(i64::MAX), Money(0));
        assert_eq!(Money(i64::MAX).for_micros_at_hourly_rate(i64::MAX), Money(i64::MAX));
    }
}
