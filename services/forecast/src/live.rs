//! The estimate lives: what a job will have cost, given its quote and what its finished frames took.
//!
//! The quote gives every frame t a median x_t. What a finished frame took, y_t, is the truth; of the others the *residual* d_t = ln(y_t / x_t)
//! is unknown, and what is known of finished frames says something of it:
//!
//! ```text
//! d_t = c + l(L_t) + g(τ_t) + e_t
//! ```
//!
//! (y_t over its expectation given the rest, so that e_t has the mean −½ Var e_t) with a factor c that the job's frames have in common, one that those have in common in which the same lights L shine, a Gaussian process g with Matérn
//! covariance (ν = 3/2) over the shot's own clock τ (a cut separates, see [`shot_times`]), and a nugget e_t, the frame's own. How much there is of each is what
//! the quote says of itself: the frames' spreads are the sum of c, g and e, the job's spread is what does not average out. Frames of which the quote
//! is less sure have a larger nugget. Where lights go on or off, half of the variance of c is that of the l, as much of each as leaves the job's spread as it is:
//! frames in a light that no finished frame has seen are expected to be off by less than those, and remain less sure.
//!
//! *How sure the quote was* is itself in doubt. All variances share an unknown scale, which starts at one, as if [`pieces::SCALE_FREEDOM`] frames had
//! been seen to agree with the quote, and learns from how surprising each finished frame is, given those before it: the
//! conjugate prior of a normal model (Gelman et al., *Bayesian Data Analysis*, 3rd edition 2013, section 3.3). The length of g and the
//! nugget's share are not estimated from fewer than [`pieces::FEW`] frames: the length is a third of the shot, and the scale does not fall below
//! one, so that no interval shrinks by luck. From there on a few of each are weighed by their marginal likelihood. That all frames are off alike by more
//! than the quote thinks possible is weighed against the quote's word from the first frame on.
//!
//! *In linear time.* g is a state-space model (Hartikainen, Särkkä 2010): the state (c, g, g′, and an l for each set of lights) goes from frame to frame by a matrix, and the
//! Kalman filter with the modified Bryson–Frazier smoother (Bierman 1973) gives all residuals in one pass there and one back. The variance of the sum
//! over unfinished frames, a'[K_UU − K_US (K_SS + D)⁻¹ K_SU] a with weights a_t = x_t exp(d̂_t), takes no matrix either: the sum so far is one more
//! component of the state, and what is left of its variance after the last frame is the answer. Nothing is carried from one call
//! to the next, so the order in which frames finish does not matter, to the last bit.
//!
//! *The quantiles* of what remains keep the quote's shape, which may have been learnt from past jobs: their distances from the median, in
//! logarithms, are those of the quote times the ratio of the standard deviations now and at the beginning; where the scale was learnt, times the ratio of
//! Student's quantiles and the normal ones.

mod pieces;
mod state;

use crate::clock::ShotClock;
use crate::conformal::{FARTHEST, Measure, NORMAL_95};
use crate::error::ForecastError;
use crate::frames::{FramePopulation, check_frames};
use crate::moments::sum;
use crate::strata::Stratum;
use pieces::{Pieces, Posterior};

/// Quantile at 0.80 of the standard normal distribution.
const NORMAL_80: f64 = 0.841_621_233_572_914_2;

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
    /// Which lights shine in it: the same number as in other frames with the same ones.
    pub lights: u32,
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
    let mut cuts = 0.0;
    let mut times = clock.times().to_vec();
    for (time, pair) in times.iter_mut().skip(1).zip(frames.windows(2)) {
        cuts += if pair[0].lights == pair[1].lights { 0.0 } else { clock.frames() };
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
    let Posterior { log_median, deviations, freedom } = pieces.posterior(total.spread(measure));
    let median = libm::exp(log_median.clamp(-FARTHEST_MEDIAN, FARTHEST_MEDIAN));
    let width = |quantile: f64, normal: f64| {
        let quoted = log_ratio(quantile, total.p50).max(normal * measure.unknown());
        (student(normal, freedom) * deviations * quoted).min(FARTHEST)
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

/// Quantile of Student's t over that of the normal distribution, to first order (Abramowitz and Stegun, 26.7.5).
fn student(normal: f64, freedom: f64) -> f64 {
    1.0 + (normal * normal + 1.0) / (4.0 * freedom)
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
