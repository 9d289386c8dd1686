//! A share with its confidence interval.

use forelight_forecast::share_interval;
use serde::Serialize;
use std::fmt;

/// A mean of shares, with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Share {
    /// From 0 to 1.
    pub share: f64,
    pub low: f64,
    pub high: f64,
}

impl Share {
    /// Mean of the shares of independent groups with equal weights. The interval is binomial (Wilson). Its
    /// number of trials gives the same variance as the groups have: their number if each is one trial, hardly
    /// more if trials of a group agree.
    pub fn of(groups: &[f64]) -> Self {
        let count = groups.len() as f64;
        if groups.is_empty() {
            return Self { share: 0.0, low: 0.0, high: 1.0 };
        }
        let share = groups.iter().sum::<f64>() / count;
        let squares: f64 = groups.iter().map(|group| (group - share) * (group - share)).sum();
        let variance_of_mean = squares / (count * (count - 1.0).max(1.0));
        let trials = if variance_of_mean > 0.0 { share * (1.0 - share) / variance_of_mean } else { count };
        let (low, high) = share_interval(share, trials);
        Self { share, low, high }
    }
}

impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { share, low, high } = self;
        write!(f, "{:.1} % ({:.0}-{:.0})", share * 100.0, low * 100.0, high * 100.0)
    }
}

#[cfg(test)]
mod tests {
    use super::Share;

    #[test]
    fn the_interval_is_the_binomial_one_of_single_trials() {
        let groups: Vec<f64> = (0..100).map(|i| f64::from(u8::from(i < 80))).collect();
        let found = Share::of(&groups);
        // Wilson interval of 80 in 100.
        assert!((found.low - 0.7112).abs() < 2e-3 && (found.high - 0.8666).abs() < 2e-3, "{found:?}");
        assert_eq!(found.to_string(), "80.0 % (71-87)");
    }

    #[test]
    fn groups_whose_trials_go_together_are_one_trial_each() {
        let even = Share::of(&[0.8; 50]);
        let torn: Vec<f64> = (0..50).map(|i| f64::from(u8::from(i < 40))).collect();
        assert!(even.high - even.low <= Share::of(&torn).high - Share::of(&torn).low + 1e-9);
        assert_eq!((Share::of(&[]).low, Share::of(&[]).high), (0.0, 1.0));
        assert!(Share::of(&[1.0; 30]).low > 0.85 && Share::of(&[1.0; 30]).high > 0.999);
    }
}
