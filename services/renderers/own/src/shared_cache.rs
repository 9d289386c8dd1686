//! The shared cache of a shot: planned for the views of many frames, filled in parts, given to every frame.
//!
//! Its records lie in the world of the first frame that it was planned for, and cover what other frames see
//! of it. Records whose light has changed in another frame are dropped there and planned anew
//! ([`crate::OwnFrame::share`]). A frame's image depends on the shared cache and the frame alone.

use crate::costs::{cost_of, counts, own_records, spent, spent_on};
use crate::error::RenderError;
use crate::profile::{ProfiledFrame, records_to_sample};
use crate::quote_options::QuoteOptions;
use crate::shot::OwnShot;
use forelight_forecast::accuracy::PixelNoise;
use forelight_protocol::{
    ArtifactHash, CACHE_BYTES, CacheFrame, CachePlanResult, CacheSample, ProfileResult, RenderSettings,
    SharedSample, Spent,
};
use forelight_scene::Frame;
use forelight_tracer::{Cache, Cost, Effects, Pixel, RecordCost, Settings};
use std::sync::atomic::{AtomicBool, Ordering};

/// A planned shared cache, and its use in each frame.
#[derive(Debug, Clone)]
pub struct SharedPlan {
    /// The cache.
    pub cache: Cache,
    /// One entry per frame, in order.
    pub frames: Vec<CacheFrame>,
    /// Cost of planning.
    pub spent: Spent,
}

impl SharedPlan {
    /// The task's result. `keep` stores a cache that is small enough to be sent, and returns its name.
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

/// Plans a cache for these frames and what each needs beyond it, on the current thread pool. `progress` goes
/// from 0 to 1. `None` if `cancel` was set, without frames, and if no cache is needed.
///
/// # Errors
/// If a frame is outside the shot, or a setting out of its range.
pub fn plan_shared(
    shot: &OwnShot,
    frames: &[u32],
    settings: &RenderSettings,
    progress: &dyn Fn(f64),
    cancel: &AtomicBool,
) -> Result<Option<SharedPlan>, RenderError> {
    // Half is planning. The rest counts each frame, which reads the cache from a file as its render will.
    let steps = 2.0 * frames.len().max(1) as f64;
    let planned = shot.plan_cache(frames, settings, &|done| progress(done as f64 / steps), cancel)?;
    let Some(cache) = planned else { return Ok(None) };
    let bytes = cache.to_bytes();
    let mut plan =
        SharedPlan { spent: spent(cache.totals().plan), frames: Vec::with_capacity(frames.len()), cache };
    for &frame in frames {
        if cancel.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let ready = shot.frame(frame, settings)?;
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

/// Costs of a profiled frame with the shared cache.
#[derive(Debug, Clone)]
pub struct SharedProfile {
    /// Its profiled pixels, in the order of the observations. Times are as in a render.
    pub pixels: Vec<SharedSample>,
    /// Sampled records of every level of the cache.
    pub records: Vec<CacheSample>,
    /// Cost of measuring.
    pub spent: Spent,
}

impl SharedProfile {
    /// Adds this to the profile of the frame with its own cache.
    pub fn add_to(self, result: &mut ProfileResult) {
        result.spent = result.spent.plus(self.spent);
        (result.shared_samples, result.shared_cache_samples) = (self.pixels, self.records);
    }
}

/// Measures a profiled frame's pixels again with the shared cache, which need not be filled. Also gathers
/// half as many records as the profile did, since all profiled frames share them.
///
/// # Errors
/// If the cache belongs to another scene or other settings.
pub fn profile_shared(
    shot: &OwnShot,
    profiled: &ProfiledFrame,
    settings: &RenderSettings,
    options: &QuoteOptions,
    cache: Cache,
) -> Result<SharedProfile, RenderError> {
    let ready = shot.frame(profiled.frame, settings)?;
    let shared = ready.share(cache)?;
    // Pixels after the observed ones were traced for their time only.
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
        spent = spent.plus(spent_on(&pixel));
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

/// A gathered record, as protocol data.
pub(crate) fn cache_sample(record: &RecordCost) -> CacheSample {
    let Cost { work, cpu_nanos } = record.cost;
    CacheSample { level: record.level, own: false, work, cpu_nanos, rays: record.rays.map(u64::from) }
}

/// A partly filled cache.
#[derive(Debug, Clone)]
pub struct Filled {
    /// The cache.
    pub cache: Cache,
    /// Records that were filled by this call.
    pub filled: u64,
    /// Their cost.
    pub spent: Spent,
}

/// As [`OwnShot::fill_cache`], with its cost.
///
/// # Errors
/// If the cache belongs to another scene or other settings.
pub fn fill_part(
    shot: &OwnShot,
    cache: Cache,
    settings: &RenderSettings,
    part: (u32, u32),
    progress: &(dyn Fn(u64, u64) + Sync),
    cancel: &AtomicBool,
) -> Result<Option<Filled>, RenderError> {
    let before = cache.totals();
    let Some(cache) = shot.fill_cache(cache, settings, part, progress, cancel)? else { return Ok(None) };
    let after = cache.totals();
    let cost = Cost {
        work: after.fill.work.saturating_sub(before.fill.work),
        cpu_nanos: after.fill.cpu_nanos.saturating_sub(before.fill.cpu_nanos),
    };
    Ok(Some(Filled { cache, filled: after.filled.saturating_sub(before.filled), spent: spent(cost) }))
}

impl OwnShot {
    /// Plans a cache for these frames, in order, on the current thread pool. `progress` receives the frames
    /// done. `None` if `cancel` was set or no cache is needed.
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
            // A frame without indirect light needs no records.
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

    /// Fills one of `parts` equal parts, from 0, of what is missing in the deepest level that is not full, since
    /// the others read it. Fills all levels if there is one part. `progress` receives the level's missing
    /// records: done, and all.
    /// `None` if `cancel` was set.
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
        for level in (0..cache.records().len()).rev() {
            let unfilled = cache.unfilled(level);
            if unfilled.is_empty() {
                continue;
            }
            let count = unfilled.len() as u64;
            let cut = |at: u32| (count * u64::from(at) / u64::from(parts)) as usize;
            let records = &unfilled[cut(part)..cut(part + 1)];
            if !cache.fill(&tracer, level, records, &|done| progress(done, count), cancel) {
                return Ok(None);
            }
            if parts > 1 {
                break;
            }
        }
        Ok(tracer.into_cache())
    }
}
