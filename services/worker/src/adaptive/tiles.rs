//! An image underway, tile by tile: what its own samples say of where more of them pay.

use crate::adaptive::allocation::Allotment;
use crate::profile::ShotError;
use crate::renderer::RenderError;
use forelight_forecast::accuracy::allot::{MOST_SAMPLES, whole};
use forelight_forecast::accuracy::{SampledPixel, Survey};
use forelight_tracer::{Passes, SampleCounts, SoFar, Tiling};

/// Width and height of a tile in pixels: of 64 pixels a few samples each show well enough how they vary, and a bright spot on a wall is wider.
const TILE: u32 = 8;

/// The pixels of a frame by tile, with what the profile says of them.
pub(crate) struct Tiles {
    pixels: Vec<Vec<u32>>,
    /// By pixel: how the variance of those like it falls, see [`SampledPixel::profiled`]; without it they are all thought to be like the image.
    profiled: Option<Vec<[f64; 2]>>,
    count: usize,
}

impl Tiles {
    pub fn new(allotment: &Allotment<'_>) -> Self {
        let (width, height) = allotment.size();
        Self { profiled: Some(allotment.profiled_variance()), ..Self::unprofiled(width, height) }
    }

    /// Of a frame of which no pixels were profiled.
    pub fn unprofiled(width: u32, height: u32) -> Self {
        let tiling = Tiling::new(width, height, TILE);
        let pixels = (0..tiling.count()).map(|tile| tiling.pixels(tile)).collect();
        Self { pixels, profiled: None, count: width as usize * height as usize }
    }

    /// What the samples so far say; every pixel has some.
    pub fn survey(&self, passes: &Passes) -> Result<Survey, ShotError> {
        let so_far = passes.so_far();
        // Nobody knows which of the two laws it is: half of each.
        let half = 0.5 * mean_variance(&so_far);
        let seen = |&pixel: &u32| {
            let profiled = self.profiled.as_ref().map_or([half; 2], |profiled| profiled[pixel as usize]);
            let pixel = so_far[pixel as usize];
            SampledPixel {
                samples: pixel.samples,
                // A pixel that has no colour says nothing.
                brightness: if pixel.brightness.is_finite() { pixel.brightness } else { 0.0 },
                variance: known_variance(&pixel),
                cost: pixel.work as f64,
                profiled,
                grown: pixel.grown.filter(|grown| grown.square.is_finite()).map(|g| (g.before, g.square)),
            }
        };
        let tiles: Vec<Vec<SampledPixel>> =
            self.pixels.iter().map(|tile| tile.iter().map(seen).collect()).collect();
        Ok(Survey::new(&tiles)?)
    }

    /// The samples of each tile, pixel by pixel.
    pub fn laid_out(&self, samples: &[f64]) -> Result<SampleCounts, RenderError> {
        laid_out(self.count, &self.pixels, samples)
    }
}

/// Variance of a sample of a pixel, if its samples say so.
fn known_variance(pixel: &SoFar) -> Option<f64> {
    pixel.variance.filter(|variance| variance.is_finite())
}

/// The mean of that; 0 where it is known of none.
fn mean_variance(pixels: &[SoFar]) -> f64 {
    let (sum, count) = pixels
        .iter()
        .filter_map(known_variance)
        .fold((0.0, 0.0), |(sum, n), of_pixel| (sum + of_pixel, n + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
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
