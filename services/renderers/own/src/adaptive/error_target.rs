//! A render that continues until its image is accurate enough.
//!
//! The first pass gives every pixel a few samples, as the profile suggests. Each later pass gives every tile
//! the samples that it lacks for the error, as the image shows by then ([`crate::adaptive::tiles`]). A pass
//! at most multiplies a tile's samples by `GROWTH`, since few samples may mislead. It takes the law of the
//! variance as certain, since the new samples will test it. The image depends on the samples alone.

use crate::adaptive::allocation::{AllotError, Allotment, Made, quantile};
use crate::adaptive::tiles::Tiles;
use crate::answers::{Progress, Step};
use crate::error::RenderError;
use crate::frame::OwnFrame;
use forelight_forecast::Calibration;
use forelight_forecast::accuracy::ErrorQuantiles;
use forelight_forecast::accuracy::allot::cost;
use forelight_protocol::Confidence;
use forelight_tracer::{Passes, SampleCounts};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Fewest samples of a pixel in the first pass: enough to show that they differ.
const LEAST: f64 = 2.0;
/// Most samples of a pixel in the first pass.
const FIRST: f64 = 4.0;
/// A pass multiplies the samples of a tile by at most this.
const GROWTH: f64 = 4.0;
/// An error that exceeds the target by this share is accepted.
pub const NEAR_ENOUGH: f64 = 0.01;
/// Least growth in cost for a pass that takes the law of the variance as certain.
const WORTHWHILE: f64 = 0.02;

/// Renders a frame, whose cache is filled, until its error is below `wanted`, a share of the image's mean.
/// `None` if `cancel` was set.
pub(crate) fn render_for_error(
    ready: &OwnFrame<'_>,
    allotment: &Allotment<'_>,
    wanted: f64,
    confidence: Confidence,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Option<Made>, AllotError> {
    let tiles = Tiles::new(allotment);
    let mut passes = ready.begin();
    let first: Vec<f64> =
        allotment.for_error(wanted, confidence).into_iter().map(|n| n.clamp(LEAST, FIRST)).collect();
    let mut next = allotment.laid_out(&first)?;
    let mut shown = 0.0..1.0 / GROWTH;
    let (samples, survey) = loop {
        pass(ready, &mut passes, &next, &shown, progress, cancel)?;
        if cancel.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let counts = passes.counts().map_err(RenderError::from)?;
        let survey = tiles.survey(&passes)?;
        let has = survey.samples();
        let at = |error: &ErrorQuantiles| quantile(error, confidence);
        if at(&survey.error(has, Calibration::NONE)) <= wanted * (1.0 + NEAR_ENOUGH) {
            break (counts, survey);
        }
        let cost_of = |samples: &[f64]| {
            let after: Vec<f64> = samples.iter().zip(has).map(|(n, has)| n.max(*has)).collect();
            cost(survey.zones(), &after)
        };
        let (to_see, sure) = (
            survey.samples_to_see(wanted, at, Calibration::NONE),
            survey.samples_for_error(wanted, at, Calibration::NONE),
        );
        let done = cost_of(has);
        let lacking = if cost_of(&to_see) > done * (1.0 + WORTHWHILE) { to_see } else { sure.clone() };
        let capped: Vec<f64> = lacking.iter().zip(has).map(|(n, has)| n.min(GROWTH * has)).collect();
        next = more(&tiles, &capped, &counts)?;
        if next == counts {
            // Every pixel has the most samples allowed.
            break (counts, survey);
        }
        let rest = (cost_of(&capped) - done) / (cost_of(&sure) - done).max(f64::MIN_POSITIVE);
        shown = shown.end..shown.end + (1.0 - shown.end) * rest.min(1.0);
    };
    Ok(Some(Made { finished: ready.finished(&passes), samples, survey, within: None }))
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

/// Brings the pixels to these numbers of samples. Progress goes from `shown.start` to `shown.end`.
pub(crate) fn pass(
    ready: &OwnFrame<'_>,
    passes: &mut Passes,
    wanted: &SampleCounts,
    shown: &Range<f64>,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<(), RenderError> {
    let (pixels, parts) = (wanted.as_slice().len() as u64, passes.parts() as f64);
    let told = AtomicU64::new(0);
    let show = || {
        let part = ((told.fetch_add(1, Ordering::Relaxed) + 1) as f64 / parts).min(1.0);
        let done = (pixels as f64 * (shown.start + part * (shown.end - shown.start))) as u64;
        progress(Progress { step: Step::Tracing, done, all: pixels });
    };
    ready.go_on(passes, wanted, &|| cancel.load(Ordering::Relaxed), &show)?;
    Ok(())
}
