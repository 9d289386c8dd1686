//! The irradiance cache of a shot: planned for the views of many frames, filled in parts, given to every frame.
//!
//! Its records are in the world of one frame, the first that it was planned for; what other frames see of this world is covered
//! as well. Where something has moved in another frame, the records whose light it changes are dropped there and planned anew
//! ([`crate::FrameRenderer::share`]). So a frame's image depends on the shot's cache and the frame alone, not on which frames were
//! rendered before it, or where.

use crate::own::AmbientShot;
use crate::profile::{ProfiledFrame, cost_of, records_to_sample};
use crate::quote::QuoteOptions;
use crate::render::{counts, own_records, spent};
use crate::renderer::{RenderError, Renderer};
use forelight_forecast::accuracy::PixelNoise;
use forelight_protocol::{
    ArtifactHash, CACHE_BYTES, CacheFrame, CachePlanResult, CacheSample, ProfileResult, RenderSettings,
    SharedSample, Spent,
};
use forelight_scene::Frame;
use forelight_tracer::{Cache, Cost, Effects, Pixel, RecordCost, Settings};
use std::sync::atomic::{AtomicBool, Ordering};

/// A shot's cache as planned, and what each frame would make of it.
#[derive(Debug, Clone)]
pub struct SharedPlan {
    /// The cache.
    pub cache: Cache,
    /// One entry a frame, in their order.
    pub frames: Vec<CacheFrame>,
    /// What finding all this out took.
    pub spent: Spent,
}

impl SharedPlan {
    /// As it is told to who decides, with the cache kept under the name that `keep` gives its bytes, unless it is larger than one that can be sent
    /// around.
    pub fn result(self, keep: impl FnOnce(Vec<u8>) -> ArtifactHash) -> CachePlanResult {
        let bytes = self.cache.to_bytes();
        let size = bytes.len() as u64;
        CachePlanResult {
            cache: (size <= CACHE_BYTES).then(|| keep(bytes)),
            bytes: size,
            records: counts(self.cache.records()),
            frames: self.frames,
            spent: self.spent,
        }
    }
}

/// Plans a cache for all of these frames, and finds out by planning what each of them needs beyond it; on the current thread pool.
/// `progress` is told how much is done, 0 to 1. `None` if `cancel` was set, if there are no frames, and where there is no use for a cache.
///
/// # Errors
/// If a frame is outside the shot, or a setting out of its range.
pub fn plan_shared(
    renderer: &dyn Renderer,
    frames: &[u32],
    settings: &RenderSettings,
    progress: &dyn Fn(f64),
    cancel: &AtomicBool,
) -> Result<Option<SharedPlan>, RenderError> {
    // Half of it is planning for all, half looking at each, which gets it as a file, as its render will.
    let steps = 2.0 * frames.len().max(1) as f64;
    let planned = renderer.plan_cache(frames, settings, &|done| progress(done as f64 / steps), cancel)?;
    let Some(cache) = planned else { return Ok(None) };
    let bytes = cache.to_bytes();
    let mut plan =
        SharedPlan { spent: spent(cache.totals().plan), frames: Vec::with_capacity(frames.len()), cache };
    for &frame in frames {
        if cancel.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let ready = renderer.frame(frame, settings)?;
        let shared = ready.share(Cache::from_bytes(&bytes)?)?;
        let fixed = ready.fixed();
        let records = ready.cache_records();
        let all: Vec<u64> = records.iter().copied().map(u64::from).collect();
        let own = own_records(&all, &shared);
        plan.spent = plan.spent.plus(ready.spent_on_setup()).plus(fixed.plan);
        plan.frames.push(CacheFrame {
            frame,
            own: counts(own),
            records,
            dropped: shared.dropped.iter().sum(),
            plan: fixed.plan,
            plan_rays: fixed.plan_rays,
        });
        progress((frames.len() + plan.frames.len()) as f64 / steps);
    }
    Ok(Some(plan))
}

/// What a profiled frame costs with the cache of its shot.
#[derive(Debug, Clone)]
pub struct SharedProfile {
    /// Its profiled pixels, in the order of the observations. Times are brought to those in a render as the profile's were.
    pub pixels: Vec<SharedSample>,
    /// Records of the cache that were gathered, some of every level.
    pub records: Vec<CacheSample>,
    /// What finding out took.
    pub spent: Spent,
}

impl SharedProfile {
    /// Puts it beside what the frame costs with a cache of its own.
    pub fn add_to(self, result: &mut ProfileResult) {
        result.spent = result.spent.plus(self.spent);
        (result.shared_samples, result.shared_cache_samples) = (self.pixels, self.records);
    }
}

/// Measures the pixels of a profiled frame once more, with the cache of its shot, which need not be filled for that, and gathers a few of that
/// cache's records: half as many as the profile did, for all profiled frames have the same ones.
///
/// # Errors
/// If the cache belongs to another scene or other settings.
pub fn profile_shared(
    renderer: &dyn Renderer,
    profiled: &ProfiledFrame,
    settings: &RenderSettings,
    options: &QuoteOptions,
    cache: Cache,
) -> Result<SharedProfile, RenderError> {
    let ready = renderer.frame(profiled.frame, settings)?;
    let shared = ready.share(cache)?;
    // The pixels after the observed ones were traced for their time alone.
    let observed = profiled.traced.iter().zip(&profiled.observations);
    let (measured, warm) =
        observed.clone().fold((0u64, 0u64), |(measured, warm), ((_, pixel), observation)| {
            (measured + pixel.cpu_nanos, warm + observation.cost.cpu_nanos)
        });
    let warmth = if measured > 0 { warm as f64 / measured as f64 } else { 1.0 };
    let indices: Vec<u32> = observed.map(|((index, _), _)| *index).collect();
    let mut spent = ready.spent_on_setup().plus(ready.fixed().plan);
    let sample = |(pixel, _): (Pixel, PixelNoise)| {
        let cost = cost_of(&pixel);
        spent = spent.plus(Spent { work: cost.work, cpu_nanos: cost.cpu_nanos });
        let cpu_nanos = (cost.cpu_nanos as f64 * warmth).round() as u64;
        SharedSample { work: cost.work, extra_work: pixel.extra_work, cpu_nanos, rays: cost.rays }
    };
    let pixels = ready.trace(&indices).into_iter().map(sample).collect();
    let gathered = ready.sample_records(records_to_sample(options.samples / 2), options.seed);
    let taken_over = |level: u32| shared.kept.get(level as usize).copied().unwrap_or(0);
    let sample = |record: &RecordCost| CacheSample {
        own: record.index as u64 >= taken_over(record.level),
        ..cache_sample(record)
    };
    let records: Vec<CacheSample> = gathered.iter().map(sample).collect();
    let spent = records
        .iter()
        .fold(spent, |sum, record| sum.plus(Spent { work: record.work, cpu_nanos: record.cpu_nanos }));
    Ok(SharedProfile { pixels, records, spent })
}

/// A record that was gathered, in the words of the wire.
pub(crate) fn cache_sample(record: &RecordCost) -> CacheSample {
    let Cost { work, cpu_nanos } = record.cost;
    CacheSample { level: record.level, own: false, work, cpu_nanos, rays: record.rays.map(u64::from) }
}

/// A cache with a part of it filled.
#[derive(Debug, Clone)]
pub struct Filled {
    /// The cache.
    pub cache: Cache,
    /// Records that were filled just now.
    pub filled: u64,
    /// What gathering these took.
    pub spent: Spent,
}

/// As [`Renderer::fill_cache`], with what it took.
///
/// # Errors
/// If the cache belongs to another scene or other settings.
pub fn fill_part(
    renderer: &dyn Renderer,
    cache: Cache,
    settings: &RenderSettings,
    part: (u32, u32),
    progress: &(dyn Fn(u64, u64) + Sync),
    cancel: &AtomicBool,
) -> Result<Option<Filled>, RenderError> {
    let before = cache.totals();
    let Some(cache) = renderer.fill_cache(cache, settings, part, progress, cancel)? else { return Ok(None) };
    let after = cache.totals();
    let cost = Cost {
        work: after.fill.work.saturating_sub(before.fill.work),
        cpu_nanos: after.fill.cpu_nanos.saturating_sub(before.fill.cpu_nanos),
    };
    Ok(Some(Filled { cache, filled: after.filled.saturating_sub(before.filled), spent: spent(cost) }))
}

impl AmbientShot {
    /// Plans a cache for all of these frames, on the current thread pool: in their order, which the records depend on. `progress` is told
    /// the frames done. `None` if `cancel` was set, if there are no frames, and where the settings or the scene have no use for a
    /// cache.
    ///
    /// # Errors
    /// If a frame is outside the shot, or a setting out of its range.
    pub fn plan_cache(
        &self,
        frames: &[u32],
        settings: &RenderSettings,
        progress: &dyn Fn(u64),
        cancel: &AtomicBool,
    ) -> Result<Option<Cache>, RenderError> {
        let settings = Settings::from(settings);
        let mut world: Option<Frame> = None;
        let mut planned: Option<Cache> = None;
        for (&frame, done) in frames.iter().zip(1..) {
            let seen = match &world {
                Some(world) => self.view_of(frame, world)?,
                None => self.frame_of(frame, &settings)?,
            };
            let tracer = self.tracer(&seen, &settings).tracer;
            // A frame in which no light gets anywhere but straight needs no records.
            if tracer.effects().has(Effects::CACHE) {
                let world = world.get_or_insert(seen);
                if let Some(cache) = planned {
                    if cache.suits(&tracer) {
                        tracer.take_cache(cache)?;
                    } else {
                        // Other lights reach what this frame sees of the same world.
                        let from = self.tracer(world, &settings).tracer;
                        tracer.take_cache(cache.carried(&from, &tracer).0)?;
                    }
                }
                tracer.plan();
                planned = tracer.into_cache();
            }
            progress(done);
            if cancel.load(Ordering::Relaxed) {
                return Ok(None);
            }
        }
        Ok(planned)
    }

    /// Fills one of `parts` equal parts of a shot's cache, counted from 0, on the current thread pool: of its deepest level that is not
    /// full, since the others read it; of all levels, if there is but one part. `progress` is told the records done, and all records
    /// of the level. `None` if `cancel` was set.
    ///
    /// # Errors
    /// If the cache belongs to another scene or other settings.
    pub fn fill_cache(
        &self,
        cache: Cache,
        settings: &RenderSettings,
        (part, parts): (u32, u32),
        progress: &(dyn Fn(u64, u64) + Sync),
        cancel: &AtomicBool,
    ) -> Result<Option<Cache>, RenderError> {
        let settings = Settings::from(settings);
        let tracer = self.tracer(&self.frame_of(cache.frame(), &settings)?, &settings).tracer;
        let cache = tracer.hold_cache(cache)?;
        for (level, count) in cache.records().into_iter().enumerate().rev() {
            if cache.is_full(level) {
                continue;
            }
            let cut = |at: u32| (count * u64::from(at) / u64::from(parts)) as usize;
            if !cache.fill(&tracer, level, cut(part)..cut(part + 1), &|done| progress(done, count), cancel) {
                return Ok(None);
            }
            if parts > 1 {
                break;
            }
        }
        Ok(tracer.into_cache())
    }
}
