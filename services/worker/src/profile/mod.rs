//! From a shot to its quote: preview all frames, choose some, profile these, estimate all.
//!
//! The service does the same steps spread over workers: a preview task is [`count_frames`], a profile task [`profile_frame`],
//! and choosing and estimating happen in the service. Offline, [`crate::quote`] does all of it.

pub(crate) mod noise;
pub(crate) mod warm_clock;
pub(crate) mod work_classes;

use crate::profile::noise::{FrameNoise, Zones};
use crate::profile::work_classes::of_frame;
use crate::quote::QuoteOptions;
use crate::render::spent;
use crate::renderer::{Counted, FrameRenderer, Previewed, RenderError, Renderer, StratumInfo};
use forelight_forecast::{Cost, Expansion, Observation, Stratum};
use forelight_preview::{NOTHING, Preview};
use forelight_protocol::{
    ByClass, CacheMode, FixedCosts, LeftOut, MaterialMode, PlanCount, PreviewBackend, ProcessCosts,
    RenderSettings, Spent,
};
use forelight_scene::{Frame, MaterialClass};
use forelight_tracer::{Pixel, Profile, RecordCost};
use std::collections::{BTreeMap, BTreeSet};

/// What can go wrong on the way to a quote.
#[derive(Debug, thiserror::Error)]
pub enum ShotError {
    /// The renderer's part.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Pixels cannot be chosen.
    #[error(transparent)]
    Forecast(#[from] forelight_forecast::ForecastError),
    /// There is no quote.
    #[error(transparent)]
    Quote(#[from] forelight_quote::QuoteError),
    /// It was told to stop.
    #[error("stopped")]
    Cancelled,
}

/// Told how far a step is; says whether to go on.
pub trait Observer: Sync {
    /// `done` of `all` frames have been previewed.
    fn previewed(&self, done: usize, all: usize);
    /// `done` of `all` frames have been profiled.
    fn profiled(&self, done: usize, all: usize);
    /// Whether to stop as soon as possible.
    fn is_cancelled(&self) -> bool;
}

/// The shot's strata as the forecast wants them, the background as the last.
///
/// The prior costs only steer where the first samples go: a pixel of glass sends out several times the rays of a wall's pixel, an
/// empty one next to none.
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

/// What gathering a record of the irradiance cache is thought to cost, relative to a plain diffuse pixel; `None` without a cache.
///
/// A ray of a gather and a sample of a pixel both meet a surface that is then lit.
pub fn record_prior_cost(settings: &RenderSettings) -> Option<f64> {
    let cost = f64::from(settings.cache_rays) / f64::from(settings.spp);
    (settings.cache == CacheMode::On).then_some(cost)
}

/// What all frames show, in the order of `frames`.
#[derive(Debug, Clone)]
pub struct CountedFrames {
    /// Per frame, pixels by stratum, the background as the last: one number for each of [`forecast_strata`].
    pub counts: Vec<Vec<u32>>,
    /// Per frame, the records of its irradiance cache by level, as planned; empty without a cache.
    pub cache_records: Vec<Vec<u32>>,
    /// Per frame, what planning that takes; nothing without a cache.
    pub cache_plans: Vec<Option<PlanCount>>,
    /// Per frame, which lights shine, in numbers from 0 by first appearance.
    pub lights: Vec<u32>,
    /// Per frame, how many lights shine.
    pub shining: Vec<u32>,
    /// Per frame, its triangles, seen or not.
    pub triangles: Vec<u64>,
    /// Who counted the last frame.
    pub backend: PreviewBackend,
    /// What it took.
    pub spent: Spent,
}

/// Previews frames for their counts.
pub fn count_frames(
    renderer: &dyn Renderer,
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
            renderer.count(frame, settings)?;
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
    /// Stratum (of those that the strategy distinguishes) and cost of each profiled pixel, in the order of `traced`; the times are those that it would have taken
    /// in a render (see `warm_clock`).
    pub observations: Vec<Observation>,
    /// What each of the observed pixels shows, in the numbers of [`forecast_strata`].
    pub shown: Vec<u32>,
    /// How they stand for all pixels.
    pub expansion: Expansion,
    /// The profiled pixels, then neighbours that were traced for their time.
    pub traced: Vec<(u32, Pixel)>,
    /// The records of the irradiance cache that were gathered, some of every level; none without a cache.
    pub records: Vec<RecordCost>,
    /// What the render can take over: the traced pixels or, with an irradiance cache, its plan and those of the gathered records
    /// that depend on no others.
    pub profile: Profile,
    /// What every render of the frame costs whatever its pixels show; without writing its files, which is for those who write
    /// them to add.
    pub fixed: FixedCosts,
    /// What this process had paid once for the shot.
    pub once: ProcessCosts,
    /// The effects that the frame calls for, by name, sorted.
    pub effects: Vec<String>,
    /// Lights and objects that cannot matter to the frame's image.
    pub left_out: Vec<LeftOut>,
    /// What setting the frame up took this time.
    pub setup: Spent,
    /// What all of the frame's work is thought to be, by class.
    pub work_by_class: Option<ByClass>,
    /// The frame's preview.
    pub preview: Spent,
    /// What was spent on all traced pixels.
    pub pixels: Spent,
    /// What the camera samples of the profiled pixels, and of some at the edges of lights, say of the image's error. With an irradiance
    /// cache nothing, unless it was filled before.
    pub noise: Option<FrameNoise>,
    /// The preview as a picture.
    pub picture: image::RgbImage,
    /// The frame as it was traced.
    pub scene: Frame,
}

impl ProfiledFrame {
    /// Everything that profiling this frame took.
    pub fn spent(&self) -> Spent {
        let gathered = self.records.iter().map(|record| spent(record.cost));
        let cache = gathered.fold(self.fixed.plan, Spent::plus);
        self.setup.plus(self.preview).plus(self.pixels).plus(cache)
    }

    /// The part of it that a render does not get back. Without an irradiance cache the traced pixels are finished pixels. With one
    /// they are not, but the plan is taken over, and of the gathered records those of the deepest level.
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

/// A record is gathered of every level for so many pixels that are profiled, 96 for 256, and this many at least. Records of a level
/// differ by a fifth to a half in cost (standard deviation over mean), more the more bounces they gather, and with two bounces
/// nearly all of a frame's cost is in the first level.
const SAMPLES_PER_RECORD: f64 = 256.0 / 96.0;
const LEAST_RECORDS: usize = 16;

/// How many records of every level are gathered for so many profiled pixels.
pub fn records_to_sample(samples: u32) -> usize {
    ((f64::from(samples) / SAMPLES_PER_RECORD) as usize).max(LEAST_RECORDS)
}

/// What each pixel of a preview shows, in the numbers of [`forecast_strata`]: the background is the last stratum.
pub fn stratum_ids(preview: &Preview) -> Vec<u32> {
    let background = preview.pairs.len() as u32;
    preview.stratum.iter().map(|&s| if s == NOTHING { background } else { s }).collect()
}

/// Profiles the pixels of one frame that the strategy of `options` picks; Snapshot does so in two phases, the first spread by strata,
/// the second where the first found cost and variation. With an irradiance cache also some records of every level. The seed of
/// `options` chooses both; the pixels' own random numbers come from the settings, as in the render.
pub fn profile_frame(
    renderer: &dyn Renderer,
    frame: u32,
    settings: &RenderSettings,
    options: &QuoteOptions,
    observer: &dyn Observer,
) -> Result<ProfiledFrame, ShotError> {
    let ready = renderer.frame(frame, settings)?;
    Ok(profile_ready(&*ready, &renderer.info().strata, settings, options, observer)?.0)
}

/// The same of a frame that was set up before, and what it shows; `shot` are the shot's strata.
pub(crate) fn profile_ready(
    ready: &dyn FrameRenderer,
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

/// Work of all pixels, thought to be in each stratum what was profiled of it on average, and of others what all were: good enough for knowing
/// which part of a frame it is.
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

/// The same of all records, level by level.
fn work_of_records(counts: &[u32], records: &[RecordCost]) -> f64 {
    let of_level = |(level, &count): (usize, &u32)| {
        let own = records.iter().filter(|record| record.level as usize == level);
        let (number, work) = own.fold((0u64, 0), |(n, sum), record| (n + 1, sum + record.cost.work));
        f64::from(count) * work as f64 / number.max(1) as f64
    };
    counts.iter().enumerate().map(of_level).sum()
}

/// What a pixel cost, as the forecast wants it.
pub fn cost_of(pixel: &Pixel) -> Cost {
    Cost { work: pixel.work, cpu_nanos: pixel.cpu_nanos, rays: pixel.rays.map(u64::from) }
}

/// What gathering a record cost, as the forecast wants it.
pub fn cost_of_record(record: &RecordCost) -> Cost {
    cost_of_gather(record.cost, record.rays)
}

/// The same of its parts.
pub fn cost_of_gather(cost: forelight_tracer::Cost, rays: [u32; 7]) -> Cost {
    Cost { work: cost.work, cpu_nanos: cost.cpu_nanos, rays: rays.map(u64::from) }
}
