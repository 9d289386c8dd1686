//! Why there is no quote.

use forelight_forecast::ForecastError;
use forelight_protocol::CACHE_BYTES;

/// Why there is no quote. Each reason is a sentence for the person who submitted the job.
#[derive(Clone, PartialEq, Debug, thiserror::Error)]
pub enum QuoteError {
    /// The statistics refuse the preview.
    #[error("no frames could be chosen for profiling: {0}")]
    Choice(ForecastError),
    /// The preview has no frame that can be profiled.
    #[error("no frame was chosen for profiling")]
    NothingChosen,
    /// A profile belongs to a frame that the preview does not have.
    #[error("frame {0} was profiled, but it is not in the preview")]
    NotPreviewed(u32),
    /// The statistics refuse the profiles.
    #[error("no forecast: {0}")]
    Forecast(ForecastError),
    /// The statistics refuse the records of the shared cache.
    #[error("no forecast of the shared irradiance cache: {0}")]
    SharedCache(ForecastError),
    /// The job asks for a shared cache that would be too large.
    #[error(
        "the job asks for a shared irradiance cache, which would take {0} bytes; the limit is {CACHE_BYTES}: \
         ask for private caches, or for a lower cache accuracy"
    )]
    CacheTooLarge(u64),
    /// There is no such frame.
    #[error("the job has no frame {0}")]
    NoFrame(u32),
    /// Not even one camera sample a pixel fits into the limit.
    #[error(
        "within: with one camera sample per pixel, the minimum, {what} takes {needed} at {confidence}; \
         the limit is {limit}"
    )]
    TooLittle {
        /// The job, or its dearest frame.
        what: &'static str,
        /// What that takes, with its unit.
        needed: String,
        /// What the limit allows, with its unit.
        limit: String,
        /// The quantile that was compared.
        confidence: &'static str,
    },
}
