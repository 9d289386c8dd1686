//! A divided frame that is rendered in passes: the files between its tasks, and the parts of the next pass.

use crate::error::RenderError;
use crate::frame::OwnFrame;
use forelight_forecast::{Stretch, parts_of_equal_cost};
use forelight_pictures::tone_map;
use forelight_tracer::{Advanced, Passes, SampleCounts, SoFar, Totals, Unfinished};
use image::{Rgb, RgbImage};
use std::ops::Range;

impl OwnFrame<'_> {
    /// Reads a file of unfinished pixels, which must be of this image.
    pub fn unfinished(&self, bytes: &[u8]) -> Result<Unfinished, RenderError> {
        let file = Unfinished::from_bytes(bytes)?;
        if file.fingerprint != self.tracer.fingerprint() || !file.fits(self.frame().camera.pixels()) {
            let differs = file.origin.unlike_image(&self.tracer.origin());
            return Err(RenderError::ForeignProfile { differs });
        }
        Ok(file)
    }

    /// Starts some pixels of an image in passes, without samples.
    pub fn begin_pixels(&self, pixels: &[u32]) -> Passes {
        Passes::of(&self.tracer, pixels)
    }

    /// The pixels with their samples so far, to be written to a file.
    pub fn so_far(&self, passes: &Passes) -> Unfinished {
        passes.unfinished(&self.tracer)
    }

    /// Brings pixels to these camera samples, on the current thread pool. Any irradiance cache must be
    /// filled. `advanced` gets pixels that are done. Returns the cost.
    pub fn advance(
        &self,
        passes: &mut Passes,
        wanted: &SampleCounts,
        stop: &(dyn Fn() -> bool + Sync),
        advanced: &(dyn Fn(&Advanced<'_>) + Sync),
    ) -> Result<Totals, RenderError> {
        Ok(passes.go_on(&self.tracer, wanted, stop, advanced)?)
    }

    /// Divides what these places of the image still need into parts of equal forecast work: further samples of
    /// a pixel cost what its first ones did, and pixels without samples what the others did.
    pub fn divide_pass(
        &self,
        passes: &Passes,
        wanted: &SampleCounts,
        places: Range<u32>,
        parts: u32,
    ) -> Vec<Stretch> {
        let (curve, so_far) = (self.curve(), passes.so_far());
        let sum = |of: fn(&SoFar) -> f64| so_far.iter().map(of).sum::<f64>();
        let mean = (sum(|pixel| pixel.work as f64) / sum(|pixel| f64::from(pixel.samples)).max(1.0)).max(1.0);
        let cost = |pixel: u32| {
            let SoFar { samples, work, .. } = so_far[pixel as usize];
            let more = u32::from(wanted.as_slice()[pixel as usize]).saturating_sub(samples);
            let each = if samples > 0 { work as f64 / f64::from(samples) } else { mean };
            (each * f64::from(more)).round() as u64
        };
        let first = places.start;
        let pixels = curve.pixels(places).into_iter();
        let runs: Vec<Stretch> =
            pixels.zip(1..).map(|(pixel, to)| Stretch { to, cost: cost(pixel) }).collect();
        let parts = parts_of_equal_cost(&runs, parts).into_iter();
        parts.map(|part| Stretch { to: first + part.to, ..part }).collect()
    }
}

/// The image so far, as a picture.
pub(crate) fn picture(passes: &Passes) -> RgbImage {
    let image = passes.image();
    RgbImage::from_fn(image.width, image.height, |x, y| {
        Rgb(tone_map(image.pixels[(y * image.width + x) as usize].color))
    })
}
