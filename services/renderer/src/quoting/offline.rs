//! A quote on this machine alone: the steps of a farm, one after the other.

use super::{Measurement, PixelChoice, PixelProfile, measure_frame, preview_result, profile_pixels};
use crate::door::{Capability, RendererError, RendererId, Run, Settings, Shot};
use forelight_forecast::Strategy;
use forelight_protocol::{Explanation, ForecastDoc, PreviewResult, QuotedShot, SceneDigest};
use forelight_quote::{
    Measured, MeasuredProfile, QuoteError, SampledProfile, explain_sampled, frames_to_profile, quote_sampled,
};

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
    /// Standard deviation of the logarithm of the total CPU time, as calibration takes it.
    pub spread: f64,
    /// Mean cost of a frame that does not depend on its samples or pixels, nanoseconds of CPU time.
    pub fixed_nanos: u64,
    /// What every frame shows.
    pub preview: PreviewResult,
    /// The measured frames, ascending, if parts of frames were measured.
    pub measured: Vec<Measurement>,
    /// The profiled frames, ascending, if single pixels were measured.
    pub profiled: Vec<PixelProfile>,
}

impl ShotQuote {
    /// The number of the first measured frame, and what each of its pixels will cost, in nanoseconds of CPU
    /// time, in rows from the top. Fixed costs are not in it. `None` if the renderer does not say where the time
    /// goes, see [`locates_costs`](super::locates_costs).
    ///
    /// # Errors
    /// Those of the quote.
    pub fn pixel_costs(&self, settings: &Settings) -> Result<Option<(u32, Vec<f64>)>, QuoteError> {
        if let Some(profile) = self.profiled.first() {
            let frame = profile.result.frame;
            let profiles = pixels_of(&self.profiled, settings.common.samples);
            let micros = Measured::new(&self.preview, &profiles).pixel_work(frame, None)?;
            return Ok(micros.map(|micros| {
                let of = |shown: Option<(u32, u32)>| match shown {
                    Some((object, material)) => micros.of(object, material),
                    None => micros.of_background(),
                };
                (frame, profile.strata.shown().map(|shown| of(shown) * 1e3).collect())
            }));
        }
        let Some(Measurement { result, blocks: Some(blocks), .. }) = self.measured.first() else {
            return Ok(None);
        };
        let forecast = self.document.frames.iter().find(|forecast| forecast.frame == result.frame);
        let nanos =
            forecast.map_or(0.0, |forecast| forecast.cpu_seconds.mean * 1e9 - self.fixed_nanos as f64);
        let mut costs = blocks.of_pixels(settings.common.width, settings.common.height);
        let sum: f64 = costs.iter().sum();
        let factor = if sum > 0.0 { nanos.max(0.0) / sum } else { 0.0 };
        costs.iter_mut().for_each(|cost| *cost *= factor);
        Ok(Some((result.frame, costs)))
    }

    /// Why all frames cost what they cost, in CPU time.
    ///
    /// # Errors
    /// Those of the quote.
    pub fn explain(&self, settings: &Settings) -> Result<Explanation, QuoteError> {
        let settings = settings.complete();
        if self.profiled.is_empty() {
            return explain_sampled(&self.preview, &samples_of(&self.measured), &settings, None);
        }
        let profiles = pixels_of(&self.profiled, settings.samples.unwrap_or(1));
        Measured::new(&self.preview, &profiles).explain_shot(&settings, None)
    }
}

/// What is measured for a quote.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wanted {
    /// Most frames to measure. `None`: the usual number.
    pub frames: Option<usize>,
    /// Pixels to profile in each of them, if the renderer measures single pixels.
    pub samples: u32,
    /// Seed of the choice of pixels.
    pub seed: u64,
}

impl Default for Wanted {
    /// 256 pixels, as in the paper.
    fn default() -> Self {
        Self { frames: None, samples: 256, seed: 0 }
    }
}

/// Quotes frames of a shot (ascending).
///
/// # Errors
/// If the renderer fails or the run is stopped.
pub fn quote_shot(
    (renderer, shot): (&RendererId, &dyn Shot),
    of: (&str, SceneDigest),
    frames: &[u32],
    settings: &Settings,
    wanted: Wanted,
    observe: &(dyn Fn(QuotingStep) + Sync),
    run: &Run<'_>,
) -> Result<ShotQuote, QuotingError> {
    let previewing = |share| observe(QuotingStep::Previewing(share));
    let preview =
        preview_result(renderer, shot, of, frames, settings, &Run { progress: &previewing, ..*run })?;
    let chosen = frames_to_profile(&preview, Strategy::Snapshot, wanted.frames)?;
    let by_pixel = shot.capabilities(settings).contains(&Capability::MeasurePixels);
    let (mut measured, mut profiled) = (Vec::new(), Vec::new());
    for (turn, &frame) in (0..).zip(&chosen) {
        observe(QuotingStep::Measuring { frame, done: turn as usize, all: chosen.len() });
        if by_pixel {
            let Wanted { samples, seed, .. } = wanted;
            let choice = PixelChoice { samples, seed, strategy: Strategy::Snapshot };
            profiled.push(profile_pixels(renderer, shot, frame, settings, choice, run)?);
        } else {
            measured.push(measure_frame(renderer, shot, (frame, turn), settings, run)?);
        }
    }
    let quote = if by_pixel {
        let profiles = pixels_of(&profiled, settings.common.samples);
        Measured::new(&preview, &profiles).quote(None)?
    } else {
        quote_sampled(&preview, &samples_of(&measured), None)?
    };
    let settings = settings.complete().into();
    let shot = QuotedShot { scene: of.1, renderer: Some(renderer.into()), settings };
    let spread = quote.spreads.0.cpu;
    let fixed_nanos = quote.job.fixed.map_or(0, |fixed| fixed.build.cpu_nanos);
    let document = quote.job.document(shot, quote.frames);
    Ok(ShotQuote { document, spread, fixed_nanos, preview, measured, profiled })
}

/// Measured frames of this machine.
fn samples_of(measured: &[Measurement]) -> Vec<SampledProfile> {
    let profile = |found: &Measurement| SampledProfile { result: found.result.clone(), node_speed: 1.0 };
    measured.iter().map(profile).collect()
}

/// Profiled pixels of this machine.
fn pixels_of(profiled: &[PixelProfile], samples: u32) -> Vec<MeasuredProfile> {
    let profile = |found: &PixelProfile| MeasuredProfile::of_renderer(found.result.clone(), 1.0, samples);
    profiled.iter().map(profile).collect()
}
