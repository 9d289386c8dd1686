//! What accuracy costs in time: the expected error of an image at any number of camera samples.
//!
//! The error of an image is the root mean square of (pixel − converged pixel) over pixels and channels, as a
//! share of the image's mean. Its square is the mean over the pixels of their variance, plus the square of
//! the bias that interpolation adds. It is estimated from a few profiled pixels, in the same way as the cost
//! of a frame: by strata whose pixel counts the preview knows.
//!
//! | file | subject |
//! | --- | --- |
//! | `pixel` | the variance of one pixel at any number of samples, from its own camera samples |
//! | `variance_curve` | how the variance of a pixel falls with the number of its samples |
//! | `image` | the error of the whole image, from some pixels |
//! | `allot` | how many camera samples each part of an image gets, for a budget or an error |
//! | `sampled_pixel` | a pixel of an unfinished image |
//! | `survey` | where further samples reduce the error most, judged by an unfinished image |
//! | `curve_correction` | corrects the profile's variance curve by what the unfinished image shows |
//! | `front` | which qualities of a ladder are Pareto optimal, and which is the next better one |
//!
//! # Why not the sample variance
//! The usual estimate of the variance of a mean, s² / n, holds for independent samples. Camera samples are
//! points of scrambled (0,2)-sequences, whose mean converges faster. On smooth pixels s² / n is too large, by
//! a factor that grows with n. So the variance of a pixel is measured as a *spectrum* over the number of
//! samples, see [`PixelSamples`].

pub mod allot;
mod curve_correction;
mod front;
mod image;
mod pixel;
mod sampled_pixel;
mod survey;
mod variance_curve;

pub use front::{Point, Step, front, front_of_known};
pub use image::{
    ErrorQuantiles, ImageNoise, MeanSquare, NoiseCell, NoiseGroup, NoiseSample, noise_cells, noise_groups,
};
pub use pixel::{PixelNoise, PixelSamples};
pub use sampled_pixel::SampledPixel;
pub use survey::Survey;
