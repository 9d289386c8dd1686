//! What accuracy costs in time: how far an image will be from its converged self, and which qualities are worth their cost.
//!
//! The error of an image is taken as the root mean square of (pixel − converged pixel) over pixels and channels, as a share of the
//! image's mean. Its square, the mean over pixels of their variance (and of what interpolation adds), is estimated from a few
//! pixels as a frame's cost is: by strata, whose numbers of pixels the preview knows.
//!
//! | file | subject |
//! | --- | --- |
//! | `pixel` | what the camera samples of one pixel say about its variance at any number of samples |
//! | `law` | how the variance of a pixel falls with its samples |
//! | `image` | from some pixels to the whole image |
//! | `allot` | how many camera samples each part of an image gets, for a budget or an error |
//! | `survey` | where more of them pay, as an image underway shows it |
//! | `settling` | how far the guess is off of how its variance falls, as it shows itself |
//! | `front` | which rungs of a ladder are worth taking, and what the next one costs |
//!
//! # Why not the sample variance
//! The usual estimate of a pixel's variance, s² / n, holds for independent samples. Camera samples are points of scrambled
//! (0,2)-sequences, whose mean converges faster: on smooth pixels s² / n is too large by a factor that grows with n. So a pixel's
//! variance is measured as a *spectrum* over the number of samples, see [`PixelSamples`].

pub mod allot;
mod front;
mod image;
mod law;
mod pixel;
mod settling;
mod survey;

pub use front::{Point, Step, front, front_of_known};
pub use image::{
    ErrorQuantiles, ImageNoise, MeanSquare, NoiseCell, NoiseGroup, NoiseSample, noise_cells, noise_groups,
};
pub use pixel::{PixelNoise, PixelSamples};
pub use survey::{Seen, Survey};
