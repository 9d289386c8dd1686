//! From a shot to its quote: preview all frames, choose some, profile these, estimate all.
//!
//! On a farm, a preview task is [`count_frames`] and a profile task [`profile_frame`]; the service chooses
//! and estimates. Offline, [`crate::quote()`] does all of it.

pub(crate) mod noise;
mod scan;
pub(crate) mod strata;
pub(crate) mod warm_clock;
pub(crate) mod work_classes;

use crate::answers::{Counted, Previewed, StratumInfo};
use crate::costs::{cost_of, spent, spent_on};
use crate::error::ShotError;
use crate::frame::OwnFrame;
use crate::profile::noise::{FrameNoise, Zones};
use crate::profile::scan::scan;
use crate::profile::strata::forecast_strata;
use crate::profile::work_classes::of_frame;
use crate::quote_options::QuoteOptions;
use crate::render::denoised::forecast_nanos;
use crate::shot::OwnShot;
use forelight_forecast::accuracy::PixelNoise;
use forelight_forecast::{Cost, Expansion, Observation, Pick};
use forelight_preview::{NOTHING, Preview};
use forelight_protocol::{
    ByClass, FixedCosts, LeftOut, PlanCount, PreviewBackend, ProcessCosts, RenderSettings, Spent,
};
use forelight_scene::Frame;
use forelight_tracer::{Pixel, Profile, RecordCost};
use std::collections::{BTreeMap, BTreeSet};

/// Receives progress, and can cancel.
pub trait Observer: Sync {
    /// `done` of `all` frames have been previewed.
    fn previewed(&self, done: usize, all: usize);
    /// `done` of `all` frames have been profiled.
    fn profiled(&self, done: usize, all: usize);
    /// Whether to stop as soon as possible.
    fn is_cancelled(&self) -> bool;
}

/// Counts of all frames, in the order of `frames`.
#[derive(Debug, Clone)]
pub struct CountedFrames {
    /// Per frame, pixels by stratum of [`forecast_strata`], the background last.
    pub counts: Vec<Vec<u32>>,
    /// Per frame, planned records of its irradiance cache by level. Empty without a cache.
    pub cache_records: Vec<Vec<u32>>,
    /// Per frame, the cost of that plan. `None` without a cache.
    pub cache_plans: Vec<Option<PlanCount>>,
    /// Per frame, which set of lights shines, numbered from 0 by first appearance.
    pub lights: Vec<u32>,
    /// Per frame, how many lights shine.
    pub shining: Vec<u32>,
    /// Per frame, its triangles, seen or not.
    pub triangles: Vec<u64>,
    /// The previewer that counted the last frame.
    pub backend: PreviewBackend,
    /// Cost of counting.
    pub spent: Spent,
}

/// Previews frames for their counts.
pub fn count_frames(
    shot: &OwnShot,
    frames: &[u32],
    settings: &RenderSettings,
    observer: &dyn Observer,
) -> Result<CountedFrames, ShotError> {
    let mut all = CountedFrames {
        counts: Vec::with_capacity(frames.len()),
        cache_records: Vec::with_capacity(frames.len()),
        cache_plans: Vec::with_capacity(frames.len()),
        lights: Vec::with_capacity(frames.len()),
        shining: Vec::with_capacity(frames.len()),
        triangles: Vec::with_capacity(frames.len()),
        backend: PreviewBackend::Cpu,
        spent: Spent::default(),
    };
    let mut lit: BTreeMap<Vec<bool>, u32> = BTreeMap::new();
    for (index, &frame) in frames.iter().enumerate() {
        if observer.is_cancelled() {
            return Err(ShotError::Cancelled);
        }
        let Counted { counts, cache_records, cache_plan, shining, triangles, backend, spent } =
            shot.count(frame, settings)?;
        let mut pixels = counts.per_stratum;
        pixels.push(counts.background);
        all.counts.push(pixels);
        all.cache_records.push(cache_records);
        all.cache_plans.push(cache_plan);
        all.triangles.push(triangles);
        let next = lit.len() as u32;
        all.shining.push(shining.iter().filter(|&&shines| shines).count() as u32);
        all.lights.push(*lit.entry(shining).or_insert(next));
        all.backend = backend;
        all.spent = all.spent.plus(spent);
        observer.previewed(index + 1, frames.len());
    }
    Ok(all)
}

/// A profiled frame.
#[derive(Debug, Clone)]
pub struct ProfiledFrame {
    /// Frame number.
    pub frame: u32,
    /// Stratum and cost of each profiled pixel, in the order of `traced`. Times are as in a render.
    pub observations: Vec<Observation>,
    /// Stratum of [`forecast_strata`] that each observed pixel shows.
    pub shown: Vec<u32>,
    /// How the observations represent all pixels.
    pub expansion: Expansion,
    /// The profiled pixels, then neighbours that were traced for their time.
    pub traced: Vec<(u32, Pixel)>,
    /// Sampled records of every level of the irradiance cache. Empty without a cache.
    pub records: Vec<RecordCost>,
    /// Traced pixels or, with an irradiance cache, its plan and the gathered records of the deepest level.
    pub profile: Profile,
    /// Costs of every render of the frame that do not depend on its pixels, without writing its files.
    pub fixed: FixedCosts,
    /// What this process had paid once for the shot.
    pub once: ProcessCosts,
    /// Effects of the frame by name, sorted.
    pub effects: Vec<String>,
    /// Lights and objects that cannot matter to the image.
    pub left_out: Vec<LeftOut>,
    /// Cost of setting the frame up this time, and of what denoising it would take.
    pub setup: Spent,
    /// Estimated work of the whole frame, by class.
    pub work_by_class: Option<ByClass>,
    /// Cost of the frame's preview.
    pub preview: Spent,
    /// Cost of all traced pixels.
    pub pixels: Spent,
    /// Cost of the scanned pixels.
    pub scan: Spent,
    /// Noise of profiled pixels and edges of lights. `None` with an irradiance cache that was not filled.
    pub noise: Option<FrameNoise>,
    /// The preview as a picture.
    pub picture: image::RgbImage,
    /// The frame as it was traced.
    pub scene: Frame,
}

impl ProfiledFrame {
    /// Cost of profiling this frame.
    pub fn spent(&self) -> Spent {
        let gathered = self.records.iter().map(|record| spent(record.cost));
        let cache = gathered.fold(self.fixed.plan, Spent::plus);
        self.setup.plus(self.preview).plus(self.pixels).plus(self.scan).plus(cache)
    }

    /// The part of it that sampled records of the deepest level cost. It was spent before if the cache was
    /// filled.
    pub fn spent_on_deepest_records(&self) -> Spent {
        let deepest = self.records.iter().map(|record| record.level).max();
        let records = self.records.iter().filter(|record| Some(record.level) == deepest);
        records.fold(Spent::default(), |sum, record| sum.plus(spent(record.cost)))
    }

    /// The part of it that a render cannot reuse. Traced pixels can be reused without an irradiance cache.
    /// With one, its plan and the gathered records of the deepest level can.
    pub fn spent_for_good(&self) -> Spent {
        let again = self.setup.plus(self.preview).plus(self.scan);
        if self.profile.cache.is_none() {
            return again;
        }
        let deepest = self.records.iter().map(|record| record.level).max();
        let gathered = self.records.iter().filter(|record| Some(record.level) < deepest);
        gathered.fold(again.plus(self.pixels), |sum, record| sum.plus(spent(record.cost)))
    }
}

/// Profiled pixels per sampled record of each level, at least [`LEAST_RECORDS`] records: 96 for 256 pixels.
/// Costs of a level's records vary by a fifth to a half (standard deviation over mean). With two bounces,
/// nearly all of a frame's cost is in the first level.
const SAMPLES_PER_RECORD: f64 = 256.0 / 96.0;
const LEAST_RECORDS: usize = 16;

/// Records to sample of every level.
pub fn records_to_sample(samples: u32) -> usize {
    ((f64::from(samples) / SAMPLES_PER_RECORD) as usize).max(LEAST_RECORDS)
}

/// Stratum of [`forecast_strata`] that each pixel of a preview shows.
pub fn stratum_ids(preview: &Preview) -> Vec<u32> {
    let background = preview.pairs.len() as u32;
    preview.stratum.iter().map(|&s| if s == NOTHING { background } else { s }).collect()
}

/// Profiles pixels of one frame, and records of every level of an irradiance cache. Snapshot has two phases:
/// the first spreads pixels by strata, the second goes where the first found cost and variation. The seed of
/// `options` chooses pixels and records. Random numbers of the pixels are those of the render.
pub fn profile_frame(
    shot: &OwnShot,
    frame: u32,
    settings: &RenderSettings,
    options: &QuoteOptions,
    observer: &dyn Observer,
) -> Result<ProfiledFrame, ShotError> {
    let ready = shot.frame(frame, settings)?;
    Ok(profile_ready(&ready, &shot.info().strata, settings, options, observer)?.0)
}

/// Pixels traced so far.
#[derive(Default)]
struct Traced {
    observations: Vec<Observation>,
    /// Of each observation, the stratum that its pixel shows.
    shown: Vec<u32>,
    /// Observed pixels first, then others, which give times and noise alone.
    pixels: Vec<(u32, Pixel)>,
    noise: Vec<(u32, PixelNoise)>,
}

impl Traced {
    /// Traces chosen pixels. `ids` holds the stratum that each pixel of the image shows.
    fn observe(&mut self, picks: &[Pick], ids: &[u32], trace: &Trace<'_>) -> Result<(), ShotError> {
        let indices: Vec<u32> = picks.iter().map(|pick| pick.pixel).collect();
        for (pick, (pixel, noise)) in picks.iter().zip(trace(&indices)?) {
            self.observations.push(Observation { stratum: pick.stratum, cost: cost_of(&pixel) });
            self.shown.push(ids[pick.pixel as usize]);
            self.pixels.push((pick.pixel, pixel));
            self.noise.push((pick.pixel, noise));
        }
        Ok(())
    }

    /// Brings CPU times to those of a render, see [`warm_clock`]. Returns the noise of the neighbours that this
    /// traced. `None` if `stop` was set.
    fn warm_clock(
        &mut self,
        ready: &OwnFrame<'_>,
        counts: &[u32],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<(u32, PixelNoise)>> {
        let warmth = warm_clock::measure(ready, counts, &self.observations, &self.pixels, stop)?;
        for observation in &mut self.observations {
            let cpu_nanos = &mut observation.cost.cpu_nanos;
            *cpu_nanos = (*cpu_nanos as f64 * warmth.factor).round() as u64;
        }
        let (pixels, noise): (Vec<_>, Vec<_>) =
            warmth.pixels.into_iter().map(|(index, (pixel, noise))| ((index, pixel), (index, noise))).unzip();
        self.pixels.extend(pixels);
        Some(noise)
    }

    /// Traces pixels at the edges of lights, for their noise.
    fn observe_edges(&mut self, zones: &Zones, trace: &Trace<'_>) -> Result<(), ShotError> {
        let taken: BTreeSet<u32> = self.pixels.iter().map(|(pixel, _)| *pixel).collect();
        let edges = zones.edges(self.observations.len(), &taken);
        for (&index, (pixel, noise)) in edges.iter().zip(trace(&edges)?) {
            self.pixels.push((index, pixel));
            self.noise.push((index, noise));
        }
        Ok(())
    }
}

/// Traces pixels by their indices.
type Trace<'a> = dyn Fn(&[u32]) -> Result<Vec<(Pixel, PixelNoise)>, ShotError> + 'a;

/// The same for a frame that is set up, with its preview. `shot` holds the shot's strata.
pub(crate) fn profile_ready(
    ready: &OwnFrame<'_>,
    shot: &[StratumInfo],
    settings: &RenderSettings,
    options: &QuoteOptions,
    observer: &dyn Observer,
) -> Result<(ProfiledFrame, Previewed), ShotError> {
    let &QuoteOptions { samples, seed, strategy, .. } = options;
    let frame = ready.frame().number;
    let seen = ready.preview()?;
    let strata = forecast_strata(shot, settings);
    let ids = stratum_ids(&seen.preview);
    let design = strategy.design(&strata, &ids, settings.width, samples, seed, i64::from(frame))?;
    let stop = || observer.is_cancelled();
    let trace = |pixels: &[u32]| ready.trace_unless(pixels, &stop).ok_or(ShotError::Cancelled);
    let mut traced = Traced::default();
    traced.observe(&design.first_phase(), &ids, &trace)?;
    traced.observe(&design.second_phase(&traced.observations)?, &ids, &trace)?;
    let neighbours = traced.warm_clock(ready, design.counts(), &stop).ok_or(ShotError::Cancelled)?;
    let (mut noise, mut scan_cost) = (None, Spent::default());
    if ready.has_final_colours() {
        let zones = Zones::new(ready, &seen.preview);
        traced.observe_edges(&zones, &trace)?;
        let scattered = traced.noise.len();
        traced.noise.extend(neighbours);
        let mut scanned = Vec::new();
        if options.scans {
            (scanned, scan_cost) =
                scan(ready, traced.noise.len(), seed, &stop).ok_or(ShotError::Cancelled)?;
        }
        noise = Some(zones.noise(traced.noise, scattered, scanned));
    }
    if stop() {
        return Err(ShotError::Cancelled);
    }
    let records = ready.sample_records(records_to_sample(samples), seed);
    let pixels = traced.pixels.iter().map(|(_, pixel)| spent_on(pixel)).sum();
    let mut fixed = ready.fixed();
    let mut setup = ready.spent_on_setup();
    if let Some(nanos_per_pixel) = options.denoiser_nanos_per_pixel {
        let observed: Vec<u32> = traced.pixels.iter().map(|(pixel, _)| *pixel).collect();
        let nanos = of_all_pixels(design.counts(), &traced.observations, |cost| cost.cpu_nanos);
        let forecast = forecast_nanos(ready, &observed, nanos, nanos_per_pixel, &stop);
        let (cpu_nanos, asking) = forecast.ok_or(ShotError::Cancelled)?;
        fixed.denoise = Spent { work: 0, cpu_nanos };
        setup.cpu_nanos += asking;
    }
    let profiled = ProfiledFrame {
        frame,
        work_by_class: of_frame(
            ready,
            of_all_pixels(design.counts(), &traced.observations, |cost| cost.work),
            work_of_records(&ready.cache_records(), &records),
        ),
        observations: traced.observations,
        shown: traced.shown,
        expansion: design.expansion().clone(),
        records,
        fixed,
        once: ready.once(),
        effects: ready.effects(),
        left_out: ready.left_out(),
        setup,
        preview: seen.spent,
        pixels,
        scan: scan_cost,
        noise,
        picture: forelight_preview::picture(&seen.preview, ready.frame()),
        scene: ready.frame().clone(),
        profile: ready.profile(&traced.pixels),
        traced: traced.pixels,
    };
    Ok((profiled, seen))
}

/// Rough cost of all pixels, at the mean of the profiled pixels of each stratum, or of all.
fn of_all_pixels(counts: &[u32], observations: &[Observation], of: fn(Cost) -> u64) -> f64 {
    let mut seen = vec![(0u64, 0u64); counts.len()];
    for observation in observations {
        let (number, cost) = &mut seen[observation.stratum as usize];
        (*number, *cost) = (*number + 1, *cost + of(observation.cost));
    }
    let (all, cost) = seen.iter().fold((0, 0), |sum, each| (sum.0 + each.0, sum.1 + each.1));
    let mean = |(number, cost): (u64, u64)| cost as f64 / number.max(1) as f64;
    let strata = counts.iter().zip(seen);
    strata.map(|(&count, own)| f64::from(count) * if own.0 > 0 { mean(own) } else { mean((all, cost)) }).sum()
}

/// The same for records, by level.
fn work_of_records(counts: &[u32], records: &[RecordCost]) -> f64 {
    let of_level = |(level, &count): (usize, &u32)| {
        let own = records.iter().filter(|record| record.level as usize == level);
        let (number, work) = own.fold((0u64, 0), |(n, sum), record| (n + 1, sum + record.cost.work));
        f64::from(count) * work as f64 / number.max(1) as f64
    };
    counts.iter().enumerate().map(of_level).sum()
}
