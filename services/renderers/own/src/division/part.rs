//! The pixels of one part of a frame.

use crate::answers::{Progress, Step};
use crate::error::RenderError;
use crate::frame::OwnFrame;
use forelight_tracer::{Cache, Pixel, PixelsFinished, Profile, clocked};
use std::sync::atomic::{AtomicBool, Ordering};

/// Pixels that one thread traces in sequence, as many as a tile of an image has.
const TOGETHER: usize = 256;

impl OwnFrame<'_> {
    /// Gives the frame the irradiance cache that was planned for it before, with its costs, before anything is
    /// planned. Records of a shared cache are part of it.
    pub fn take_own_cache(&self, cache: Cache) -> Result<(), RenderError> {
        let reading = cache.reading_nanos();
        let (taken, taking) = clocked(|| self.tracer.take_cache(cache));
        taken?;
        self.taking.store(reading + taking, Ordering::Relaxed);
        Ok(())
    }

    /// Whether all that this frame needs is in the shared cache that it was given: nothing was planned for it,
    /// and every record is filled. False without a cache.
    pub fn shared_is_enough(&self) -> bool {
        self.tracer.plan();
        self.tracer.cache().is_some_and(|cache| {
            let own = cache.records().iter().sum::<u64>() - cache.shared().kept.iter().sum::<u64>();
            own == 0 && cache.totals().plan.work == 0 && cache.is_complete()
        })
    }

    /// The irradiance cache as it is, planned if needed. `None` without one.
    pub fn planned_cache(&self) -> Option<&Cache> {
        self.tracer.plan();
        self.tracer.cache()
    }

    /// Renders pixels by index on the current thread pool, and fills the irradiance cache before if it is not
    /// full. `progress` counts pixels of `pixels`. `None` if `cancel` was set.
    pub fn render_pixels(
        &self,
        pixels: &[u32],
        progress: &(dyn Fn(Progress) + Sync),
        finished: &PixelsFinished<'_>,
        cancel: &AtomicBool,
    ) -> Option<Vec<(u32, Pixel)>> {
        if !self.fill(progress, cancel) {
            return None;
        }
        let lists: Vec<Vec<u32>> = pixels.chunks(TOGETHER).map(<[u32]>::to_vec).collect();
        let traced = |done| progress(Progress { step: Step::Tracing, done, all: pixels.len() as u64 });
        Some(self.tracer.trace(&lists, &traced, finished, cancel)?.concat())
    }

    /// A file of finished pixels of this image.
    pub fn finished_pixels(&self, pixels: Vec<(u32, Pixel)>) -> Profile {
        let (origin, fingerprint) = (self.tracer.origin(), self.tracer.fingerprint());
        Profile { origin, fingerprint, pixels, cache: None }
    }
}
