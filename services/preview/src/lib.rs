//! Finds what the camera sees in every pixel of a frame: the (object, material) pair, and the position and
//! normal of the surface at the centre of the pixel.
//!
//! There are two implementations: the GPU (headless Vulkan through `wgpu`), and its CPU twin, which traces
//! one ray per pixel. Both find only *which triangle* a pixel shows. One function then computes stratum,
//! position and normal from the triangle and the pixel. So wherever both find the same triangle, all other
//! bits agree too. They may find different triangles where an edge passes a pixel centre within the
//! rasteriser's snapping (1/256 pixel). The same holds where two surfaces are closer to each other than the
//! precision of a float depth.
//!
//! Both sides of every triangle are visible, as seen through a pinhole. A lens blurs, but does not change
//! what a pixel mostly shows. Surfaces with an opacity below ½ are left out, as are the transparent texels of
//! a cut-out texture. Glass is shown, not what is behind it. Of surfaces at the same depth, the one with the
//! lowest triangle index is visible.

mod clock;
mod cost;
mod cpu;
mod error;
mod gpu;
mod picture;
mod preview;
mod previewer;
mod visible;

pub use cost::Cost;
pub use cpu::{cpu_counts_with, cpu_preview_with};
pub use error::PreviewError;
pub use picture::{palette, picture};
pub use preview::{Counts, NOTHING, Preview};
pub use previewer::{Choice, ParseChoiceError, Previewer};
