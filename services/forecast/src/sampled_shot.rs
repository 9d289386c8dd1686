//! Forecasts the frames of a shot from a few frames that were rendered at few samples.
//!
//! Each measured frame has a line in its samples (`sample_line`), which is brought to the full number. The
//! cost per sample is carried to the other frames, over the shot's clock.

use serde::{Deserialize, Serialize};

use crate::cost::Quantity;
use crate::drift::Drift;
use crate::error::ForecastError;
use crate::interval::{Calibration, Part, combined, log_deviation, quantity};
use crate::moments::sum;
use crate::population::{FramePopulation, check_frames};
use crate::sample_line::{Noise, SampleCost, SampleLine};
use crate::shot_clock::ShotClock;
use crate::strata::Stratum;

/// Relative standard deviation of a cost for each factor e by which samples go beyond what was measured: how
/// far from a line costs may be. All frames share this error.
const CURVATURE: f64 = 0.01;
/// Degrees of freedom of that prior.
const CURVATURE_FREEDOM: f64 = 4.0;

/// Pixel counts have to predict measured frames this much better than time alone, before they are used.
const CLEARLY_BETTER: f64 = 0.8;

/// A frame that was rendered at few samples.
#[derive(Clone, Copy, Debug)]
pub struct SampledFrame<'a> {
    /// Index of the frame among the shot's frames.
    pub frame: usize,
    /// Its measured costs, at two different numbers of samples at least.
    pub costs: &'a [SampleCost],
    /// Share of the time that each stratum took, in any unit. Empty if the renderer does not know it.
    pub stratum_times: &'a [f64],
}

/// Forecast of one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SampledFrameForecast {
    /// The frame's number.
    pub number: i64,
    /// Whether it was measured.
    pub measured: bool,
    /// CPU time, nanoseconds.
    pub cpu_nanos: Quantity,
    /// What of it does not depend on the samples, nanoseconds.
    pub fixed_nanos: f64,
}

/// Forecast of a shot from few samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SampledShotForecast {
    /// Every frame, in order.
    pub frames: Vec<SampledFrameForecast>,
    /// CPU time of all frames, nanoseconds. Its quantiles are *not* sums of the frames' quantiles.
    pub total: Quantity,
    /// Log-standard deviation of the total, inflated like the quantiles.
    pub job_sigma: f64,
    /// Relative standard deviation of a measurement, pooled over all measured frames.
    pub noise: f64,
    /// Measurements that the noise rests on, beyond those that the lines need. Zero: it is a prior alone.
    pub spare_measurements: u64,
    /// Whether pixel counts carry costs over time. If not, costs are interpolated.
    pub by_counts: bool,
    /// Whether the quantiles were calibrated on past jobs.
    pub calibrated: bool,
}

/// Forecasts every frame at `samples` samples per pixel, or with so many pixels: whatever the measured costs
/// are lines in.
///
/// A measured frame has the cost of its line. Any other frame takes the fixed cost and the cost per sample of
/// the nearest measured frames before and after it, with weights by the shot's clock. Where the times of
/// strata are known, the cost per sample is first multiplied by Σ N_h,t u_h / Σ N_h,k u_h, with u_h the time
/// per pixel in the measured frame k. That is done only if it predicts the measured frames from each other
/// clearly better than time alone does, for which three measured frames are needed.
///
/// The variance has three parts. *Lines*: the noise of measurements, as it grows towards more samples. It is
/// shared by all frames that rest on a measured one. *Curvature*: how far costs may be from a line, shared by
/// all frames. *Carrying*: as in [`forecast_shot`](crate::forecast_shot()).
///
/// # Errors
/// If nothing was measured, a measured frame has no two different numbers of samples, or frames and strata do
/// not match.
pub fn forecast_sampled_shot(
    strata: &[Stratum],
    frames: &[FramePopulation],
    measured: &[SampledFrame<'_>],
    samples: u32,
    calibration: Calibration,
) -> Result<SampledShotForecast, ForecastError> {
    check_frames(strata, frames)?;
    let carrier = Carrier::new(strata, frames, measured)?;
    let lines: Vec<SampleLine> = carrier.sources.iter().map(|source| source.line).collect();
    let noise = Noise::pooled(&lines);
    let (by_counts, mut drift) = carrier.judge(frames, samples);
    if !by_counts.learnt {
        drift = Drift::new(&carrier.clock, frames, carrier.indices());
    }
    let predictions: Vec<Prediction> =
        (0..frames.len()).map(|t| carrier.predict(t, None, by_counts.used, samples)).collect();
    let parts = |weights: &[f64], total: f64, carried: Part| {
        let of_lines = |(line, weight): (&SampleLine, &f64)| Part {
            variance: weight * weight * line.relative_variance(samples, noise),
            degrees_of_freedom: noise.degrees_of_freedom,
        };
        let mut parts: Vec<Part> = lines.iter().zip(weights).map(of_lines).collect();
        let reach = lines.iter().map(|line| line.reach(samples)).fold(0.0, f64::max);
        let curvature = (CURVATURE * reach * total).powi(2);
        parts.push(Part { variance: curvature, degrees_of_freedom: CURVATURE_FREEDOM });
        parts.push(carried);
        combined(&parts)
    };
    let totals: Vec<f64> = predictions.iter().map(Prediction::cost).collect();
    let frame_forecasts = predictions.iter().enumerate().map(|(t, prediction)| {
        let cost = totals[t];
        let part = parts(&prediction.weights, cost, drift.of_frame(t, cost));
        SampledFrameForecast {
            number: frames[t].number,
            measured: carrier.sources.iter().any(|source| source.frame == t),
            cpu_nanos: quantity(cost, part, calibration),
            fixed_nanos: prediction.fixed,
        }
    });
    let frame_forecasts = frame_forecasts.collect();
    let mut weights = vec![0.0; lines.len()];
    for prediction in &predictions {
        weights.iter_mut().zip(&prediction.weights).for_each(|(all, own)| *all += own);
    }
    let all = sum(totals.iter().copied());
    let total = quantity(all, parts(&weights, all, drift.of_total(&totals)), calibration);
    let spare: usize = measured.iter().map(|frame| frame.costs.len() - 2).sum();
    Ok(SampledShotForecast {
        frames: frame_forecasts,
        job_sigma: log_deviation(all, total.variance) * calibration.inflation,
        total,
        noise: noise.variance.sqrt(),
        spare_measurements: spare as u64,
        by_counts: by_counts.used,
        calibrated: calibration.calibrated,
    })
}

/// A measured frame.
struct Source {
    frame: usize,
    line: SampleLine,
    /// Time per pixel of each stratum, relative. `None` where the frame does not show it or does not tell.
    unit_times: Vec<Option<f64>>,
}

/// A frame as predicted from the measured ones.
struct Prediction {
    fixed: f64,
    sampled: f64,
    /// How much of the cost rests on each measured frame.
    weights: Vec<f64>,
}

impl Prediction {
    fn cost(&self) -> f64 {
        self.fixed + self.sampled
    }
}

/// Whether pixel counts carry costs, and whether anything could be learnt about that.
struct ByCounts {
    used: bool,
    learnt: bool,
}

/// Carries costs from the measured frames to the others.
struct Carrier<'a> {
    strata: &'a [Stratum],
    frames: &'a [FramePopulation],
    clock: ShotClock,
    /// In the order of time.
    sources: Vec<Source>,
}

impl<'a> Carrier<'a> {
    fn new(
        strata: &'a [Stratum],
        frames: &'a [FramePopulation],
        measured: &[SampledFrame<'_>],
    ) -> Result<Self, ForecastError> {
        let mut sources: Vec<Source> = Vec::with_capacity(measured.len());
        for one in measured {
            let unknown = ForecastError::ProfiledFrame { index: one.frame };
            let frame = frames.get(one.frame).ok_or(unknown.clone())?;
            if sources.iter().any(|source| source.frame == one.frame) {
                return Err(unknown);
            }
            let line =
                SampleLine::fit(one.costs).ok_or(ForecastError::NoSampleLine { frame: frame.number })?;
            let unit = |h: usize| {
                let time = one.stratum_times.get(h).copied().filter(|time| time.is_finite())?;
                (frame.counts[h] > 0).then(|| time.max(0.0) / f64::from(frame.counts[h]))
            };
            let unit_times = (0..strata.len()).map(unit).collect();
            sources.push(Source { frame: one.frame, line, unit_times });
        }
        if sources.is_empty() {
            return Err(ForecastError::NoSamples);
        }
        sources.sort_by_key(|source| source.frame);
        Ok(Self { strata, frames, clock: ShotClock::new(strata, frames), sources })
    }

    fn indices(&self) -> Vec<usize> {
        self.sources.iter().map(|source| source.frame).collect()
    }

    /// Predicts every measured frame from the others, with and without pixel counts, and lets the drift learn
    /// from the better way.
    fn judge(&self, frames: &[FramePopulation], samples: u32) -> (ByCounts, Drift) {
        let drift = Drift::new(&self.clock, frames, self.indices());
        if self.sources.len() < 3 {
            return (ByCounts { used: false, learnt: false }, drift);
        }
        let residuals = |by_counts: bool| -> Vec<f64> {
            let residual = |(k, source): (usize, &Source)| {
                let predicted = self.predict(source.frame, Some(k), by_counts, samples).cost();
                libm::log(source.line.at(samples).max(1.0) / predicted.max(1.0))
            };
            self.sources.iter().enumerate().map(residual).collect()
        };
        let [by_time, by_counts] = [residuals(false), residuals(true)];
        let size = |residuals: &[f64]| sum(residuals.iter().map(|r| r * r));
        let used = size(&by_counts) < CLEARLY_BETTER * CLEARLY_BETTER * size(&by_time);
        let mut learning = drift;
        for (k, &residual) in (if used { by_counts } else { by_time }).iter().enumerate() {
            learning.learn(k, residual, 0.0);
        }
        (ByCounts { used, learnt: true }, learning)
    }

    /// Predicts frame `t`, without the help of source `left_out`.
    fn predict(&self, t: usize, left_out: Option<usize>, by_counts: bool, samples: u32) -> Prediction {
        let mut prediction = Prediction { fixed: 0.0, sampled: 0.0, weights: vec![0.0; self.sources.len()] };
        for (k, share) in self.neighbours(t, left_out) {
            let source = &self.sources[k];
            let factor = if by_counts { self.size_ratio(t, source) } else { 1.0 };
            let sampled = share * factor * source.line.slope * f64::from(samples);
            let fixed = share * source.line.fixed;
            prediction.fixed += fixed;
            prediction.sampled += sampled;
            prediction.weights[k] = fixed + sampled;
        }
        prediction
    }

    /// The measured frames nearest before and after `t`, with shares that add up to one. Frames with the same
    /// lights are preferred.
    fn neighbours(&self, t: usize, left_out: Option<usize>) -> Vec<(usize, f64)> {
        let usable = |k: &usize| Some(*k) != left_out;
        let lights = self.frames[t].lights;
        let same = |k: &usize| usable(k) && self.frames[self.sources[*k].frame].lights == lights;
        let split = self.sources.partition_point(|source| source.frame <= t);
        let nearest = |useful: &dyn Fn(&usize) -> bool| {
            [(0..split).rev().find(useful), (split..self.sources.len()).find(useful)]
        };
        let found = match nearest(&same) {
            [None, None] => nearest(&usable),
            found => found,
        };
        let distance = |k: usize| self.clock.between(t, self.sources[k].frame);
        match found {
            [Some(before), Some(after)] => {
                let (near, far) = (distance(before), distance(after));
                let share = if near + far > 0.0 { far / (near + far) } else { 1.0 };
                vec![(before, share), (after, 1.0 - share)]
            }
            [Some(only), None] | [None, Some(only)] => vec![(only, 1.0)],
            [None, None] => Vec::new(),
        }
    }

    /// Expected cost per sample of frame `t` relative to that of a measured frame, by its times per pixel.
    /// Strata that the measured frame does not show have its mean time per pixel. One if nothing is known.
    fn size_ratio(&self, t: usize, source: &Source) -> f64 {
        let counts = |frame: usize| self.frames[frame].counts.iter().map(|&n| f64::from(n));
        let timed = |frame: usize| {
            let known = counts(frame).zip(&source.unit_times).filter_map(|(n, unit)| Some((n, (*unit)?)));
            known.fold((0.0, 0.0), |(pixels, time), (n, unit)| (pixels + n, time + n * unit))
        };
        let (pixels, own) = timed(source.frame);
        if pixels <= 0.0 || own <= 0.0 {
            return 1.0;
        }
        let mean = own / pixels;
        let there = counts(t).zip(&source.unit_times).zip(self.strata);
        let expected = sum(there.map(|((n, unit), stratum)| match unit {
            Some(unit) => n * unit,
            None if stratum.apart => 0.0,
            None => n * mean,
        }));
        expected / own
    }
}
