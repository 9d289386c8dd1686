//! forelight's own renderer: previews, profiles, renders and caches, with the crates `scene`, `preview` and
//! `tracer`. Workers reach it through [`TaskRunner`]. The command line calls the same steps without a service.
//!
//! | folder or file | subject |
//! | --- | --- |
//! | `opening`, `previewer` | bundles become shots; they share one previewer |
//! | `shot`, `frame` | a shot; one frame, ready to be traced; `answers` and `error` are what they return |
//! | `tasks/` | what each kind of task does |
//! | `profile/` | counting what frames show, and profiling some of their pixels |
//! | `quote`, `quote_options` | an offline quote: preview, profile, estimate |
//! | `results`, `costs` | previews, profiles and costs in the terms of the wire |
//! | `render/` | one frame with its true cost, and its files |
//! | `adaptive/` | a frame for a time, an error or an amount of work |
//! | `accuracy/` | what other qualities of a frame cost, and how far their images are from converged |
//! | `division/` | a frame that is divided into parts, which several nodes render |
//! | `shared_cache` | the irradiance cache that the frames of a shot share |
//! | `calibration/` | how fast this machine is, by class of work |

// Code that unit tests share with integration tests uses this crate by name.
#[cfg(test)]
extern crate self as forelight_renderer_own;
#[cfg(test)]
#[path = "../tests/common/mod.rs"]
mod common;

mod accuracy;
mod adaptive;
mod answers;
mod calibration;
mod costs;
mod division;
mod error;
mod frame;
mod opening;
mod preview_cost;
mod profile;
mod quote;
mod quote_options;
mod render;
mod results;
mod shared_cache;
mod shot;
mod tasks;

pub use accuracy::{
    AccuracyObserver, AccuracyOptions, Blocks, ChosenCache, DenoiseBy, MeasureOptions, choose_cache, measure,
    predict,
};
pub use adaptive::allocation::{Aim, AllotOptions, render_allotted, render_as_allotted};
pub use adaptive::made::{AllotError, Allotted};
pub use adaptive::time_limit::{Budget, Stopwatch};
pub use answers::{CacheUse, Counted, Finished, Previewed, Progress, ShotInfo, Step, StratumInfo};
pub use calibration::{CALIBRATION_VERSION, ROUNDS, calibrate, node_speed};
pub use costs::{cost_of, cost_of_gather, cost_of_record, seconds};
pub use division::{Divided, colors_of_part};
pub use error::{RenderError, ShotError};
pub use frame::OwnFrame;
pub use opening::{Adapter, OwnRenderer};
pub use profile::noise::FrameNoise;
pub use profile::strata::{forecast_strata, record_prior_cost};
pub use profile::{CountedFrames, Observer, ProfiledFrame, profile_frame, records_to_sample, stratum_ids};
pub use quote::{Quote, quote};
pub use quote_options::QuoteOptions;
pub use render::pictures::png;
pub use render::{Given, Rendered, render_frame, render_ready};
pub use shared_cache::{Filled, SharedPlan, SharedProfile, fill_part, plan_shared, profile_shared};
pub use shot::OwnShot;
pub use tasks::{Denoising, TaskRunner};
