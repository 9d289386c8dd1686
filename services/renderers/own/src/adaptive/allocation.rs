//! Distributes the camera samples of a frame with a time limit or an error target.
//!
//! Some pixels are profiled with a few camera samples (see `accuracy::pilot`). For each stratum, and for the
//! edges of lights, they show the cost of a sample and how variance falls with samples. That gives the first
//! pass and the forecast. Later passes follow the image, which shows where on a wall the bright spot is
//! ([`crate::adaptive::tiles`]). An irradiance cache is filled first, since the time left depends on it.

use crate::accuracy::{AccuracyObserver, AccuracyOptions, Pilot, piloted};
use crate::adaptive::error_target::render_for_error;
use crate::adaptive::tiles::laid_out;
use crate::adaptive::time_limit::{Budget, fits_the_cache, render_within};
use crate::answers::{Finished, Progress};
use crate::error::RenderError;
use crate::frame::OwnFrame;
use crate::profile::ShotError;
use crate::render::{Given, Rendered, render_ready, rendered, seconds};
use crate::shot::OwnShot;
use forelight_forecast::accuracy::allot::{Zone, cost, samples_for_variance};
use forelight_forecast::accuracy::{ErrorQuantiles, ImageNoise, NoiseGroup, Survey, noise_groups};
use forelight_forecast::{Calibration, ForecastError};
use forelight_protocol::{
    AllottedForecast, AllottedStats, Confidence, ImageError, Quantiles, RenderSettings, WithinStats,
};
use forelight_tracer::SampleCounts;
use std::time::Instant;

/// What a frame should reach.
#[derive(Clone, Copy)]
pub enum Aim<'a> {
    /// The best image for a time.
    Within(Budget<'a>),
    /// Root mean square error as a share of the image's mean.
    Error(f64),
}

/// How camera samples are allotted.
#[derive(Clone, Copy)]
pub struct AllotOptions<'a> {
    /// What to reach.
    pub aim: Aim<'a>,
    /// Of meeting the error, or of fitting the least image into the time before a pixel is rendered.
    pub confidence: Confidence,
    /// Pixels to profile.
    pub samples: u32,
    /// Seed of the choice of pixels.
    pub seed: u64,
}

/// Why samples cannot be distributed.
#[derive(Debug, thiserror::Error)]
pub enum AllotError {
    /// One camera sample per pixel takes longer.
    #[error(
        "{given:.3} s is too short: the frame takes about {least:.3} s with one camera sample per pixel; allow at least that"
    )]
    TooLittle {
        /// Seconds given.
        given: f64,
        /// Seconds of the least image, on the same clock.
        least: f64,
    },
    /// Filling the irradiance cache alone takes longer.
    #[error(
        "{given:.3} s is too short: filling the frame's irradiance cache takes until about {filled:.3} s; allow more or use no cache"
    )]
    TooLittleForCache {
        /// Seconds given.
        given: f64,
        /// When the cache is filled, in seconds on the same clock.
        filled: f64,
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

/// An image whose pixels differ in their camera samples.
#[derive(Debug, Clone)]
pub struct Allotted {
    /// The image.
    pub rendered: Rendered,
    /// Samples per pixel. [`render_as_allotted`] makes the same image from them, bit by bit.
    pub samples: SampleCounts,
}

/// Renders one frame with the camera samples that reach an aim. `None` if the observer's flag was set.
///
/// The image depends on the settings and the aim. With a time limit, the speed of the machine decides how
/// many samples the pixels get, and nothing else.
///
/// # Errors
/// If the time is too short for any image.
pub fn render_allotted(
    shot: &OwnShot,
    frame: u32,
    asked: &RenderSettings,
    given: Given<'_>,
    options: &AllotOptions<'_>,
    progress: &(dyn Fn(Progress) + Sync),
    observer: &dyn AccuracyObserver,
) -> Result<Option<Allotted>, AllotError> {
    let start = Instant::now();
    let settings = piloted(asked);
    let ready = shot.frame(frame, &settings)?;
    if let (Aim::Within(budget), None) = (&options.aim, &given.cache) {
        fits_the_cache(&ready, budget, options.seed)?;
    }
    given.cache.map_or(Ok(()), |cache| ready.share(cache).map(drop))?;
    if !ready.fill(progress, observer.cancel()) {
        return Ok(None);
    }
    let picked = AccuracyOptions { samples: options.samples, seed: options.seed };
    let pilot = match Pilot::new(shot, &ready, settings.clone(), &picked, observer) {
        Err(ShotError::Cancelled) => return Ok(None),
        pilot => pilot?,
    };
    let allotment = Allotment::new(&pilot)?;
    let (confidence, cancel) = (options.confidence, observer.cancel());
    let made = match &options.aim {
        Aim::Within(budget) => render_within(&ready, &allotment, budget, confidence, progress, cancel)?,
        Aim::Error(wanted) => render_for_error(&ready, &allotment, *wanted, confidence, progress, cancel)?,
    };
    let Some(made) = made else { return Ok(None) };
    let forecast = allotment.forecast(&made.samples)?;
    Ok(Some(made.rendered(&ready, &settings, Some(forecast), start.elapsed().as_secs_f64())))
}

/// Renders one frame with camera samples that were distributed before. The same settings give the same image,
/// bit by bit. `None` if the observer's flag was set.
///
/// # Errors
/// If `samples` does not have one number per pixel.
pub fn render_as_allotted(
    shot: &OwnShot,
    frame: u32,
    asked: &RenderSettings,
    given: Given<'_>,
    samples: &SampleCounts,
    progress: &(dyn Fn(Progress) + Sync),
    observer: &dyn AccuracyObserver,
) -> Result<Option<Allotted>, RenderError> {
    let start = Instant::now();
    let settings = piloted(asked);
    let ready = shot.frame(frame, &settings)?;
    given.cache.map_or(Ok(()), |cache| ready.share(cache).map(drop))?;
    ready.allot(samples.clone())?;
    let rendered = render_ready(&ready, &settings, None, progress, &|_| (), observer.cancel())?;
    Ok(rendered.map(|mut rendered| {
        rendered.stats.spp = samples.range().2.round() as u32;
        rendered.stats.wall_seconds = start.elapsed().as_secs_f64();
        Allotted { rendered, samples: samples.clone() }
    }))
}

pub(crate) struct Made {
    pub finished: Finished,
    pub samples: SampleCounts,
    /// The image's own estimate of its error.
    pub survey: Survey,
    pub within: Option<WithinStats>,
}

impl Made {
    /// The frame with its cost, its forecast, and its estimated error.
    pub fn rendered(
        self,
        ready: &OwnFrame<'_>,
        settings: &RenderSettings,
        forecast: Option<AllottedForecast>,
        wall_seconds: f64,
    ) -> Allotted {
        let Self { finished, samples, survey, within } = self;
        let (least, most, mean) = samples.range();
        let ErrorQuantiles { p05, p50, p80, p95 } = survey.error(survey.samples(), Calibration::NONE);
        let error = ImageError { p05, p50, p80, p95 };
        let mut rendered = rendered(ready, finished, settings, wall_seconds);
        rendered.stats.spp = mean.round() as u32;
        rendered.stats.allotted =
            Some(Box::new(AllottedStats { least, most, mean, error, forecast, within }));
        Allotted { rendered, samples }
    }
}

/// Cost and benefit of samples, by zone of a frame.
pub(crate) struct Allotment<'a> {
    pilot: &'a Pilot,
    image: ImageNoise,
    zones: Vec<Zone>,
    /// Of each zone, ascending.
    pixels: Vec<Vec<u32>>,
    /// Indices of the pilot's scattered samples in each zone.
    profiled: Vec<Vec<usize>>,
    /// Of the frame with the pilot's camera samples.
    cpu_seconds: Quantiles,
    /// Work of the pixels per unit of the zones' cost, as strata of cost are finer than zones.
    scale: f64,
    /// CPU seconds per unit of work, as measured by the pilot.
    pub seconds_per_work: f64,
    /// Error with the pilot's camera samples, and its root mean square.
    spread: ErrorQuantiles,
    rms: f64,
}

impl<'a> Allotment<'a> {
    fn new(pilot: &'a Pilot) -> Result<Self, ShotError> {
        let spp = pilot.settings.spp;
        let (work, cpu_seconds) = pilot.cost(&pilot.view, spp)?;
        let (double_work, double_seconds) = pilot.cost(&pilot.view, 2 * spp)?;
        let pixel_work = double_work.mean - work.mean;
        let noise = &pilot.noise;
        let image = ImageNoise::new(noise.cells(&pilot.noise_strata, &noise.counts)?)?;
        let groups = noise_groups(&pilot.noise_strata, &noise.counts, &noise.samples)?;
        let zones = zones(pilot, &image, &groups)?;
        let scattered = |group: NoiseGroup| -> Vec<usize> {
            group.samples.into_iter().filter(|&i| i < noise.scattered).collect()
        };
        let uniform = image.noise_at(spp);
        Ok(Self {
            scale: pixel_work / cost(&zones, &vec![f64::from(spp); zones.len()]).max(f64::MIN_POSITIVE),
            seconds_per_work: (double_seconds.mean - cpu_seconds.mean) / pixel_work.max(f64::MIN_POSITIVE),
            spread: uniform.error(Calibration::NONE),
            rms: uniform.value.sqrt().max(f64::MIN_POSITIVE),
            pilot,
            image,
            zones,
            pixels: groups.iter().map(|group| pilot.zones.pixels_of(&group.strata)).collect(),
            profiled: groups.into_iter().map(scattered).collect(),
            cpu_seconds,
        })
    }

    /// Ratio of the CPU time at a confidence to its mean.
    pub fn surety(&self, confidence: Confidence) -> f64 {
        ratio(self.cpu_seconds.at(confidence), self.cpu_seconds.mean)
    }

    fn work_of(&self, samples: &[f64]) -> f64 {
        self.scale * cost(&self.zones, samples)
    }

    pub fn least_work(&self) -> f64 {
        self.work_of(&vec![1.0; self.zones.len()])
    }

    /// Samples of each zone that reach an error, as a share of the image's mean, with the least work.
    pub fn for_error(&self, wanted: f64, confidence: Confidence) -> Vec<f64> {
        let wanted = wanted / ratio(quantile(&self.spread, confidence), self.rms) * self.image.mean();
        samples_for_variance(&self.zones, wanted * wanted)
    }

    pub fn laid_out(&self, samples: &[f64]) -> Result<SampleCounts, RenderError> {
        laid_out(self.pilot.settings.pixels() as usize, &self.pixels, samples)
    }

    pub fn size(&self) -> (u32, u32) {
        (self.pilot.settings.width, self.pilot.settings.height)
    }

    /// For each pixel, how the variance of its zone falls with samples, see [`Zone::variance`].
    pub fn profiled_variance(&self) -> Vec<[f64; 2]> {
        let mut variance = vec![self.image.curve(); self.pilot.settings.pixels() as usize];
        for (pixels, zone) in self.pixels.iter().zip(&self.zones) {
            pixels.iter().for_each(|&pixel| variance[pixel as usize] = zone.variance);
        }
        variance
    }

    /// Mean samples of each zone, weighted by the cost of a sample of each pixel. The profiled pixels
    /// estimate the difference to the plain mean (a difference estimator), since costly tiles may get more
    /// samples.
    fn means(&self, counts: &SampleCounts) -> Vec<f64> {
        let of_pixel = |pixel: u32| f64::from(counts.as_slice()[pixel as usize]);
        let mean = |(pixels, profiled): (&Vec<u32>, &Vec<usize>)| {
            let plain = pixels.iter().map(|&pixel| of_pixel(pixel)).sum::<f64>() / pixels.len().max(1) as f64;
            let (mut samples, mut work, mut both) = (0.0, 0.0, 0.0);
            for &i in profiled {
                let (here, took) = (of_pixel(self.pilot.noise.pixels[i]), self.pilot.pixel_work[i] as f64);
                (samples, work, both) = (samples + here, work + took, both + here * took);
            }
            let tilt = if work > 0.0 { both / work - samples / profiled.len() as f64 } else { 0.0 };
            (plain + tilt).max(1.0)
        };
        self.pixels.iter().zip(&self.profiled).map(mean).collect()
    }

    /// Forecast of a frame with the same mean everywhere, corrected for the distribution of samples.
    fn forecast(&self, counts: &SampleCounts) -> Result<AllottedForecast, ShotError> {
        let even = (counts.range().2.round() as u32).max(1);
        let (work, cpu_seconds) = self.pilot.cost(&self.pilot.view, even)?;
        let (double_work, double_seconds) = self.pilot.cost(&self.pilot.view, 2 * even)?;
        let evenly = vec![f64::from(even); self.zones.len()];
        let more = ratio(cost(&self.zones, &self.means(counts)), cost(&self.zones, &evenly)) - 1.0;
        Ok(AllottedForecast {
            work: moved(&work, more * (double_work.mean - work.mean)),
            cpu_seconds: moved(&cpu_seconds, more * (double_seconds.mean - cpu_seconds.mean)),
            profiling_work: self.pilot.overhead.work,
            profiling_cpu_seconds: seconds(self.pilot.overhead.cpu_nanos),
        })
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

pub(crate) fn quantile(error: &ErrorQuantiles, confidence: Confidence) -> f64 {
    match confidence {
        Confidence::P50 => error.p50,
        Confidence::P80 => error.p80,
        Confidence::P95 => error.p95,
    }
}

/// 1 if either is 0.
fn ratio(part: f64, whole: f64) -> f64 {
    if part > 0.0 && whole > 0.0 { part / whole } else { 1.0 }
}

fn moved(quantiles: &Quantiles, change: f64) -> Quantiles {
    let factor = ratio((quantiles.mean + change).max(0.0), quantiles.mean);
    let Quantiles { mean, p50, p80, p95 } = *quantiles;
    Quantiles { mean: mean * factor, p50: p50 * factor, p80: p80 * factor, p95: p95 * factor }
}
