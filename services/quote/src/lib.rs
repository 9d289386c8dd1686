//! From previews and profiles to the quote of a shot: which frames to profile, what every frame will cost, and why.
//!
//! Everything here is a pure function of the documents that workers return. There is no I/O, no clock and no random
//! number. The service calls these functions between the tasks of a job; the command line calls them between the
//! steps of an offline quote. So both give the same quote, to the last bit.
//!
//! A quote is made in these steps:
//!
//! 1. [`frames_to_profile`] picks the first frames to profile from the preview of all frames.
//! 2. [`Measured::more_to_profile`] picks more of them if the forecast is still uncertain and the cost is small.
//! 3. [`quote`] forecasts every frame. With an irradiance cache it prices a cache of each frame's own, and one that
//!    all frames share, and takes the cheaper one. [`Limit::quote`] instead finds the most camera samples that fit
//!    into a time or a sum of money.
//! 4. [`Measured::explain`] says what the work goes into, and [`Measured::qualities`] what other qualities cost.
//!
//! | file | subject |
//! | --- | --- |
//! | `measured` | the input: preview, profiles, plan of a shared cache |
//! | `populations` | the input as the statistics want it: strata and their pixels |
//! | `choose` | which frames to profile |
//! | `estimate` | the statistics of all frames |
//! | `job_forecast` | the quote as it is stored and shown |
//! | `sharing` | one irradiance cache for the shot, or one a frame |
//! | `limit` | the most samples for a time or a sum of money |
//! | `samples` | what profiled pixels cost with other numbers of camera samples |
//! | `pixel_costs` | what single pixels will cost |
//! | `living` | the estimate of a job under way: when it is made again, and when it leaves the plan |
//! | `price` | CPU time in money |
//! | `explanation/` | why a quote is what it is, in numbers and words |
//! | `qualities/` | what other qualities cost, and how far their images are from converged |

mod choose;
mod error;
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
mod samples;
mod sharing;
#[cfg(test)]
mod tests;

pub use choose::frames_to_profile;
pub use error::QuoteError;
pub use estimate::Estimate;
pub use job_forecast::{JobForecast, Quote, QuoteBasis, QuoteKind, SharedCacheToBuild, Spreads, quantiles};
pub use limit::{Limit, Most};
pub use measured::{Measured, MeasuredProfile, SharedCache};
pub use pixel_costs::PixelWork;
pub use price::mean_price;
pub use qualities::{is_own, ladder, mark, points, without_ladders};
pub use samples::with_samples;
pub use sharing::{is_shared_cache_worth_planning, quote};
