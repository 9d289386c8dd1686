//! Errors of quotes.

use forelight_forecast::ForecastError;
use forelight_protocol::CACHE_BYTES;

/// Why there is no quote. Each message is for the person who submitted the job.
#[derive(Clone, PartialEq, Debug, thiserror::Error)]
pub enum QuoteError {
    /// The preview is unusable.
    #[error("no frames could be chosen for profiling: {0}")]
    Choice(ForecastError),
    /// The preview has no frame that can be profiled.
    #[error("no frame was chosen for profiling")]
    NothingChosen,
    /// A profiled frame is missing from the preview.
    #[error("frame {0} was profiled, but it is not in the preview")]
    NotPreviewed(u32),
    /// Frames were measured differently.
    #[error("frame {frame} was measured for {whole} samples or pixels, other frames for {expected}")]
    Measured {
        /// The frame.
        frame: u32,
        /// What it was measured for.
        whole: u32,
        /// What the first measured frame was measured for.
        expected: u32,
    },
    /// The profiles are unusable.
    #[error("no forecast: {0}")]
    Forecast(ForecastError),
    /// The records of the shared cache are unusable.
    #[error("no forecast of the shared irradiance cache: {0}")]
    SharedCache(ForecastError),
    /// The job asks for a shared cache that is too large.
    #[error(
        "the job asks for a shared irradiance cache, which would take {0} bytes; the limit is {CACHE_BYTES}: \
         ask for private caches, or for a lower cache accuracy"
    )]
    CacheTooLarge(u64),
    /// The job has no such frame.
    #[error("the job has no frame {0}")]
    NoFrame(u32),
    /// A profile does not say what the job's error takes.
    #[error("error_target: the profile of frame {0} does not say how many camera samples reach the error")]
    NoSamplesForError(u32),
    /// Even one camera sample per pixel exceeds the limit.
    #[error(
        "within: with one camera sample per pixel, the minimum, {what} takes {needed} at {confidence}; \
         the limit is {limit}: raise it or lower the resolution"
    )]
    TooLittle {
        /// The job, or its most expensive frame.
        what: &'static str,
        /// Its cost, with the unit.
        needed: String,
        /// The limit, with the unit.
        limit: String,
        /// Quantile compared with the limit.
        confidence: &'static str,
    },
}
