//! Distributes the camera samples of a frame with a time limit or an error target.
//!
//! Some pixels are profiled with a few camera samples (see `accuracy::pilot`). For each stratum, and for the
//! edges of lights, they show the cost of a sample and how variance falls with samples. That gives the forecast
//! and, with a time limit, the first pass. Later passes follow the image, which shows where on a wall the bright
//! spot is ([`crate::adaptive::tiles`]). An irradiance cache is filled first, since the time left depends on it.

use crate::accuracy::{AccuracyObserver, Pilot, piloted};
use crate::adaptive::allotment::Allotment;
use crate::adaptive::error_target::ErrorAim;
use crate::adaptive::made::{AllotError, Allotted};
use crate::adaptive::passes::{PassPlan, render_in_passes};
use crate::adaptive::time_limit::{Budget, fits_the_cache, render_within};
use crate::answers::Progress;
use crate::error::{RenderError, ShotError};
use crate::quote_options::QuoteOptions;
use crate::render::{Given, render_ready};
use crate::shot::OwnShot;
use forelight_forecast::ForecastError;
use forelight_protocol::{Confidence, RenderSettings};
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
    let AllotOptions { samples, seed, .. } = *options;
    let picked = QuoteOptions { samples, seed, scans: true, ..QuoteOptions::default() };
    let pilot = match Pilot::new(shot, &ready, settings.clone(), &picked, observer) {
        Err(ShotError::Cancelled) => return Ok(None),
        pilot => pilot?,
    };
    let allotment = Allotment::new(&pilot)?;
    let (confidence, cancel) = (options.confidence, observer.cancel());
    let made = match &options.aim {
        Aim::Within(budget) => render_within(&ready, &allotment, budget, confidence, progress, cancel)?,
        Aim::Error(wanted) => {
            let plan = PassPlan::for_error(&ready, ErrorAim { wanted: *wanted, confidence })?;
            render_in_passes(&ready, &plan, progress, &|_, _| (), cancel)?
        }
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
