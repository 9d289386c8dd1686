//! The paper's four ambient levels, each with a full render and the cost of every pixel.

use crate::statistics::upper_median;
use anyhow::Result;
use forelight_forecast::{Cost, Costs, Stratum};
use forelight_protocol::{CacheMode, RenderSettings, RenderSettingsRequest};
use forelight_renderer_own::OwnFrame;
use forelight_renderer_own::{
    cost_of, cost_of_gather, cost_of_record, forecast_strata, record_prior_cost, records_to_sample,
    stratum_ids,
};
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::Local;
use forelight_terminal::output::{Bars, RenderBar};
use forelight_tracer::{Cache, CacheTotals};
use glam::Vec3;
use image::RgbImage;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Numbers of profiled pixels to compare errors at.
pub const LADDER: [u32; 5] = [16, 64, 256, 1024, 4096];

/// How indirect light is simulated (section 5 of the paper).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    NoAmbient,
    /// One bounce, gathered by every pixel.
    OneBounce,
    /// One bounce with an irradiance cache.
    OneBounceCached,
    /// Two bounces with an irradiance cache.
    TwoBouncesCached,
}

impl Level {
    /// All levels, in the paper's order.
    pub const ALL: [Level; 4] =
        [Level::NoAmbient, Level::OneBounce, Level::OneBounceCached, Level::TwoBouncesCached];

    pub const fn title(self) -> &'static str {
        match self {
            Level::NoAmbient => "no ambient bounce",
            Level::OneBounce => "one ambient bounce, no cache",
            Level::OneBounceCached => "one ambient bounce, with cache",
            Level::TwoBouncesCached => "two ambient bounces, with cache",
        }
    }

    /// Name in a file name.
    pub const fn slug(self) -> &'static str {
        match self {
            Level::NoAmbient => "none",
            Level::OneBounce => "one",
            Level::OneBounceCached => "one-cached",
            Level::TwoBouncesCached => "two-cached",
        }
    }

    pub const fn is_cached(self) -> bool {
        matches!(self, Level::OneBounceCached | Level::TwoBouncesCached)
    }

    /// Diffuse bounces.
    pub const fn bounces(self) -> u32 {
        match self {
            Level::NoAmbient => 0,
            Level::OneBounce | Level::OneBounceCached => 1,
            Level::TwoBouncesCached => 2,
        }
    }

    /// One camera ray per pixel, as in the paper. Gathers have the same number of rays with and without a
    /// cache.
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

/// The preview of the frame, equal at all levels.
#[derive(Debug, Clone)]
pub struct Seen {
    pub strata: Vec<Stratum>,
    pub ids: Vec<u32>,
    /// Position that every pixel shows.
    pub positions: Vec<Vec3>,
    /// The ID preview, in the paper's colours.
    pub picture: RgbImage,
}

/// A full render at one level.
#[derive(Debug, Clone)]
pub struct Truth {
    pub level: Level,
    pub pixels: Vec<Cost>,
    /// Cost of every pixel if profiled with an empty cache, as in the paper: see [`cold`].
    pub cold: Vec<Cost>,
    /// Cost of planning the cache. Known when a forecast is made.
    pub plan: Cost,
    /// Cost of gathering all records.
    pub fill: Cost,
    pub records: Vec<u32>,
    /// Visible records of the first level, each with its pixel and cost, for pictures.
    pub seen_records: Vec<(u32, Cost)>,
    /// Prior cost of a record, in pixels.
    pub record_prior_cost: f64,
    /// Level and cost of the records that a forecast gathers, by number of profiled pixels and by seed. Empty
    /// without a cache.
    pub sampled_records: BTreeMap<u32, Vec<Vec<(u32, Cost)>>>,
    pub picture: RgbImage,
}

impl Truth {
    /// Whether the records of its cache can be planned before a profile.
    pub fn has_plan(&self) -> bool {
        !self.level.is_cached() || !self.records.is_empty()
    }

    /// By seed, the records gathered by a forecast with so many profiled pixels.
    pub fn sampled(&self, samples: u32) -> &[Vec<(u32, Cost)>] {
        self.sampled_records.get(&samples).map_or(&[], Vec::as_slice)
    }

    /// Cost of the frame: pixels, records and their plan.
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

/// A record is visible in a pixel if it lies within this share of its camera distance from the pixel's
/// position. Rays of the plan meet pixels away from their centres.
const NEAR: f32 = 0.03;

/// Records of the first level at the pixels that show them.
fn seen_records(ready: &OwnFrame<'_>, positions: &[Vec3]) -> Result<Vec<(u32, Cost)>> {
    let Some(bytes) = ready.profile(&[]).cache else { return Ok(Vec::new()) };
    let cache = Cache::from_bytes(&bytes)?;
    let camera = &ready.frame().camera;
    let mut seen = Vec::new();
    for (index, planned) in cache.planned(0).iter().enumerate() {
        let position = planned.site.position;
        let Some((x, y)) = camera.pixel_of(position) else { continue };
        let pixel = y * camera.width + x;
        let shown = position.distance(positions[pixel as usize]) < NEAR * position.distance(camera.origin);
        if let Some(record) = cache.record(0, index).filter(|_| shown) {
            seen.push((pixel, cost_of_gather(record.cost, record.rays)));
        }
    }
    Ok(seen)
}

/// Cost of every pixel with an empty cache, as the paper profiles it. No record is near, so each pixel
/// gathers for itself.
///
/// With one bounce this is the cost without a cache. With two, gather rays also read the second level, which
/// is cheap once filled. So the cost of the gather is scaled by the cost of first-level records at two
/// bounces over that at one. The cost of starting the second level is left out, in favour of the paper's
/// strategies.
pub fn cold(
    level: Level,
    before: &[Truth],
    samples: u32,
    own_records: &[Vec<(u32, Cost)>],
) -> Option<Vec<Cost>> {
    let at = |level| before.iter().find(|truth| truth.level == level);
    let (none, one) = (at(Level::NoAmbient)?, at(Level::OneBounce)?);
    if level != Level::TwoBouncesCached {
        return level.is_cached().then(|| one.pixels.clone());
    }
    let (once, twice) = (mean_record(at(Level::OneBounceCached)?.sampled(samples)), mean_record(own_records));
    let deeper = |column: fn(&Costs<f64>) -> f64| {
        let ratio = column(&twice) / column(&once);
        if ratio.is_finite() { ratio } else { 1.0 }
    };
    let ratios = [deeper(|c| c.work), deeper(|c| c.cpu_nanos), deeper(|c| c.all_rays)];
    let gathered = |none: u64, one: u64, ratio: f64| {
        none.min(one) + (one.saturating_sub(none) as f64 * ratio).round() as u64
    };
    let pixel = |(none, one): (&Cost, &Cost)| Cost {
        work: gathered(none.work, one.work, ratios[0]),
        cpu_nanos: gathered(none.cpu_nanos, one.cpu_nanos, ratios[1]),
        rays: std::array::from_fn(|kind| gathered(none.rays[kind], one.rays[kind], ratios[2])),
    };
    Some(none.pixels.iter().zip(&one.pixels).map(pixel).collect())
}

/// Mean cost of the sampled records of the first level.
pub fn mean_record(sampled: &[Vec<(u32, Cost)>]) -> Costs<f64> {
    let first: Vec<&Cost> =
        sampled.iter().flatten().filter(|(level, _)| *level == 0).map(|(_, c)| c).collect();
    let mean = |column: &dyn Fn(&Cost) -> f64| {
        first.iter().map(|cost| column(cost)).sum::<f64>() / first.len().max(1) as f64
    };
    Costs {
        work: mean(&|c| c.work as f64),
        cpu_nanos: mean(&|c| c.cpu_nanos as f64),
        all_rays: mean(&|c| c.rays.iter().sum::<u64>() as f64),
        rays: std::array::from_fn(|kind| mean(&|c| c.rays[kind] as f64)),
    }
}

/// What to trace.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    pub local: &'a Local,
    pub frame: u32,
    pub size: u32,
    pub gather_rays: u32,
    /// Pixels that a forecast profiles. They determine the number of records that it gathers.
    pub samples: u32,
    pub seeds: u32,
    /// Renders at each level. The median of their times counts.
    pub repeats: u32,
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
            let truth =
                self.local.pool.install(|| self.trace(level, &truths, &seen.positions, bars, interrupt))?;
            truths.push(truth);
        }
        Ok((seen, truths))
    }

    fn trace(
        &self,
        level: Level,
        before: &[Truth],
        positions: &[Vec3],
        bars: &Bars,
        interrupt: &Interrupt,
    ) -> Result<Truth> {
        let settings = level.settings(self.size, self.gather_rays);
        let ready = self.local.shot.frame(self.frame, &settings)?;
        let render = |ready: &OwnFrame<'_>| -> Result<_> {
            let bar = RenderBar::new(bars);
            let finished = ready.render(None, &|progress| bar.show(progress), &|_| (), interrupt.flag())?;
            let finished = finished.ok_or(Interrupted)?;
            Ok((finished.image, finished.cache.map(|cache| cache.all).unwrap_or_default()))
        };
        let (image, cache) = render(&ready)?;
        let mut pixels: Vec<Cost> = image.pixels.iter().map(cost_of).collect();
        let mut sampled_records = BTreeMap::new();
        let numbers = LADDER.into_iter().chain([self.samples]).filter(|_| level.is_cached());
        for samples in numbers.collect::<BTreeSet<u32>>() {
            let by_seed = (0..self.seeds.into())
                .map(|seed| sample_records(&ready, samples, seed, interrupt))
                .collect::<Result<Vec<_>>>()?;
            sampled_records.insert(samples, by_seed);
        }
        let own_records = sampled_records.get(&self.samples).map_or(&[][..], Vec::as_slice);
        let seen_records = seen_records(&ready, positions)?;
        let CacheTotals { plan, plan_rays, fill, fill_rays, records, .. } = cache;
        let mut times = Times::new(&pixels, &cache_times(plan, fill));
        for _ in 1..self.repeats {
            // Render again for the times. All else is equal to the last bit.
            let (image, cache) = render(&self.local.shot.frame(self.frame, &settings)?)?;
            let again: Vec<Cost> = image.pixels.iter().map(cost_of).collect();
            times.add(&again, &cache_times(cache.plan, cache.fill));
        }
        let [plan_nanos, fill_nanos] = times.into_medians(&mut pixels);
        Ok(Truth {
            level,
            cold: cold(level, before, self.samples, own_records).unwrap_or_else(|| pixels.clone()),
            pixels,
            seen_records,
            plan: Cost { work: plan.work, cpu_nanos: plan_nanos, rays: plan_rays },
            fill: Cost { work: fill.work, cpu_nanos: fill_nanos, rays: fill_rays },
            // There are fewer records than rays of the plan, and those are fewer than 2³².
            records: records.iter().map(|&count| u32::try_from(count).unwrap_or(u32::MAX)).collect(),
            record_prior_cost: record_prior_cost(&settings).unwrap_or(1.0),
            sampled_records,
            picture: image.picture(),
        })
    }
}

fn sample_records(
    ready: &OwnFrame<'_>,
    samples: u32,
    seed: u64,
    interrupt: &Interrupt,
) -> Result<Vec<(u32, Cost)>> {
    if interrupt.is_set() {
        return Err(Interrupted.into());
    }
    let records = ready.sample_records(records_to_sample(samples), seed);
    Ok(records.iter().map(|record| (record.level, cost_of_record(record))).collect())
}

fn cache_times(plan: forelight_tracer::Cost, fill: forelight_tracer::Cost) -> [u64; 2] {
    [plan.cpu_nanos, fill.cpu_nanos]
}

/// Times of several renders of one image. Medians remove moments when the processor was busy elsewhere.
struct Times {
    pixels: Vec<Vec<u64>>,
    cache: [Vec<u64>; 2],
}

impl Times {
    fn new(pixels: &[Cost], cache: &[u64; 2]) -> Self {
        let mut times = Self { pixels: vec![Vec::new(); pixels.len()], cache: Default::default() };
        times.add(pixels, cache);
        times
    }

    fn add(&mut self, pixels: &[Cost], cache: &[u64; 2]) {
        self.pixels.iter_mut().zip(pixels).for_each(|(times, cost)| times.push(cost.cpu_nanos));
        self.cache.iter_mut().zip(cache).for_each(|(times, &nanos)| times.push(nanos));
    }

    /// Gives the pixels their median times, and returns the cache's.
    fn into_medians(self, pixels: &mut [Cost]) -> [u64; 2] {
        let median = |mut nanos: Vec<u64>| {
            nanos.sort_unstable();
            upper_median(&nanos).unwrap_or(0)
        };
        pixels.iter_mut().zip(self.pixels).for_each(|(cost, times)| cost.cpu_nanos = median(times));
        self.cache.map(median)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn costs(works: &[u64]) -> Vec<Cost> {
        works.iter().map(|&work| Cost { work, cpu_nanos: work, rays: [1, work, 0, 0, 0, 0, 0] }).collect()
    }

    fn truth(level: Level, works: &[u64], record: u64) -> Truth {
        Truth {
            level,
            pixels: costs(works),
            cold: costs(works),
            plan: Cost::default(),
            fill: Cost::default(),
            records: Vec::new(),
            seen_records: Vec::new(),
            record_prior_cost: 1.0,
            sampled_records: BTreeMap::from([(
                16,
                vec![vec![(0, costs(&[record])[0]), (1, costs(&[9999])[0])]],
            )]),
            picture: RgbImage::new(1, 1),
        }
    }

    #[test]
    fn into_an_empty_cache_a_pixel_gathers_for_itself() {
        let none = truth(Level::NoAmbient, &[10, 20], 0);
        let one = truth(Level::OneBounce, &[110, 15], 0);
        let cached = truth(Level::OneBounceCached, &[30, 40], 50);
        let before = [none, one, cached];
        assert_eq!(cold(Level::OneBounce, &before[..1], 16, &[]), None);
        assert_eq!(cold(Level::OneBounceCached, &before[..2], 16, &[]), Some(costs(&[110, 15])));
        let twice = truth(Level::TwoBouncesCached, &[], 75);
        let found: Vec<u64> = cold(Level::TwoBouncesCached, &before, 16, twice.sampled(16))
            .expect("costs")
            .iter()
            .map(|c| c.work)
            .collect();
        assert_eq!(found, [10 + 150, 15]);
    }

    #[test]
    fn a_time_is_the_middle_one_of_several() {
        let mut pixels = costs(&[5, 7]);
        let mut times = Times::new(&pixels, &[1, 2]);
        times.add(&costs(&[900, 6]), &[3, 2]);
        times.add(&costs(&[4, 8]), &[2, 90]);
        assert_eq!(times.into_medians(&mut pixels), [2, 2]);
        assert_eq!(pixels.iter().map(|cost| cost.cpu_nanos).collect::<Vec<_>>(), [5, 7]);
    }
}
