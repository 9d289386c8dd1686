//! Errors of settings that are close to others, by the same pixels with both.
//!
//! A rung that gathers with more rays, or interpolates, errs as the settings that were asked for do, a little less or more. Seen on pixels of
//! its own, that little would be lost in the chance of which pixels these are: rare samples that meet a lamp make most of an
//! image's error. So the scattered pixels of the first pilot are traced with the other settings too, from the same camera samples,
//! and the drops of all of its pixels scaled by the ratios that these show (two-phase sampling with a ratio estimator: Cochran,
//! *Sampling Techniques*, 3rd edition 1977, section 12.8).

use super::pilot::Pilot;
use super::{AccuracyObserver, traced};
use crate::profile::ShotError;
use crate::profile::noise::FrameNoise;
use crate::renderer::{FrameRenderer, Renderer};
use forelight_forecast::accuracy::{ImageNoise, PixelNoise};
use forelight_forecast::{ForecastError, Stratum};
use forelight_protocol::{RenderSettings, Spent};
use forelight_tracer::Pixel;
use std::ops::RangeInclusive;

/// So many pixels at least are traced with both settings, of gathers however large.
const LEAST_PIXELS: u32 = 32;

/// The fewest pixels of other gathers may have so many times the rays of the first pilot.
const MOST_TIMES: f64 = 4.0;

/// Or so many rays, which take a few seconds.
const MOST_RAYS: f64 = 2e6;

/// Replaces what a pilot without a cache says of the error by what the first one says, scaled.
pub fn relate(
    renderer: &dyn Renderer,
    ready: &dyn FrameRenderer,
    first: &Pilot,
    pilot: &mut Pilot,
    observer: &dyn AccuracyObserver,
) -> Result<(), ShotError> {
    let most = affordable(first.noise.scattered as u32, LEAST_PIXELS, &first.settings, &pilot.settings);
    let few = first.noise.thinned(most as usize);
    let pixels = few.scattered_pixels();
    let with_own = traced(ready, pixels, observer)?;
    pilot.spent = pilot.spent.plus(cost(&with_own));
    let own = few.with_scattered(with_own.into_iter().map(|(_, noise)| noise));
    let known = if pilot.settings.spp == first.settings.spp {
        few
    } else {
        // Ratios are of the same camera samples, or what some of them met by chance would be in one part alone.
        let alike = RenderSettings { spp: pilot.settings.spp, ..first.settings.clone() };
        let again = renderer.frame(ready.frame().number, &alike)?;
        let with_first = traced(&*again, pixels, observer)?;
        pilot.spent = pilot.spent.plus(again.spent_on_setup()).plus(cost(&with_first));
        few.with_scattered(with_first.into_iter().map(|(_, noise)| noise))
    };
    let finer = pilot.settings.ambient_divisions > first.settings.ambient_divisions;
    let bounds = if finer { LESS_NOISY } else { MORE_NOISY };
    pilot.noise = scaled(&pilot.noise_strata, &first.noise, &known, &own, bounds)?;
    Ok(())
}

/// More rays of a gather, and interpolation of gathers, never add to the variance between camera samples.
pub const LESS_NOISY: RangeInclusive<f64> = 0.0..=1.0;
const MORE_NOISY: RangeInclusive<f64> = 1.0..=f64::MAX;

/// `first` with its drops scaled by the ratios of the image's drops that `own` has to those that `known`, the same settings as `first`,
/// has on the same pixels; ratios that cannot be, which chance has made, are brought within their bounds. Where the two were traced
/// with fewer camera samples than `first`, the last ratio holds for all further doublings.
pub fn scaled(
    strata: &[Stratum],
    first: &FrameNoise,
    known: &FrameNoise,
    own: &FrameNoise,
    bounds: RangeInclusive<f64>,
) -> Result<FrameNoise, ForecastError> {
    let drops = |noise: &FrameNoise| -> Result<Vec<f64>, ForecastError> {
        Ok(ImageNoise::new(noise.cells(strata, &noise.counts)?)?.drops())
    };
    let ratios: Vec<f64> = drops(own)?
        .iter()
        .zip(drops(known)?)
        .map(
            |(own, known)| {
                if known > 0.0 { (own / known).clamp(*bounds.start(), *bounds.end()) } else { 1.0 }
            },
        )
        .collect();
    let mut scaled = first.clone();
    for sample in &mut scaled.samples {
        for (k, drop) in sample.noise.drops.iter_mut().enumerate() {
            *drop *= ratios.get(k).or(ratios.last()).copied().unwrap_or(1.0);
        }
    }
    Ok(scaled)
}

/// How many pixels of other gathers may be traced for about the price of `count` pixels of the first pilot's; `least`, or all, however
/// dear they are.
pub fn affordable(count: u32, least: u32, first: &RenderSettings, other: &RenderSettings) -> u32 {
    let times = times_the_rays(first, other);
    let affordable = if times > 1.0 { (f64::from(count) / times) as u32 } else { count };
    affordable.max(least.min(count))
}

/// Whether even `least` pixels of other gathers are too dear beside `count` of the first pilot's.
pub fn is_too_dear(count: u32, least: u32, first: &RenderSettings, other: &RenderSettings) -> bool {
    let count = count.min(first.width.saturating_mul(first.height));
    let rays = |pixels: u32, settings: &RenderSettings| f64::from(pixels) * gathered_rays(settings);
    rays(least.min(count), other) > f64::max(MOST_TIMES * rays(count, first), MOST_RAYS)
}

/// How many times the rays of a pixel with the first settings one with the others has, without a cache.
pub fn times_the_rays(first: &RenderSettings, other: &RenderSettings) -> f64 {
    gathered_rays(other) / gathered_rays(first)
}

/// Rays that a pixel gathers without a cache, of all levels: every level but the first has an eighth of the rays of the one before.
fn gathered_rays(settings: &RenderSettings) -> f64 {
    let divisions = f64::from(settings.ambient_divisions);
    let mut rays = 1.0;
    let mut of_level = f64::from(settings.spp);
    for level in 0..settings.ambient_bounces {
        of_level *= (divisions / f64::from(1 << (3 * level).min(30))).max(1.0);
        rays += of_level;
    }
    rays
}

/// What tracing took.
pub fn cost(traced: &[(Pixel, PixelNoise)]) -> Spent {
    let spent = |pixel: &Pixel| Spent { work: pixel.work, cpu_nanos: pixel.cpu_nanos };
    traced.iter().map(|(pixel, _)| spent(pixel)).fold(Spent::default(), Spent::plus)
}
