//! Finds the most camera samples within a limit of time or money.
//!
//! A profiled pixel costs in proportion to its samples; records and fixed costs stay the same. So the job's
//! own profiles price any number of samples, and bisection finds the most that fit. Each frame gets the work
//! of that many samples, and its renderer spends it where the image needs it. Frames of such a job build
//! their own irradiance caches.

use forelight_forecast::Corrections;
use forelight_protocol::{Confidence, Node, Per, PreviewResult};

use crate::error::QuoteError;
use crate::job_forecast::Quote;
use crate::measured::{Measured, MeasuredProfile};
use crate::price::mean_price;
use crate::samples::with_samples;

/// Most samples per pixel: the maximum of the settings.
const MOST_SAMPLES: u32 = 65_536;

/// A limit on the cost of a job, or of each of its frames.
#[derive(Clone, Debug)]
pub struct Limit {
    /// The amount.
    pub most: Most,
    /// Job or frame.
    pub per: Per,
    /// Quantile of the cost that must stay within the limit.
    pub confidence: Confidence,
}

/// An amount of time or money.
#[derive(Clone, Debug)]
pub enum Most {
    /// CPU seconds on a node of speed 1.
    Seconds(f64),
    /// Micro-units, at the mean price of these nodes.
    Money(i64, Vec<Node>),
}

impl Limit {
    /// The quote with the most samples that fit.
    ///
    /// # Errors
    /// If one sample does not fit, with its cost. Also those of [`Measured::estimate`].
    pub fn quote(
        &self,
        preview: &PreviewResult,
        profiles: &[MeasuredProfile],
        corrections: Option<&Corrections>,
    ) -> Result<Quote, QuoteError> {
        let with = |spp: u32| -> Result<Quote, QuoteError> {
            let profiles = with_samples(profiles, spp);
            let mut quote = Measured::new(preview, &profiles).quote(corrections)?;
            quote.job.chosen_spp = Some(spp);
            Ok(quote)
        };
        let mut best = with(1)?;
        if !self.fits(&best) {
            return Err(self.too_little(&best));
        }
        let (mut fits, mut too_many) = (1, MOST_SAMPLES + 1);
        while too_many - fits > 1 {
            let middle = fits + (too_many - fits) / 2;
            let quote = with(middle)?;
            if self.fits(&quote) {
                (fits, best) = (middle, quote);
            } else {
                too_many = middle;
            }
        }
        Ok(best)
    }

    fn fits(&self, quote: &Quote) -> bool {
        let seconds = self.seconds(quote);
        match &self.most {
            Most::Seconds(most) => seconds <= *most,
            Most::Money(most, nodes) => seconds * price(nodes, quote) <= *most as f64,
        }
    }

    /// CPU seconds to compare with the limit.
    fn seconds(&self, quote: &Quote) -> f64 {
        match self.per {
            Per::Job => quote.job.total.cpu_seconds.at(self.confidence),
            Per::Frame => {
                let frames = quote.frames.iter().map(|frame| frame.cpu_seconds.at(self.confidence));
                frames.fold(0.0, f64::max)
            }
        }
    }

    fn too_little(&self, least: &Quote) -> QuoteError {
        let seconds = self.seconds(least);
        let in_millionths = |millionths: f64| millionths.ceil() * 1e-6;
        let (needed, limit) = match &self.most {
            Most::Seconds(most) => {
                let text = |seconds: f64| format!("{:.6} CPU seconds", in_millionths(seconds * 1e6));
                (text(seconds), text(*most))
            }
            Most::Money(most, nodes) => {
                let text = |micro_units: f64| format!("{:.6} of money", in_millionths(micro_units));
                (text(seconds * price(nodes, least)), text(*most as f64))
            }
        };
        let what = match self.per {
            Per::Job => "the job",
            Per::Frame => "its most expensive frame",
        };
        QuoteError::TooLittle { what, needed, limit, confidence: self.confidence.name() }
    }
}

/// Price of a CPU second of the quote, in micro-units.
fn price(nodes: &[Node], quote: &Quote) -> f64 {
    mean_price(nodes, quote.job.work_by_class.as_ref()).unwrap_or_default()
}
