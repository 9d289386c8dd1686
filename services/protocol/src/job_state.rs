//! States of jobs.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// State of a job.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// The frames are being previewed.
    Previewing,
    /// Some frames are being profiled.
    Profiling,
    /// The quote is complete. Nothing is booked: the job waits to be accepted.
    Quoted,
    /// The quote is complete, and nodes are booked.
    Booked,
    /// A worker has started a frame, or a part of a shared irradiance cache.
    Rendering,
    /// All frames are finished.
    Done,
    /// A task failed after all attempts. `error` has the reason.
    Failed,
    /// A person cancelled it.
    Cancelled,
}

impl JobState {
    /// All states, in the order of a job's life.
    pub const ALL: [JobState; 8] = [
        JobState::Previewing,
        JobState::Profiling,
        JobState::Quoted,
        JobState::Booked,
        JobState::Rendering,
        JobState::Done,
        JobState::Failed,
        JobState::Cancelled,
    ];

    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            JobState::Previewing => "previewing",
            JobState::Profiling => "profiling",
            JobState::Quoted => "quoted",
            JobState::Booked => "booked",
            JobState::Rendering => "rendering",
            JobState::Done => "done",
            JobState::Failed => "failed",
            JobState::Cancelled => "cancelled",
        }
    }

    /// Whether a plan books the job.
    pub const fn is_booked(self) -> bool {
        matches!(self, JobState::Booked | JobState::Rendering)
    }

    /// Whether the state can no longer change.
    pub const fn is_final(self) -> bool {
        matches!(self, JobState::Done | JobState::Failed | JobState::Cancelled)
    }
}

impl fmt::Display for JobState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
