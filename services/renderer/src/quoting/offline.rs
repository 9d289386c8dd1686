//! A quote on this machine alone: the steps of a farm, one after the other.

use super::{Measurement, measure_frame, preview_result};
use crate::door::{RendererError, RendererId, Run, Settings, Shot};
use forelight_forecast::Strategy;
use forelight_protocol::{ForecastDoc, PreviewResult, QuotedShot, SceneDigest};
use forelight_quote::{QuoteError, SampledProfile, frames_to_profile, quote_sampled};

/// Why a shot cannot be quoted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum QuotingError {
    /// The renderer failed.
    #[error(transparent)]
    Renderer(#[from] RendererError),
    /// The quote cannot be computed.
    #[error(transparent)]
    Quote(#[from] QuoteError),
}

/// How far a quote is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum QuotingStep {
    /// Frames are previewed: the share that is done.
    Previewing(f64),
    /// A frame is measured: its number, and the frames that are done and all of them.
    Measuring {
        /// Number of the frame.
        frame: u32,
        /// Frames that are done.
        done: usize,
        /// All frames to measure.
        all: usize,
    },
}

/// A quote, and the measurements behind it.
#[derive(Debug, Clone)]
pub struct ShotQuote {
    /// The quote.
    pub document: ForecastDoc,
    /// What every frame shows.
    pub preview: PreviewResult,
    /// The measured frames, ascending.
    pub measured: Vec<Measurement>,
}

/// Quotes frames of a shot (ascending). At most `most` frames are measured.
///
/// # Errors
/// If the renderer fails or the run is stopped.
pub fn quote_shot(
    (renderer, shot): (&RendererId, &dyn Shot),
    of: (&str, SceneDigest),
    frames: &[u32],
    settings: &Settings,
    most: Option<usize>,
    observe: &(dyn Fn(QuotingStep) + Sync),
    run: &Run<'_>,
) -> Result<ShotQuote, QuotingError> {
    let previewing = |share| observe(QuotingStep::Previewing(share));
    let preview =
        preview_result(renderer, shot, of, frames, settings, &Run { progress: &previewing, ..*run })?;
    let chosen = frames_to_profile(&preview, Strategy::Snapshot, most)?;
    let mut measured = Vec::with_capacity(chosen.len());
    for (turn, &frame) in (0..).zip(&chosen) {
        let done = measured.len();
        observe(QuotingStep::Measuring { frame, done, all: chosen.len() });
        measured.push(measure_frame(renderer, shot, (frame, turn), settings, run)?);
    }
    let profile = |found: &Measurement| SampledProfile { result: found.result.clone(), node_speed: 1.0 };
    let profiles: Vec<SampledProfile> = measured.iter().map(profile).collect();
    let quote = quote_sampled(&preview, &profiles, None)?;
    let settings = settings.complete().into();
    let shot = QuotedShot { scene: of.1, renderer: Some(renderer.into()), settings };
    Ok(ShotQuote { document: quote.job.document(shot, quote.frames), preview, measured })
}
