//! Drift of unit costs between profiled frames: a random walk. Its variance rate is learnt by predicting each
//! profiled frame from the others.

use std::collections::BTreeSet;

use crate::interval::Part;
use crate::moments::sum;
use crate::population::FramePopulation;
use crate::shot_clock::ShotClock;

/// Variance for frames whose lights no profiled frame has, in shot lengths of the walk.
const UNKNOWN_LIGHTS: f64 = 4.0;

/// Prior standard deviation of the log unit cost gained over a third of the shot.
const PRIOR_DEVIATION: f64 = 0.1;

/// Weight of the prior, as a number of leave-one-out comparisons.
const PRIOR_FREEDOM: f64 = 2.0;

/// The residuals d_t = ln(y_t / ŷ_t) of carried frames, modelled as a random walk.
///
/// The walk has the variance q per frame of the shot's clock and is zero at every profiled frame. Between two
/// of them it is a Brownian bridge: Cov(d_s, d_t) = q (s − L)(R − t) / (R − L) for L ≤ s ≤ t ≤ R. Outside it
/// is a free walk. Each set of shining lights has its own walk with the same q. Frames with lights of no
/// profiled frame share one error, with the variance of a walk over [`UNKNOWN_LIGHTS`] shot lengths.
///
/// Unlike a Gaussian process, the walk needs no length scale, which few frames cannot show, and has closed
/// forms. Its rate starts from a prior of 10 % over a third of the shot, with the weight of two comparisons,
/// and learns from leaving each profiled frame out. The degrees of freedom are the comparisons plus two.
#[derive(Clone, Debug)]
pub(crate) struct Drift {
    times: Vec<f64>,
    /// Length of the shot, in frames.
    length: f64,
    /// The set of shining lights of each frame.
    lights: Vec<u32>,
    /// Indices of the profiled frames, increasing.
    profiled: Vec<usize>,
    prior: f64,
    learnt: f64,
    comparisons: f64,
}

impl Drift {
    /// Prior variance per frame of the shot's clock. The length of the shot excludes what cuts add to the
    /// clock, or a cut would reduce the variance across it.
    pub fn prior_rate(clock: &ShotClock) -> f64 {
        PRIOR_DEVIATION * PRIOR_DEVIATION / (clock.frames().max(1.0) / 3.0)
    }

    /// The walk over these frames, with its prior rate.
    pub fn new(clock: &ShotClock, frames: &[FramePopulation], profiled: Vec<usize>) -> Self {
        Drift {
            times: clock.times().to_vec(),
            length: clock.frames().max(1.0),
            lights: frames.iter().map(|frame| frame.lights).collect(),
            profiled,
            prior: Self::prior_rate(clock),
            learnt: 0.0,
            comparisons: 0.0,
        }
    }

    /// The same for a cost that does not drift: the prior rate is zero.
    pub fn without_drift(self) -> Self {
        Self { prior: 0.0, ..self }
    }

    /// Learns from predicting profiled frame number `k` by the others. `residual` is the logarithm of true
    /// over predicted cost, `noise` its sampling variance. The only frame with its lights is ignored.
    pub fn learn(&mut self, k: usize, residual: f64, noise: f64) {
        let at = self.profiled[k];
        let others: Vec<usize> = self.pins(self.lights[at]).filter(|&other| other != at).collect();
        let spread = self.spread(at, &others);
        if spread > 0.0 {
            self.learnt += (residual * residual - noise) / spread;
            self.comparisons += 1.0;
        }
    }

    /// Variance per frame. Comparisons with less error than sampling explains lower it, but not below zero.
    fn rate(&self) -> f64 {
        ((PRIOR_FREEDOM * self.prior + self.learnt) / (PRIOR_FREEDOM + self.comparisons)).max(0.0)
    }

    fn part(&self, variance_per_rate: f64) -> Part {
        Part {
            variance: self.rate() * variance_per_rate,
            degrees_of_freedom: PRIOR_FREEDOM + self.comparisons,
        }
    }

    /// Variance due to carrying of frame t, whose total is `total`.
    pub fn of_frame(&self, t: usize, total: f64) -> Part {
        let pins: Vec<usize> = self.pins(self.lights[t]).collect();
        let spread = if pins.is_empty() { UNKNOWN_LIGHTS * self.length } else { self.spread(t, &pins) };
        self.part(total * total * spread)
    }

    /// Profiled frames with these lights, increasing.
    fn pins(&self, lights: u32) -> impl Iterator<Item = usize> {
        self.profiled.iter().copied().filter(move |&k| self.lights[k] == lights)
    }

    /// Variance of the sum over all frames due to carrying; frame t has the total `totals[t]`. A free walk
    /// with steps Δ_i and sums S_i of the totals after them has q Σ Δ_i S_i². Pinning its end reduces that by
    /// q (Σ Δ_i S_i)² / Σ Δ_i.
    pub fn of_total(&self, totals: &[f64]) -> Part {
        let known: BTreeSet<u32> = self.profiled.iter().map(|&k| self.lights[k]).collect();
        let of_set = |&lights: &u32| {
            let own = |(&total, &of): (&f64, &u32)| if of == lights { total } else { 0.0 };
            let totals: Vec<f64> = totals.iter().zip(&self.lights).map(own).collect();
            self.variance_of_set(&self.pins(lights).collect::<Vec<_>>(), &totals)
        };
        // All other frames take their unit costs from the same few frames, so they share one error.
        let others = totals.iter().zip(&self.lights).filter(|(_, of)| !known.contains(of));
        let borrowed = sum(others.map(|(&total, _)| total));
        let of_others = UNKNOWN_LIGHTS * borrowed * borrowed * self.length;
        self.part(sum(known.iter().map(of_set)) + of_others)
    }

    /// The same for the frames with one set of lights, in units of the rate. `pins` are the profiled ones of
    /// them, and all other frames have a total of zero. Zero if none is profiled.
    fn variance_of_set(&self, pins: &[usize], totals: &[f64]) -> f64 {
        let (Some(&first), Some(&last)) = (pins.first(), pins.last()) else { return 0.0 };
        let mut variance = self.walk((0..=first).rev(), pins, totals).0;
        variance += self.walk(last..totals.len(), pins, totals).0;
        for ends in pins.windows(2) {
            let (free, with_end, length) = self.walk(ends[0]..ends[1] + 1, pins, totals);
            // The far end is pinned, so its own total does not count.
            variance += (free - with_end * with_end / length).max(0.0);
        }
        variance
    }

    /// Σ Δ S², Σ Δ S and Σ Δ along frames after a profiled one. Totals of profiled frames do not count.
    fn walk(
        &self,
        path: impl DoubleEndedIterator<Item = usize> + Clone,
        pins: &[usize],
        totals: &[f64],
    ) -> (f64, f64, f64) {
        let (mut squares, mut sums, mut length, mut after) = (0.0, 0.0, 0.0, 0.0);
        let nearer = path.clone().rev().skip(1);
        for (far, near) in path.rev().zip(nearer) {
            if pins.binary_search(&far).is_err() {
                after += totals[far];
            }
            let step = (self.times[far] - self.times[near]).abs();
            squares += step * after * after;
            sums += step * after;
            length += step;
        }
        (squares, sums, length)
    }

    /// Variance at frame t of a unit-rate walk pinned at the nearest of the increasing `pins`. Zero without
    /// pins.
    fn spread(&self, t: usize, pins: &[usize]) -> f64 {
        let split = pins.partition_point(|&pin| pin <= t);
        let before = split.checked_sub(1).map(|before| self.times[pins[before]]);
        let after = pins.get(split).map(|&after| self.times[after]);
        let at = self.times[t];
        match (before, after) {
            (Some(before), Some(after)) => (at - before) * (after - at) / (after - before),
            (Some(end), None) | (None, Some(end)) => (at - end).abs(),
            (None, None) => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Drift;
    use crate::population::FramePopulation;
    use crate::shot_clock::ShotClock;

    /// A shot of every third frame. `lights` are the sets of shining lights.
    fn lit(lights: impl IntoIterator<Item = u32>) -> (ShotClock, Vec<FramePopulation>) {
        let frame = |(number, lights)| FramePopulation {
            number: 3 * number,
            counts: vec![],
            lights,
            shining: 0,
            triangles: 0,
        };
        let frames: Vec<FramePopulation> = (0i64..).zip(lights).map(frame).collect();
        (ShotClock::new(&[], &frames), frames)
    }

    fn drift(frames: usize, profiled: &[usize]) -> Drift {
        let (clock, frames) = lit(vec![0; frames]);
        Drift::new(&clock, &frames, profiled.to_vec())
    }

    #[test]
    fn the_closed_form_of_the_total_equals_the_sum_of_all_covariances() {
        let profiled = [2, 7, 8];
        let drift = drift(12, &profiled);
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
        expected *= drift.rate();
        let found = drift.of_total(&totals).variance;
        assert!((found / expected - 1.0).abs() < 1e-12, "{found} against {expected}");
    }

    #[test]
    fn profiled_frames_have_no_carried_error_and_distant_ones_more_than_near_ones() {
        let drifting = drift(20, &[5, 15]);
        let variance = |t| drifting.of_frame(t, 1.0).variance;
        assert_eq!(variance(5), 0.0);
        assert!(variance(6) < variance(10));
        assert!(variance(16) < variance(19));
        assert_eq!(drift(3, &[0, 1, 2]).of_total(&[1.0; 3]).variance, 0.0);
    }

    #[test]
    fn good_predictions_lower_the_rate_and_bad_ones_raise_it() {
        let prior = drift(20, &[2, 10, 18]);
        let rate = |residual| {
            let mut drift = prior.clone();
            (0..3).for_each(|k| drift.learn(k, residual, 0.0));
            drift.rate()
        };
        assert!(rate(0.0) < prior.rate());
        assert!(rate(0.5) > prior.rate());
    }

    #[test]
    fn frames_with_other_lights_say_nothing_of_each_other() {
        // The light is on in every second frame. Frames 0, 8 and 12 are profiled, all with the light off.
        let (clock, frames) = lit((0..20).map(|t| t % 2));
        let mut drift = Drift::new(&clock, &frames, vec![0, 8, 12]);
        let variance = |drift: &Drift, t| drift.of_frame(t, 1.0).variance;
        assert_eq!(variance(&drift, 8), 0.0);
        assert!(variance(&drift, 2) < variance(&drift, 18));
        assert!(variance(&drift, 9) > variance(&drift, 18), "its lights are in no profiled frame");
        let off: Vec<f64> = (0..20).map(|t| f64::from(1 - t % 2)).collect();
        assert!(drift.of_total(&off).variance < drift.of_total(&[1.0; 20]).variance / 10.0);

        drift = Drift::new(&clock, &frames, vec![0, 7, 12]);
        let before = drift.rate();
        drift.learn(1, 2.0, 0.0);
        assert_eq!(drift.rate(), before, "the only frame with its lights is not expected to be like others");
        assert!(variance(&drift, 9) < variance(&drift, 17));
        // The bridge spans frames 0 to 12. Frame 7 has other lights and does not pin it.
        assert!((variance(&drift, 6) / before - 9.0).abs() < 1e-9, "{}", variance(&drift, 6) / before);
    }
}
