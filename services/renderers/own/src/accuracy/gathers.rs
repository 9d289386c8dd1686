//! Errors of similar settings, estimated on the same pixels.
//!
//! A rung with more gather rays, or with interpolation, has nearly the error of the settings that were asked
//! for. On other pixels, the difference would be lost in sampling noise. So the scattered pixels of the first
//! pilot are traced again with the other settings, from the same camera samples. The ratios that they show
//! scale the drops of all its pixels (two-phase sampling with a ratio estimator: Cochran, *Sampling
//! Techniques*, 3rd edition 1977, section 12.8).

use super::pilot::Pilot;
use crate::accuracy::observer::{AccuracyObserver, traced};
use crate::costs::spent_on;
use crate::error::ShotError;
use crate::frame::OwnFrame;
use crate::profile::noise::FrameNoise;
use crate::shot::OwnShot;
use forelight_forecast::accuracy::{ImageNoise, PixelNoise};
use forelight_forecast::{ForecastError, Stratum};
use forelight_protocol::{RenderSettings, Spent};
use forelight_tracer::Pixel;
use std::ops::RangeInclusive;

/// Least number of pixels that are traced with both settings, however expensive the gathers are.
const LEAST_PIXELS: u32 = 32;

/// The pixels of other gathers may cost at most this many times the rays of the first pilot.
const MOST_TIMES: f64 = 4.0;

/// Or this many rays, which take a few seconds.
const MOST_RAYS: f64 = 2e6;

/// Replaces the noise of a pilot without a cache by the first pilot's noise, scaled.
pub fn relate(
    shot: &OwnShot,
    ready: &OwnFrame<'_>,
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
        // Ratios need the same camera samples. Otherwise a rare sample may be in one part alone.
        let alike = RenderSettings { spp: pilot.settings.spp, ..first.settings.clone() };
        let again = shot.frame(ready.frame().number, &alike)?;
        let with_first = traced(&again, pixels, observer)?;
        pilot.spent = pilot.spent.plus(again.spent_on_setup()).plus(cost(&with_first));
        few.with_scattered(with_first.into_iter().map(|(_, noise)| noise))
    };
    let finer = pilot.settings.ambient_divisions > first.settings.ambient_divisions;
    let bounds = if finer { LESS_NOISY } else { MORE_NOISY };
    pilot.noise = scaled(&pilot.noise_strata, &first.noise, &known, &own, bounds)?;
    Ok(())
}

/// More rays per gather, and interpolation, never add to the variance between camera samples.
pub const LESS_NOISY: RangeInclusive<f64> = 0.0..=1.0;
const MORE_NOISY: RangeInclusive<f64> = 1.0..=f64::MAX;

/// `first`, with its drops scaled by the ratios of `own` to `known` on the same pixels. `known` has the
/// settings of `first`. Ratios outside `bounds` are chance and are clamped. If `known` and `own` have fewer
/// camera samples than `first`, the last ratio holds for all further doublings.
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
    for sample in scaled.samples.iter_mut().chain(&mut scaled.scanned) {
        for (k, drop) in sample.noise.drops.iter_mut().enumerate() {
            *drop *= ratios.get(k).or(ratios.last()).copied().unwrap_or(1.0);
        }
    }
    Ok(scaled)
}

/// How many pixels of other gathers can be traced at about the cost of `count` pixels of the first pilot. At
/// least `least`, or all of them, whatever they cost.
pub fn affordable(count: u32, least: u32, first: &RenderSettings, other: &RenderSettings) -> u32 {
    let times = times_the_rays(first, other);
    let affordable = if times > 1.0 { (f64::from(count) / times) as u32 } else { count };
    affordable.max(least.min(count))
}

pub fn is_too_dear(count: u32, least: u32, first: &RenderSettings, other: &RenderSettings) -> bool {
    let count = count.min(first.width.saturating_mul(first.height));
    let rays = |pixels: u32, settings: &RenderSettings| f64::from(pixels) * gathered_rays(settings);
    rays(least.min(count), other) > f64::max(MOST_TIMES * rays(count, first), MOST_RAYS)
}

/// Rays per pixel with the settings `other`, relative to `first`, without a cache.
pub fn times_the_rays(first: &RenderSettings, other: &RenderSettings) -> f64 {
    gathered_rays(other) / gathered_rays(first)
}

/// Rays per pixel, over all levels. Each level has an eighth of the divisions of the one before.
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

pub fn cost(traced: &[(Pixel, PixelNoise)]) -> Spent {
    traced.iter().map(|(pixel, _)| spent_on(pixel)).sum()
}
