//! Forecasts every frame of a shot from a few profiled ones: unit costs of the strata are carried to the
//! other frames. All frames depend on the same samples, which the variance of a total takes into account.

use serde::{Deserialize, Serialize};

use crate::cost::{COLUMNS, Cost, Costs, Observation, Quantity, Row, WORK, add_scaled};
use crate::drift::Drift;
use crate::error::ForecastError;
use crate::estimate::{BORROWED_FREEDOM, BORROWED_VARIATION, FrameFit, StratumEstimate, Uncertainty};
use crate::expansion::Expansion;
use crate::interval::{Calibration, Part, log_deviation, quantity};
use crate::moments::sum;
use crate::population::{FramePopulation, check_frames};
use crate::shot_clock::ShotClock;
use crate::strata::Stratum;

/// The result of profiling one frame.
#[derive(Clone, Copy, Debug)]
pub struct ProfiledFrame<'a> {
    /// Index of the frame among the shot's frames.
    pub frame: usize,
    /// The profiled pixels and the measured cache records.
    pub observations: &'a [Observation],
    /// How the profiled pixels are expanded to all pixels.
    pub expansion: &'a Expansion,
    /// Cost of the frame that does not depend on its pixels or triangles: loading, planning, writing.
    pub fixed: Cost,
    /// Cost of building the tree over its triangles.
    pub build: Cost,
}

/// Forecast of one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameForecast {
    /// The frame's number.
    pub number: i64,
    /// Whether pixels of this frame were profiled.
    pub profiled: bool,
    /// Totals over all pixels, including the fixed cost.
    pub total: Costs<Quantity>,
    /// One entry per stratum.
    pub strata: Vec<StratumEstimate>,
}

/// Forecast of a whole shot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShotForecast {
    /// Every frame, in order.
    pub frames: Vec<FrameForecast>,
    /// Totals over all frames. Their quantiles are *not* sums of the frames' quantiles.
    pub total: Costs<Quantity>,
    /// Log-standard deviation of the job's total work, inflated like the quantiles. It is the error that the
    /// frames share, because they depend on the same samples. It does not average out over frames.
    pub job_sigma: f64,
    /// Number of groups of strata in profiled frames that borrow, plus strata that no profiled frame shows.
    pub borrowed: usize,
    /// Whether the quantiles were calibrated on past jobs.
    pub calibrated: bool,
}

/// Forecasts every frame from the profiled ones.
///
/// A profiled frame is estimated as by [`crate::estimate()`]. Another frame t has ŷ_t = Σ_h N_h,t ĉ_h(t) +
/// fixed(t). The unit cost of a stratum comes from the nearest profiled frames before and after that sampled
/// it, each with the weight 1 / (CV² / n_h + q Δτ). Here q is the prior drift of unit costs. Time is the
/// shot's own (`shot_clock`), so frames beyond a cut have little weight. Frames with the same lights are
/// preferred.
///
/// The variance of a frame and of the total has three parts.
///
/// * *Sampling*: each group mean of a profiled frame counts with all pixels that depend on it, over all
///   frames. So shared errors are added before they are squared.
/// * *Carrying*: the residual ln(y_t / ŷ_t) is a random walk that is zero at every profiled frame. Its rate
///   has a prior of 10 % over a third of the shot, and learns from predicting each profiled frame by the
///   others.
/// * *Borrowing*: a stratum that no profiled frame shows costs what its material costs, with a standard
///   deviation of half of that.
///
/// # Errors
/// If nothing was profiled, or frames, counts, strata and observations do not match.
pub fn forecast_shot(
    strata: &[Stratum],
    frames: &[FramePopulation],
    profiled: &[ProfiledFrame<'_>],
    calibration: Calibration,
) -> Result<ShotForecast, ForecastError> {
    check_frames(strata, frames)?;
    let carrier = Carrier::new(strata, frames, profiled)?;
    let predictions: Vec<Prediction> = (0..frames.len()).map(|t| carrier.predict(t, None)).collect();
    let drifts: Vec<Drift> = (0..COLUMNS).map(|column| carrier.drift(column)).collect();

    let mut unseen = vec![[0.0; COLUMNS]; strata.len()];
    let mut weights = carrier.no_weights();
    let frame_forecasts = predictions
        .iter()
        .enumerate()
        .map(|(t, prediction)| {
            for (all, own) in weights.iter_mut().flatten().zip(prediction.weights.iter().flatten()) {
                *all += own;
            }
            for &h in &prediction.unseen {
                add_scaled(&mut unseen[h], f64::from(frames[t].counts[h]), &prediction.means[h]);
            }
            let total = std::array::from_fn(|column| {
                let borrowed = prediction
                    .unseen
                    .iter()
                    .map(|&h| f64::from(frames[t].counts[h]) * prediction.means[h][column]);
                let mut uncertainty = carrier.uncertainty(&prediction.weights, borrowed, column);
                uncertainty.add_part(drifts[column].of_frame(t, prediction.total[column]));
                let mean = prediction.total[column] + prediction.fixed[column];
                quantity(mean, uncertainty.combined(), calibration)
            });
            FrameForecast {
                number: frames[t].number,
                profiled: carrier.profiled_at(t).is_some(),
                total: Costs::from(total),
                strata: carrier.stratum_estimates(t, prediction),
            }
        })
        .collect();

    let total: [Quantity; COLUMNS] = std::array::from_fn(|column| {
        let borrowed = unseen.iter().map(|amounts| amounts[column]);
        let mut uncertainty = carrier.uncertainty(&weights, borrowed, column);
        let traced: Vec<f64> = predictions.iter().map(|p| p.total[column]).collect();
        uncertainty.add_part(drifts[column].of_total(&traced));
        let mean = sum(traced) + sum(predictions.iter().map(|p| p.fixed[column]));
        quantity(mean, uncertainty.combined(), calibration)
    });
    let mut never_seen: Vec<usize> = predictions.iter().flat_map(|p| p.unseen.iter().copied()).collect();
    never_seen.sort_unstable();
    never_seen.dedup();
    Ok(ShotForecast {
        frames: frame_forecasts,
        job_sigma: log_deviation(total[WORK].mean, total[WORK].variance) * calibration.inflation,
        total: Costs::from(total),
        borrowed: carrier.borrowed_groups() + never_seen.len(),
        calibrated: calibration.calibrated,
    })
}

/// Squared coefficient of variation within a stratum, weighed against drift.
const CARRIED_VARIATION_SQUARED: f64 = 0.25;

/// A frame as predicted from the profiled ones.
struct Prediction {
    /// Totals over pixels, without the fixed cost.
    total: Row,
    fixed: Row,
    /// Unit costs by stratum.
    means: Vec<Row>,
    /// Number of pixels that depend on each group of each profiled frame.
    weights: Vec<Vec<f64>>,
    /// Strata that none of the profiled frames shows.
    unseen: Vec<usize>,
}

/// A profiled frame with its estimate.
struct Source {
    frame: usize,
    fit: FrameFit,
    fixed: Row,
    build: Row,
    /// Mean unit cost of all pixels of the frame, without cache records.
    overall: Row,
}

/// Difference of two frames' lights: only one has any, then the number. Up to a third counts as equal.
fn light_difference(one: &FramePopulation, other: &FramePopulation) -> (bool, u32) {
    let (fewer, more) = (one.shining.min(other.shining), one.shining.max(other.shining));
    let differ = more - fewer;
    ((fewer == 0) != (more == 0), if differ <= more / 3 { 0 } else { differ })
}

/// Carries unit costs from the profiled frames to the others.
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
        profiled: &[ProfiledFrame<'_>],
    ) -> Result<Self, ForecastError> {
        let mut sources = Vec::with_capacity(profiled.len());
        let mut taken = vec![false; frames.len()];
        for profile in profiled {
            let unknown = ForecastError::ProfiledFrame { index: profile.frame };
            let frame = frames.get(profile.frame).ok_or(unknown.clone())?;
            if std::mem::replace(&mut taken[profile.frame], true) {
                return Err(unknown);
            }
            let fit =
                FrameFit::new(strata, frame.number, &frame.counts, profile.observations, profile.expansion)?;
            let overall = std::array::from_fn(|column| fit.mean_of_pixels(column));
            let [fixed, build] =
                [profile.fixed, profile.build].map(|cost| cost.columns().map(|value| value as f64));
            sources.push(Source { frame: profile.frame, fit, fixed, build, overall });
        }
        if sources.is_empty() && !frames.is_empty() {
            return Err(ForecastError::NoSamples);
        }
        sources.sort_by_key(|source| source.frame);
        Ok(Carrier { strata, frames, clock: ShotClock::new(strata, frames), sources })
    }

    fn profiled_at(&self, t: usize) -> Option<usize> {
        self.sources.binary_search_by_key(&t, |source| source.frame).ok()
    }

    fn borrowed_groups(&self) -> usize {
        self.sources.iter().flat_map(|source| &source.fit.groups).filter(|group| group.borrowed).count()
    }

    fn no_weights(&self) -> Vec<Vec<f64>> {
        self.sources.iter().map(|source| vec![0.0; source.fit.groups.len()]).collect()
    }

    /// Predicts frame t, without the help of source `left_out`.
    fn predict(&self, t: usize, left_out: Option<usize>) -> Prediction {
        let mut weights = self.no_weights();
        if let Some(k) = self.profiled_at(t)
            && left_out != Some(k)
        {
            let source = &self.sources[k];
            for (weight, group) in weights[k].iter_mut().zip(&source.fit.groups) {
                *weight = group.pixels as f64;
            }
            let total = std::array::from_fn(|column| source.fit.total(column));
            let means = source.fit.means.clone();
            let mut fixed = source.fixed;
            add_scaled(&mut fixed, 1.0, &source.build);
            return Prediction { total, fixed, means, weights, unseen: Vec::new() };
        }
        let mut means = vec![[0.0; COLUMNS]; self.strata.len()];
        let mut unseen = Vec::new();
        for (h, &pixels) in self.frames[t].counts.iter().enumerate() {
            if pixels == 0 {
                continue;
            }
            let sampled = |k: usize| self.sources[k].fit.strata[h].samples > 0;
            let shown = |k: usize| self.sources[k].fit.strata[h].pixels > 0;
            let mut shares = self.neighbours(t, left_out, |k| sampled(k).then(|| self.samples(k, h)));
            if shares.is_empty() {
                shares = self.neighbours(t, left_out, |k| shown(k).then_some(1.0));
            }
            if shares.is_empty() {
                unseen.push(h);
                means[h] = self.material_mean(t, left_out, &self.strata[h]);
            }
            for (k, share) in shares {
                let fit = &self.sources[k].fit;
                add_scaled(&mut means[h], share, &fit.means[h]);
                if let Some(group) = fit.group_of[h] {
                    weights[k][group] += share * f64::from(pixels);
                }
            }
        }
        let counts = &self.frames[t].counts;
        let total = std::array::from_fn(|column| {
            sum(counts.iter().zip(&means).map(|(&pixels, mean)| f64::from(pixels) * mean[column]))
        });
        let mut fixed = [0.0; COLUMNS];
        for (k, share) in self.neighbours(t, left_out, |_| Some(f64::INFINITY)) {
            let source = &self.sources[k];
            add_scaled(&mut fixed, share, &source.fixed);
            // A tree takes as much as there are triangles, which need not be in sight.
            let [here, there] = [t, source.frame].map(|frame| self.frames[frame].triangles as f64);
            let size = if there > 0.0 { here / there } else { 1.0 };
            add_scaled(&mut fixed, share * size, &source.build);
        }
        Prediction { total, fixed, means, weights, unseen }
    }

    fn samples(&self, k: usize, h: usize) -> f64 {
        f64::from(self.sources[k].fit.strata[h].samples)
    }

    /// The nearest usable sources before and after frame t, with shares that add up to one. Those with the
    /// most similar lights are preferred. `samples` is the number of samples of a source, or `None` if not
    /// usable.
    fn neighbours(
        &self,
        t: usize,
        left_out: Option<usize>,
        samples: impl Fn(usize) -> Option<f64>,
    ) -> Vec<(usize, f64)> {
        let usable = |k: &usize| Some(*k) != left_out && samples(*k).is_some();
        let (own, of) = (&self.frames[t], |k: usize| &self.frames[self.sources[k].frame]);
        let same = |k: &usize| usable(k) && of(*k).lights == own.lights;
        let split = self.sources.partition_point(|source| source.frame <= t);
        let nearest = |useful: &dyn Fn(&usize) -> bool| {
            [(0..split).rev().find(useful), (split..self.sources.len()).find(useful)]
        };
        let nearest = match nearest(&same) {
            [None, None] => {
                let closest =
                    (0..self.sources.len()).filter(usable).map(|k| light_difference(own, of(k))).min();
                nearest(&|k: &usize| usable(k) && Some(light_difference(own, of(*k))) == closest)
            }
            found => found,
        };
        let drift = Drift::prior_rate(&self.clock);
        let mut shares: Vec<(usize, f64)> = nearest
            .into_iter()
            .flatten()
            .map(|k| {
                let noise = samples(k).map_or(0.0, |n| CARRIED_VARIATION_SQUARED / n);
                (k, 1.0 / (noise + drift * self.clock.between(t, self.sources[k].frame)))
            })
            .collect();
        let all: f64 = shares.iter().map(|(_, share)| share).sum();
        shares.iter_mut().for_each(|(_, share)| *share /= all);
        shares
    }

    /// Mean unit cost of a stratum's material in the profiled frames nearest to frame t. If none shows it,
    /// the mean over all pixels, for cache records times their prior cost.
    fn material_mean(&self, t: usize, left_out: Option<usize>, stratum: &Stratum) -> Row {
        let amount = |k: usize| {
            let source = &self.sources[k];
            let mut amount = [0.0; COLUMNS];
            let mut pixels = 0.0;
            for h in (0..self.strata.len()).filter(|&h| self.strata[h].material == stratum.material) {
                let shown = f64::from(source.fit.strata[h].pixels);
                pixels += shown;
                add_scaled(&mut amount, shown, &source.fit.means[h]);
            }
            (pixels > 0.0).then(|| amount.map(|value| value / pixels))
        };
        let mut shares = self.neighbours(t, left_out, |k| amount(k).map(|_| 1.0));
        if shares.is_empty() {
            shares = self.neighbours(t, left_out, |_| Some(1.0));
        }
        let prior = if stratum.apart { stratum.prior_cost } else { 1.0 };
        let mut mean = [0.0; COLUMNS];
        for (k, share) in shares {
            let unit = amount(k).unwrap_or_else(|| self.sources[k].overall.map(|value| value * prior));
            add_scaled(&mut mean, share, &unit);
        }
        mean
    }

    /// Sampling and borrowing error of a total in which each group mean has the weight `weights`.
    fn uncertainty(
        &self,
        weights: &[Vec<f64>],
        borrowed: impl Iterator<Item = f64>,
        column: usize,
    ) -> Uncertainty {
        let mut uncertainty = Uncertainty::default();
        for (source, weights) in self.sources.iter().zip(weights) {
            for (group, &weight) in source.fit.groups.iter().zip(weights) {
                uncertainty.add(group, weight, column);
            }
        }
        for amount in borrowed {
            let deviation = BORROWED_VARIATION * amount;
            uncertainty
                .add_part(Part { variance: deviation * deviation, degrees_of_freedom: BORROWED_FREEDOM });
        }
        uncertainty
    }

    /// Whether all profiled pixels cost exactly the same in this column, and records nothing: camera rays.
    fn is_constant(&self, column: usize) -> bool {
        let mut groups = self.sources.iter().flat_map(|source| &source.fit.groups);
        let pixels = self.sources[0].fit.groups.iter().find(|group| !group.is_apart());
        let constant = pixels.and_then(|group| group.constant(column));
        constant.is_some()
            && groups
                .all(|group| group.constant(column) == if group.is_apart() { Some(0.0) } else { constant })
    }

    /// Learns how fast unit costs drift, from how well each profiled frame is predicted by the others.
    fn drift(&self, column: usize) -> Drift {
        let profiled = self.sources.iter().map(|source| source.frame).collect();
        let mut drift = Drift::new(&self.clock, self.frames, profiled);
        if self.sources.len() < 2 {
            return drift;
        }
        if column > WORK && self.is_constant(column) {
            return drift.without_drift();
        }
        for (k, source) in self.sources.iter().enumerate() {
            let measured = source.fit.total(column);
            let prediction = self.predict(source.frame, Some(k));
            let predicted = prediction.total[column];
            if measured > 0.0 && predicted > 0.0 {
                let borrowed = prediction
                    .unseen
                    .iter()
                    .map(|&h| f64::from(self.frames[source.frame].counts[h]) * prediction.means[h][column]);
                let of_prediction =
                    self.uncertainty(&prediction.weights, borrowed, column).combined().variance;
                let own = self.predict(source.frame, None);
                let of_frame = self.uncertainty(&own.weights, std::iter::empty(), column).combined().variance;
                let noise = of_prediction / predicted / predicted + of_frame / measured / measured;
                drift.learn(k, libm::log(measured / predicted), noise);
            }
        }
        drift
    }

    fn stratum_estimates(&self, t: usize, prediction: &Prediction) -> Vec<StratumEstimate> {
        if let Some(k) = self.profiled_at(t) {
            return self.sources[k].fit.strata.clone();
        }
        (0..self.strata.len())
            .map(|h| StratumEstimate {
                pixels: self.frames[t].counts[h],
                samples: 0,
                borrowed: self.frames[t].counts[h] > 0
                    && self.sources.iter().all(|source| source.fit.strata[h].samples == 0),
                mean: Costs::from(prediction.means[h]),
            })
            .collect()
    }
}
