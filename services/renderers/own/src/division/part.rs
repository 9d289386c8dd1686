//! The pixels of one part of a frame.

use crate::answers::{Progress, Step};
use crate::error::RenderError;
use crate::frame::OwnFrame;
use forelight_tracer::{Pixel, PixelFileError, PixelsFinished, Profile, Unfinished};
use std::sync::atomic::AtomicBool;

/// Pixels that one thread traces in sequence, as many as a tile of an image has.
const TOGETHER: usize = 256;

impl OwnFrame<'_> {
    /// Renders pixels by index on the current thread pool, and fills the irradiance cache before if it is not
    /// full. No further pixels are begun once `enough` returns true: those returned are the first ones.
    /// `progress` counts pixels of `pixels`. `None` if `cancel` was set.
    pub fn render_pixels(
        &self,
        pixels: &[u32],
        enough: &(dyn Fn() -> bool + Sync),
        progress: &(dyn Fn(Progress) + Sync),
        finished: &PixelsFinished<'_>,
        cancel: &AtomicBool,
    ) -> Option<Vec<(u32, Pixel)>> {
        if !self.fill(progress, cancel) {
            return None;
        }
        let lists: Vec<Vec<u32>> = pixels.chunks(TOGETHER).map(<[u32]>::to_vec).collect();
        let traced = |done| progress(Progress { step: Step::Tracing, done, all: pixels.len() as u64 });
        Some(self.tracer.trace(&lists, enough, &traced, finished, cancel)?.concat())
    }

    /// A file of finished pixels of this image.
    pub fn finished_pixels(&self, pixels: Vec<(u32, Pixel)>) -> Profile {
        let (origin, fingerprint) = (self.tracer.origin(), self.tracer.fingerprint());
        Profile { origin, fingerprint, pixels, cache: None }
    }
}

/// The pixels in the file of a part, finished or not: row-major index and colour.
///
/// # Errors
/// If the file is damaged, or of another version.
pub fn colors_of_part(bytes: &[u8]) -> Result<Vec<(u32, [f32; 3])>, RenderError> {
    match Profile::from_bytes(bytes) {
        Ok(profile) => Ok(profile.pixels.iter().map(|(index, pixel)| (*index, pixel.color)).collect()),
        Err(PixelFileError::Foreign { .. }) => Ok(Unfinished::from_bytes(bytes)?.colors().collect()),
        Err(error) => Err(error.into()),
    }
}
