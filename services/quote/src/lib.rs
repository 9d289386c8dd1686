//! From previews and profiles to the quote of a shot: which frames to profile, and what every frame will
//! cost.
//!
//! All functions are pure: no I/O, no clock, no random numbers. The service calls them between the tasks of a
//! job, the command line between the steps of an offline quote. Both give the same quote, bit for bit.
//!
//! A quote takes these steps:
//!
//! 1. [`frames_to_profile`] picks the first frames to profile from the preview of all frames.
//! 2. [`Measured::more_to_profile`] picks more if the forecast is still uncertain and they cost little.
//! 3. [`quote`] forecasts every frame. It prices irradiance caches of each frame's own and one shared cache,
//!    and takes the cheaper way. [`Limit::quote`] instead finds the most camera samples within a limit of
//!    time or money, and [`quote_for_error`] prices those that an error takes.
//! 4. [`Measured::explain`] shows where the work goes, and [`Measured::qualities`] what other qualities cost.
//!
//! | file | subject |
//! | --- | --- |
//! | `measured` | the input: preview, profiles, plan of a shared cache |
//! | `populations` | the input as strata and their pixels |
//! | `choose` | which frames to profile |
//! | `estimate` | forecasts of all frames |
//! | `sampled` | quotes from a few frames at few samples, for renderers that cannot measure pixels |
//! | `job_forecast` | the quote as it is stored and shown |
//! | `sharing` | one irradiance cache for the shot, or one per frame |
//! | `limit` | the most samples within a limit of time or money |
//! | `error_target` | the samples that an error takes |
//! | `samples` | cost of profiled pixels at other numbers of camera samples |
//! | `pixel_costs` | cost of single pixels |
//! | `living` | the estimate of a running job: when to update it, when it exceeds its booking |
//! | `price` | CPU time in money |
//! | `serial_time` | how long frames keep a node beyond their CPU time divided by its cores |
//! | `explanation/` | where the work goes, in numbers and words |
//! | `qualities/` | cost and error of other qualities |

mod choose;
pub mod division;
mod error;
mod error_target;
mod estimate;
mod explanation;
mod job_forecast;
mod limit;
pub mod living;
mod measured;
mod pixel_costs;
mod populations;
mod price;
mod qualities;
mod sampled;
mod samples;
pub mod serial_time;
mod sharing;
#[cfg(test)]
mod tests;

pub use choose::frames_to_profile;
pub use error::QuoteError;
pub use error_target::{quote_for_error, with_samples_for_error};
pub use estimate::Estimate;
pub use explanation::explain_sampled;
pub use job_forecast::{JobForecast, Quote, QuoteBasis, QuoteKind, SharedCacheToBuild, Spreads, quantiles};
pub use limit::{Limit, Most};
pub use measured::{Measured, MeasuredProfile, SharedCache};
pub use pixel_costs::PixelWork;
pub use price::{mean_price, mean_serial_price};
pub use qualities::{image_error, is_own, ladder, mark, points, without_ladders};
pub use sampled::{SampledProfile, quote_sampled, stratum_key};
pub use samples::with_samples;
pub use sharing::{is_shared_cache_worth_planning, quote};
