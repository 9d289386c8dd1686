//! A quote of a shot through the door, on this machine: preview all frames, render a few of them at few
//! samples, forecast all.

use crate::door::{
    Artefact, Cost, FrameCounts, Measured, Part, PixelCount, RendererError, Run, Settings, Shot,
};
use forelight_forecast::{
    Calibration, ForecastError, FramePopulation, SampleCost, SampledFrame, SampledShotForecast, Stratum,
    choose_frames, forecast_sampled_shot,
};
use std::collections::BTreeMap;

/// Share of a frame's samples that are measured, as a divisor. More make the quote surer, and cost more.
const SHARE: u32 = 16;

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
    /// Its costs at some numbers of samples.
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
    /// The forecast.
    pub forecast: SampledShotForecast,
    /// Cost of making the quote, without opening the scene.
    pub spent: Cost,
}

/// Quotes frames of a shot (ascending). At most `most` frames are measured.
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
    let places = places(&previews);
    let (strata, populations) = populations(&previews, &places);
    let chosen = choose_frames(&strata, &populations, most)?;
    let (mut measured, mut times) = (Vec::new(), Vec::new());
    for (done, &index) in chosen.iter().enumerate() {
        let frame = frames[index];
        observe(QuotingStep::Measuring { frame, done, all: chosen.len() });
        let mut found = MeasuredFrame { frame, costs: Vec::new(), artefacts: Vec::new() };
        let mut nanos = vec![0.0; strata.len()];
        for part in parts(settings.common.samples) {
            let Part::Samples { count, .. } = part else { continue };
            let Measured { cost, fixed, strata, artefact, .. } = shot.measure(frame, settings, &part, run)?;
            spent += &cost;
            found.costs.push(SampleCost { samples: count, cpu_nanos: cost.cpu_nanos });
            if !fixed.is_empty() {
                found.costs.push(SampleCost { samples: 0, cpu_nanos: fixed.values().sum() });
            }
            found.artefacts.extend(artefact);
            for cost in strata {
                nanos[places.get(&key(&cost.count)).copied().unwrap_or(places.len())] += cost.nanos as f64;
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
    let forecast =
        forecast_sampled_shot(&strata, &populations, &sampled, settings.common.samples, Calibration::NONE)?;
    Ok(ShotQuote { previews, measured, forecast, spent })
}

/// The shares of the samples that are measured, one after the other: one sample, then some more.
fn parts(samples: u32) -> Vec<Part> {
    let more = (samples / SHARE).max(2).min(samples.saturating_sub(1));
    let share = |offset, count| Part::Samples { offset, count };
    [share(0, 1), share(1, more)].into_iter().take(if more == 0 { 1 } else { 2 }).collect()
}

type Key = (Option<u32>, Option<u32>);

fn key(count: &PixelCount) -> Key {
    (count.object, count.material)
}

/// Every (object, material) that any frame shows, with its place among the strata. What shows nothing is the
/// background, which comes last and has no place here.
fn places(previews: &[FrameCounts]) -> BTreeMap<Key, usize> {
    let shown = previews.iter().flat_map(|preview| &preview.counts).map(key);
    let mut places: BTreeMap<Key, usize> =
        shown.filter(|key| *key != (None, None)).map(|key| (key, 0)).collect();
    places.values_mut().enumerate().for_each(|(at, place)| *place = at);
    places
}

fn populations(
    previews: &[FrameCounts],
    places: &BTreeMap<Key, usize>,
) -> (Vec<Stratum>, Vec<FramePopulation>) {
    let stratum = |(&(object, material), _): (&Key, &usize)| Stratum {
        object: object.map_or(u32::MAX, |it| it),
        material: material.map_or(u32::MAX, |it| it),
        prior_cost: 1.0,
        apart: false,
    };
    let strata: Vec<Stratum> = places.iter().map(stratum).chain([Stratum::background(0.1)]).collect();
    let population = |preview: &FrameCounts| {
        let mut counts = vec![0u32; strata.len()];
        for count in &preview.counts {
            let place = places.get(&key(count)).copied().unwrap_or(places.len());
            counts[place] = u32::try_from(count.pixels).unwrap_or(u32::MAX);
        }
        FramePopulation { number: i64::from(preview.frame), counts, lights: 0, shining: 0, triangles: 0 }
    };
    let populations = previews.iter().map(population).collect();
    (strata, populations)
}
