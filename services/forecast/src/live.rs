//! The estimate lives: what a job will have cost, given its quote and what its finished frames took.
//!
//! The quote gives every frame t a median x_t. What a finished frame took, y_t, is the truth; of the others the *residual* d_t = ln(y_t / x_t)
//! is unknown, and what is known of finished frames says something of it:
//!
//! ```text
//! d_t = c + g(τ_t) + e_t
//! ```
//!
//! with a factor c that the job's frames have in common, a Gaussian process g with Matérn covariance (ν = 3/2) over the shot's own clock τ
//! (a cut separates, see [`shot_times`]), and a nugget e_t, the frame's own. How much there is of each is what the quote says of itself: the frames'
//! spreads are the sum of all three, the job's spread is what does not average out. Frames of which the quote is less sure have a larger nugget.
//!
//! *How sure the quote was* is itself in doubt. All variances share an unknown scale, which starts at one, as if [`SCALE_FREEDOM`] frames had
//! been seen to agree with the quote, and learns from how surprising each finished frame is, given those before it: the
//! conjugate prior of a normal model (Gelman et al., *Bayesian Data Analysis*, 3rd edition 2013, section 3.3). The length of g and the
//! nugget's share are not estimated from fewer than [`FEW`] frames: the length is a third of the shot, and the scale does not fall below
//! one, so that no interval shrinks by luck. From there on a few of each are weighed by their marginal likelihood. That all frames are off alike by more
//! than the quote thinks possible is weighed against the quote's word from the first frame on.
//!
//! *In linear time.* g is a state-space model (Hartikainen, Särkkä 2010): the state (c, g, g′) goes from frame to frame by a 3 × 3 matrix, and the
//! Kalman filter with the modified Bryson–Frazier smoother (Bierman 1973) gives all residuals in one pass there and one back. The variance of the sum
//! over unfinished frames, a'[K_UU − K_US (K_SS + D)⁻¹ K_SU] a with weights a_t = x_t exp(d̂_t), takes no matrix either: the sum so far is a fourth
//! component of the state, and what is left of its variance after the last frame is the answer. Nothing is carried from one call
//! to the next, so the order in which frames finish does not matter, to the last bit.
//!
//! *The quantiles* of what remains keep the quote's shape, which may have been learnt from past jobs: their distances from the median, in
//! logarithms, are those of the quote times the ratio of the standard deviations now and at the beginning.

use crate::clock::ShotClock;
use crate::conformal::{FARTHEST, Measure, NORMAL_95};
use crate::error::ForecastError;
use crate::frames::{FramePopulation, check_frames};
use crate::moments::sum;
use crate::strata::Stratum;

/// Quantile at 0.80 of the standard normal distribution.
const NORMAL_80: f64 = 0.841_621_233_572_914_2;

/// Frames that the quote's own idea of its spread counts for.
const SCALE_FREEDOM: f64 = 4.0;

/// With fewer finished frames than this neither length nor nugget is estimated.
const FEW: usize = 5;

/// Lengths of the process that are weighed against each other, as parts of the shot; the first is used while there are few frames.
const LENGTHS: [f64; 3] = [1.0 / 3.0, 1.0 / 12.0, 1.0 / 48.0];

/// Shares of the nugget in what frames do not have in common; the first is used while there are few frames.
const NUGGETS: [f64; 3] = [0.5, 0.1, 0.9];

/// What frames have in common may be more than the quote knows of: this times the variance of a frame. Weighed against each other from the first frame on.
const MORE_COMMON: [f64; 3] = [0.0, 1.0, 3.0];

/// What frames have in common is at least this share of their variance, and so is what they do not: no quote knows either to be nothing.
const LEAST_SHARE: f64 = 0.1;

/// Models of less than this posterior weight are left out.
const LEAST_WEIGHT: f64 = 0.01;

/// Log-standard deviation between the cost of a pixel in one half of a frame and in the other: tiles differ.
const BETWEEN_HALVES: f64 = 0.5;

/// The logarithm of no median is farther from zero, so that neither it nor its quantiles leave the range of a float.
const FARTHEST_MEDIAN: f64 = 600.0;

/// A forecast of one number: its mean and three quantiles, not negative and ascending.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Band {
    /// Expected value.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 80 % quantile.
    pub p80: f64,
    /// 95 % quantile.
    pub p95: f64,
}

impl Band {
    /// A number that is known.
    pub const fn known(value: f64) -> Self {
        Self { mean: value, p50: value, p80: value, p95: value }
    }

    fn plus(self, spent: f64) -> Self {
        let Self { mean, p50, p80, p95 } = self;
        Self { mean: mean + spent, p50: p50 + spent, p80: p80 + spent, p95: p95 + spent }
    }

    /// Standard deviation of the logarithm that the quantiles stand for, with what no formula knows.
    fn spread(&self, measure: Measure) -> f64 {
        libm::hypot(log_ratio(self.p95, self.p50) / NORMAL_95, measure.unknown())
    }
}

/// What is known of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Known {
    /// Nothing but its quote.
    Nothing,
    /// A share of it, between 0 and 1, is finished and took this much.
    Part {
        /// Finished pixels over all pixels.
        share: f64,
        /// What they took.
        cost: f64,
    },
    /// All of it is finished, and took this much.
    All(f64),
}

/// A frame of the job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiveFrame {
    /// When it is on the shot's own clock ([`shot_times`]).
    pub time: f64,
    /// What was quoted.
    pub quote: Band,
    /// What has come of it.
    pub known: Known,
}

/// The estimate as it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Live {
    /// What all that is finished took.
    pub spent: f64,
    /// What the rest will take.
    pub remaining: Band,
    /// All of it.
    pub whole: Band,
    /// Median of what remains over what was quoted for it: 1.3 if the job turns out 30 % dearer. 1 if nothing remains.
    pub factor: f64,
}

/// When each frame is on the shot's own clock, which runs faster where the picture changes faster: from zero, strictly increasing. A light that goes on
/// or off is a cut: what the quote got wrong with it says little of frames without it.
///
/// # Errors
/// If frames are out of order, or counts and strata do not fit together.
pub fn shot_times(strata: &[Stratum], frames: &[FramePopulation]) -> Result<Vec<f64>, ForecastError> {
    check_frames(strata, frames)?;
    let clock = ShotClock::new(strata, frames);
    let frames_apart = |early: i64, late: i64| late.abs_diff(early) as f64;
    let length = match frames {
        [first, .., last] => frames_apart(first.number, last.number),
        _ => 0.0,
    };
    let mut cuts = 0.0;
    let mut times = clock.times().to_vec();
    for (time, pair) in times.iter_mut().skip(1).zip(frames.windows(2)) {
        cuts += if pair[0].lights == pair[1].lights { 0.0 } else { length };
        *time += cuts;
    }
    Ok(times)
}

/// The estimate of a job that was quoted at `total`, of these frames in their order.
///
/// While nothing is finished it is the quote itself, and once everything is, the truth. Takes time linear in the number of frames. Numbers that
/// are negative or not finite count as zero.
pub fn live(total: &Band, frames: &[LiveFrame], measure: Measure) -> Live {
    let spent = sum(frames.iter().map(|frame| match frame.known {
        Known::Nothing => 0.0,
        Known::Part { cost, .. } | Known::All(cost) => usable(cost),
    }));
    if frames.iter().all(|frame| matches!(frame.known, Known::All(_))) && !frames.is_empty() {
        return Live { spent, remaining: Band::default(), whole: Band::known(spent), factor: 1.0 };
    }
    let started = frames.iter().any(|frame| frame.known != Known::Nothing);
    if !started {
        return Live { spent, remaining: *total, whole: *total, factor: 1.0 };
    }
    let pieces = Pieces::new(total, frames, measure);
    let quoted = pieces.quoted_remainder();
    if quoted <= 0.0 {
        // All that remains was quoted to cost nothing.
        return Live { spent, remaining: Band::default(), whole: Band::known(spent), factor: 1.0 };
    }
    let Posterior { log_median, deviations } = pieces.posterior(total.spread(measure));
    let median = libm::exp(log_median.clamp(-FARTHEST_MEDIAN, FARTHEST_MEDIAN));
    let width = |quantile: f64, normal: f64| {
        let quoted = log_ratio(quantile, total.p50).max(normal * measure.unknown());
        (deviations * quoted).min(FARTHEST)
    };
    let to_80 = width(total.p80, NORMAL_80);
    // Of a lognormal distribution the logarithm of mean over median goes with the variance.
    let to_mean = (log_ratio(total.mean, total.p50) * deviations * deviations).clamp(-FARTHEST, FARTHEST);
    let remaining = Band {
        mean: median * libm::exp(to_mean),
        p50: median,
        p80: median * libm::exp(to_80),
        p95: median * libm::exp(width(total.p95, NORMAL_95).max(to_80)),
    };
    Live { spent, remaining, whole: remaining.plus(spent), factor: median / quoted }
}

/// What counts as zero counts as zero.
fn usable(value: f64) -> f64 {
    if value.is_finite() && value > 0.0 { value } else { 0.0 }
}

/// ln(a / b), zero where that says nothing.
fn log_ratio(a: f64, b: f64) -> f64 {
    let (a, b) = (usable(a), usable(b));
    if a > 0.0 && b > 0.0 { libm::log(a) - libm::log(b) } else { 0.0 }
}

/// A frame, or the part of one that is finished or is not: a part is a frame of its own, at the same time.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// Since the piece before.
    step: f64,
    /// Median as quoted, positive.
    quoted: f64,
    /// Variance of its nugget over that of the mean frame.
    nugget: f64,
    /// What is known of it: its residual, and a variance that it has beside the nugget.
    seen: Option<(f64, f64)>,
}

struct Pieces {
    list: Vec<Piece>,
    /// Of the shot's clock.
    length: f64,
    /// Mean variance of a frame's logarithm, weighted by medians.
    variance: f64,
    /// Sum of the medians of all pieces.
    quoted: f64,
}

/// What is known of the logarithm of the remainder.
struct Posterior {
    log_median: f64,
    /// Standard deviation, in those of the quote's total.
    deviations: f64,
}

impl Pieces {
    fn new(total: &Band, frames: &[LiveFrame], measure: Measure) -> Self {
        // Medians that add up to the job's.
        let to_median = libm::exp(log_ratio(total.p50, total.mean));
        let median = |frame: &LiveFrame| usable(frame.quote.mean) * to_median;
        let variance_of = |frame: &LiveFrame| frame.quote.spread(measure).powi(2);
        let all = sum(frames.iter().map(median));
        let variance = sum(frames.iter().map(|frame| median(frame) * variance_of(frame)));
        let variance = if all > 0.0 { variance / all } else { measure.unknown().powi(2) };
        let mut list = Vec::with_capacity(frames.len());
        let (mut before, mut length) = (None, 0.0);
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
            let nugget = variance_of(frame) / variance;
            let (done, cost) = match frame.known {
                Known::Nothing => (0.0, 0.0),
                Known::Part { share, cost } => (usable(share).min(1.0), usable(cost)),
                Known::All(cost) => (1.0, usable(cost)),
            };
            let mut push = |share: f64, seen| {
                list.push(Piece { step, quoted: share * quoted, nugget, seen });
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
        Self { list, length: if length > 0.0 { length } else { 1.0 }, variance, quoted: all }
    }

    /// Median of what remains, as quoted.
    fn quoted_remainder(&self) -> f64 {
        sum(self.list.iter().filter(|piece| piece.seen.is_none()).map(|piece| piece.quoted))
    }

    /// What all models together say of what remains, if the job's own spread is `of_job`.
    fn posterior(&self, of_job: f64) -> Posterior {
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
                    let evidence = self.filter(&model, |_, _| {});
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
        Posterior { log_median, deviations: libm::sqrt(variance.max(0.0)) }
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
        Model {
            decay,
            common: common + more * self.variance,
            smooth: own * (1.0 - nugget),
            nugget: own * nugget,
            of_job: common + kept * own,
        }
    }

    /// Variance of the process of variance one, averaged over all pieces.
    fn variance_of_mean(&self, decay: f64) -> f64 {
        let model = Model { decay, common: 0.0, smooth: 1.0, nugget: 0.0, of_job: 1.0 };
        let mut state = State::new(&model);
        for piece in &self.list {
            state.advance(&model, piece.step);
            state.accumulate(piece.quoted / self.quoted);
        }
        state.variance[SUM][SUM].max(0.0)
    }

    /// Filters the pieces; `each` is told what the filter knew after each of them.
    fn filter(&self, model: &Model, mut each: impl FnMut(&State, Option<Update>)) -> Evidence {
        let mut state = State::new(model);
        let mut evidence = Evidence { surprise: 0.0, log_variances: 0.0 };
        for piece in &self.list {
            state.advance(model, piece.step);
            let update = piece.seen.map(|(residual, more)| {
                let update = state.update(residual, model.nugget * piece.nugget + more);
                evidence.surprise += update.innovation * update.innovation / update.variance;
                evidence.log_variances += libm::log(update.variance);
                update
            });
            each(&state, update);
        }
        evidence
    }

    /// The expected residual c + g of every piece, given all that is seen.
    fn smoothed(&self, model: &Model) -> Vec<f64> {
        let mut steps = Vec::with_capacity(self.list.len());
        self.filter(model, |state, update| {
            let signal: [f64; COMPONENTS] =
                std::array::from_fn(|i| state.variance[i][COMMON] + state.variance[i][SMOOTH]);
            steps.push((state.mean[COMMON] + state.mean[SMOOTH], signal, update));
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
                adjoint[COMMON] -= change;
                adjoint[SMOOTH] -= change;
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
                    state.update(seen, model.nugget * piece.nugget + more);
                }
                None => state.accumulate(expected(piece, residual) / median),
            }
        }
        (libm::log(median) + libm::log(quoted), state.variance[SUM][SUM].max(0.0) + nuggets)
    }
}

/// What the residuals are made of.
struct Model {
    /// √3 over the length of the process.
    decay: f64,
    /// Variance of the common factor.
    common: f64,
    /// Variance of the process.
    smooth: f64,
    /// Variance of the mean frame's nugget.
    nugget: f64,
    /// Variance of the job's logarithm before anything is seen, as the quote has it.
    of_job: f64,
}

/// How surprising what was seen is to a model.
struct Evidence {
    /// Sum of squared innovations over their variances.
    surprise: f64,
    /// Sum of the logarithms of these variances.
    log_variances: f64,
}

/// Places in the state: the common factor, the process, its slope, and the sum over what remains.
const COMMON: usize = 0;
const SMOOTH: usize = 1;
const SLOPE: usize = 2;
const SUM: usize = 3;
/// Without the sum, and with it.
const COMPONENTS: usize = 3;
const ALL: usize = 4;

/// How process and slope go on: the matrix, and the covariance that comes in anew.
struct Transition {
    matrix: [[f64; 2]; 2],
    noise: [[f64; 2]; 2],
}

impl Model {
    /// Over a step of the clock: exp(F Δ) = e^(−λΔ) [1 + λΔ, Δ; −λ²Δ, 1 − λΔ], and P∞ − A P∞ Aᵀ with P∞ = σ² diag(1, λ²).
    ///
    /// The slope is counted in units of λ, so that no length of a shot makes the state's components differ in size.
    fn transition(&self, step: f64) -> Transition {
        let x = self.decay * step;
        let fall = libm::exp(-x);
        let matrix = [[fall * (1.0 + x), fall * x], [-fall * x, fall * (1.0 - x)]];
        let kept = |i: usize, j: usize| matrix[i][0] * matrix[j][0] + matrix[i][1] * matrix[j][1];
        let cross = -kept(0, 1) * self.smooth;
        let own = |i| (self.smooth * (1.0 - kept(i, i))).max(0.0);
        Transition { matrix, noise: [[own(0), cross], [cross, own(1)]] }
    }
}

/// What an observation did to the state.
struct Update {
    innovation: f64,
    variance: f64,
    gain: [f64; COMPONENTS],
}

/// Mean and covariance of the state, given what was seen so far.
struct State {
    mean: [f64; ALL],
    variance: [[f64; ALL]; ALL],
}

impl State {
    /// Before the first frame.
    fn new(model: &Model) -> Self {
        let mut variance = [[0.0; ALL]; ALL];
        variance[COMMON][COMMON] = model.common;
        variance[SMOOTH][SMOOTH] = model.smooth;
        variance[SLOPE][SLOPE] = model.smooth;
        Self { mean: [0.0; ALL], variance }
    }

    /// Goes on by a step of the clock.
    fn advance(&mut self, model: &Model, step: f64) {
        if step <= 0.0 {
            return;
        }
        let Transition { matrix, noise } = model.transition(step);
        let turned = |level: f64, slope: f64| matrix.map(|row| row[0] * level + row[1] * slope);
        [self.mean[SMOOTH], self.mean[SLOPE]] = turned(self.mean[SMOOTH], self.mean[SLOPE]);
        for row in &mut self.variance {
            [row[SMOOTH], row[SLOPE]] = turned(row[SMOOTH], row[SLOPE]);
        }
        for column in 0..ALL {
            let [level, slope] = turned(self.variance[SMOOTH][column], self.variance[SLOPE][column]);
            self.variance[SMOOTH][column] = level;
            self.variance[SLOPE][column] = slope;
        }
        for (i, row) in noise.iter().enumerate() {
            for (j, noise) in row.iter().enumerate() {
                self.variance[SMOOTH + i][SMOOTH + j] += noise;
            }
        }
    }

    /// Takes in that c + g is `residual`, give or take a `noise`.
    fn update(&mut self, residual: f64, noise: f64) -> Update {
        let signal: [f64; ALL] = std::array::from_fn(|i| self.variance[i][COMMON] + self.variance[i][SMOOTH]);
        let variance = signal[COMMON] + signal[SMOOTH] + noise;
        let innovation = residual - self.mean[COMMON] - self.mean[SMOOTH];
        for (mean, signal) in self.mean.iter_mut().zip(&signal) {
            *mean += signal / variance * innovation;
        }
        for (row, of_row) in self.variance.iter_mut().zip(&signal) {
            for (entry, of_column) in row.iter_mut().zip(&signal) {
                *entry -= of_row * of_column / variance;
            }
        }
        Update { innovation, variance, gain: std::array::from_fn(|i| signal[i] / variance) }
    }

    /// Adds c + g, so many times, to the sum.
    fn accumulate(&mut self, weight: f64) {
        self.mean[SUM] += weight * (self.mean[COMMON] + self.mean[SMOOTH]);
        let row: [f64; ALL] =
            std::array::from_fn(|j| weight * (self.variance[COMMON][j] + self.variance[SMOOTH][j]));
        for (entry, more) in self.variance[SUM].iter_mut().zip(row) {
            *entry += more;
        }
        for row in &mut self.variance {
            row[SUM] += weight * (row[COMMON] + row[SMOOTH]);
        }
    }
}
