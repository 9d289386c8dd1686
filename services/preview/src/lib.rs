//! What the camera sees, cheaply: for every pixel the (object, material) pair, the position and the normal of the
//! surface at its centre.
//!
//! Two makers give the same answer: the GPU (headless Vulkan through `wgpu`) and its CPU twin, which traces one ray a pixel.
//! Both say only *which triangle* a pixel shows; stratum, position and normal then come out of one function, from the
//! triangle and the pixel. So wherever the two agree on the triangle, they agree on every bit of the rest. They
//! can disagree where a triangle's edge passes a pixel's centre within the rasteriser's snapping (1/256 pixel), and
//! where two surfaces are nearer to each other than a float's precision of depth.
//!
//! What is visible: both sides of every triangle, as seen through a pinhole (the lens blurs, it does not change what
//! a pixel mostly shows); surfaces whose opacity is below ½ are left out, and so are the texels that a cut-out
//! texture leaves out; glass is shown, not what lies behind it. Of surfaces at the same depth the lowest triangle
//! index is seen.

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
