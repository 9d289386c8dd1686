//! The expected error of an image at any number of camera samples.
//!
//! The error is the root mean square of (pixel − converged pixel) over pixels and channels, divided by the
//! image's mean. Its square is the mean variance of the pixels, plus the square of the bias of interpolation.
//! It is estimated from a few profiled pixels by strata, like the cost of a frame.
//!
//! | file | subject |
//! | --- | --- |
//! | `pixel` | the variance of one pixel at any number of samples, from its own camera samples |
//! | `variance_curve` | how the variance of a pixel falls with the number of its samples |
//! | `variance_fit` | fits that fall to what was sampled |
//! | `cells` | which sampled pixels stand for which pixels of an image |
//! | `image` | the error of the whole image, from some pixels |
//! | `allot` | how many camera samples each part of an image gets, for a budget or an error |
//! | `sampled_pixel` | a pixel of an unfinished image |
//! | `survey` | where further samples reduce the error most, judged by an unfinished image |
//! | `observed_laws` | how the variance of an unfinished image falls, by the image itself |
//! | `front` | which qualities of a ladder are Pareto optimal, and which is the next better one |
//!
//! The usual estimate s² / n holds only for independent samples. Camera samples are points of scrambled
//! (0,2)-sequences, whose mean converges faster. So the variance is measured as a *spectrum* over the number
//! of samples; see [`PixelSamples`].

pub mod allot;
mod cells;
mod front;
mod image;
mod observed_laws;
mod pixel;
mod sampled_pixel;
mod survey;
mod variance_curve;
mod variance_fit;

pub use cells::{NoiseCell, NoiseGroup, NoiseSample, Sampled};
pub use front::{Point, Step, front, front_of_known};
pub use image::{ErrorQuantiles, ImageNoise, MeanSquare};
pub use pixel::{PixelNoise, PixelSamples};
pub use sampled_pixel::SampledPixel;
pub use survey::Survey;
pub use variance_curve::Terms;
