//! Confidence interval of an observed proportion.

/// 0.975 quantile of the standard normal distribution.
const NORMAL: f64 = 1.959_963_984_540_054;

/// The 95 % interval of Wilson (1927) for a proportion observed in `trials` trials, as (low, high). With less
/// than one trial, or a proportion outside 0 to 1, it is (0, 1).
pub fn share_interval(share: f64, trials: f64) -> (f64, f64) {
    if !(trials >= 1.0 && (0.0..=1.0).contains(&share)) {
        return (0.0, 1.0);
    }
    let z = NORMAL * NORMAL / trials;
    let centre = (share + z / 2.0) / (1.0 + z);
    let half = NORMAL / (1.0 + z) * libm::sqrt(share * (1.0 - share) / trials + z / (4.0 * trials));
    ((centre - half).max(0.0), (centre + half).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::share_interval;

    #[test]
    fn printed_intervals_are_met_and_the_ends_are_not_certain() {
        let (low, high) = share_interval(0.8, 100.0);
        assert!((low - 0.7112).abs() < 1e-4 && (high - 0.8666).abs() < 1e-4, "{low} {high}");
        let (low, high) = share_interval(1.0, 30.0);
        assert!((low - 0.8865).abs() < 1e-4 && high > 1.0 - 1e-12 && high <= 1.0, "{low} {high}");
        assert_eq!((share_interval(0.5, 0.0), share_interval(f64::NAN, 9.0)), ((0.0, 1.0), (0.0, 1.0)));
    }
}
