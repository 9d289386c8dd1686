//! The live estimate: the cost of a running job, given its quote and the costs of its finished frames.
//!
//! Let x_t be the quoted median of frame t, and y_t its true cost. The *residual* d_t = ln(y_t / x_t) is
//! known for finished frames:
//!
//! ```text
//! d_t = c + l(L_t) + g(τ_t) + e_t
//! ```
//!
//! * c is a factor that all frames of the job share.
//! * l is a factor that frames with the same set L of shining lights share.
//! * g is a Gaussian process over the shot's clock τ ([`shot_times`]), with Matérn covariance (ν = 3/2).
//! * e_t is a nugget of this frame. Its mean is −½ Var e_t, so that exp(e_t) has the mean 1.
//!
//! The quote gives the size of each part: the spread of a frame is that of all four, the spread of the job is
//! what does not average out. If lights change within the job, half of the variance of c goes to l, scaled so
//! that the job's spread stays. Frames under lights of no finished frame then stay less certain.
//!
//! *The scale of the variances* is an unknown common factor. It starts at one, with the weight of
//! [`pieces::SCALE_FREEDOM`] frames, and learns from each finished frame (conjugate prior of a normal model:
//! Gelman et al., *Bayesian Data Analysis*, 3rd edition 2013, section 3.3). With fewer than
//! [`pieces::MIN_FINISHED`] finished frames, the length of g is a third of the shot and the scale at least
//! one, so no interval shrinks by luck. Then a few lengths, nuggets and larger variances of c are averaged by
//! marginal likelihood.
//!
//! *Linear time.* The state-space form of g (Hartikainen, Särkkä 2010) has the state (c, g, g′) and one l per
//! set of lights. A Kalman filter and the modified Bryson–Frazier smoother (Bierman 1973) yield all residuals
//! in two passes. The variance of the sum over unfinished frames, a'[K_UU − K_US (K_SS + D)⁻¹ K_SU] a with
//! a_t = x_t exp(d̂_t), comes from the running sum as one more component of the state. No state is kept
//! between calls, so the order of finishing changes no bit.
//!
//! *The quantiles* of the remainder keep the shape of the quote. Their log distances from the median are the
//! quote's, times the ratio of the standard deviations now and at the start. Where the scale was learnt, they
//! are widened by the ratio of Student's t quantiles to normal ones.

mod band;
mod frame;
mod kalman;
mod pieces;

use crate::conformal::{MAX_LOG_RATIO, Measure, NORMAL_95};
use crate::error::ForecastError;
use crate::moments::sum;
use crate::population::{FramePopulation, check_frames};
use crate::shot_clock::ShotClock;
use crate::strata::Stratum;
use band::{log_ratio, positive};
use pieces::{Pieces, Posterior};

pub use band::Band;
pub use frame::{Known, LiveFrame};

/// 0.80 quantile of the standard normal distribution.
pub(crate) const NORMAL_80: f64 = 0.841_621_233_572_914_2;

/// Bound on the absolute logarithm of a median, so that quantiles stay in the range of a float.
const MAX_LOG_MEDIAN: f64 = 600.0;

/// The present estimate of a job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Live {
    /// Cost of everything that is finished.
    pub spent: f64,
    /// Forecast cost of the rest.
    pub remaining: Band,
    /// Forecast cost of the whole job: spent and remaining.
    pub whole: Band,
    /// Forecast over quoted median of the rest: 1.3 is 30 % more expensive. 1 if nothing remains.
    pub factor: f64,
}

/// The time of each frame on the shot's own clock. Times start at zero and increase strictly. A light that
/// goes on or off counts as a cut.
///
/// # Errors
/// If frames are out of order, or counts and strata do not match.
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

/// The present estimate of a job that was quoted at `total` and consists of these frames, in order. It is the
/// quote while nothing is finished, and the true cost in the end. Negative and non-finite numbers count as
/// zero.
pub fn live(total: &Band, frames: &[LiveFrame], measure: Measure) -> Live {
    let spent = sum(frames.iter().map(|frame| match frame.known {
        Known::Nothing => 0.0,
        Known::Part { cost, .. } | Known::All(cost) => positive(cost),
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
        // Everything that remains was quoted at zero.
        return Live { spent, remaining: Band::default(), whole: Band::known(spent), factor: 1.0 };
    }
    let Posterior { log_median, deviations, freedom } = pieces.posterior(total.spread(measure));
    let median = libm::exp(log_median.clamp(-MAX_LOG_MEDIAN, MAX_LOG_MEDIAN));
    let width = |quantile: f64, normal: f64| {
        let quoted = log_ratio(quantile, total.p50).max(normal * measure.extra_deviation());
        (student(normal, freedom) * deviations * quoted).min(MAX_LOG_RATIO)
    };
    let to_80 = width(total.p80, NORMAL_80);
    // For a lognormal distribution, ln(mean / median) is proportional to the variance of the logarithm.
    let to_mean =
        (log_ratio(total.mean, total.p50) * deviations * deviations).clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO);
    let remaining = Band {
        mean: median * libm::exp(to_mean),
        p50: median,
        p80: median * libm::exp(to_80),
        p95: median * libm::exp(width(total.p95, NORMAL_95).max(to_80)),
    };
    Live { spent, remaining, whole: remaining.plus(spent), factor: median / quoted }
}

/// Ratio of a quantile of Student's t to the normal quantile, to first order (Abramowitz and Stegun, 26.7.5).
fn student(normal: f64, freedom: f64) -> f64 {
    1.0 + (normal * normal + 1.0) / (4.0 * freedom)
}
