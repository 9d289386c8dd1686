//! An image underway, tile by tile: what its own samples say of where more of them pay.

use crate::allot::Allotment;
use crate::renderer::RenderError;
use crate::shot::ShotError;
use forelight_forecast::accuracy::allot::{MOST_SAMPLES, whole};
use forelight_forecast::accuracy::{Seen, Survey};
use forelight_tracer::{Passes, SampleCounts, Tiling};

/// Width and height of a tile in pixels: of 64 pixels a few samples each show well enough how they vary, and a bright spot on a wall is wider.
const TILE: u32 = 8;

/// The pixels of a frame by tile, with what the profile says of them.
pub(crate) struct Tiles {
    pixels: Vec<Vec<u32>>,
    /// By pixel: how the variance of those like it falls, see [`Seen::profiled`].
    profiled: Vec<[f64; 2]>,
}

impl Tiles {
    pub fn new(allotment: &Allotment<'_>) -> Self {
        let (width, height) = allotment.size();
        let tiling = Tiling::new(width, height, TILE);
        let pixels = (0..tiling.count()).map(|tile| tiling.pixels(tile)).collect();
        Self { pixels, profiled: allotment.profiled_variance() }
    }

    /// What the samples so far say; every pixel has some.
    pub fn survey(&self, passes: &Passes) -> Result<Survey, ShotError> {
        let so_far = passes.so_far();
        let seen = |&pixel: &u32| {
            let (profiled, pixel) = (self.profiled[pixel as usize], so_far[pixel as usize]);
            Seen {
                samples: pixel.samples,
                // A pixel that has no colour says nothing.
                brightness: if pixel.brightness.is_finite() { pixel.brightness } else { 0.0 },
                variance: pixel.variance.filter(|variance| variance.is_finite()),
                cost: pixel.work as f64,
                profiled,
            }
        };
        let tiles: Vec<Vec<Seen>> = self.pixels.iter().map(|tile| tile.iter().map(seen).collect()).collect();
        Ok(Survey::new(&tiles)?)
    }

    /// The samples of each tile, pixel by pixel.
    pub fn laid_out(&self, samples: &[f64]) -> Result<SampleCounts, RenderError> {
        laid_out(self.profiled.len(), &self.pixels, samples)
    }
}

/// Mean numbers of samples of some sets of pixels, pixel by pixel; one for those in none.
pub(crate) fn laid_out(
    pixels: usize,
    sets: &[Vec<u32>],
    samples: &[f64],
) -> Result<SampleCounts, RenderError> {
    let mut counts = vec![1u16; pixels];
    for (set, &samples) in sets.iter().zip(samples) {
        for (&pixel, n) in set.iter().zip(whole(samples, set.len())) {
            // At most as many as that type holds.
            counts[pixel as usize] = n.min(MOST_SAMPLES as u32) as u16;
        }
    }
    Ok(SampleCounts::new(counts)?)
}
