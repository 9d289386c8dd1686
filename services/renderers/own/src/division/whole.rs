//! The image of a divided frame, put together from the pixels of its parts.

use crate::answers::{Finished, Progress, Step};
use crate::error::RenderError;
use crate::frame::OwnFrame;
use forelight_tracer::{Pixel, PixelsFinished, Profile};
use std::sync::atomic::AtomicBool;

impl OwnFrame<'_> {
    /// Puts the image together from finished pixels, in rows from the top, on the current thread pool. Those
    /// that are `None` are traced. Pixels and records of the frame's profile count as taken over, as in a
    /// render in one piece; those of parts do not. `None` if `cancel` was set.
    pub fn put_together(
        &self,
        mut finished: Vec<Option<Pixel>>,
        profile: Option<&Profile>,
        progress: &(dyn Fn(Progress) + Sync),
        watch: &PixelsFinished<'_>,
        cancel: &AtomicBool,
    ) -> Result<Option<Finished>, RenderError> {
        let taken_over = self.totals_of_profiled_cache(profile)?;
        let mut reused = vec![false; finished.len()];
        if let Some(profile) = profile {
            for (index, pixel) in &profile.pixels {
                finished[*index as usize] = Some(*pixel);
                reused[*index as usize] = true;
            }
        }
        let all = finished.len() as u64;
        if finished.iter().any(Option::is_none) && !self.fill(progress, cancel) {
            return Ok(None);
        }
        let traced = |done| progress(Progress { step: Step::Tracing, done, all });
        let image = self.tracer.render_rest(finished, &traced, watch, cancel);
        Ok(image.map(|image| {
            let image = forelight_tracer::Image { reused, ..image };
            Finished { image, cache: self.cache_use(taken_over) }
        }))
    }
}
