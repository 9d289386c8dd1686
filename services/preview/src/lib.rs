//! Finds what the camera sees at the centre of every pixel: the (object, material) pair, position and normal.
//!
//! The GPU (headless Vulkan through `wgpu`) and its CPU twin, which traces one ray per pixel, only find
//! *which triangle* a pixel shows. One function computes the rest, so for the same triangle all bits agree.
//! They may differ where an edge passes a pixel centre within 1/256 pixel (the rasteriser's snapping), or
//! where two surfaces are closer than a float depth resolves.
//!
//! Both sides of every triangle are visible, through a pinhole. Surfaces with an opacity below ½ and
//! transparent texels are left out. Glass is shown, not what is behind it. At equal depth, the lowest
//! triangle index is visible.

mod clock;
mod cost;
mod cpu;
mod error;
mod gpu;
mod picture;
mod preview;
mod previewer;
mod shared;
mod visible;

pub use cost::Cost;
pub use cpu::{cpu_counts_with, cpu_preview_with};
pub use error::PreviewError;
pub use picture::{palette, picture};
pub use preview::{Counts, NOTHING, Preview};
pub use previewer::{Choice, ParseChoiceError, Previewer};
pub use shared::SharedPreviewer;
