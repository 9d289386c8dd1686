//! Errors, medians and quantiles of measurements.

/// forecast / actual − 1. Zero if both are zero.
pub fn relative_error(forecast: f64, actual: f64) -> f64 {
    if actual == forecast { 0.0 } else { forecast / actual - 1.0 }
}

/// Mean of the absolute values. Zero without values.
pub fn mean_absolute(errors: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = errors.fold((0.0, 0u32), |(sum, count), error| (sum + error.abs(), count + 1));
    if count == 0 { 0.0 } else { sum / f64::from(count) }
}

/// Median. The mean of the middle two if the number is even, zero without values.
pub fn median(values: &[f64]) -> f64 {
    let values = sorted(values.to_vec());
    let half = values.len() / 2;
    match values.len() {
        0 => 0.0,
        even if even % 2 == 0 => 0.5 * (values[half - 1] + values[half]),
        _ => values[half],
    }
}

/// Median. The greater of the middle two if the number is even, `None` without values.
pub fn upper_median<T: Copy>(sorted: &[T]) -> Option<T> {
    sorted.get(sorted.len() / 2).copied()
}

/// Quantile of sorted values, to the nearest value. Zero without values.
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted.get((share * last as f64).round() as usize).copied().unwrap_or(0.0)
}

pub fn sorted(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_have_a_sign_and_their_mean_has_none() {
        assert_eq!(relative_error(150.0, 100.0), 0.5);
        assert_eq!(relative_error(0.0, 0.0), 0.0);
        assert_eq!(mean_absolute([0.5, -0.25].into_iter()), 0.375);
        assert_eq!(mean_absolute(std::iter::empty()), 0.0);
    }

    #[test]
    fn a_median_is_the_value_in_the_middle_whatever_the_order() {
        assert_eq!([median(&[3.0, 1.0, 2.0]), median(&[4.0, 1.0, 2.0, 3.0]), median(&[])], [2.0, 2.5, 0.0]);
        assert_eq!(upper_median(&sorted(vec![3.0, 1.0, 2.0])), Some(2.0));
        assert_eq!(upper_median(&[1, 2, 3, 4]), Some(3));
        assert_eq!(upper_median::<u64>(&[]), None);
    }

    #[test]
    fn a_quantile_is_one_of_the_values() {
        assert_eq!(
            [0.0, 0.5, 0.99, 1.0].map(|share| quantile(&[1.0, 2.0, 3.0], share)),
            [1.0, 2.0, 3.0, 3.0]
        );
        assert_eq!(quantile(&[], 0.5), 0.0);
    }
}
