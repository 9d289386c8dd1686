//! The renderer's door: what the worker asks of a renderer, in words that suit any of them.
//!
//! | file | subject |
//! | --- | --- |
//! | `door` | the four questions to a renderer: describe, preview, measure, render |
//! | `quoting` | what a quote needs of a shot: previews of all frames, a few frames at few samples |
//! | `tasks` | tasks of the farm for any renderer behind the door |
//! | `open_shots` | the last few opened scenes, shared by all workers of a process |
//! | `process` | foreign programs, held to limits |
//! | `execute` | a task in, a result and its files out; progress, orders and log lines on the way |
//! | `files` | the files of a result |
//! | `memory` | memory of this process |

pub mod door;
mod execute;
mod files;
mod memory;
mod open_shots;
pub mod process;
mod quoting;
mod summary;
mod tasks;

pub use execute::{Assignment, Control, Execute, ExecuteError, FETCHED, Outcome, picture_name};
pub use files::{Files, artifact_name};
pub use memory::{peak_rss_bytes, resident_bytes};
pub use open_shots::OpenShots;
pub use quoting::{
    Measurement, PixelChoice, PixelProfile, QuotingError, QuotingStep, ShotQuote, WARMING_SHARE, Wanted,
    free_neighbours, locates_costs, measure_frame, middle_mean, preview_result, profile_pixels,
    proportional_sites, quote_shot, sites,
};
pub use summary::summary;
pub use tasks::{Renderers, failure, read_written, scene_digest, scene_name, with_run};
