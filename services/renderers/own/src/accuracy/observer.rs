//! Options of a prediction; its progress, and how it is cancelled.

use super::denoising::DenoiseBy;
use crate::error::ShotError;
use crate::frame::OwnFrame;
use forelight_forecast::accuracy::PixelNoise;
use forelight_tracer::Pixel;
use std::sync::atomic::{AtomicBool, Ordering};

/// How accuracy is predicted.
#[derive(Clone, Copy)]
pub struct AccuracyOptions<'a> {
    /// Pixels to profile for every kind of setting.
    pub samples: u32,
    /// Seed of the choice of pixels.
    pub seed: u64,
    /// Also predicts the error once the noise was removed.
    pub denoise: Option<DenoiseBy<'a>>,
}

/// Receives progress, and can cancel.
pub trait AccuracyObserver: Sync {
    /// `done` of `all` steps of the prediction are finished.
    fn predicted(&self, done: usize, all: usize);
    /// Set to cancel.
    fn cancel(&self) -> &AtomicBool;
}

pub(super) fn is_cancelled(observer: &dyn AccuracyObserver) -> bool {
    observer.cancel().load(Ordering::Relaxed)
}

pub(super) fn traced(
    ready: &OwnFrame<'_>,
    pixels: &[u32],
    observer: &dyn AccuracyObserver,
) -> Result<Vec<(Pixel, PixelNoise)>, ShotError> {
    ready.trace_unless(pixels, &|| is_cancelled(observer)).ok_or(ShotError::Cancelled)
}
