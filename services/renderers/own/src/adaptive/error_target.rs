//! Passes until the error of an image is small enough.
//!
//! The first pass gives every pixel two samples. Each later pass gives every tile the samples that it lacks for
//! the error, as the image shows by then ([`crate::adaptive::tiles`]). A pass at most multiplies a tile's
//! samples by `GROWTH`, since few samples may mislead. It takes the law of the variance as certain, since the
//! new samples will test it.
//!
//! No profile is used: that of a few hundred pixels promises a smaller error than the image has.

use crate::adaptive::allotment::quantile;
use crate::adaptive::passes::{Following, NextPass};
use crate::adaptive::tiles::Tiles;
use crate::error::RenderError;
use forelight_forecast::Calibration;
use forelight_forecast::accuracy::allot::cost;
use forelight_forecast::accuracy::{ErrorQuantiles, Survey};
use forelight_protocol::{Confidence, ErrorTarget};
use forelight_tracer::SampleCounts;

/// A pass multiplies the samples of a tile by at most this.
const GROWTH: f64 = 4.0;
/// Least growth in cost for a pass that takes the law of the variance as certain.
const WORTHWHILE: f64 = 0.02;

/// The largest error of an image, as a share of its mean, and how sure that must be.
#[derive(Clone, Copy)]
pub(crate) struct ErrorAim {
    pub wanted: f64,
    pub confidence: Confidence,
}

impl ErrorAim {
    /// Samples of every pixel in the first pass: enough to show that they differ.
    pub const FIRST: u16 = 2;

    /// What follows a pass with these samples.
    pub fn after(
        &self,
        tiles: &Tiles,
        counts: &SampleCounts,
        survey: &Survey,
    ) -> Result<Following, RenderError> {
        let (wanted, has) = (self.wanted, survey.samples());
        let at = |error: &ErrorQuantiles| quantile(error, self.confidence);
        if at(&survey.error(has, Calibration::NONE)) <= wanted * (1.0 + ErrorTarget::NEAR_ENOUGH) {
            return Ok(Following { done: 1.0, next: None });
        }
        let cost_of = |samples: &[f64]| {
            let after: Vec<f64> = samples.iter().zip(has).map(|(n, has)| n.max(*has)).collect();
            cost(survey.zones(), &after)
        };
        let (to_see, sure) = (
            survey.samples_to_see(wanted, at, Calibration::NONE),
            survey.samples_for_error(wanted, at, Calibration::NONE),
        );
        let (done, all) = (cost_of(has), cost_of(&sure).max(f64::MIN_POSITIVE));
        let lacking = if cost_of(&to_see) > done * (1.0 + WORTHWHILE) { to_see } else { sure };
        let capped: Vec<f64> = lacking.iter().zip(has).map(|(n, has)| n.min(GROWTH * has)).collect();
        let samples = more(tiles, &capped, counts)?;
        // If nothing is added, every pixel has the most samples allowed.
        let is_more = samples != *counts;
        let next = is_more.then(|| NextPass { samples, until: (cost_of(&capped) / all).min(1.0) });
        Ok(Following { done: if is_more { done / all } else { 1.0 }, next })
    }
}

/// At least these samples, and more than `has` if possible. In a tile of few pixels, a mean between two
/// evenly spread numbers may not reach the next.
fn more(tiles: &Tiles, samples: &[f64], has: &SampleCounts) -> Result<SampleCounts, RenderError> {
    let mut scale = 1.0;
    loop {
        let scaled: Vec<f64> = samples.iter().map(|n| n * scale).collect();
        let next = tiles.laid_out(&scaled)?.or_more(has);
        if next != *has || scale >= 2.0 {
            return Ok(next);
        }
        scale *= 1.25;
    }
}
