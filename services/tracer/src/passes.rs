//! Images refined in passes: each pass adds camera samples to pixels where the previous pass stopped.
//!
//! The result does not depend on where one pass ends: samples are summed in f64 in the order of their
//! indices, and random sequences continue. So another process may continue them ([`Unfinished`]). For this,
//! each pixel keeps the position of its random sequences (8 bytes each), and its sum at earlier sample
//! counts. That is about 150 bytes per pixel for `ambient` and several hundred for `path`.

use crate::cost::share_cpu_time;
use crate::image::{Image, Totals};
use crate::pixel::Underway;
use crate::samples::{SampleCounts, SampleCountsError};
use crate::settings::Settings;
use crate::tiling::{TILE, Tiling};
use crate::tracer::Tracer;
use crate::unfinished::Unfinished;
use rayon::prelude::*;

/// Number of samples between two checks whether to stop. They take a few milliseconds.
const RUN: u32 = 32;

impl Underway {
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

/// Statistics of a pixel's samples so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoFar {
    /// Number of samples.
    pub samples: u32,
    /// Mean radiance, averaged over the three channels.
    pub brightness: f64,
    /// Variance of one sample, averaged over the channels. `None` for fewer than two samples.
    pub variance: Option<f64>,
    /// Work of the samples.
    pub work: u64,
    /// Change of the mean by the later half of the samples (rounded up). `None` with fewer than two.
    pub grown: Option<Grown>,
}

/// How much additional samples changed a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grown {
    /// Number of samples before.
    pub before: u32,
    /// Squared change of the mean, averaged over the channels.
    pub square: f64,
}

/// An image in progress, or some pixels of one. All calls need the same tracer, whose cache must be filled.
#[derive(Debug)]
pub struct Passes {
    width: u32,
    height: u32,
    tiles: Vec<Tile>,
    /// For each pixel of the image, its tile and its place there. [`NOWHERE`] for pixels that are not among
    /// these.
    places: Vec<[u32; 2]>,
    /// Cost of all passes.
    totals: Totals,
}

const NOWHERE: [u32; 2] = [u32::MAX; 2];

/// Pixels that one thread processes in sequence.
#[derive(Debug)]
struct Tile {
    indices: Vec<u32>,
    pixels: Vec<Underway>,
}

impl Tile {
    fn new(indices: Vec<u32>) -> Self {
        Self { pixels: vec![Underway::default(); indices.len()], indices }
    }

    fn totals(&self) -> Totals {
        Totals::of(self.pixels.iter().map(|underway| &underway.pixel))
    }
}

/// Pixels that a pass has brought to their numbers of samples.
#[derive(Debug)]
pub struct Advanced<'a> {
    tile: &'a Tile,
    /// Cost of the samples that this pass added to them.
    pub cost: Totals,
}

impl Advanced<'_> {
    /// Adds the pixels to a file of the same image.
    pub fn add_to(&self, file: &mut Unfinished) {
        file.pixels.extend(self.tile.indices.iter().copied().zip(self.tile.pixels.iter().cloned()));
    }
}

impl Passes {
    /// An image without samples.
    pub fn new(tracer: &Tracer) -> Self {
        let Settings { width, height, .. } = *tracer.settings();
        let tiling = Tiling::new(width, height, TILE);
        // Tiles are scattered, so that an interrupted pass leaves unfinished tiles all over the image.
        let tiles = scattered(tiling.count()).map(|number| Tile::new(tiling.pixels(number)));
        Self::with(width, height, tiles.collect())
    }

    /// Some pixels of an image, by their indices, without samples.
    pub fn of(tracer: &Tracer, pixels: &[u32]) -> Self {
        let Settings { width, height, .. } = *tracer.settings();
        let tiles = pixels.chunks((TILE * TILE) as usize).map(|indices| Tile::new(indices.to_vec()));
        Self::with(width, height, tiles.collect())
    }

    fn with(width: u32, height: u32, tiles: Vec<Tile>) -> Self {
        let mut places = vec![NOWHERE; (width * height) as usize];
        for (number, tile) in (0..).zip(&tiles) {
            for (&index, place) in tile.indices.iter().zip(0..) {
                places[index as usize] = [number, place];
            }
        }
        Self { width, height, tiles, places, totals: Totals::default() }
    }

    /// Takes over the samples of files of this image, as far as these are its pixels: of pixels that have
    /// more there, but not more than `most`. Stops at the first file that is an error.
    pub fn take_over<E>(
        &mut self,
        files: impl IntoIterator<Item = Result<Unfinished, E>>,
        most: Option<&SampleCounts>,
    ) -> Result<(), E> {
        for file in files {
            for (index, pixel) in file?.pixels {
                let [tile, place] = self.places[index as usize];
                let Some(tile) = self.tiles.get_mut(tile as usize) else { continue };
                let known = &mut tile.pixels[place as usize];
                // Nothing is taken over if there are too few numbers: `go_on` refuses them.
                let of_pixel =
                    |most: &SampleCounts| most.as_slice().get(index as usize).map_or(0, |&n| n.into());
                let most: u32 = most.map_or(u32::MAX, of_pixel);
                if (known.samples + 1..=most).contains(&pixel.samples) {
                    *known = pixel;
                }
            }
        }
        self.totals = self.tiles.iter().map(Tile::totals).fold(Totals::default(), Totals::plus);
        Ok(())
    }

    /// The pixels with their samples so far, for another task.
    pub fn unfinished(&self, tracer: &Tracer) -> Unfinished {
        let pixels = self.pixels().map(|(index, pixel)| (index, pixel.clone())).collect();
        Unfinished { origin: tracer.origin(), fingerprint: tracer.fingerprint(), pixels }
    }

    /// Adds samples until every pixel has the number in `wanted`, on the current thread pool. Returns the
    /// cost. `stop` is called before each pixel and every few samples; once `true`, all remaining pixels stay
    /// unchanged. `progress` receives pixels that are done. Fails if `wanted` does not have one number per
    /// pixel of the image.
    pub fn go_on(
        &mut self,
        tracer: &Tracer,
        wanted: &SampleCounts,
        stop: &(dyn Fn() -> bool + Sync),
        progress: &(dyn Fn(&Advanced<'_>) + Sync),
    ) -> Result<Totals, SampleCountsError> {
        let wanted = wanted.for_pixels((self.width * self.height) as usize)?;
        tracer.plan();
        let of_tile = |tile: &mut Tile| {
            let before = tile.totals();
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
            let totals = tile.totals();
            progress(&Advanced { tile, cost: totals.minus(&before) });
            totals
        };
        let totals = self.tiles.par_iter_mut().map(of_tile).reduce(Totals::default, Totals::plus);
        let before = std::mem::replace(&mut self.totals, totals);
        Ok(totals.minus(&before))
    }

    /// Number of times that [`Self::go_on`] calls `progress`.
    pub fn parts(&self) -> usize {
        self.tiles.len()
    }

    /// Number of samples of each pixel. Fails if a pixel has none.
    pub fn counts(&self) -> Result<SampleCounts, SampleCountsError> {
        let mut counts = vec![0; (self.width * self.height) as usize];
        for (index, pixel) in self.pixels() {
            // `wanted` never exceeds the range of this type.
            counts[index as usize] = pixel.samples as u16;
        }
        SampleCounts::new(counts)
    }

    /// Statistics of every pixel's samples so far, in row-major order.
    pub fn so_far(&self) -> Vec<SoFar> {
        let mut all = vec![Underway::default().so_far(); (self.width * self.height) as usize];
        for (index, pixel) in self.pixels() {
            all[index as usize] = pixel.so_far();
        }
        all
    }

    /// Cost of all passes.
    pub const fn totals(&self) -> Totals {
        self.totals
    }

    /// The image with the samples so far.
    pub fn image(&self) -> Image {
        let mut pixels = vec![Underway::default().pixel; (self.width * self.height) as usize];
        for (index, underway) in self.pixels() {
            pixels[index as usize] = underway.finished();
        }
        Image {
            width: self.width,
            height: self.height,
            reused: vec![false; pixels.len()],
            pixels,
            denoised: None,
        }
    }

    fn pixels(&self) -> impl Iterator<Item = (u32, &Underway)> {
        self.tiles.iter().flat_map(|tile| tile.indices.iter().copied().zip(&tile.pixels))
    }
}

/// The numbers below `count`, each once, with neighbours far apart: ordered by their reversed bits.
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
