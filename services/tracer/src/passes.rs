//! An image in passes: every pixel goes on from the sample at which the pass before left it.
//!
//! Nothing of a pass is traced again in the next one, and nothing depends on where one pass ends and the next begins: a pixel's samples are
//! added up in f64 in the order of their indices, and its random sequences go on where they were. So a pixel that got 3 samples, and 5 later on,
//! has the bits of one that got 8 at once. What has to be kept for that is small: how far each random sequence that the pixel uses was
//! drawn, 8 bytes for each, and what the sum was at fewer samples, which says how it settles. It comes to about 150 bytes a pixel of the
//! `ambient` integrator and several hundred of `path`.

use crate::image::{Image, Totals};
use crate::random::Drawn;
use crate::samples::{SampleCounts, SampleCountsError};
use crate::tiling::Tiling;
use crate::tracer::{Pixel, TILE, Tracer, share_cpu_time};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Samples of a pixel after which it is asked whether to stop: a few milliseconds.
const RUN: u32 = 32;

/// A pixel that can be given more samples.
#[derive(Debug, Clone)]
pub(crate) struct Underway {
    /// How far its random sequences are drawn.
    pub drawn: Drawn,
    /// Radiance of its samples, added up in their order.
    pub sum: DVec3,
    /// Squares of that, mean over the channels, the same way.
    pub squares: f64,
    pub samples: u32,
    /// The sum when the number of samples was a power of two, the last two times.
    pub before: [(u32, DVec3); 2],
    /// What its samples took; the colour is not known before [`Self::finished`].
    pub pixel: Pixel,
}

impl Default for Underway {
    fn default() -> Self {
        let pixel = Pixel {
            color: [0.0; 3],
            rays: [0; 7],
            work: 0,
            work_by_ray: [0; 7],
            extra_work: 0,
            cpu_nanos: 0,
            uncovered: 0,
            stratum: Pixel::NOTHING,
        };
        let before = [(0, DVec3::ZERO); 2];
        Self { drawn: Drawn::default(), sum: DVec3::ZERO, squares: 0.0, samples: 0, before, pixel }
    }
}

impl Underway {
    /// Adds the radiance of one more sample.
    pub fn add(&mut self, sample: Vec3) {
        self.sum += sample.as_dvec3();
        self.samples += 1;
        if self.samples.is_power_of_two() {
            self.before = [self.before[1], (self.samples, self.sum)];
        }
    }

    /// The pixel with the samples that it has; of none it is black.
    pub fn finished(&self) -> Pixel {
        let color = (self.sum / f64::from(self.samples.max(1))).as_vec3().to_array();
        Pixel { color, ..self.pixel }
    }

    fn so_far(&self) -> SoFar {
        let samples = f64::from(self.samples);
        let mean = self.sum / samples.max(1.0);
        let square = mean.length_squared() / 3.0;
        let (before, sum) = self.before[0];
        let grown = (before > 0)
            .then(|| Grown { before, square: (mean - sum / f64::from(before)).length_squared() / 3.0 });
        SoFar {
            samples: self.samples,
            brightness: mean.element_sum() / 3.0,
            variance: (self.samples > 1)
                .then(|| ((self.squares - samples * square) / (samples - 1.0)).max(0.0)),
            work: self.pixel.work,
            grown,
        }
    }
}

/// What the samples of a pixel say so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoFar {
    /// How many they are.
    pub samples: u32,
    /// Their mean over the three channels.
    pub brightness: f64,
    /// Variance of one sample, mean over the channels; not known of a single one.
    pub variance: Option<f64>,
    /// What they took.
    pub work: u64,
    /// What the later half of its samples changed, or somewhat more than half; not known of one sample.
    pub grown: Option<Grown>,
}

/// What more samples did to a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grown {
    /// How many there were before.
    pub before: u32,
    /// Square of the change of their mean, mean over the channels.
    pub square: f64,
}

/// All pixels of an image, underway. They belong to the tracer that they are begun with, whose cache has to be filled.
#[derive(Debug)]
pub struct Passes {
    width: u32,
    height: u32,
    tiles: Vec<Tile>,
    /// What all passes took.
    totals: Totals,
}

/// Pixels that one thread works off one after the other.
#[derive(Debug)]
struct Tile {
    indices: Vec<u32>,
    pixels: Vec<Underway>,
}

impl Passes {
    /// No sample of any pixel.
    pub fn new(tracer: &Tracer) -> Self {
        let (width, height) = (tracer.settings().width, tracer.settings().height);
        let tiling = Tiling::new(width, height, TILE);
        let tile = |number: u32| {
            let indices = tiling.pixels(number);
            Tile { pixels: vec![Underway::default(); indices.len()], indices }
        };
        // Scattered, so that what a pass does not come to any more lies all over the image.
        let tiles = scattered(tiling.count()).map(tile).collect();
        Self { width, height, tiles, totals: Totals::default() }
    }

    /// Brings every pixel to the number of samples that `wanted` has for it, on the current thread pool, and says what that took. Pixels that have as many keep theirs.
    /// Before each pixel, and now and then within it, `stop` is asked whether to leave it, and all others, as they are. `progress` is told the pixels done.
    ///
    /// # Errors
    /// If the numbers are not those of this image's pixels.
    pub fn go_on(
        &mut self,
        tracer: &Tracer,
        wanted: &SampleCounts,
        stop: &(dyn Fn() -> bool + Sync),
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Totals, SampleCountsError> {
        let wanted = wanted.for_pixels((self.width * self.height) as usize)?;
        tracer.plan();
        let done = AtomicU64::new(0);
        let of_tile = |tile: &mut Tile| {
            share_cpu_time(|| {
                let mut traced = Vec::new();
                for (&index, pixel) in tile.indices.iter().zip(&mut tile.pixels) {
                    let samples = u32::from(wanted[index as usize]);
                    if samples <= pixel.samples {
                        continue;
                    }
                    if stop() {
                        break;
                    }
                    let nanos = pixel.pixel.cpu_nanos;
                    let mut squares = pixel.squares;
                    let mut add = |sample: [f32; 3]| {
                        squares += sample.map(|c| f64::from(c) * f64::from(c)).iter().sum::<f64>() / 3.0;
                    };
                    while pixel.samples < samples {
                        let next = samples.min(pixel.samples + RUN);
                        tracer.kernel.go_on(tracer, index, pixel, next, &mut add);
                        if next < samples && stop() {
                            break;
                        }
                    }
                    pixel.squares = squares;
                    traced.push((nanos, &mut pixel.pixel.cpu_nanos));
                }
                traced
            });
            let pixels = tile.indices.len() as u64;
            progress(done.fetch_add(pixels, Ordering::Relaxed) + pixels);
            Totals::of(tile.pixels.iter().map(|underway| &underway.pixel))
        };
        let totals = self.tiles.par_iter_mut().map(of_tile).reduce(Totals::default, Totals::plus);
        let before = std::mem::replace(&mut self.totals, totals);
        Ok(totals.minus(&before))
    }

    /// How often [`Self::go_on`] calls `progress`.
    pub fn parts(&self) -> usize {
        self.tiles.len()
    }

    /// Samples that each pixel has got.
    ///
    /// # Errors
    /// If one of them has none.
    pub fn counts(&self) -> Result<SampleCounts, SampleCountsError> {
        let mut counts = vec![0; (self.width * self.height) as usize];
        for (index, pixel) in self.pixels() {
            // No more were ever wanted than this type holds.
            counts[index as usize] = pixel.samples as u16;
        }
        SampleCounts::new(counts)
    }

    /// What the samples of every pixel say so far, row by row from the top left.
    pub fn so_far(&self) -> Vec<SoFar> {
        let mut all = vec![Underway::default().so_far(); (self.width * self.height) as usize];
        for (index, pixel) in self.pixels() {
            all[index as usize] = pixel.so_far();
        }
        all
    }

    /// What all passes took.
    pub const fn totals(&self) -> Totals {
        self.totals
    }

    /// The image, as far as it has come.
    pub fn image(&self) -> Image {
        let mut pixels = vec![Underway::default().pixel; (self.width * self.height) as usize];
        for (index, underway) in self.pixels() {
            pixels[index as usize] = underway.finished();
        }
        Image { width: self.width, height: self.height, reused: vec![false; pixels.len()], pixels }
    }

    fn pixels(&self) -> impl Iterator<Item = (u32, &Underway)> {
        self.tiles.iter().flat_map(|tile| tile.indices.iter().copied().zip(&tile.pixels))
    }
}

/// The numbers below `count`, each once, neighbours far apart: by their reversed bits.
fn scattered(count: u32) -> impl Iterator<Item = u32> {
    let bits = count.next_power_of_two().trailing_zeros();
    (0..1u64 << bits)
        .map(move |i| if bits == 0 { 0 } else { (i as u32).reverse_bits() >> (32 - bits) })
        .filter(move |&i| i < count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scattered_numbers_are_all_numbers_once() {
        for count in [1, 2, 7, 24, 64] {
            let mut all: Vec<u32> = scattered(count).collect();
            all.sort_unstable();
            assert!(all.iter().copied().eq(0..count), "{all:?}");
        }
        assert_eq!(scattered(8).collect::<Vec<_>>(), [0, 4, 2, 6, 1, 5, 3, 7]);
    }
}
