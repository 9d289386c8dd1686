//! The irradiance cache of a shot: planned for the views of many frames, filled in parts, given to every frame.
//!
//! Its records are in the world of one frame, the first that it was planned for; what other frames see of this world is covered
//! as well. Where something has moved in another frame, the records whose light it changes are dropped there and planned anew
//! ([`crate::FrameRenderer::share`]). So a frame's image depends on the shot's cache and the frame alone, not on which frames were
//! rendered before it, or where.

use crate::ambient::{AmbientShot, tracer_settings};
use crate::renderer::RenderError;
use forelight_protocol::RenderSettings;
use forelight_tracer::Cache;
use std::sync::atomic::{AtomicBool, Ordering};

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
        let settings = tracer_settings(settings);
        let Some(&first) = frames.first() else { return Ok(None) };
        let world = self.frame_of(first, &settings)?;
        let mut planned: Option<Cache> = None;
        for (&frame, done) in frames.iter().zip(1..) {
            let tracer = self.tracer(&self.view_of(frame, &world)?, &settings).tracer;
            if let Some(cache) = planned {
                if cache.suits(&tracer) {
                    tracer.take_cache(cache)?;
                } else {
                    // Other lights reach what this frame sees of the same world.
                    let from = self.tracer(&world, &settings).tracer;
                    tracer.take_cache(cache.carried(&from, &tracer).0)?;
                }
            }
            tracer.plan();
            planned = tracer.into_cache();
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
        let settings = tracer_settings(settings);
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
