//! Divides a job into finished and unfinished pieces (frames or parts of them) and predicts the unfinished
//! ones. Several models of the residuals are filtered over the pieces and averaged by marginal likelihood.

use super::band::{Band, log_ratio, positive};
use super::frame::{Known, LiveFrame};
use super::kalman::{
    COMMON, COMPONENTS, Evidence, LIGHTS, Model, SETS, SLOPE, SMOOTH, SUM, State, Transition, Update,
};
use crate::conformal::{MAX_LOG_RATIO, Measure};
use crate::moments::sum;

/// Weight of the quote's own spread, as a number of frames.
pub(super) const SCALE_FREEDOM: f64 = 4.0;

/// Least number of finished frames for estimating the process length and the nugget.
pub(super) const MIN_FINISHED: usize = 5;

/// Candidate lengths of the process, as shares of the shot. The first is used while few frames are finished.
const LENGTHS: [f64; 3] = [1.0 / 3.0, 1.0 / 12.0, 1.0 / 48.0];

/// Candidate shares of the nugget in the unshared variance. The first holds while few frames are finished.
const NUGGETS: [f64; 3] = [0.5, 0.1, 0.9];

/// Candidate additions to the variance that all frames share, as multiples of a frame's variance. The quote
/// may underestimate it, so these are compared from the first finished frame on.
const EXTRA_COMMON: [f64; 3] = [0.0, 1.0, 3.0];

/// Share of the common variance that goes to several sets of lights. A half makes both equally likely.
const LIGHTS_SHARE: f64 = 0.5;

/// Least share of the shared, and of the unshared, variance in a frame's. No quote knows either to be zero.
const LEAST_SHARE: f64 = 0.1;

/// Models with less than this weight, relative to the best, are left out.
const LEAST_WEIGHT: f64 = 0.01;

/// Log-standard deviation between the costs per pixel of two halves of a frame, since tiles differ.
const BETWEEN_HALVES: f64 = 0.5;

/// A frame, or the finished or unfinished part of one. Both parts of a frame are at the same time.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// Time since the previous piece.
    step: f64,
    /// Quoted median, positive.
    quoted: f64,
    /// Variance of its nugget, relative to that of the average frame.
    nugget: f64,
    /// Index of its set of lights. The last index collects all sets that are not distinguished.
    lights: usize,
    /// For a finished piece: its residual, and a variance in addition to the nugget's.
    seen: Option<(f64, f64)>,
}

/// A job as a list of finished and unfinished pieces.
pub(super) struct Pieces {
    list: Vec<Piece>,
    /// Length of the shot on its clock.
    length: f64,
    /// Mean variance of the logarithm of a frame's cost, weighted by medians.
    variance: f64,
    /// Sum of the medians of all pieces.
    quoted: f64,
    /// Sum of squares of the sets of lights' shares in these medians. 1 if all frames have the same lights.
    lights: f64,
}

/// Distribution of the logarithm of the remaining cost.
pub(super) struct Posterior {
    /// Median.
    pub log_median: f64,
    /// Standard deviation, in units of that of the quote's total.
    pub deviations: f64,
    /// Degrees of freedom of the standard deviation. Infinite while the quote's own spread is used.
    pub freedom: f64,
}

impl Pieces {
    /// The pieces of a job that was quoted at `total`.
    pub fn new(total: &Band, frames: &[LiveFrame], measure: Measure) -> Self {
        // Scales the frames' means to medians that add up to the job's.
        let to_median = libm::exp(log_ratio(total.p50, total.mean));
        let median = |frame: &LiveFrame| positive(frame.quote.mean) * to_median;
        let variance_of = |frame: &LiveFrame| frame.quote.spread(measure).powi(2);
        let all = sum(frames.iter().map(median));
        let variance = sum(frames.iter().map(|frame| median(frame) * variance_of(frame)));
        let variance = if all > 0.0 { variance / all } else { measure.extra_deviation().powi(2) };
        let mut list = Vec::with_capacity(frames.len());
        let (mut before, mut length) = (None, 0.0);
        let (mut sets, mut of_set): (Vec<u32>, [f64; SETS]) = (Vec::with_capacity(SETS), [0.0; SETS]);
        for frame in frames {
            let quoted = median(frame);
            if quoted <= 0.0 {
                // A frame that was quoted at zero tells nothing about the others.
                continue;
            }
            let mut step = before.map_or(0.0, |before: f64| positive(frame.time - before));
            if frame.time.is_finite() {
                before = Some(frame.time);
            }
            length += step;
            let lights = sets.iter().position(|&set| set == frame.lights).unwrap_or_else(|| {
                if sets.len() < SETS {
                    sets.push(frame.lights);
                }
                sets.len() - 1
            });
            of_set[lights] += quoted;
            let nugget = variance_of(frame) / variance;
            let (done, cost) = match frame.known {
                Known::Nothing => (0.0, 0.0),
                Known::Part { share, cost } => (positive(share).min(1.0), positive(cost)),
                Known::All(cost) => (1.0, positive(cost)),
            };
            let mut push = |share: f64, seen| {
                list.push(Piece { step, quoted: share * quoted, nugget, lights, seen });
                step = 0.0;
            };
            if done > 0.0 {
                // A cost of zero has no logarithm. Such a part counts neither as observed nor as remaining.
                let residual = log_ratio(cost, done * quoted).clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO);
                let of_part = BETWEEN_HALVES * BETWEEN_HALVES * (1.0 - done) / done;
                if cost > 0.0 {
                    push(done, Some((residual, of_part)));
                }
            }
            if done < 1.0 {
                push(1.0 - done, None);
            }
        }
        let lights = if sets.len() > 1 { sum(of_set.iter().map(|own| (own / all).powi(2))) } else { 1.0 };
        Self { list, length: if length > 0.0 { length } else { 1.0 }, variance, quoted: all, lights }
    }

    /// Quoted median of the remainder.
    pub fn quoted_remainder(&self) -> f64 {
        sum(self.list.iter().filter(|piece| piece.seen.is_none()).map(|piece| piece.quoted))
    }

    /// Average of all models' predictions of the remainder. `of_job` is the log deviation of the quoted
    /// total.
    pub fn posterior(&self, of_job: f64) -> Posterior {
        let seen = self.list.iter().filter(|piece| piece.seen.is_some()).count();
        let few = seen < MIN_FINISHED;
        let lengths = if few { &LENGTHS[..1] } else { &LENGTHS[..] };
        let nuggets = if few { &NUGGETS[..1] } else { &NUGGETS[..] };
        let mut models = Vec::with_capacity(lengths.len() * nuggets.len());
        for length in lengths {
            let decay = 3.0f64.sqrt() / (length * self.length);
            let averaged = self.variance_of_mean(decay);
            for &nugget in nuggets {
                for more in EXTRA_COMMON {
                    let model = self.model(decay, averaged, nugget, of_job, more);
                    let evidence = self.filter(&model, |_, _, _| {});
                    models.push((model, evidence));
                }
            }
        }
        // Log-likelihood, integrated over the scale, without the constant that all models share.
        let freedom = SCALE_FREEDOM + seen as f64;
        let log_likelihood = |evidence: &Evidence| {
            -0.5 * evidence.log_variances - 0.5 * freedom * libm::log(SCALE_FREEDOM + evidence.surprise)
        };
        let best = models.iter().map(|(_, evidence)| log_likelihood(evidence)).fold(f64::MIN, f64::max);
        let mut weighted = Vec::with_capacity(models.len());
        for (model, evidence) in &models {
            let weight = libm::exp(log_likelihood(evidence) - best);
            if weight < LEAST_WEIGHT {
                continue;
            }
            let scale = (SCALE_FREEDOM + evidence.surprise) / freedom;
            let scale = if few { scale.max(1.0) } else { scale };
            let (log_median, variance) = self.remainder(model);
            weighted.push((weight, log_median, scale * variance / model.of_job));
        }
        let all = sum(weighted.iter().map(|(weight, ..)| *weight));
        let log_median = sum(weighted.iter().map(|(weight, log_median, _)| weight * log_median)) / all;
        let of_job = models.first().map_or(1.0, |(model, _)| model.of_job);
        let variance = sum(weighted.iter().map(|(weight, own, variance)| {
            let apart = own - log_median;
            weight * (variance + apart * apart / of_job)
        })) / all;
        let freedom = if few { f64::INFINITY } else { freedom };
        Posterior { log_median, deviations: libm::sqrt(variance.max(0.0)), freedom }
    }

    /// The model with the spreads of the quote: `self.variance` per frame and `of_job`² for the job.
    /// `averaged` is the share of the process's variance left after averaging over the job. `more` is added
    /// to the common variance, in multiples of a frame's.
    fn model(&self, decay: f64, averaged: f64, nugget: f64, of_job: f64, more: f64) -> Model {
        let squares = sum(self.list.iter().map(|piece| {
            let weight = piece.quoted / self.quoted;
            weight * weight * piece.nugget
        }));
        let kept = (1.0 - nugget) * averaged + nugget * squares;
        let of_job = of_job * of_job;
        let own = if kept < 1.0 { (self.variance - of_job) / (1.0 - kept) } else { 0.0 };
        let least = LEAST_SHARE * self.variance;
        let own = own.clamp(least, self.variance - least);
        let common = (of_job - kept * own).max(least);
        let of_lights = if self.lights < 1.0 { LIGHTS_SHARE * common } else { 0.0 };
        Model {
            decay,
            common: common - of_lights + more * self.variance,
            lights: of_lights / self.lights,
            smooth: own * (1.0 - nugget),
            nugget: own * nugget,
            of_job: common + kept * own,
        }
    }

    /// Variance of the average over all pieces of a process with variance one.
    fn variance_of_mean(&self, decay: f64) -> f64 {
        let model = Model { decay, common: 0.0, lights: 0.0, smooth: 1.0, nugget: 0.0, of_job: 1.0 };
        let mut state = State::new(&model);
        for piece in &self.list {
            state.advance(&model, piece.step);
            state.accumulate(piece.lights, piece.quoted / self.quoted);
        }
        state.variance[SUM][SUM].max(0.0)
    }

    /// Runs the Kalman filter over the pieces. Calls `each` after every piece with the state of the filter.
    fn filter(&self, model: &Model, mut each: impl FnMut(&Piece, &State, Option<Update>)) -> Evidence {
        let mut state = State::new(model);
        let mut evidence = Evidence { surprise: 0.0, log_variances: 0.0 };
        for piece in &self.list {
            state.advance(model, piece.step);
            let update = piece.seen.map(|(residual, more)| {
                let own = model.nugget * piece.nugget;
                let update = state.update(piece.lights, residual + 0.5 * own, own + more);
                evidence.surprise += update.innovation * update.innovation / update.variance;
                evidence.log_variances += libm::log(update.variance);
                update
            });
            each(piece, &state, update);
        }
        evidence
    }

    /// The expected residual c + l + g of every piece, given all finished pieces.
    fn smoothed(&self, model: &Model) -> Vec<f64> {
        let mut steps = Vec::with_capacity(self.list.len());
        self.filter(model, |piece, state, update| {
            steps.push((state.expected(piece.lights), state.signal(piece.lights), update));
        });
        // The adjoint state of the later pieces. Zero after the last one.
        let mut adjoint = [0.0; COMPONENTS];
        let mut smoothed = vec![0.0; steps.len()];
        for (at, (mean, signal, update)) in steps.iter().enumerate().rev() {
            let correction: f64 = signal.iter().zip(&adjoint).map(|(s, a)| s * a).sum();
            smoothed[at] = (mean - correction).clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO);
            if let Some(Update { innovation, variance, gain }) = update {
                let through: f64 = gain.iter().zip(&adjoint).map(|(g, a)| g * a).sum();
                let change = innovation / variance + through;
                for part in [COMMON, SMOOTH, LIGHTS + self.list[at].lights] {
                    adjoint[part] -= change;
                }
            }
            let Transition { matrix, .. } = model.transition(self.list[at].step);
            let [level, slope] = [adjoint[SMOOTH], adjoint[SLOPE]];
            adjoint[SMOOTH] = matrix[0][0] * level + matrix[1][0] * slope;
            adjoint[SLOPE] = matrix[0][1] * level + matrix[1][1] * slope;
        }
        smoothed
    }

    /// Logarithm of the median of the remaining cost, and the variance of that logarithm.
    fn remainder(&self, model: &Model) -> (f64, f64) {
        let residuals = self.smoothed(model);
        let left = || self.list.iter().zip(&residuals).filter(|(piece, _)| piece.seen.is_none());
        // Relative to the quoted remainder, so that the size of the job causes no overflow or underflow.
        let quoted = self.quoted_remainder();
        let expected = |piece: &Piece, residual: f64| piece.quoted / quoted * libm::exp(residual);
        let median = sum(left().map(|(piece, &residual)| expected(piece, residual)));
        let nuggets = sum(left().map(|(piece, &residual)| {
            let share = expected(piece, residual) / median;
            share * share * piece.nugget * model.nugget
        }));
        let mut state = State::new(model);
        for (piece, &residual) in self.list.iter().zip(&residuals) {
            state.advance(model, piece.step);
            match piece.seen {
                Some((seen, more)) => {
                    let own = model.nugget * piece.nugget;
                    state.update(piece.lights, seen + 0.5 * own, own + more);
                }
                None => state.accumulate(piece.lights, expected(piece, residual) / median),
            }
        }
        (libm::log(median) + libm::log(quoted), state.variance[SUM][SUM].max(0.0) + nuggets)
    }
}
