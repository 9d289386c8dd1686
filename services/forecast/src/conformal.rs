//! Calibrates quantiles by finished jobs, so that they hold whatever the distribution of costs (conformal
//! prediction).
//!
//! A forecast has a mean ŷ and a spread s, its estimate of the standard deviation of ln y plus a constant
//! ([`Measure`]). A finished job yields the *residual* z = ln(y / ŷ) / s. If the next job is exchangeable
//! with n past ones, its z has each of the n + 1 ranks with the same probability. So it stays below the
//! ⌈(n + 1) p⌉-th smallest past residual with probability p at least. This is split conformal prediction with
//! a normalised residual (Papadopoulos et al. 2002; Vovk, Gammerman, Shafer 2005). The calibrated quantile
//! ŷ exp(s z_(p)) is one-sided and corrects bias as well.
//!
//! Frames of one job share their errors. So for a frame of a new job, each of J past jobs has the weight one,
//! divided over its n_j frames, and the new job has the weight one at infinity. The result is the quantile of
//! Σ_j Σ_i δ(z_ji) / ((J + 1) n_j) + δ(∞) / (J + 1): hierarchical conformal prediction (Lee, Barber, Willett
//! 2023).
//!
//! The caller passes comparable jobs: same version of the renderer and same class of features.

use serde::{Deserialize, Serialize};

use crate::cost::{Costs, Quantity};
use crate::interval::log_deviation;
use crate::sampled_shot::SampledShotForecast;
use crate::shot::ShotForecast;
use crate::student;

/// 0.95 quantile of the standard normal distribution.
pub(crate) const NORMAL_95: f64 = 1.644_853_626_951_472_2;

/// The least number of past jobs that yields all three quantiles. With 19 jobs, P95 is the largest residual.
pub const LEAST_JOBS: usize = 19;

/// The kind of quantity. It decides how much error a forecast has beyond what its formulas say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// A deterministic count of operations. Profile and render count exactly the same operations.
    Work,
    /// CPU time, in which no two runs agree.
    CpuTime,
}

impl Measure {
    /// Standard deviation of the logarithm that is added to every spread, for errors that no sample shows:
    /// noise of clocks, or a slow tree build. Without it, the residual of a very certain forecast would be
    /// hundreds of spreads.
    pub(crate) const fn extra_deviation(self) -> f64 {
        match self {
            Measure::Work => 0.001,
            Measure::CpuTime => 0.05,
        }
    }
}

impl Quantity {
    /// The estimate's own standard deviation of its logarithm, without inflation, combined with [`Measure`]'s
    /// constant. It is that of a normal distribution with the same 95 % quantile. Never zero.
    pub fn spread(&self, measure: Measure) -> f64 {
        let own = log_deviation(self.mean, self.variance) * student::quantile(0.95, self.degrees_of_freedom);
        libm::hypot(own / NORMAL_95, measure.extra_deviation())
    }

    /// The quantile at any `p` between 0 and 1, of the log-t distribution through p50 and p95. Only for
    /// quantities made by [`Calibration`](crate::Calibration), not for corrected ones.
    pub fn at(&self, p: f64) -> f64 {
        if self.mean <= 0.0 || self.p95 <= self.mean {
            return self.mean;
        }
        let of_t = |p: f64| student::quantile(p, self.degrees_of_freedom);
        let t = if p < 0.5 { -of_t(1.0 - p) } else { of_t(p) };
        self.mean * libm::exp(libm::log(self.p95 / self.mean) * t / of_t(0.95))
    }
}

/// The residual ln(actual / mean) in units of the spread. `None` unless all three are positive.
pub fn residual(mean: f64, spread: f64, actual: f64) -> Option<f64> {
    (mean > 0.0 && actual > 0.0 && spread > 0.0).then(|| libm::log(actual / mean) / spread)
}

/// Bound on the logarithm of quantile over mean, so that every quantile is finite.
pub(crate) const MAX_LOG_RATIO: f64 = 50.0;

/// Residuals of past forecasts, grouped by job.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Past {
    jobs: Vec<Vec<f64>>,
}

impl Past {
    /// Adds a job with the residuals of all its forecasts of one kind. Ignored if it is empty or has a NaN.
    pub fn push(&mut self, residuals: Vec<f64>) {
        if !residuals.is_empty() && residuals.iter().all(|z| !z.is_nan()) {
            self.jobs.push(residuals);
        }
    }

    /// Number of jobs.
    pub fn jobs(&self) -> usize {
        self.jobs.len()
    }

    /// Bound on the next residual that holds with probability `p` at least. `None` with too few jobs.
    pub fn quantile(&self, p: f64) -> Option<f64> {
        let mut weighted: Vec<(f64, f64)> =
            self.jobs.iter().flat_map(|job| job.iter().map(|&z| (z, 1.0 / job.len() as f64))).collect();
        weighted.sort_by(|one, other| one.0.total_cmp(&other.0));
        // Slightly less than the exact value, so that the rounding of p does not raise ⌈(n + 1) p⌉.
        let wanted = p * (self.jobs.len() + 1) as f64 * (1.0 - 1e-12);
        let mut reached = 0.0;
        let found = weighted.into_iter().find(|&(_, weight)| {
            reached += weight;
            reached >= wanted
        });
        found.map(|(z, _)| z).filter(|z| z.is_finite())
    }

    /// The residuals at 0.50, 0.80 and 0.95. `None` if there are too few jobs for one of them.
    pub fn correction(&self) -> Option<Correction> {
        let [p50, p80, p95] = [0.50, 0.80, 0.95].map(|p| self.quantile(p));
        Some(Correction { p50: p50?, p80: p80?, p95: p95? })
    }
}

/// Positions of three quantiles, in spreads from the mean of the forecast, ascending.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correction {
    /// Median.
    pub p50: f64,
    /// 80 % quantile.
    pub p80: f64,
    /// 95 % quantile.
    pub p95: f64,
}

impl Correction {
    /// The quantity with its quantiles moved to these positions. Mean and variance stay.
    pub fn apply(&self, quantity: &Quantity, measure: Measure) -> Quantity {
        let spread = quantity.spread(measure);
        let at = |z: f64| quantity.mean * libm::exp((spread * z).clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO));
        Quantity { p50: at(self.p50), p80: at(self.p80), p95: at(self.p95), ..*quantity }
    }
}

/// Residuals of finished jobs, of one version of the renderer and one class of features.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Experience {
    /// Of the work of single frames.
    pub frame_work: Past,
    /// Of the CPU time of single frames.
    pub frame_cpu: Past,
    /// Of the work of whole jobs.
    pub job_work: Past,
    /// Of the CPU time of whole jobs.
    pub job_cpu: Past,
}

/// Corrections for the quantiles of the next job's quote.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Corrections {
    /// For the work of single frames.
    pub frame_work: Correction,
    /// For the CPU time of single frames.
    pub frame_cpu: Correction,
    /// For the work of the whole job.
    pub job_work: Correction,
    /// For the CPU time of the whole job.
    pub job_cpu: Correction,
}

impl Experience {
    /// The corrections for the next quote. `None` with too few jobs: see [`LEAST_JOBS`].
    pub fn corrections(&self) -> Option<Corrections> {
        Some(Corrections {
            frame_work: self.frame_work.correction()?,
            frame_cpu: self.frame_cpu.correction()?,
            job_work: self.job_work.correction()?,
            job_cpu: self.job_cpu.correction()?,
        })
    }
}

impl SampledShotForecast {
    /// The forecast with calibrated quantiles.
    #[must_use]
    pub fn corrected(mut self, corrections: &Corrections) -> Self {
        for frame in &mut self.frames {
            frame.cpu_nanos = corrections.frame_cpu.apply(&frame.cpu_nanos, Measure::CpuTime);
        }
        let job = &corrections.job_cpu;
        self.total = job.apply(&self.total, Measure::CpuTime);
        self.job_sigma = self.total.spread(Measure::CpuTime) * (job.p95 - job.p50) / NORMAL_95;
        self.calibrated = true;
        self
    }
}

impl ShotForecast {
    /// The forecast with calibrated quantiles of work and CPU time. Those of rays stay, as none is booked.
    #[must_use]
    pub fn corrected(mut self, corrections: &Corrections) -> Self {
        let correct = |costs: &mut Costs<Quantity>, work: &Correction, cpu: &Correction| {
            costs.work = work.apply(&costs.work, Measure::Work);
            costs.cpu_nanos = cpu.apply(&costs.cpu_nanos, Measure::CpuTime);
        };
        for frame in &mut self.frames {
            correct(&mut frame.total, &corrections.frame_work, &corrections.frame_cpu);
        }
        correct(&mut self.total, &corrections.job_work, &corrections.job_cpu);
        let work = &corrections.job_work;
        self.job_sigma = self.total.work.spread(Measure::Work) * (work.p95 - work.p50) / NORMAL_95;
        self.calibrated = true;
        self
    }
}
