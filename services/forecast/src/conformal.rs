//! What past jobs teach: quantiles that hold what they promise, whatever the distribution of costs.
//!
//! A forecast has a mean ŷ and a spread s, its own idea of the standard deviation of ln y, and what no formula knows ([`Measure`]) added. A finished job tells the *residual* z =
//! ln(y / ŷ) / s. If the next job is of the same kind as n past ones (exchangeable with them: any order of them is as likely), its z is
//! as likely to have any of the n + 1 ranks, so it stays below the ⌈(n + 1) p⌉-th smallest of the past with probability p at the least,
//! whatever is wrong with the formulas behind ŷ and s: split conformal prediction with a normalised residual (Papadopoulos et al. 2002; Vovk,
//! Gammerman, Shafer 2005). The calibrated quantile is ŷ exp(s z_(p)). It is one-sided, and what was biased is set right as well.
//!
//! Frames of one job share their errors, so a hundred frames are not a hundred witnesses. For a frame of a new job the weight of
//! each past job is one, divided over its frames, against one for the new job, of which nothing is known yet: the quantile of
//! Σ_j Σ_i δ(z_ji) / ((J + 1) n_j) + δ(∞) / (J + 1) (hierarchical conformal prediction: Lee, Barber, Willett 2023). With one residual a
//! job that is the rule above.
//!
//! What may be compared is up to the caller: jobs of one version of the renderer and one class of features, since neither may change the
//! distribution of z.

use serde::{Deserialize, Serialize};

use crate::cost::{Costs, Quantity};
use crate::interval::log_deviation;
use crate::shot::ShotForecast;
use crate::student;

/// Quantile at 0.95 of the standard normal distribution.
pub(crate) const NORMAL_95: f64 = 1.644_853_626_951_472_2;

/// Least number of past jobs from which all quantiles follow: from 19 the 95th is the greatest.
pub const LEAST_JOBS: usize = 19;

/// What is measured, which decides by how much a forecast is off whatever its formulas say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// A count of operations: what is rendered is what was profiled, to the last of them.
    Work,
    /// Time, which no two runs agree on.
    CpuTime,
}

impl Measure {
    /// Standard deviation of the logarithm that is added to every spread. Without it a forecast that is very sure, and off by what no
    /// sample shows (noise of clocks, a tree that takes longer to build), would be off by hundreds of its spreads, and the next one, less
    /// sure, would be stretched by as many of its own.
    pub(crate) const fn unknown(self) -> f64 {
        match self {
            Measure::Work => 0.001,
            Measure::CpuTime => 0.05,
        }
    }
}

impl Quantity {
    /// The standard deviation of the logarithm that the estimate gives itself, without inflation, and what no formula knows: that of
    /// a normal distribution with the same 95th quantile. Never zero.
    pub fn spread(&self, measure: Measure) -> f64 {
        let own = log_deviation(self.mean, self.variance) * student::quantile(0.95, self.degrees_of_freedom);
        libm::hypot(own / NORMAL_95, measure.unknown())
    }

    /// The quantile at any `p` between 0 and 1 of the distribution of which the estimate names three. Only of one that
    /// [`Calibration`](crate::Calibration) made, not of one that was corrected by past jobs.
    pub fn at(&self, p: f64) -> f64 {
        if self.mean <= 0.0 || self.p95 <= self.mean {
            return self.mean;
        }
        let of_t = |p: f64| student::quantile(p, self.degrees_of_freedom);
        let t = if p < 0.5 { -of_t(1.0 - p) } else { of_t(p) };
        self.mean * libm::exp(libm::log(self.p95 / self.mean) * t / of_t(0.95))
    }
}

/// How far a forecast was off, in units of its spread; none where a logarithm says nothing.
pub fn residual(mean: f64, spread: f64, actual: f64) -> Option<f64> {
    (mean > 0.0 && actual > 0.0 && spread > 0.0).then(|| libm::log(actual / mean) / spread)
}

/// No quantile lies farther from its mean than by the exponential of this: a number for every input.
pub(crate) const FARTHEST: f64 = 50.0;

/// Residuals of past forecasts, by job.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Past {
    jobs: Vec<Vec<f64>>,
}

impl Past {
    /// Adds a job with the residuals of all its forecasts of one kind. One without any teaches nothing.
    pub fn push(&mut self, residuals: Vec<f64>) {
        if !residuals.is_empty() && residuals.iter().all(|z| !z.is_nan()) {
            self.jobs.push(residuals);
        }
    }

    /// How many jobs there are.
    pub fn jobs(&self) -> usize {
        self.jobs.len()
    }

    /// The residual that the next one stays below with a probability of `p` at the least; none while too few jobs are known to say.
    pub fn quantile(&self, p: f64) -> Option<f64> {
        let mut weighted: Vec<(f64, f64)> =
            self.jobs.iter().flat_map(|job| job.iter().map(|&z| (z, 1.0 / job.len() as f64))).collect();
        weighted.sort_by(|one, other| one.0.total_cmp(&other.0));
        // A little less than asked for, so that ⌈(n + 1) p⌉ does not rise by the rounding of p.
        let wanted = p * (self.jobs.len() + 1) as f64 * (1.0 - 1e-12);
        let mut reached = 0.0;
        let found = weighted.into_iter().find(|&(_, weight)| {
            reached += weight;
            reached >= wanted
        });
        found.map(|(z, _)| z).filter(|z| z.is_finite())
    }

    /// The three quantiles, if all can be said.
    pub fn correction(&self) -> Option<Correction> {
        let [p50, p80, p95] = [0.50, 0.80, 0.95].map(|p| self.quantile(p));
        Some(Correction { p50: p50?, p80: p80?, p95: p95? })
    }
}

/// Where quantiles lie, in spreads from the mean, ascending.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correction {
    /// Of one in two.
    pub p50: f64,
    /// Of four in five.
    pub p80: f64,
    /// Of nineteen in twenty.
    pub p95: f64,
}

impl Correction {
    /// The quantity with quantiles as past jobs teach them.
    pub fn apply(&self, quantity: &Quantity, measure: Measure) -> Quantity {
        let spread = quantity.spread(measure);
        let at = |z: f64| quantity.mean * libm::exp((spread * z).clamp(-FARTHEST, FARTHEST));
        Quantity { p50: at(self.p50), p80: at(self.p80), p95: at(self.p95), ..*quantity }
    }
}

/// Past jobs of one version of the renderer and one class of features.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Experience {
    /// Work of single frames.
    pub frame_work: Past,
    /// CPU time of single frames.
    pub frame_cpu: Past,
    /// Work of whole jobs.
    pub job_work: Past,
    /// CPU time of whole jobs.
    pub job_cpu: Past,
}

/// What follows from it for the quantiles of the next job's quote.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Corrections {
    /// Work of single frames.
    pub frame_work: Correction,
    /// CPU time of single frames.
    pub frame_cpu: Correction,
    /// Work of the whole job.
    pub job_work: Correction,
    /// CPU time of the whole job.
    pub job_cpu: Correction,
}

impl Experience {
    /// None while there are too few jobs: see [`LEAST_JOBS`].
    pub fn corrections(&self) -> Option<Corrections> {
        Some(Corrections {
            frame_work: self.frame_work.correction()?,
            frame_cpu: self.frame_cpu.correction()?,
            job_work: self.job_work.correction()?,
            job_cpu: self.job_cpu.correction()?,
        })
    }
}

impl ShotForecast {
    /// The forecast with quantiles of work and CPU time as past jobs teach them. Those of rays, which nobody books, stay.
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
