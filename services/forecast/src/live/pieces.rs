//! A job as pieces that are finished or are not, and what the ones say of the others.

use super::state::{
    COMMON, COMPONENTS, Evidence, LIGHTS, Model, SETS, SLOPE, SMOOTH, SUM, State, Transition, Update,
};
use super::{Band, Known, LiveFrame, log_ratio, usable};
use crate::conformal::{FARTHEST, Measure};
use crate::moments::sum;

/// Frames that the quote's own idea of its spread counts for.
pub(super) const SCALE_FREEDOM: f64 = 4.0;

/// With fewer finished frames than this neither length nor nugget is estimated.
pub(super) const FEW: usize = 5;

/// Lengths of the process that are weighed against each other, as parts of the shot; the first is used while there are few frames.
const LENGTHS: [f64; 3] = [1.0 / 3.0, 1.0 / 12.0, 1.0 / 48.0];

/// Shares of the nugget in what frames do not have in common; the first is used while there are few frames.
const NUGGETS: [f64; 3] = [0.5, 0.1, 0.9];

/// What frames have in common may be more than the quote knows of: this times the variance of a frame. Weighed against each other from the first frame on.
const MORE_COMMON: [f64; 3] = [0.0, 1.0, 3.0];

/// Share of what frames have in common that is apart for each set of lights, where there are several: as likely the one as the other.
const OF_LIGHTS: f64 = 0.5;

/// What frames have in common is at least this share of their variance, and so is what they do not: no quote knows either to be nothing.
const LEAST_SHARE: f64 = 0.1;

/// Models of less than this posterior weight are left out.
const LEAST_WEIGHT: f64 = 0.01;

/// Log-standard deviation between the cost of a pixel in one half of a frame and in the other: tiles differ.
const BETWEEN_HALVES: f64 = 0.5;

/// A frame, or the part of one that is finished or is not: a part is a frame of its own, at the same time.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// Since the piece before.
    step: f64,
    /// Median as quoted, positive.
    quoted: f64,
    /// Variance of its nugget over that of the mean frame.
    nugget: f64,
    /// Place of its lights among those of the job; the last is of all that are not told apart.
    lights: usize,
    /// What is known of it: its residual, and a variance that it has beside the nugget.
    seen: Option<(f64, f64)>,
}

/// A job as what is finished of it, and what is not.
pub(super) struct Pieces {
    list: Vec<Piece>,
    /// Of the shot's clock.
    length: f64,
    /// Mean variance of a frame's logarithm, weighted by medians.
    variance: f64,
    /// Sum of the medians of all pieces.
    quoted: f64,
    /// Sum of the squared shares of the sets of lights in these medians; 1 if the same ones shine in all frames.
    lights: f64,
}

/// What is known of the logarithm of the remainder.
pub(super) struct Posterior {
    /// Its median.
    pub log_median: f64,
    /// Its standard deviation, in those of the quote's total.
    pub deviations: f64,
    /// Degrees of freedom of that, infinite where the quote is taken at its word.
    pub freedom: f64,
}

impl Pieces {
    /// Those of a job that was quoted at `total`.
    pub fn new(total: &Band, frames: &[LiveFrame], measure: Measure) -> Self {
        // Medians that add up to the job's.
        let to_median = libm::exp(log_ratio(total.p50, total.mean));
        let median = |frame: &LiveFrame| usable(frame.quote.mean) * to_median;
        let variance_of = |frame: &LiveFrame| frame.quote.spread(measure).powi(2);
        let all = sum(frames.iter().map(median));
        let variance = sum(frames.iter().map(|frame| median(frame) * variance_of(frame)));
        let variance = if all > 0.0 { variance / all } else { measure.unknown().powi(2) };
        let mut list = Vec::with_capacity(frames.len());
        let (mut before, mut length) = (None, 0.0);
        let (mut sets, mut of_set): (Vec<u32>, [f64; SETS]) = (Vec::with_capacity(SETS), [0.0; SETS]);
        for frame in frames {
            let quoted = median(frame);
            if quoted <= 0.0 {
                // It says nothing of the others.
                continue;
            }
            let mut step = before.map_or(0.0, |before: f64| usable(frame.time - before));
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
                Known::Part { share, cost } => (usable(share).min(1.0), usable(cost)),
                Known::All(cost) => (1.0, usable(cost)),
            };
            let mut push = |share: f64, seen| {
                list.push(Piece { step, quoted: share * quoted, nugget, lights, seen });
                step = 0.0;
            };
            if done > 0.0 {
                // Of what took nothing a logarithm says nothing: it is a piece that is neither seen nor left.
                let residual = log_ratio(cost, done * quoted).clamp(-FARTHEST, FARTHEST);
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

    /// Median of what remains, as quoted.
    pub fn quoted_remainder(&self) -> f64 {
        sum(self.list.iter().filter(|piece| piece.seen.is_none()).map(|piece| piece.quoted))
    }

    /// What all models together say of what remains, if the job's own spread is `of_job`.
    pub fn posterior(&self, of_job: f64) -> Posterior {
        let seen = self.list.iter().filter(|piece| piece.seen.is_some()).count();
        let few = seen < FEW;
        let lengths = if few { &LENGTHS[..1] } else { &LENGTHS[..] };
        let nuggets = if few { &NUGGETS[..1] } else { &NUGGETS[..] };
        let mut models = Vec::with_capacity(lengths.len() * nuggets.len());
        for length in lengths {
            let decay = 3.0f64.sqrt() / (length * self.length);
            let averaged = self.variance_of_mean(decay);
            for &nugget in nuggets {
                for more in MORE_COMMON {
                    let model = self.model(decay, averaged, nugget, of_job, more);
                    let evidence = self.filter(&model, |_, _, _| {});
                    models.push((model, evidence));
                }
            }
        }
        // Integrated over the scale; what all models share is left out.
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

    /// The variances that the quote's own spreads call for: frames have `self.variance`, the job has `of_job`², of which the process keeps the
    /// part `averaged` when it is averaged over the job; and `more` variances of a frame in common, of which the quote knows nothing.
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
        let of_lights = if self.lights < 1.0 { OF_LIGHTS * common } else { 0.0 };
        Model {
            decay,
            common: common - of_lights + more * self.variance,
            lights: of_lights / self.lights,
            smooth: own * (1.0 - nugget),
            nugget: own * nugget,
            of_job: common + kept * own,
        }
    }

    /// Variance of the process of variance one, averaged over all pieces.
    fn variance_of_mean(&self, decay: f64) -> f64 {
        let model = Model { decay, common: 0.0, lights: 0.0, smooth: 1.0, nugget: 0.0, of_job: 1.0 };
        let mut state = State::new(&model);
        for piece in &self.list {
            state.advance(&model, piece.step);
            state.accumulate(piece.lights, piece.quoted / self.quoted);
        }
        state.variance[SUM][SUM].max(0.0)
    }

    /// Filters the pieces; `each` is told what the filter knew after each of them.
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

    /// The expected residual c + l + g of every piece, given all that is seen.
    fn smoothed(&self, model: &Model) -> Vec<f64> {
        let mut steps = Vec::with_capacity(self.list.len());
        self.filter(model, |piece, state, update| {
            steps.push((state.expected(piece.lights), state.signal(piece.lights), update));
        });
        // The adjoint of what follows; zero behind the last piece.
        let mut adjoint = [0.0; COMPONENTS];
        let mut smoothed = vec![0.0; steps.len()];
        for (at, (mean, signal, update)) in steps.iter().enumerate().rev() {
            let correction: f64 = signal.iter().zip(&adjoint).map(|(s, a)| s * a).sum();
            smoothed[at] = (mean - correction).clamp(-FARTHEST, FARTHEST);
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

    /// Logarithm of the median of what remains, and the variance of that logarithm.
    fn remainder(&self, model: &Model) -> (f64, f64) {
        let residuals = self.smoothed(model);
        let left = || self.list.iter().zip(&residuals).filter(|(piece, _)| piece.seen.is_none());
        // As parts of what was quoted for the rest, so that no job is too large and no rest too small.
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
