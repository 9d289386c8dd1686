//! How far unit costs wander between profiled frames.

use crate::clock::ShotClock;
use crate::interval::Part;

/// Prior log-standard deviation that a frame's cost picks up over a third of the shot, beyond what its pixel
/// counts explain.
const PRIOR_DEVIATION: f64 = 0.1;

/// Weight of the prior, in leave-one-out comparisons.
const PRIOR_FREEDOM: f64 = 2.0;

/// The residual d_t = ln(y_t / ŷ_t) of the carried frames, as a random walk of variance q per frame of the shot's
/// clock that is zero at every profiled frame: a Brownian bridge between two of them, with Cov(d_s, d_t) = q (s − L)(R − t)
/// / (R − L) for L ≤ s ≤ t ≤ R, and a free walk before the first and after the last.
///
/// It is the rough relative of a Gaussian process with Matérn covariance. A handful of profiled frames cannot
/// show a length scale; the walk needs none, is never too sure between frames, and has closed forms. Its one
/// parameter starts from a prior (10 % over a third of the shot, worth two comparisons) and learns from
/// leaving each profiled frame out; the degrees of freedom are the comparisons plus two, so with few profiled
/// frames the quantiles are wide.
#[derive(Clone, Debug)]
pub(crate) struct Drift {
    times: Vec<f64>,
    /// Indices of the profiled frames, increasing.
    profiled: Vec<usize>,
    prior: f64,
    learnt: f64,
    comparisons: f64,
}

impl Drift {
    /// Variance per frame of the shot's clock before anything is learnt.
    pub fn prior_rate(clock: &ShotClock) -> f64 {
        PRIOR_DEVIATION * PRIOR_DEVIATION / (clock.length() / 3.0)
    }

    /// The prior walk over the frames.
    pub fn new(clock: &ShotClock, profiled: Vec<usize>) -> Self {
        Drift {
            times: clock.times().to_vec(),
            profiled,
            prior: Self::prior_rate(clock),
            learnt: 0.0,
            comparisons: 0.0,
        }
    }

    /// Takes in that the profiled frame number `k` was missed by `residual` (logarithm) when predicted from
    /// the others, of which sampling explains the variance `noise`.
    pub fn learn(&mut self, k: usize, residual: f64, noise: f64) {
        let at = self.times[self.profiled[k]];
        let before = k.checked_sub(1).map(|b| self.times[self.profiled[b]]);
        let after = self.profiled.get(k + 1).map(|&a| self.times[a]);
        let spread = spread(at, before, after);
        if spread > 0.0 {
            self.learnt += (residual * residual - noise) / spread;
            self.comparisons += 1.0;
        }
    }

    /// Variance per frame. Comparisons that say less than nothing (less error than sampling explains) lower
    /// it, but not below zero.
    fn rate(&self) -> f64 {
        ((PRIOR_FREEDOM * self.prior + self.learnt) / (PRIOR_FREEDOM + self.comparisons)).max(0.0)
    }

    fn part(&self, variance_per_rate: f64) -> Part {
        Part {
            variance: self.rate() * variance_per_rate,
            degrees_of_freedom: PRIOR_FREEDOM + self.comparisons,
        }
    }

    /// The carried part of the variance of frame t, whose total is `total`.
    pub fn of_frame(&self, t: usize, total: f64) -> Part {
        let split = self.profiled.partition_point(|&k| k <= t);
        let before = split.checked_sub(1).map(|b| self.times[self.profiled[b]]);
        let after = self.profiled.get(split).map(|&a| self.times[a]);
        self.part(total * total * spread(self.times[t], before, after))
    }

    /// The carried part of the variance of the sum over all frames, where frame t has the total `totals[t]`.
    ///
    /// With walk steps of length Δ_i and S_i the sum of the totals after step i, the variance of a free walk
    /// is q Σ Δ_i S_i²; pinning its end takes off q (Σ Δ_i S_i)² / Σ Δ_i.
    pub fn of_total(&self, totals: &[f64]) -> Part {
        let (Some(&first), Some(&last)) = (self.profiled.first(), self.profiled.last()) else {
            return self.part(0.0);
        };
        let mut variance = self.walk((0..=first).rev(), totals).0;
        variance += self.walk(last..totals.len(), totals).0;
        for ends in self.profiled.windows(2) {
            let (free, with_end, length) = self.walk(ends[0]..ends[1] + 1, totals);
            // The far end is pinned, so its own total takes no part.
            variance += (free - with_end * with_end / length).max(0.0);
        }
        self.part(variance)
    }

    /// Σ Δ S², Σ Δ S and Σ Δ along a path of frames that starts at a profiled one. Only frames that are not
    /// profiled have a residual.
    fn walk(&self, path: impl DoubleEndedIterator<Item = usize> + Clone, totals: &[f64]) -> (f64, f64, f64) {
        let (mut squares, mut sums, mut length, mut after) = (0.0, 0.0, 0.0, 0.0);
        let nearer = path.clone().rev().skip(1);
        for (far, near) in path.rev().zip(nearer) {
            if self.profiled.binary_search(&far).is_err() {
                after += totals[far];
            }
            let step = (self.times[far] - self.times[near]).abs();
            squares += step * after * after;
            sums += step * after;
            length += step;
        }
        (squares, sums, length)
    }
}

/// Variance of a walk of unit rate at a time, pinned at the times before and after as far as there are any.
fn spread(at: f64, before: Option<f64>, after: Option<f64>) -> f64 {
    match (before, after) {
        (Some(before), Some(after)) => (at - before) * (after - at) / (after - before),
        (Some(end), None) | (None, Some(end)) => (at - end).abs(),
        (None, None) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::Drift;
    use crate::clock::ShotClock;
    use crate::frames::FramePopulation;

    fn shot(frames: i64) -> ShotClock {
        let frames: Vec<FramePopulation> =
            (0..frames).map(|number| FramePopulation { number: 3 * number, counts: vec![] }).collect();
        ShotClock::new(&[], &frames)
    }

    #[test]
    fn the_closed_form_of_the_total_equals_the_sum_of_all_covariances() {
        let frames = shot(12);
        let profiled = vec![2, 7, 8];
        let drift = Drift::new(&frames, profiled.clone());
        let totals: Vec<f64> = (0..12).map(|t| 10.0 + f64::from(t * t % 7)).collect();
        let time = |t: usize| 3.0 * t as f64;
        let covariance = |s: usize, t: usize| {
            let (s, t) = (s.min(t), s.max(t));
            match (profiled.iter().rfind(|&&k| k <= s), profiled.iter().find(|&&k| k >= t)) {
                (Some(&l), Some(&r)) if l == r => 0.0,
                (Some(&l), Some(&r)) if profiled.iter().all(|&k| k <= l || k >= r) => {
                    (time(s) - time(l)) * (time(r) - time(t)) / (time(r) - time(l))
                }
                (None, Some(&r)) if r == 2 => time(r) - time(t),
                (Some(&l), None) if l == 8 => time(s) - time(l),
                _ => 0.0,
            }
        };
        let mut expected = 0.0;
        for s in 0..12 {
            for t in 0..12 {
                expected += totals[s] * totals[t] * covariance(s, t);
            }
        }
        expected *= Drift::prior_rate(&frames);
        let found = drift.of_total(&totals).variance;
        assert!((found / expected - 1.0).abs() < 1e-12, "{found} against {expected}");
    }

    #[test]
    fn profiled_frames_have_no_carried_error_and_distant_ones_more_than_near_ones() {
        let drift = Drift::new(&shot(20), vec![5, 15]);
        let variance = |t| drift.of_frame(t, 1.0).variance;
        assert_eq!(variance(5), 0.0);
        assert!(variance(6) < variance(10));
        assert!(variance(16) < variance(19));
        assert_eq!(Drift::new(&shot(3), vec![0, 1, 2]).of_total(&[1.0; 3]).variance, 0.0);
    }

    #[test]
    fn good_predictions_lower_the_rate_and_bad_ones_raise_it() {
        let frames = shot(20);
        let rate = |residual| {
            let mut drift = Drift::new(&frames, vec![2, 10, 18]);
            (0..3).for_each(|k| drift.learn(k, residual, 0.0));
            drift.rate()
        };
        assert!(rate(0.0) < Drift::prior_rate(&frames));
        assert!(rate(0.5) > Drift::prior_rate(&frames));
    }
}
