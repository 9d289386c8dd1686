//! What is traced beside an image: what its pixels show, and other random samples of them.

use super::Tracer;
use crate::cost::{Cost, clocked};
use crate::pixel::{Feature, Pixel};
use crate::random::hash;
use rayon::prelude::*;

/// Pixels whose features one thread traces before it looks whether to stop.
const FEATURES_AT_ONCE: usize = 256;

impl Tracer {
    /// What the first `samples` camera samples of every pixel show, on average, in row-major order, and the
    /// CPU time in nanoseconds. Uses the current thread pool. `None` if `stop` returned `true`.
    pub fn features(&self, samples: u32, stop: &(dyn Fn() -> bool + Sync)) -> Option<(Vec<Feature>, u64)> {
        let all: Vec<u32> = (0..self.settings.width * self.settings.height).collect();
        self.features_of(&all, samples, stop)
    }

    /// The same for some pixels by their indices.
    pub fn features_of(
        &self,
        pixels: &[u32],
        samples: u32,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<(Vec<Feature>, u64)> {
        let shown = |&index: &u32| self.kernel.feature(self, index, samples);
        let batch = |pixels: &[u32]| {
            (!stop()).then(|| clocked(|| pixels.iter().map(shown).collect::<Vec<Feature>>()))
        };
        let batches = pixels.par_chunks(FEATURES_AT_ONCE).map(batch).collect::<Option<Vec<_>>>()?;
        let (features, nanos): (Vec<_>, Vec<u64>) = batches.into_iter().unzip();
        Some((features.concat(), nanos.into_iter().sum()))
    }

    /// Traces pixels several times, `samples` camera samples each time, by random numbers that are
    /// independent of each other and of the image. Returns the pixels of each index, and the cost. Uses the
    /// current thread pool. Any cache must be filled. `None` if `stop` returned `true`.
    pub fn independent_pixels(
        &self,
        pixels: &[u32],
        times: (u32, u32),
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<(Vec<Vec<Pixel>>, Cost)> {
        self.pixels_by(self.settings.seed, pixels, times, stop)
    }

    /// The same by random numbers that follow from `seed`, whatever the settings' is. So images that differ in
    /// their caches have the same camera samples.
    pub fn pixels_by(
        &self,
        seed: u64,
        pixels: &[u32],
        (times, samples): (u32, u32),
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<(Vec<Vec<Pixel>>, Cost)> {
        let of_time = |time: u32| hash(hash(seed) ^ u64::from(time));
        let again = |&index: &u32| {
            let traced = |time| self.kernel.again(self, index, of_time(time), samples);
            (!stop()).then(|| clocked(|| (0..times).map(traced).collect::<Vec<Pixel>>()))
        };
        let traced = pixels.par_iter().map(again).collect::<Option<Vec<_>>>()?;
        let (pixels, nanos): (Vec<_>, Vec<u64>) = traced.into_iter().unzip();
        let work = pixels.iter().flatten().map(|pixel: &Pixel| pixel.work).sum();
        Some((pixels, Cost { work, cpu_nanos: nanos.into_iter().sum() }))
    }
}
