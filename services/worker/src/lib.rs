//! The worker: leases a task, runs it, reports. Knows no SQL; speaks to the service by HTTP alone.
//!
//! | file | subject |
//! | --- | --- |
//! | `renderer` | the small door behind which the renderer stands |
//! | `ambient` | our renderer behind it |
//! | `shot`, `quote` | preview all frames, profile some, estimate all: the way to a quote |
//! | `accuracy` | what accuracy costs in time |
//! | `allot` | a frame for so many seconds, or of so small an error |
//! | `noise` | what profiled pixels say of the image's error |
//! | `warm_clock` | what a scattered pixel would have taken among its neighbours |
//! | `render` | one frame with its true cost |
//! | `pictures` | the files of a finished frame, and what making them takes |
//! | `shot_cache` | the irradiance cache that the frames of a shot share |
//! | `tasks`, `cache_tasks`, `render_task` | the kinds of tasks |
//! | `execute`, `agent` | a task's life between lease and result |
//! | `library` | bundles, fetched once and kept open |
//! | `within`, `refine`, `spend` | a render that holds to its time, to its error, or to its work |
//! | `tiles` | what an image underway says of where more samples pay |
//! | `calibrate`, `classes`, `capabilities` | how fast this machine is by class of work, what a frame's work is of, and what the machine has |
//! | `checkpoint` | the finished tiles of a frame, for whoever has it next |
//! | `limits` | what a task may use at most |

// What unit tests share with the others speaks of this crate by its name.
#[cfg(test)]
extern crate self as forelight_worker;
#[cfg(test)]
#[path = "../tests/common/mod.rs"]
mod common;

mod accuracy;
mod agent;
mod allot;
mod ambient;
mod cache_tasks;
mod calibrate;
mod capabilities;
mod checkpoint;
mod classes;
mod execute;
mod library;
mod limits;
mod noise;
mod pictures;
mod quote;
mod refine;
mod render;
mod render_task;
mod renderer;
mod shot;
mod shot_cache;
mod spend;
mod tasks;
mod tiles;
mod warm_clock;
mod within;

pub use accuracy::{AccuracyObserver, AccuracyOptions, MeasureOptions, measure, predict};
pub use agent::{Agent, AgentError, Errand};
pub use allot::{Aim, AllotError, AllotOptions, Allotted, render_allotted, render_as_allotted};
pub use ambient::{Adapter, Ambient, AmbientShot, tracer_settings};
pub use calibrate::{CALIBRATION_VERSION, REFERENCE_RATE, ROUNDS, calibrate, node_speed};
pub use capabilities::capabilities;
pub use execute::{Assignment, Control, Execute, ExecuteError, Outcome};
pub use library::Library;
pub use noise::FrameNoise;
pub use pictures::png;
pub use quote::{Quote, QuoteOptions, quote};
pub use refine::NEAR_ENOUGH;
pub use render::{Given, Rendered, peak_rss_bytes, render_frame, render_ready, seconds};
pub use renderer::{
    CacheUse, Counted, Finished, FrameRenderer, OpenRenderer, Previewed, Progress, RenderError, Renderer,
    ShotInfo, Step, StratumInfo,
};
pub use shot::{
    CountedFrames, Observer, ProfiledFrame, ShotError, cost_of, cost_of_gather, cost_of_record, count_frames,
    forecast_strata, profile_frame, record_prior_cost, records_to_sample, stratum_ids,
};
pub use shot_cache::{Filled, SharedPlan, SharedProfile, fill_part, plan_shared, profile_shared};
pub use tasks::{TaskRunner, preview_result, profile_result};
pub use within::{Budget, Stopwatch};
