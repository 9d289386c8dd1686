//! Amounts of money.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// An amount in micro-units (millionths) of the farm's one currency. Prices are in micro-units per node hour.
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

    /// Cost of `micros` microseconds at this price per hour, rounded up to the next micro-unit. Saturating.
    pub fn for_micros_at_hourly_rate(self, micros: i64) -> Money {
        const MICROS_PER_HOUR: i128 = 3_600_000_000;
        let exact = i128::from(self.0) * i128::from(micros);
        let rounded_up =
            exact.div_euclid(MICROS_PER_HOUR) + i128::from(exact.rem_euclid(MICROS_PER_HOUR) != 0);
        Money(rounded_up.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64)
    }
}

impl fmt::Display for Money {
    /// Rounded to two decimals. Amounts below 1 have up to six decimals, for four significant digits.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const WHOLE: u64 = 1_000_000;
        let amount = self.0.unsigned_abs();
        // Number of decimals for four significant digits: 0.1234 needs four, 0.01234 needs five.
        let decimals = match amount {
            0 | WHOLE.. => 2,
            100_000.. => 4,
            10_000.. => 5,
            _ => 6,
        };
        let step = 10u64.pow(6 - decimals);
        let rounded = (amount.saturating_add(step / 2)) / step * step;
        let digits = format!("{:06}", rounded % WHOLE);
        let shown = digits[..decimals as usize].trim_end_matches('0');
        let sign = if self.0 < 0 && rounded > 0 { "-" } else { "" };
        // At least two decimals.
        f.pad(&format!("{sign}{}.{shown:0<2}", rounded / WHOLE))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_are_shown_to_the_cent_and_small_ones_with_four_significant_digits() {
        for (micro_units, shown) in [
            (12_500_000, "12.50"),
            (1_234_567, "1.23"),
            (-1_235_000, "-1.24"),
            (1_000_000, "1.00"),
            (999_999, "1.00"),
            (123_456, "0.1235"),
            (12_345, "0.01235"),
            (-4_999, "-0.004999"),
            (120_000, "0.12"),
            (500_000, "0.50"),
            (1, "0.000001"),
            (0, "0.00"),
            (i64::MIN, "-9223372036854.78"),
        ] {
            assert_eq!(Money(micro_units).to_string(), shown, "{micro_units}");
        }
        assert_eq!(format!("{:>8}", Money(10_000)), "    0.01");
    }

    #[test]
    fn half_an_hour_costs_half_the_hourly_rate_and_a_moment_costs_one() {
        assert_eq!(Money(2_000_000).for_micros_at_hourly_rate(1_800_000_000), Money(1_000_000));
        assert_eq!(Money(2_000_000).for_micros_at_hourly_rate(1), Money(1));
        assert_eq!(Money(0).for_micros_at_hourly_rate(i64::MAX), Money(0));
        assert_eq!(Money(i64::MAX).for_micros_at_hourly_rate(i64::MAX), Money(i64::MAX));
    }
}
