//! How accurate an image has to be.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{Confidence, ImageError};

/// The largest error of an image. Pixels get as many camera samples as it takes, where they help most.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ErrorTarget {
    /// Root mean square error over the pixels, in millionths of the image's mean: 20000 is 2 %.
    #[schema(minimum = 1, maximum = 1_000_000)]
    pub ppm: u32,
    /// Probability with which the error is not above that. An image may exceed it by a hundredth.
    #[serde(default)]
    pub confidence: Confidence,
}

impl ErrorTarget {
    /// An error that exceeds the target by this share is accepted.
    pub const NEAR_ENOUGH: f64 = 0.01;

    /// The largest number of camera samples of a pixel.
    pub const MOST_SAMPLES: u32 = 65_535;

    /// The largest target: the image's mean.
    pub const MOST_PPM: u32 = 1_000_000;

    /// A target in per cent, as people write it.
    ///
    /// # Errors
    /// If it is not within 0.0001 to 100.
    pub fn of_percent(percent: f64, confidence: Confidence) -> Result<Self, String> {
        let ppm = (percent * 1e4).round();
        if !(1.0..=f64::from(Self::MOST_PPM)).contains(&ppm) {
            return Err(format!("{percent} % is not within 0.0001 to 100 % of the image's mean"));
        }
        Ok(Self { ppm: ppm as u32, confidence })
    }

    /// As a share of the image's mean.
    pub fn share(self) -> f64 {
        f64::from(self.ppm) / 1e6
    }

    /// Whether an image of this error is finished. So is one whose pixels cannot have more samples.
    pub fn is_met(self, error: &ImageError, most_samples: u32) -> bool {
        error.at(self.confidence) <= self.share() * (1.0 + Self::NEAR_ENOUGH)
            || most_samples >= Self::MOST_SAMPLES
    }
}

/// Camera samples per pixel that reach a job's error target in one frame, by what a profile says: as many in
/// every pixel would cost what the frame costs whose samples go where they help.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SamplesForError {
    /// Enough with 50 % probability.
    #[schema(minimum = 1)]
    pub p50: f64,
    /// Enough with 80 % probability.
    #[schema(minimum = 1)]
    pub p80: f64,
    /// Enough with 95 % probability.
    #[schema(minimum = 1)]
    pub p95: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_in_per_cent_is_the_share_that_was_meant() {
        let of = |percent| ErrorTarget::of_percent(percent, Confidence::P50);
        assert_eq!(of(2.0).unwrap().share(), 0.02);
        assert_eq!(of(0.0001).unwrap().ppm, 1);
        assert_eq!(of(100.0).unwrap().ppm, ErrorTarget::MOST_PPM);
        for wrong in [0.0, -1.0, 100.1, f64::NAN, f64::INFINITY, 0.00001] {
            assert!(of(wrong).is_err(), "{wrong}");
        }
    }
}
