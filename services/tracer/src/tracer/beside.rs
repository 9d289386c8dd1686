//! What is traced beside an image: what its pixels show, and other random samples of them.

use super::Tracer;
use crate::cost::{Cost, Counters, clocked};
use crate::pixel::{Feature, Pixel};
use crate::random::hash;
use rayon::prelude::*;

impl Tracer {
    /// What the first `samples` camera samples of every pixel show, on average, in row-major order, and the
    /// cost. Uses the current thread pool. `None` if `stop` returned `true`.
    pub fn features(&self, samples: u32, stop: &(dyn Fn() -> bool + Sync)) -> Option<(Vec<Feature>, Cost)> {
        let row = |y: u32| {
            if stop() {
                return None;
            }
            let width = self.settings.width;
            let mut counters = Counters::default();
            let mut trace = |x| self.kernel.feature(self, y * width + x, samples, &mut counters);
            let (features, cpu_nanos) = clocked(|| (0..width).map(&mut trace).collect::<Vec<Feature>>());
            Some((features, Cost { work: counters.work(), cpu_nanos }))
        };
        let rows = (0..self.settings.height).into_par_iter().map(row).collect::<Option<Vec<_>>>()?;
        let cost = rows.iter().fold(Cost::default(), |sum, (_, cost)| sum + *cost);
        Some((rows.into_iter().flat_map(|(features, _)| features).collect(), cost))
    }

    /// Traces pixels several times, `samples` camera samples each time, by random numbers that are
    /// independent of each other and of the image. Returns the pixels of each index, and the cost. Uses the
    /// current thread pool. Any cache must be filled. `None` if `stop` returned `true`.
    pub fn independent_pixels(
        &self,
        pixels: &[u32],
        (times, samples): (u32, u32),
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<(Vec<Vec<Pixel>>, Cost)> {
        let seed = |time: u32| hash(hash(self.settings.seed) ^ u64::from(time));
        let again = |&index: &u32| {
            let traced = |time| self.kernel.again(self, index, seed(time), samples);
            (!stop()).then(|| clocked(|| (0..times).map(traced).collect::<Vec<Pixel>>()))
        };
        let traced = pixels.par_iter().map(again).collect::<Option<Vec<_>>>()?;
        let (pixels, nanos): (Vec<_>, Vec<u64>) = traced.into_iter().unzip();
        let work = pixels.iter().flatten().map(|pixel: &Pixel| pixel.work).sum();
        Some((pixels, Cost { work, cpu_nanos: nanos.into_iter().sum() }))
    }
}
