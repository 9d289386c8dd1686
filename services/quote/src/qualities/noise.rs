//! The error of a job's images, from its profiles.

use forelight_forecast::Calibration;
use forelight_forecast::accuracy::{ErrorQuantiles, ImageNoise, MeanSquare, NoiseCell, PixelNoise};
use forelight_protocol::{self as protocol, ImageError};

use crate::measured::MeasuredProfile;

/// Noise of every profiled frame, or why it is unknown.
pub(super) struct Noise(Result<Vec<ImageNoise>, String>);

impl Noise {
    pub fn of(profiles: &[MeasuredProfile]) -> Self {
        Self(profiles.iter().map(image).collect())
    }

    /// Why errors are unknown. `None` if they are known.
    pub fn missing(&self) -> Option<&str> {
        self.0.as_ref().err().map(String::as_str)
    }

    /// Error at `spp` camera samples per pixel: root mean square over the profiled frames.
    pub fn error(&self, spp: u32) -> Option<ImageError> {
        let images = self.0.as_ref().ok()?;
        let frames: Vec<MeanSquare> = images.iter().map(|image| image.at(spp)).collect();
        Some(image_error(MeanSquare::mean(&frames)?.error(Calibration::NONE)))
    }
}

/// An image's error, as documents have it.
pub fn image_error(ErrorQuantiles { p05, p50, p80, p95 }: ErrorQuantiles) -> ImageError {
    ImageError { p05, p50, p80, p95 }
}

fn image(profile: &MeasuredProfile) -> Result<ImageNoise, String> {
    if profile.result.noise.is_empty() {
        let reason = "pixels were profiled before the irradiance cache was filled, or with one camera sample";
        return Err(reason.to_owned());
    }
    let sample = |sample: &protocol::NoiseSample| PixelNoise {
        brightness: sample.brightness.into(),
        drops: sample.drops.iter().map(|&drop| drop.into()).collect(),
        bias_square: 0.0,
    };
    let cells = profile.result.noise.iter().map(|cell| NoiseCell {
        pixels: cell.pixels.into(),
        samples: cell.samples.iter().map(sample).collect(),
    });
    ImageNoise::new(cells.collect()).map_err(|error| error.to_string())
}
