//! A frame whose camera samples were distributed.

use crate::answers::Finished;
use crate::error::ShotError;
use crate::frame::OwnFrame;
use crate::render::{Rendered, rendered};
use forelight_forecast::Calibration;
use forelight_forecast::accuracy::Survey;
use forelight_protocol::{AllottedForecast, AllottedStats, RenderSettings, WithinStats};
use forelight_quote::image_error;
use forelight_tracer::SampleCounts;

/// Why samples cannot be distributed.
#[derive(Debug, thiserror::Error)]
pub enum AllotError {
    /// One camera sample per pixel takes longer.
    #[error(
        "{given:.3} s is too short: the frame takes about {least:.3} s with one camera sample per pixel; allow at least that"
    )]
    TooLittle {
        /// Seconds given.
        given: f64,
        /// Seconds of the least image, on the same clock.
        least: f64,
    },
    /// Filling the irradiance cache alone takes longer.
    #[error(
        "{given:.3} s is too short: filling the frame's irradiance cache takes until about {filled:.3} s; allow more or use no cache"
    )]
    TooLittleForCache {
        /// Seconds given.
        given: f64,
        /// When the cache is filled, in seconds on the same clock.
        filled: f64,
    },
    /// The frame cannot be profiled.
    #[error(transparent)]
    Shot(#[from] ShotError),
}

/// An image whose pixels differ in their camera samples.
#[derive(Debug, Clone)]
pub struct Allotted {
    /// The image.
    pub rendered: Rendered,
    /// Samples per pixel. [`crate::render_as_allotted`] makes the same image from them, bit by bit.
    pub samples: SampleCounts,
}

pub(crate) struct Made {
    pub finished: Finished,
    pub samples: SampleCounts,
    /// The image's own estimate of its error.
    pub survey: Survey,
    pub within: Option<WithinStats>,
}

impl Made {
    /// The frame with its cost, its forecast, and its estimated error.
    pub fn rendered(
        self,
        ready: &OwnFrame<'_>,
        settings: &RenderSettings,
        forecast: Option<AllottedForecast>,
        wall_seconds: f64,
    ) -> Allotted {
        let Self { finished, samples, survey, within } = self;
        let (least, most, mean) = samples.range();
        let error = image_error(survey.error(survey.samples(), Calibration::NONE));
        let mut rendered = rendered(ready, finished, settings, wall_seconds);
        rendered.stats.spp = mean.round() as u32;
        rendered.stats.allotted =
            Some(Box::new(AllottedStats { least, most, mean, error, forecast, within }));
        Allotted { rendered, samples }
    }
}
