//! An unfinished image, tile by tile: its own samples show where more of them pay.

use crate::adaptive::allotment::{Allotment, laid_out};
use crate::error::{RenderError, ShotError};
use forelight_forecast::accuracy::{SampledPixel, Survey, Terms};
use forelight_tracer::{Passes, SampleCounts, SoFar, Tiling};

/// Edge of a tile in pixels. The samples of 64 pixels show how they vary; bright spots are wider.
const TILE: u32 = 8;

/// The pixels of a frame by tile, with their noise from the profile.
pub(crate) struct Tiles {
    pixels: Vec<Vec<u32>>,
    /// For each pixel, how the variance of its zone falls with samples, see [`SampledPixel::profiled`].
    /// `None`: all pixels follow the image's curve.
    profiled: Option<Vec<Terms>>,
    count: usize,
}

impl Tiles {
    pub fn new(allotment: &Allotment<'_>) -> Self {
        let (width, height) = allotment.size();
        Self { profiled: Some(allotment.profiled_variance()), ..Self::unprofiled(width, height) }
    }

    /// For a frame without a profile.
    pub fn unprofiled(width: u32, height: u32) -> Self {
        let tiling = Tiling::new(width, height, TILE);
        let pixels = (0..tiling.count()).map(|tile| tiling.pixels(tile)).collect();
        Self { pixels, profiled: None, count: width as usize * height as usize }
    }

    /// Evaluates the samples so far. Every pixel must have one.
    pub fn survey(&self, passes: &Passes) -> Result<Survey, ShotError> {
        let so_far = passes.so_far();
        // Without a profile, which law the variance follows is unknown: half of each of the flatter two.
        let half = 0.5 * mean_variance(&so_far);
        let unknown = [0.0, half, half];
        let seen = |&pixel: &u32| {
            let profiled = self.profiled.as_ref().map_or(unknown, |profiled| profiled[pixel as usize]);
            let pixel = so_far[pixel as usize];
            SampledPixel {
                samples: pixel.samples,
                // A pixel without a finite colour is ignored.
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

    pub fn laid_out(&self, samples: &[f64]) -> Result<SampleCounts, RenderError> {
        laid_out(self.count, &self.pixels, samples)
    }
}

fn known_variance(pixel: &SoFar) -> Option<f64> {
    pixel.variance.filter(|variance| variance.is_finite())
}

fn mean_variance(pixels: &[SoFar]) -> f64 {
    let (sum, count) = pixels
        .iter()
        .filter_map(known_variance)
        .fold((0.0, 0.0), |(sum, n), of_pixel| (sum + of_pixel, n + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}
