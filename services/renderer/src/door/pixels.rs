//! Measuring single pixels of a frame.

use super::answers::{Cost, FixedCosts};
use super::artefact::Artefact;
use super::error::RendererError;
use image::RgbImage;

/// What a pixel shows: numbers of the object and of its material, as in a
/// [`PixelCount`](super::PixelCount). The background has neither.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Shown {
    /// The object.
    pub object: Option<u32>,
    /// Its material.
    pub material: Option<u32>,
}

/// Cost of one pixel with all of its samples.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PixelCost {
    /// CPU time as in a render, nanoseconds.
    pub cpu_nanos: u64,
    /// Rays: primary, shadow, transparent, reflected, refracted, ambient, specular. All 0 if unknown.
    pub rays: [u64; 7],
}

/// Pixels that were measured.
#[derive(Debug, Clone, PartialEq)]
pub struct ProfiledPixels {
    /// Cost of all that was done.
    pub cost: Cost,
    /// What of a render's cost does not depend on its pixels.
    pub fixed: FixedCosts,
    /// Finished pixels, which a render may take over.
    pub artefact: Option<Artefact>,
    /// CPU time that they took, nanoseconds.
    pub finished_nanos: u64,
    /// Object and material of each pixel as a colour. `None` if there is no such picture.
    pub ids: Option<RgbImage>,
}

/// Measures pixels of one frame, in several steps: which pixels come next may depend on those before.
pub trait PixelProfiler {
    /// What every pixel shows, in rows from the top.
    fn shown(&self) -> &[Shown];

    /// Renders pixels (indices in rows from the top, each once over all steps), and returns their costs in
    /// the same order.
    ///
    /// # Errors
    /// If the renderer fails or the run is stopped.
    fn measure(&mut self, pixels: &[u32]) -> Result<Vec<PixelCost>, RendererError>;

    /// Renders runs of neighbouring pixels, each in one go, as a render does. So many of the first pixels of
    /// a run only bring the scene's data into the processor's caches; the costs are sums over the
    /// others. Pixels are not among those of [`measure`](Self::measure).
    ///
    /// # Errors
    /// If the renderer fails or the run is stopped.
    fn measure_runs(&mut self, runs: &[(Vec<u32>, usize)]) -> Result<Vec<PixelCost>, RendererError>;

    /// Ends the measurement.
    ///
    /// # Errors
    /// If the finished pixels cannot be written.
    fn finish(self: Box<Self>) -> Result<ProfiledPixels, RendererError>;
}
