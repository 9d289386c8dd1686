//! The time of a task that is under way, given its age and its progress.
//!
//! The time T of a task that works is lognormal, with its booked length as the 0.80 quantile and the
//! forecast's 0.95 quantile. With probability h = [`HANGS`] it does not work at all: it hangs, until somebody
//! notices at R. What is known at age e is that T > e, or that it hangs:
//!
//! ```text
//! P(hangs | e)   = h / ( h + (1 − h) S(e) ),        S(e) = 1 − F(e)
//! P(by d | e)    = ( (1 − h) (F(d) − F(e)) + h [R ≤ d] ) / ( h + (1 − h) S(e) )
//! ```
//!
//! So a task that is beyond its 0.99 quantile rather hangs than works. Progress is new evidence: the rest,
//! counted from there, is the same distribution times the share that is left.

use crate::conformal::NORMAL_95;
use crate::live::NORMAL_80;

/// Probability that a task hangs.
const HANGS: f64 = 0.01;

/// 0.99 quantile of the standard normal distribution.
const NORMAL_99: f64 = 2.326_347_874_040_841;

/// Least standard deviation of the logarithm of a task's time: no forecast is better than a tenth.
const LEAST_DEVIATION: f64 = 0.1;

/// Distribution of the time that the rest of a task takes, counted from its last sign of progress. In any
/// unit of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnderWay {
    log_median: f64,
    deviation: f64,
}

impl UnderWay {
    /// Of a task that was booked for `length` and takes longer than `p95` in one case of twenty. `left` is
    /// the share of it that is left, 0 to 1. `None` if nothing is left or known.
    pub fn new(length: f64, p95: f64, left: f64) -> Option<Self> {
        let (length, p95) = (length * left, p95 * left);
        if !(length > 0.0 && p95 > 0.0 && length.is_finite() && p95.is_finite()) {
            return None;
        }
        let (length, p95) = (libm::log(length), libm::log(p95));
        let deviation = ((p95 - length) / (NORMAL_95 - NORMAL_80)).max(LEAST_DEVIATION);
        Some(Self { log_median: p95.max(length) - NORMAL_95 * deviation, deviation })
    }

    /// The time beyond which the task rather hangs than works: its 0.99 quantile.
    pub fn rather_hangs_after(&self) -> f64 {
        libm::exp(self.log_median + NORMAL_99 * self.deviation)
    }

    /// Probability that the task takes longer than `time`, if it works.
    fn survival(&self, time: f64) -> f64 {
        if time <= 0.0 {
            return 1.0;
        }
        let normal = (libm::log(time) - self.log_median) / self.deviation;
        0.5 * libm::erfc(normal * std::f64::consts::FRAC_1_SQRT_2)
    }

    /// Probability that the task ends within `time`, given that it has not after `age`. `if_it_hangs` says
    /// whether it also does if it hangs. All from the last sign of progress.
    pub fn chance(&self, age: f64, time: f64, if_it_hangs: bool) -> f64 {
        if time <= age {
            return 0.0;
        }
        let (now, then) = (self.survival(age), self.survival(time));
        let works = (1.0 - HANGS) * (now - then).max(0.0);
        let hangs = if if_it_hangs { HANGS } else { 0.0 };
        ((works + hangs) / (HANGS + (1.0 - HANGS) * now)).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task() -> UnderWay {
        UnderWay::new(10.0, 12.0, 1.0).unwrap()
    }

    #[test]
    fn the_quantiles_are_those_that_were_given() {
        for (time, longer) in [(10.0, 0.2), (12.0, 0.05)] {
            assert!((task().survival(time) - longer).abs() < 1e-9, "{time}");
        }
        assert!((task().survival(task().rather_hangs_after()) - 0.01).abs() < 1e-9);
        assert_eq!(UnderWay::new(0.0, 12.0, 1.0), None);
        assert_eq!(UnderWay::new(10.0, 12.0, 0.0), None);
    }

    #[test]
    fn the_chance_falls_with_every_instant_beyond_the_quantiles_and_progress_brings_it_back() {
        let chance = |age: f64| task().chance(age, 40.0, false);
        let chances: Vec<f64> = [0.0, 10.0, 12.0, 15.0, 20.0].map(chance).into();
        assert!(chances[0] > 0.98 && chances.windows(2).all(|pair| pair[1] < pair[0]), "{chances:?}");
        assert!(chances[4] < 0.05, "{chances:?}");
        // At half of the task, five units ago.
        let half = UnderWay::new(10.0, 12.0, 0.5).unwrap();
        assert!(half.chance(4.0, 24.0, false) > 0.97);
        assert_eq!(task().chance(20.0, 20.0, true), 0.0);
        assert!(task().chance(20.0, 40.0, true) > 0.99, "a second attempt ends in time");
    }
}
