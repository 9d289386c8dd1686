//! A quote of a shot through the door, on this machine: preview all frames, measure cheap parts of a few of
//! them, forecast all.
//!
//! | file | subject |
//! | --- | --- |
//! | `probes` | which parts of a frame are measured, by what the renderer can do |
//! | `populations` | what frames show, as the forecast needs it |

mod populations;
mod probes;

pub use probes::Varied;

use crate::door::{Artefact, Cost, FrameCounts, RendererError, Run, Settings, Shot};
use forelight_forecast::{
    Calibration, ForecastError, SampleCost, SampledFrame, SampledShotForecast, choose_frames,
    forecast_sampled_shot,
};
use populations::Populations;
use probes::hide;

/// Why a shot cannot be quoted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum QuotingError {
    /// The renderer failed.
    #[error(transparent)]
    Renderer(#[from] RendererError),
    /// The forecast cannot be computed.
    #[error(transparent)]
    Forecast(#[from] ForecastError),
}

/// How far a quote is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum QuotingStep {
    /// Frames are previewed: the share that is done.
    Previewing(f64),
    /// A frame is measured: its number, and the frames that are done and all of them.
    Measuring {
        /// Number of the frame.
        frame: i32,
        /// Frames that are done.
        done: usize,
        /// All frames to measure.
        all: usize,
    },
}

/// A frame that was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredFrame {
    /// Its number.
    pub frame: i32,
    /// Its costs at some amounts of what is varied, which `samples` holds.
    pub costs: Vec<SampleCost>,
    /// What a render takes over.
    pub artefacts: Vec<Artefact>,
}

/// A quote.
#[derive(Debug, Clone, PartialEq)]
pub struct ShotQuote {
    /// What every frame shows.
    pub previews: Vec<FrameCounts>,
    /// The measured frames, ascending.
    pub measured: Vec<MeasuredFrame>,
    /// In what the measurements of a frame differ.
    pub varied: Varied,
    /// The forecast.
    pub forecast: SampledShotForecast,
    /// Cost of making the quote, without opening the scene.
    pub spent: Cost,
}

/// Quotes frames of a shot (ascending). At most `most` frames are measured.
///
/// What is measured depends on what the renderer can do: a few samples, or smaller images, or regions. If it
/// can do none of these, whole frames are measured.
///
/// # Errors
/// If the renderer fails or the run is stopped.
pub fn quote_shot(
    shot: &dyn Shot,
    frames: &[i32],
    settings: &Settings,
    most: usize,
    observe: &(dyn Fn(QuotingStep) + Sync),
    run: &Run<'_>,
) -> Result<ShotQuote, QuotingError> {
    let previewing = |share| observe(QuotingStep::Previewing(share));
    let previews = shot.preview(frames, settings, &Run { progress: &previewing, ..*run })?;
    let mut spent = Cost::default();
    previews.iter().for_each(|preview| spent += &preview.cost);
    let description = shot.description();
    let populations =
        Populations::new(&previews, description.objects.is_some() || description.materials.is_some());
    let Populations { strata, frames: shown, .. } = &populations;
    let chosen = choose_frames(strata, shown, most)?;
    let varied = Varied::best(&shot.capabilities(settings), settings);
    let (mut measured, mut times) = (Vec::new(), Vec::new());
    for (done, &index) in chosen.iter().enumerate() {
        let frame = frames[index];
        observe(QuotingStep::Measuring { frame, done, all: chosen.len() });
        let mut found = MeasuredFrame { frame, costs: Vec::new(), artefacts: Vec::new() };
        let mut nanos = vec![0.0; strata.len()];
        for probe in varied.probes(settings, done) {
            if probe.in_addition && !hide(&found.costs) {
                continue;
            }
            let part = shot.measure(frame, &probe.settings, &probe.part, run)?;
            spent += &part.cost;
            found.costs.extend(varied.costs(&probe, &part));
            found.artefacts.extend(part.artefact);
            for cost in part.strata {
                nanos[populations.place(&cost.count)] += cost.nanos as f64;
            }
        }
        times.push(if nanos.iter().any(|&time| time > 0.0) { nanos } else { Vec::new() });
        measured.push(found);
    }
    let sampled: Vec<SampledFrame<'_>> = chosen
        .iter()
        .zip(&measured)
        .zip(&times)
        .map(|((&frame, found), times)| SampledFrame { frame, costs: &found.costs, stratum_times: times })
        .collect();
    let forecast = forecast_sampled_shot(strata, shown, &sampled, varied.whole(settings), Calibration::NONE)?;
    Ok(ShotQuote { previews, measured, varied, forecast, spent })
}
