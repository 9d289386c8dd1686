//! Adaptive sampling: a frame for a time, for an error, or for an amount of work.
//!
//! The frame is rendered in passes. After each, the image shows where more samples lower its error most.
//!
//! | file | subject |
//! | --- | --- |
//! | `allocation` | what a profile says of a frame: its forecast and, with a time limit, the first samples |
//! | `passes` | passes over a frame, on one machine or divided over nodes |
//! | `tiles` | what the unfinished image says of each tile |
//! | `time_limit` | passes until the time is up |
//! | `error_target` | passes until the error is small enough |
//! | `work_budget` | passes until the work is spent |

pub(crate) mod allocation;
pub(crate) mod allotment;
pub(crate) mod error_target;
pub(crate) mod made;
pub(crate) mod passes;
pub(crate) mod tiles;
pub(crate) mod time_limit;
pub(crate) mod work_budget;
