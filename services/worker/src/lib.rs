//! The worker: leases a task, runs it, reports the result. It knows no SQL and talks to the service by HTTP alone. The
//! command line uses the same steps offline, without a service.
//!
//! | folder or file | subject |
//! | --- | --- |
//! | `agent/` | the life of a task between lease and result; bundles, limits, checkpoints |
//! | `tasks/` | what each kind of task does |
//! | `renderer` | what a renderer can be asked: a trait |
//! | `own/` | our renderer behind it |
//! | `profile/` | counting what frames show, and profiling some of their pixels |
//! | `quote` | an offline quote: preview, profile, estimate |
//! | `render/` | one frame with its true cost, and its files |
//! | `adaptive/` | a frame for a time, an error or an amount of work |
//! | `accuracy/` | what other qualities of a frame cost, and how far their images are from converged |
//! | `shared_cache` | the irradiance cache that the frames of a shot share |
//! | `calibration/` | how fast this machine is, by class of work |

// What unit tests share with the others speaks of this crate by its name.
#[cfg(test)]
extern crate self as forelight_worker;
#[cfg(test)]
#[path = "../tests/common/mod.rs"]
mod common;

mod accuracy;
mod adaptive;
mod agent;
mod calibration;
mod own;
mod profile;
mod quote;
mod render;
mod renderer;
mod shared_cache;
mod tasks;

pub use accuracy::{AccuracyObserver, AccuracyOptions, MeasureOptions, measure, predict};
pub use adaptive::allocation::{
    Aim, AllotError, AllotOptions, Allotted, render_allotted, render_as_allotted,
};
pub use adaptive::error_target::NEAR_ENOUGH;
pub use adaptive::time_limit::{Budget, Stopwatch};
pub use agent::capabilities::capabilities;
pub use agent::execute::{Assignment, Control, Execute, ExecuteError, Outcome};
pub use agent::library::Library;
pub use agent::{Agent, AgentError, Errand};
pub use calibration::{CALIBRATION_VERSION, REFERENCE_RATE, ROUNDS, calibrate, node_speed};
pub use own::{Adapter, Ambient, AmbientShot};
pub use profile::noise::FrameNoise;
pub use profile::{
    CountedFrames, Observer, ProfiledFrame, ShotError, cost_of, cost_of_gather, cost_of_record, count_frames,
    forecast_strata, profile_frame, record_prior_cost, records_to_sample, stratum_ids,
};
pub use quote::{Quote, QuoteOptions, quote};
pub use render::pictures::png;
pub use render::{Given, Rendered, peak_rss_bytes, render_frame, render_ready, seconds};
pub use renderer::{
    CacheUse, Counted, Finished, FrameRenderer, OpenRenderer, Previewed, Progress, RenderError, Renderer,
    ShotInfo, Step, StratumInfo,
};
pub use shared_cache::{Filled, SharedPlan, SharedProfile, fill_part, plan_shared, profile_shared};
pub use tasks::{TaskRunner, preview_result, profile_result};
