//! Adds costs that are known without profiling, such as shared cache records. Means shift; variances stay.

use crate::cost::{Cost, Costs, Quantity};
use crate::interval::{Calibration, Part, log_deviation, quantity};
use crate::shot::ShotForecast;

impl ShotForecast {
    /// Adds the known cost of each frame, in order; it may be negative. `calibration` must be the one that
    /// made this forecast. Call this before [`ShotForecast::corrected`].
    #[must_use]
    pub fn with_known(mut self, known: &[Costs<f64>], calibration: Calibration) -> Self {
        let mut all = Costs::default();
        for (frame, known) in self.frames.iter_mut().zip(known) {
            frame.total = shifted(&frame.total, known, calibration);
            all = all.plus(known);
        }
        self.total = shifted(&self.total, &all, calibration);
        let work = &self.total.work;
        self.job_sigma = log_deviation(work.mean, work.variance) * calibration.inflation;
        self
    }
}

/// Adds times to costs whose work and rays were counted. The rate is that of `taken`: pairs of work and
/// nanoseconds of the same kind.
pub fn with_times(
    counted: impl IntoIterator<Item = Cost>,
    taken: impl IntoIterator<Item = (u64, u64)>,
) -> Vec<Costs<f64>> {
    let sum = |(work, nanos): (f64, f64), taken: (u64, u64)| (work + taken.0 as f64, nanos + taken.1 as f64);
    let (work, nanos) = taken.into_iter().fold((0.0, 0.0), sum);
    let rate = if work > 0.0 { nanos / work } else { 0.0 };
    let timed = |cost: Cost| {
        // The conversion saturates at the end of the range.
        Costs::from(Cost { cpu_nanos: (cost.work as f64 * rate).round() as u64, ..cost })
    };
    counted.into_iter().map(timed).collect()
}

fn shifted(costs: &Costs<Quantity>, known: &Costs<f64>, calibration: Calibration) -> Costs<Quantity> {
    let shift = |from: &Quantity, by: f64| {
        let part = Part { variance: from.variance, degrees_of_freedom: from.degrees_of_freedom };
        quantity((from.mean + by).max(0.0), part, calibration)
    };
    Costs {
        work: shift(&costs.work, known.work),
        cpu_nanos: shift(&costs.cpu_nanos, known.cpu_nanos),
        all_rays: shift(&costs.all_rays, known.all_rays),
        rays: std::array::from_fn(|kind| shift(&costs.rays[kind], known.rays[kind])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Cost, Expansion, FramePopulation, Observation, ProfiledFrame, Stratum, forecast_shot};

    #[test]
    fn what_is_known_moves_means_and_leaves_what_is_uncertain_as_it_is() {
        let strata = [Stratum::background(1.0)];
        let frames = [0, 1].map(|number| FramePopulation {
            number,
            counts: vec![100],
            lights: 0,
            shining: 0,
            triangles: 0,
        });
        let cost = |work| Cost { work, ..Cost::default() };
        let observations: Vec<Observation> =
            [90, 110, 95, 105].map(|work| Observation { stratum: 0, cost: cost(work) }).to_vec();
        let profiled = ProfiledFrame {
            frame: 0,
            observations: &observations,
            expansion: &Expansion::Groups,
            fixed: Cost::default(),
            build: Cost::default(),
        };
        let plain = forecast_shot(&strata, &frames, &[profiled], Calibration::NONE).unwrap();
        let known = [cost(5000), Cost::default()].map(Costs::from);
        let more = plain.clone().with_known(&known, Calibration::NONE);
        assert_eq!(more.frames[0].total.work.mean, plain.frames[0].total.work.mean + 5000.0);
        assert_eq!(more.frames[1], plain.frames[1]);
        assert_eq!(more.total.work.mean, plain.total.work.mean + 5000.0);
        assert_eq!(more.total.work.variance, plain.total.work.variance);
        let above = |q: &Quantity| q.p95 - q.mean;
        assert!((above(&more.total.work) / above(&plain.total.work) - 1.0).abs() < 0.05);
        assert!(more.job_sigma < plain.job_sigma);
        // A total does not fall below zero.
        let less = plain.clone().with_known(&[known[0].times(-10.0), known[1]], Calibration::NONE);
        assert_eq!((less.frames[0].total.work.mean, less.frames[0].total.work.p95), (0.0, 0.0));
    }
}
