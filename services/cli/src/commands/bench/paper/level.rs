//! The paper's four ambient levels, each a full render with the cost of every pixel.

use crate::failure::Interrupted;
use crate::interrupt::Interrupt;
use crate::local::Local;
use crate::output::{Bars, RenderBar};
use anyhow::Result;
use forelight_forecast::{Cost, Stratum};
use forelight_protocol::{CacheMode, RenderSettings, RenderSettingsRequest};
use forelight_tracer::{Cache, CacheTotals};
use forelight_worker::{
    FrameRenderer, Renderer, cost_of, cost_of_record, forecast_strata, record_prior_cost, records_to_sample,
    stratum_ids,
};
use glam::Vec3;
use image::RgbImage;
use serde::Serialize;

/// How indirect light is simulated (the paper, section 5).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Not at all.
    NoAmbient,
    /// One bounce, gathered by every pixel.
    OneBounce,
    /// One bounce, by way of an irradiance cache.
    OneBounceCached,
    /// Two bounces, by way of an irradiance cache.
    TwoBouncesCached,
}

impl Level {
    /// All of them, in the paper's order.
    pub const ALL: [Level; 4] =
        [Level::NoAmbient, Level::OneBounce, Level::OneBounceCached, Level::TwoBouncesCached];

    /// Its name in a report.
    pub const fn title(self) -> &'static str {
        match self {
            Level::NoAmbient => "no ambient bounce",
            Level::OneBounce => "one ambient bounce, no cache",
            Level::OneBounceCached => "one ambient bounce, with cache",
            Level::TwoBouncesCached => "two ambient bounces, with cache",
        }
    }

    /// Its name in a file's.
    pub const fn slug(self) -> &'static str {
        match self {
            Level::NoAmbient => "none",
            Level::OneBounce => "one",
            Level::OneBounceCached => "one-cached",
            Level::TwoBouncesCached => "two-cached",
        }
    }

    /// Whether indirect light is interpolated.
    pub const fn is_cached(self) -> bool {
        matches!(self, Level::OneBounceCached | Level::TwoBouncesCached)
    }

    fn bounces(self) -> u32 {
        match self {
            Level::NoAmbient => 0,
            Level::OneBounce | Level::OneBounceCached => 1,
            Level::TwoBouncesCached => 2,
        }
    }

    /// One camera ray a pixel, as in the paper. A gather takes the same rays with a cache as without one.
    pub fn settings(self, size: u32, gather_rays: u32) -> RenderSettings {
        let request = RenderSettingsRequest {
            spp: Some(1),
            ambient_bounces: Some(self.bounces()),
            ambient_divisions: Some(gather_rays),
            cache: Some(if self.is_cached() { CacheMode::On } else { CacheMode::Off }),
            cache_rays: self.is_cached().then_some(gather_rays),
            ..RenderSettingsRequest::default()
        };
        request.complete((size, size))
    }
}

/// What the preview says of the frame, which is the same at every level.
#[derive(Debug, Clone)]
pub struct Seen {
    /// The shot's strata.
    pub strata: Vec<Stratum>,
    /// The stratum of every pixel.
    pub ids: Vec<u32>,
    /// What the preview shows of them: where.
    pub positions: Vec<Vec3>,
    /// The ID preview, in the paper's colours.
    pub picture: RgbImage,
}

/// A full render at one level.
#[derive(Debug, Clone)]
pub struct Truth {
    /// The level.
    pub level: Level,
    /// What each pixel cost.
    pub pixels: Vec<Cost>,
    /// What a pixel costs that is profiled as the paper does it, with a cache that is still empty: it gathers for itself, as
    /// without a cache. That is what the level of one bounce without a cache measures. (With two bounces such a pixel would also
    /// begin the second level of the cache; that is left out, in favour of the paper's strategies.)
    pub cold: Vec<Cost>,
    /// What planning the cache took; known when a forecast is made.
    pub plan: Cost,
    /// What gathering all records took.
    pub fill: Cost,
    /// Records by level.
    pub records: Vec<u32>,
    /// What each pixel cost, with the records of the first level at the pixels that show them: for looking at.
    pub drawn: Vec<Cost>,
    /// What a record is thought to cost before any is gathered, in pixels.
    pub record_prior_cost: f64,
    /// By seed, the level and cost of the records that a forecast gathers.
    pub sampled_records: Vec<Vec<(u32, Cost)>>,
    /// The image.
    pub picture: RgbImage,
}

impl Truth {
    /// What the frame cost: pixels, records and their plan.
    pub fn total(&self) -> Cost {
        self.pixels.iter().chain([&self.plan, &self.fill]).fold(Cost::default(), |sum, cost| plus(&sum, cost))
    }
}

fn plus(one: &Cost, other: &Cost) -> Cost {
    Cost {
        work: one.work + other.work,
        cpu_nanos: one.cpu_nanos + other.cpu_nanos,
        rays: std::array::from_fn(|kind| one.rays[kind] + other.rays[kind]),
    }
}

/// A record lies on what its pixel shows if it is no farther from it than this share of its distance from the camera: it was
/// planned for a ray that met the pixel elsewhere than at its centre.
const NEAR: f32 = 0.03;

/// The pixels' costs, and those of the cache's records of the first level at the pixels where they are seen.
fn with_records(pixels: &[Cost], ready: &dyn FrameRenderer, positions: &[Vec3]) -> Result<Vec<Cost>> {
    let mut drawn = pixels.to_vec();
    let Some(bytes) = ready.profile(&[]).cache else { return Ok(drawn) };
    let cache = Cache::from_bytes(&bytes)?;
    let camera = &ready.frame().camera;
    for (index, planned) in cache.planned(0).iter().enumerate() {
        let position = planned.site.position;
        let Some((x, y)) = camera.pixel_of(position) else { continue };
        let pixel = (y * camera.width + x) as usize;
        let Some(record) = cache.record(0, index) else { continue };
        if position.distance(positions[pixel]) < NEAR * position.distance(camera.origin) {
            let gathered = Cost {
                work: record.cost.work,
                cpu_nanos: record.cost.cpu_nanos,
                rays: record.rays.map(u64::from),
            };
            drawn[pixel] = plus(&drawn[pixel], &gathered);
        }
    }
    Ok(drawn)
}

/// What is to be traced.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// The opened bundle.
    pub local: &'a Local,
    /// Frame number.
    pub frame: u32,
    /// Width and height, pixels.
    pub size: u32,
    /// Rays of a gather.
    pub gather_rays: u32,
    /// Pixels that a forecast profiles, which says how many records it gathers.
    pub samples: u32,
    /// Forecasts at each level.
    pub seeds: u32,
}

impl Task<'_> {
    /// Previews the frame and renders it at every level.
    pub fn measure(&self, bars: &Bars, interrupt: &Interrupt) -> Result<(Seen, Vec<Truth>)> {
        let renderer = &self.local.shot;
        let settings = Level::NoAmbient.settings(self.size, self.gather_rays);
        let ready = self.local.pool.install(|| renderer.frame(self.frame, &settings))?;
        let previewed = ready.preview()?;
        let seen = Seen {
            strata: forecast_strata(&renderer.info().strata, &settings),
            ids: stratum_ids(&previewed.preview),
            positions: previewed.preview.position.clone(),
            picture: forelight_preview::picture(&previewed.preview, ready.frame()),
        };
        let mut truths: Vec<Truth> = Vec::with_capacity(Level::ALL.len());
        for level in Level::ALL {
            let uncached = truths.iter().find(|truth| truth.level == Level::OneBounce);
            let cold = uncached.filter(|_| level.is_cached()).map(|truth| truth.pixels.clone());
            truths
                .push(self.local.pool.install(|| self.trace(level, cold, &seen.positions, bars, interrupt))?);
        }
        Ok((seen, truths))
    }

    fn trace(
        &self,
        level: Level,
        cold: Option<Vec<Cost>>,
        positions: &[Vec3],
        bars: &Bars,
        interrupt: &Interrupt,
    ) -> Result<Truth> {
        let settings = level.settings(self.size, self.gather_rays);
        let ready = self.local.shot.frame(self.frame, &settings)?;
        let bar = RenderBar::new(bars);
        let finished = ready.render(None, &|progress| bar.show(progress), interrupt.flag())?;
        drop(bar);
        let finished = finished.ok_or(Interrupted)?;
        let cache = finished.cache.map(|cache| cache.all).unwrap_or_default();
        let CacheTotals { plan, plan_rays, fill, fill_rays, ref records, .. } = cache;
        let pixels: Vec<Cost> = finished.image.pixels.iter().map(cost_of).collect();
        Ok(Truth {
            level,
            cold: cold.unwrap_or_else(|| pixels.clone()),
            drawn: with_records(&pixels, &*ready, positions)?,
            pixels,
            plan: Cost { work: plan.work, cpu_nanos: plan.cpu_nanos, rays: plan_rays },
            fill: Cost { work: fill.work, cpu_nanos: fill.cpu_nanos, rays: fill_rays },
            // There are fewer than the plan's rays, of which a frame cannot have 2³².
            records: records.iter().map(|&count| u32::try_from(count).unwrap_or(u32::MAX)).collect(),
            record_prior_cost: record_prior_cost(&settings).unwrap_or(1.0),
            sampled_records: (0..self.seeds.into())
                .map(|seed| self.sample_records(&*ready, seed, interrupt))
                .collect::<Result<_>>()?,
            picture: finished.image.picture(),
        })
    }

    fn sample_records(
        &self,
        ready: &dyn FrameRenderer,
        seed: u64,
        interrupt: &Interrupt,
    ) -> Result<Vec<(u32, Cost)>> {
        if interrupt.is_set() {
            return Err(Interrupted.into());
        }
        let records = ready.sample_records(records_to_sample(self.samples), seed);
        Ok(records.iter().map(|record| (record.level, cost_of_record(record))).collect())
    }
}
