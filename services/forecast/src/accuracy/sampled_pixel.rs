//! A pixel of an unfinished image, with what its samples show so far.

use super::Terms;

/// A pixel of an unfinished image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampledPixel {
    /// Number of samples so far.
    pub samples: u32,
    /// Mean of the samples, over the three channels.
    pub brightness: f64,
    /// Variance of one sample, mean over the channels. `None` for a pixel with a single sample.
    pub variance: Option<f64>,
    /// Total cost of the samples, in any unit that all pixels share.
    pub cost: f64,
    /// The profile's variance of pixels like this one.
    pub profiled: Terms,
    /// Number of samples before the later ones, which are half to three quarters of all, and the squared
    /// change of the mean that those brought, mean over channels. `None` with a single sample.
    pub grown: Option<(u32, f64)>,
}
