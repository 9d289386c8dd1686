//! The most camera samples that fit into a time or an amount of money.
//!
//! A profiled pixel costs in proportion to its samples, while records and fixed costs stay: so what other numbers of samples take
//! follows from the job's own profiles, as in `accuracy`, and the most that fit are found by halving. Each frame is given the work that
//! equally many take in it, which its renderer spends where the image shows that it pays. Frames of such a job make their irradiance caches themselves.

use forelight_forecast::Corrections;
use forelight_protocol::{Confidence, Job, Money, Node, Per, PreviewResult, Within};
use forelight_store::MeasuredProfile;

use super::AdvanceError;
use super::accuracy::with_samples;
use super::book::mean_price;
use super::estimate::{self, Forecast};

/// Most camera samples that are chosen: what the settings allow.
const MOST: u32 = 65_536;

/// What frames may take.
pub(super) struct Limit {
    most: Most,
    per: Per,
    confidence: Confidence,
}

/// The most of it.
enum Most {
    /// CPU seconds on a node of speed 1.
    Seconds(f64),
    /// Micro-units, at the mean price of nodes.
    Money(i64, Vec<Node>),
}

impl Limit {
    /// Of a job, on a farm of these nodes; without them money says nothing of time.
    pub(super) fn new(within: &Within, job: &Job, nodes: Vec<Node>) -> Result<Self, AdvanceError> {
        let most = match (within.cpu_micros, within.money) {
            (Some(micros), _) => Most::Seconds(micros as f64 * 1e-6),
            (None, Some(money)) if nodes.iter().any(|node| node.price_per_hour > Money(0)) => {
                Most::Money(money.micro_units(), nodes)
            }
            (None, Some(_)) => {
                return Err(AdvanceError::Hopeless(
                    "within: the farm has no node with a price, so money says nothing of quality".to_owned(),
                ));
            }
            (None, None) => return Err(AdvanceError::Hopeless("within: there is no limit in it".to_owned())),
        };
        Ok(Self { most, per: within.per, confidence: job.confidence })
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
        if !self.fits(&best) {
            return Err(AdvanceError::Hopeless(self.too_little(&best)));
        }
        let (mut fits, mut too_many) = (1, MOST + 1);
        while too_many - fits > 1 {
            let middle = fits + (too_many - fits) / 2;
            let forecast = with(middle)?;
            if self.fits(&forecast) {
                (fits, best) = (middle, forecast);
            } else {
                too_many = middle;
            }
        }
        Ok(best)
    }

    fn fits(&self, forecast: &Forecast) -> bool {
        let takes = self.seconds(forecast);
        match &self.most {
            Most::Seconds(most) => takes <= *most,
            Most::Money(most, nodes) => takes * price(nodes, forecast) <= *most as f64,
        }
    }

    /// CPU seconds that the limit is held against.
    fn seconds(&self, forecast: &Forecast) -> f64 {
        match self.per {
            Per::Job => forecast.job.total.cpu_seconds.at(self.confidence),
            Per::Frame => {
                let frames = forecast.frames.iter().map(|frame| frame.cpu_seconds.at(self.confidence));
                frames.fold(0.0, f64::max)
            }
        }
    }

    /// That not even this fits.
    fn too_little(&self, least: &Forecast) -> String {
        let what = match self.per {
            Per::Job => "the job",
            Per::Frame => "its dearest frame",
        };
        let takes = self.seconds(least);
        let in_millionths = |millionths: f64| millionths.ceil() * 1e-6;
        let (needed, given) = match &self.most {
            Most::Seconds(most) => {
                let seconds = |seconds: f64| format!("{:.6} CPU seconds", in_millionths(seconds * 1e6));
                (seconds(takes), seconds(*most))
            }
            Most::Money(most, nodes) => {
                let money = |micro_units: f64| format!("{:.6} of money", in_millionths(micro_units));
                (money(takes * price(nodes, least)), money(*most as f64))
            }
        };
        format!(
            "within: with one camera sample per pixel, the least there is, {what} takes {needed} at {}, and {given} were given",
            self.confidence.name(),
        )
    }
}

/// Micro-units for a second of what was forecast.
fn price(nodes: &[Node], forecast: &Forecast) -> f64 {
    mean_price(nodes, forecast.job.work_by_class.as_ref()).unwrap_or_default()
}
