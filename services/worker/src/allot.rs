//! A frame for so many seconds, or of so small an error: the camera samples that each part of it gets.
//!
//! Some pixels are profiled with a few camera samples (see `accuracy::pilot`). They say, stratum by stratum and for the edges of lights
//! apart, how variance falls with samples and what a sample costs; from these follow the numbers of samples that make the least
//! error for the time, or the least time for the error (`forelight_forecast::accuracy::allot`). With an irradiance cache that is filled first, for
//! what is left of the time depends on it.

use crate::accuracy::{AccuracyObserver, AccuracyOptions, Pilot, piloted};
use crate::render::{Given, Rendered, render_ready, seconds};
use crate::renderer::{Progress, RenderError, Renderer};
use crate::shot::ShotError;
use forelight_forecast::accuracy::allot::{
    MOST_SAMPLES, Zone, cost, mean_variance, samples_for_budget, samples_for_variance, whole,
};
use forelight_forecast::accuracy::{ImageNoise, NoiseGroup, noise_groups};
use forelight_forecast::{Calibration, ForecastError};
use forelight_protocol::{AllottedStats, Confidence, ImageError, Quantiles, RenderSettings};
use forelight_tracer::SampleCounts;
use std::time::Instant;

/// What a frame is to come to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Aim {
    /// CPU seconds of all threads, with those that finding out takes.
    CpuSeconds(f64),
    /// Root mean square error as a share of the image's mean.
    Error(f64),
}

/// How camera samples are allotted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AllotOptions {
    /// What to reach.
    pub aim: Aim,
    /// How sure.
    pub confidence: Confidence,
    /// Pixels to profile.
    pub samples: u32,
    /// Seed of their choice.
    pub seed: u64,
}

/// Why no samples can be allotted.
#[derive(Debug, thiserror::Error)]
pub enum AllotError {
    /// One camera sample a pixel takes longer.
    #[error("{given} CPU seconds are too few: with one camera sample per pixel the frame takes {least:.3} s")]
    TooLittle {
        /// Seconds given.
        given: f64,
        /// Seconds that the least image takes.
        least: f64,
    },
    /// The frame cannot be profiled.
    #[error(transparent)]
    Shot(#[from] ShotError),
}

impl From<RenderError> for AllotError {
    fn from(error: RenderError) -> Self {
        Self::Shot(error.into())
    }
}

impl From<ForecastError> for AllotError {
    fn from(error: ForecastError) -> Self {
        Self::Shot(error.into())
    }
}

/// Renders one frame with the camera samples that reach an aim. `None` if the observer's flag was set.
///
/// The image depends on the settings, the aim and, if that is a time, on how fast this machine was while it profiled.
///
/// # Errors
/// If the time is too short for any image.
pub fn render_allotted(
    renderer: &dyn Renderer,
    frame: u32,
    asked: &RenderSettings,
    given: Given<'_>,
    options: &AllotOptions,
    progress: &(dyn Fn(Progress) + Sync),
    observer: &dyn AccuracyObserver,
) -> Result<Option<Rendered>, AllotError> {
    let start = Instant::now();
    let settings = piloted(asked);
    let ready = renderer.frame(frame, &settings)?;
    given.cache.map_or(Ok(()), |cache| ready.share(cache))?;
    if !ready.fill(progress, observer.cancel()) {
        return Ok(None);
    }
    let picked = AccuracyOptions { samples: options.samples, seed: options.seed };
    let pilot = match Pilot::new(renderer, &*ready, settings.clone(), &picked, observer) {
        Err(ShotError::Cancelled) => return Ok(None),
        pilot => pilot?,
    };
    let (samples, allotted) = Costs::of(&pilot)?.allot(&pilot, options)?;
    ready.allot(samples)?;
    let mut rendered = render_ready(&*ready, &settings, None, progress, &|_| (), observer.cancel())?;
    if let Some(rendered) = &mut rendered {
        rendered.stats.spp = allotted.mean.round() as u32;
        rendered.stats.allotted = Some(allotted);
        rendered.stats.wall_seconds = start.elapsed().as_secs_f64();
    }
    Ok(rendered)
}

/// What the frame takes with the pilot's camera samples.
struct Costs {
    work: Quantiles,
    cpu_seconds: Quantiles,
    /// The part of it that is in proportion to the samples.
    pixel_work: f64,
    pixel_seconds: f64,
}

impl Costs {
    fn of(pilot: &Pilot) -> Result<Self, ShotError> {
        let spp = pilot.settings.spp;
        let (work, cpu_seconds) = pilot.cost(&pilot.view, spp)?;
        let (double_work, double_seconds) = pilot.cost(&pilot.view, 2 * spp)?;
        Ok(Self {
            pixel_work: double_work.mean - work.mean,
            pixel_seconds: double_seconds.mean - cpu_seconds.mean,
            work,
            cpu_seconds,
        })
    }

    fn allot(
        &self,
        pilot: &Pilot,
        options: &AllotOptions,
    ) -> Result<(SampleCounts, AllottedStats), AllotError> {
        let spp = pilot.settings.spp;
        let noise = &pilot.noise;
        let image = ImageNoise::new(noise.cells(&pilot.noise_strata, &noise.counts)?)?;
        let groups = noise_groups(&pilot.noise_strata, &noise.counts, &noise.samples)?;
        let zones = zones(pilot, &image, &groups)?;
        // The strata of cost are finer, and their estimate of the whole is the better one.
        let scale = self.pixel_work / cost(&zones, &vec![f64::from(spp); zones.len()]).max(f64::MIN_POSITIVE);
        let per_work = self.pixel_seconds / self.pixel_work.max(f64::MIN_POSITIVE);
        let of_pixels = |samples: &[f64]| scale * cost(&zones, samples);
        let uniform = image.noise_at(spp);
        let spread = uniform.error(Calibration::NONE);
        let rms = uniform.value.sqrt().max(f64::MIN_POSITIVE);
        let samples = match options.aim {
            Aim::CpuSeconds(given) => {
                let surety = ratio(self.cpu_seconds.at(options.confidence), self.cpu_seconds.mean);
                let fixed = self.cpu_seconds.mean - self.pixel_seconds + seconds(pilot.overhead.cpu_nanos);
                let left = (given / surety - fixed) / per_work.max(f64::MIN_POSITIVE);
                samples_for_budget(&zones, left / scale.max(f64::MIN_POSITIVE)).ok_or_else(|| {
                    let least = of_pixels(&vec![1.0; zones.len()]) * per_work;
                    AllotError::TooLittle { given, least: surety * (fixed + least) }
                })?
            }
            Aim::Error(wanted) => {
                let quantile = match options.confidence {
                    Confidence::P50 => spread.p50,
                    Confidence::P80 => spread.p80,
                    Confidence::P95 => spread.p95,
                };
                let wanted = wanted / ratio(quantile, rms) * image.mean();
                samples_for_variance(&zones, wanted * wanted)
            }
        };
        let samples_of_pixels = laid_out(pilot, &groups, &samples)?;
        let (least, most, mean) = samples_of_pixels.range();
        let change = of_pixels(&samples) - self.pixel_work;
        let error = mean_variance(&zones, &samples).sqrt() / image.mean().max(f64::MIN_POSITIVE);
        let scaled = |quantile: f64| error * ratio(quantile, rms);
        let allotted = AllottedStats {
            least,
            most,
            mean,
            work: moved(&self.work, change),
            cpu_seconds: moved(&self.cpu_seconds, change * per_work),
            error: ImageError {
                p05: scaled(spread.p05),
                p50: scaled(spread.p50),
                p80: scaled(spread.p80),
                p95: scaled(spread.p95),
            },
            profiling_work: pilot.overhead.work,
            profiling_cpu_seconds: seconds(pilot.overhead.cpu_nanos),
        };
        Ok((samples_of_pixels, allotted))
    }
}

fn zones(pilot: &Pilot, image: &ImageNoise, groups: &[NoiseGroup]) -> Result<Vec<Zone>, ForecastError> {
    let (noise, of_image) = (&pilot.noise, image.curve());
    let zone = |group: &NoiseGroup| {
        let pixels = group.strata.iter().map(|&h| u64::from(noise.counts[h])).sum();
        let sample = |&i: &usize| (image.curve_of(&noise.samples[i].noise), pilot.pixel_work[i] as f64);
        let samples: Vec<_> = group.samples.iter().map(sample).collect();
        Zone::new(pixels, &samples, pilot.settings.spp, of_image)
    };
    groups.iter().map(zone).collect()
}

/// The samples of each group of strata, pixel by pixel.
fn laid_out(pilot: &Pilot, groups: &[NoiseGroup], samples: &[f64]) -> Result<SampleCounts, RenderError> {
    let mut counts = vec![1u16; pilot.settings.pixels() as usize];
    for (group, &samples) in groups.iter().zip(samples) {
        let pixels = pilot.zones.pixels_of(&group.strata);
        for (&pixel, n) in pixels.iter().zip(whole(samples, pixels.len())) {
            // At most as many as that type holds.
            counts[pixel as usize] = n.min(MOST_SAMPLES as u32) as u16;
        }
    }
    Ok(SampleCounts::new(counts)?)
}

/// 1 for nothing of nothing.
fn ratio(part: f64, whole: f64) -> f64 {
    if part > 0.0 && whole > 0.0 { part / whole } else { 1.0 }
}

/// The quantiles of what takes so much more, as sure in proportion.
fn moved(quantiles: &Quantiles, change: f64) -> Quantiles {
    let factor = ratio((quantiles.mean + change).max(0.0), quantiles.mean);
    let Quantiles { mean, p50, p80, p95 } = *quantiles;
    Quantiles { mean: mean * factor, p50: p50 * factor, p80: p80 * factor, p95: p95 * factor }
}
