//! From a shot to its quote: preview all frames, choose some, profile these, estimate all.
//!
//! On a farm, a preview task is [`count_frames`] and a profile task [`profile_frame`]; the service chooses
//! and estimates. Offline, [`crate::quote`] does all of it.

pub(crate) mod noise;
pub(crate) mod warm_clock;
pub(crate) mod work_classes;

use crate::answers::{Counted, Previewed, StratumInfo};
use crate::error::RenderError;
use crate::frame::OwnFrame;
use crate::profile::noise::{FrameNoise, Zones};
use crate::profile::work_classes::of_frame;
use crate::quote::QuoteOptions;
use crate::render::spent;
use crate::shot::OwnShot;
use forelight_forecast::{Cost, Expansion, Observation, Stratum};
use forelight_preview::{NOTHING, Preview};
use forelight_protocol::{
    ByClass, CacheMode, FixedCosts, LeftOut, MaterialMode, PlanCount, PreviewBackend, ProcessCosts,
    RenderSettings, Spent,
};
use forelight_scene::{Frame, MaterialClass};
use forelight_tracer::{Pixel, Profile, RecordCost};
use std::collections::{BTreeMap, BTreeSet};

/// Why a quote cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ShotError {
    /// The renderer failed.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Pixels cannot be chosen.
    #[error(transparent)]
    Forecast(#[from] forelight_forecast::ForecastError),
    /// The quote cannot be computed.
    #[error(transparent)]
    Quote(#[from] forelight_quote::QuoteError),
    /// The caller cancelled.
    #[error("stopped")]
    Cancelled,
}

/// Receives progress, and can cancel.
pub trait Observer: Sync {
    /// `done` of `all` frames have been previewed.
    fn previewed(&self, done: usize, all: usize);
    /// `done` of `all` frames have been profiled.
    fn profiled(&self, done: usize, all: usize);
    /// Whether to stop as soon as possible.
    fn is_cancelled(&self) -> bool;
}

/// The shot's strata for the forecast, the background last.
///
/// Prior costs only steer the first samples. Glass sends out several times the rays of a wall.
pub fn forecast_strata(strata: &[StratumInfo], settings: &RenderSettings) -> Vec<Stratum> {
    const TRANSPARENT: f64 = 3.0;
    const SPECULAR: f64 = 2.0;
    const DIFFUSE: f64 = 1.0;
    const BACKGROUND: f64 = 0.1;
    let prior = |class| match (settings.materials, class) {
        (MaterialMode::Lambert, _) | (_, MaterialClass::Diffuse) => DIFFUSE,
        (_, MaterialClass::Specular) => SPECULAR,
        (_, MaterialClass::Transparent) => TRANSPARENT,
    };
    let known = strata.iter().map(|s| Stratum {
        object: s.object,
        material: s.material,
        prior_cost: prior(s.class),
        apart: false,
    });
    known.chain([Stratum::background(BACKGROUND)]).collect()
}

/// Prior cost of gathering a record, relative to a plain diffuse pixel. `None` without a cache.
pub fn record_prior_cost(settings: &RenderSettings) -> Option<f64> {
    let cost = f64::from(settings.cache_rays) / f64::from(settings.spp);
    (settings.cache == CacheMode::On).then_some(cost)
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
    /// Cost of setting the frame up this time.
    pub setup: Spent,
    /// Estimated work of the whole frame, by class.
    pub work_by_class: Option<ByClass>,
    /// Cost of the frame's preview.
    pub preview: Spent,
    /// Cost of all traced pixels.
    pub pixels: Spent,
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
        self.setup.plus(self.preview).plus(self.pixels).plus(cache)
    }

    /// The part of it that a render cannot reuse. Traced pixels can be reused without an irradiance cache.
    /// With one, its plan and the gathered records of the deepest level can.
    pub fn spent_for_good(&self) -> Spent {
        let again = self.setup.plus(self.preview);
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
    let mut observations = Vec::with_capacity(samples as usize);
    let mut finished = Vec::with_capacity(samples as usize);
    let mut sampled = Vec::with_capacity(samples as usize);
    let mut shown = Vec::with_capacity(samples as usize);
    let stop = || observer.is_cancelled();
    let trace = |pixels: &[u32]| ready.trace_unless(pixels, &stop).ok_or(ShotError::Cancelled);
    let mut observe = |picks: &[forelight_forecast::Pick], observations: &mut Vec<Observation>| {
        let indices: Vec<u32> = picks.iter().map(|pick| pick.pixel).collect();
        for (pick, (pixel, noise)) in picks.iter().zip(trace(&indices)?) {
            observations.push(Observation { stratum: pick.stratum, cost: cost_of(&pixel) });
            finished.push((pick.pixel, pixel));
            sampled.push((pick.pixel, noise));
            shown.push(ids[pick.pixel as usize]);
        }
        Ok::<(), ShotError>(())
    };
    observe(&design.first_phase(), &mut observations)?;
    observe(&design.second_phase(&observations)?, &mut observations)?;
    let warmth = warm_clock::measure(ready, design.counts(), &observations, &finished, &stop)
        .ok_or(ShotError::Cancelled)?;
    for observation in &mut observations {
        let cpu_nanos = &mut observation.cost.cpu_nanos;
        *cpu_nanos = (*cpu_nanos as f64 * warmth.factor).round() as u64;
    }
    let (neighbours, of_neighbours): (Vec<_>, Vec<_>) =
        warmth.pixels.into_iter().map(|(index, (pixel, noise))| ((index, pixel), (index, noise))).unzip();
    finished.extend(neighbours);
    let mut noise = None;
    if ready.has_final_colours() {
        let zones = Zones::new(ready, &seen.preview);
        let taken: BTreeSet<u32> = finished.iter().map(|(pixel, _)| *pixel).collect();
        let edges = zones.edges(observations.len(), &taken);
        for (&index, (pixel, noise)) in edges.iter().zip(trace(&edges)?) {
            finished.push((index, pixel));
            sampled.push((index, noise));
        }
        let scattered = sampled.len();
        sampled.extend(of_neighbours);
        noise = Some(zones.noise(sampled, scattered));
    }
    if stop() {
        return Err(ShotError::Cancelled);
    }
    let records = ready.sample_records(records_to_sample(samples), seed);
    let pixels = finished.iter().fold(Spent::default(), |sum, (_, pixel)| {
        sum.plus(Spent { work: pixel.work, cpu_nanos: pixel.cpu_nanos })
    });
    let profiled = ProfiledFrame {
        frame,
        work_by_class: of_frame(
            ready,
            work_of_pixels(design.counts(), &observations),
            work_of_records(&ready.cache_records(), &records),
        ),
        observations,
        shown,
        expansion: design.expansion().clone(),
        records,
        fixed: ready.fixed(),
        once: ready.once(),
        effects: ready.effects(),
        left_out: ready.left_out(),
        setup: ready.spent_on_setup(),
        preview: seen.spent,
        pixels,
        noise,
        picture: forelight_preview::picture(&seen.preview, ready.frame()),
        scene: ready.frame().clone(),
        profile: ready.profile(&finished),
        traced: finished,
    };
    Ok((profiled, seen))
}

/// Rough work of all pixels, at the mean of the profiled pixels of each stratum, or of all.
fn work_of_pixels(counts: &[u32], observations: &[Observation]) -> f64 {
    let mut seen = vec![(0u64, 0u64); counts.len()];
    for observation in observations {
        let (number, work) = &mut seen[observation.stratum as usize];
        (*number, *work) = (*number + 1, *work + observation.cost.work);
    }
    let (all, work) = seen.iter().fold((0, 0), |sum, each| (sum.0 + each.0, sum.1 + each.1));
    let mean = |(number, work): (u64, u64)| work as f64 / number.max(1) as f64;
    let strata = counts.iter().zip(seen);
    strata.map(|(&count, own)| f64::from(count) * if own.0 > 0 { mean(own) } else { mean((all, work)) }).sum()
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

/// Cost of a pixel, for the forecast.
pub fn cost_of(pixel: &Pixel) -> Cost {
    Cost { work: pixel.work, cpu_nanos: pixel.cpu_nanos, rays: pixel.rays.map(u64::from) }
}

/// Cost of gathering a record, for the forecast.
pub fn cost_of_record(record: &RecordCost) -> Cost {
    cost_of_gather(record.cost, record.rays)
}

/// The same, from cost and rays by kind.
pub fn cost_of_gather(cost: forelight_tracer::Cost, rays: [u32; 7]) -> Cost {
    Cost { work: cost.work, cpu_nanos: cost.cpu_nanos, rays: rays.map(u64::from) }
}
