//! The most camera samples that fit into a time or an amount of money.
//!
//! A profiled pixel costs in proportion to its samples, while records and fixed costs stay: so what other numbers of samples take
//! follows from the job's own profiles, as in `accuracy`, and the most that fit are found by halving. Each frame is given the work that
//! equally many take in it, which its renderer spends where the image shows that it pays. Frames of such a job make their irradiance caches themselves.

use forelight_forecast::Corrections;
use forelight_protocol::{Confidence, Job, Per, PreviewResult, Within};
use forelight_store::MeasuredProfile;

use super::AdvanceError;
use super::accuracy::with_samples;
use super::estimate::{self, Forecast};

/// Most camera samples that are chosen: what the settings allow.
const MOST: u32 = 65_536;

/// What frames may take.
pub(super) struct Limit {
    /// CPU seconds on a node of speed 1.
    seconds: f64,
    per: Per,
    confidence: Confidence,
    /// Micro-units a second, where the limit is money.
    price: Option<f64>,
}

impl Limit {
    /// Of a job, where a second of a core of speed 1 costs so much; that is not known without nodes.
    pub(super) fn new(within: &Within, job: &Job, price: Option<f64>) -> Result<Self, AdvanceError> {
        let limit = |seconds, price| Self { seconds, per: within.per, confidence: job.confidence, price };
        match (within.cpu_micros, within.money) {
            (Some(micros), _) => Ok(limit(micros as f64 * 1e-6, None)),
            (None, Some(money)) => match price {
                Some(price) if price > 0.0 => Ok(limit(money.micro_units() as f64 / price, Some(price))),
                _ => Err(AdvanceError::Hopeless(
                    "within: the farm has no node with a price, so money says nothing of quality".to_owned(),
                )),
            },
            (None, None) => Err(AdvanceError::Hopeless("within: there is no limit in it".to_owned())),
        }
    }

    /// The forecast with the most samples that fit.
    ///
    /// # Errors
    /// If one sample does not, with what it takes.
    pub(super) fn best(
        &self,
        preview: &PreviewResult,
        profiles: &[MeasuredProfile],
        corrections: Option<&Corrections>,
    ) -> Result<Forecast, AdvanceError> {
        let with = |spp: u32| -> Result<Forecast, AdvanceError> {
            let profiles = with_samples(profiles, spp);
            let mut forecast = estimate::calibrated(preview, &profiles, None, corrections)?;
            forecast.job.chosen_spp = Some(spp);
            Ok(forecast)
        };
        let mut best = with(1)?;
        let least = self.takes(&best);
        if least > self.seconds {
            return Err(AdvanceError::Hopeless(self.too_little(least)));
        }
        let (mut fits, mut too_many) = (1, MOST + 1);
        while too_many - fits > 1 {
            let middle = fits + (too_many - fits) / 2;
            let forecast = with(middle)?;
            if self.takes(&forecast) <= self.seconds {
                (fits, best) = (middle, forecast);
            } else {
                too_many = middle;
            }
        }
        Ok(best)
    }

    /// CPU seconds that the limit is held against.
    fn takes(&self, forecast: &Forecast) -> f64 {
        match self.per {
            Per::Job => forecast.job.total.cpu_seconds.at(self.confidence),
            Per::Frame => {
                let frames = forecast.frames.iter().map(|frame| frame.cpu_seconds.at(self.confidence));
                frames.fold(0.0, f64::max)
            }
        }
    }

    fn too_little(&self, least: f64) -> String {
        let what = match self.per {
            Per::Job => "the job",
            Per::Frame => "its dearest frame",
        };
        let amounts = |seconds: f64| match self.price {
            None => format!("{:.6} CPU seconds", (seconds * 1e6).ceil() * 1e-6),
            Some(price) => format!("{:.6} of money", (seconds * price).ceil() * 1e-6),
        };
        format!(
            "within: with one camera sample per pixel, the least there is, {what} takes {} at {}, and {} were given",
            amounts(least),
            self.confidence.name(),
            amounts(self.seconds)
        )
    }
}
