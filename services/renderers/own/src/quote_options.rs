//! Options of a quote.

use forelight_forecast::{Corrections, Strategy};

/// How a quote is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuoteOptions {
    /// Pixels to profile per profiled frame.
    pub samples: u32,
    /// Most frames to profile, at least 1. `None`: as many as pay ([`forelight_quote::Measured::more_to_profile`]).
    pub profile_frames: Option<usize>,
    /// Seed of the choice of pixels.
    pub seed: u64,
    /// How pixels are chosen, and how their costs are expanded to the frame.
    pub strategy: Strategy,
    /// CPU time that a denoiser takes for a pixel, nanoseconds. `None`: images keep their noise.
    pub denoiser_nanos_per_pixel: Option<u64>,
    /// Whether pixels are scanned for the error of the image, beside those that are profiled for its cost.
    pub scans: bool,
    /// Corrections of the quantiles from past jobs with the same renderer and class of features.
    pub corrections: Option<Corrections>,
}

impl Default for QuoteOptions {
    fn default() -> Self {
        Self {
            samples: 256,
            profile_frames: None,
            seed: 0,
            strategy: Strategy::Snapshot,
            denoiser_nanos_per_pixel: None,
            scans: false,
            corrections: None,
        }
    }
}
