//! Leases: a worker's hold on a task for a bounded time.
//!
//! A lease carries a *fencing token* (`fence`), which grows with every hand-out of the task. A worker that lost its
//! lease without noticing (it was paused, or cut off) still holds an old token, and everything it says is refused.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

use crate::{JobId, JobState, LeaseId, LogLine, NodeId, TaskId, TaskResult, TaskSpec, Timestamp};

/// Most bytes of a checkpoint, the finished tiles of a frame: about a million pixels. Larger frames have none.
pub const CHECKPOINT_BYTES: usize = 64 << 20;

/// A worker asks for a task.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ClaimRequest {
    /// The node that asks.
    pub node_id: NodeId,
    /// How long to wait for a task if there is none, in milliseconds: 0 to 60000.
    #[serde(default)]
    #[schema(default = 0, maximum = 60000)]
    pub wait_ms: u32,
    /// The one task that is wanted, by a process that was started for it; whoever placed it there has decided that this node does
    /// it. Waits while another worker holds the task; a conflict once it is over. Absent: whatever is next.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task_id: Option<TaskId>,
    /// The number under which the process registered. If another has taken the node over since, that is a conflict.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub worker: Option<Uuid>,
}

/// A task in a worker's hands.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Lease {
    /// Its id.
    pub lease_id: LeaseId,
    /// The task.
    pub task_id: TaskId,
    /// The task's job.
    pub job_id: JobId,
    /// The fencing token: belongs into everything that is said about the lease.
    pub fence: u64,
    /// When the lease ends unless it is renewed, by the service's clock.
    pub expires_at: Timestamp,
    /// For how long each renewal holds, in milliseconds. Renew three times as often.
    pub ttl_ms: u64,
    /// What to do.
    pub spec: TaskSpec,
    /// What it may use at most.
    #[serde(default, skip_serializing_if = "TaskLimits::are_none")]
    pub limits: TaskLimits,
}

/// What a task of a job may use at most. These are limits, not forecasts: the worker ends a task that goes beyond, and says by which
/// limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskLimits {
    /// Resident memory of the worker's process while it does the task, in bytes, 2²⁰ or more; absent: no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1_048_576)]
    pub memory_bytes: Option<u64>,
    /// Wall time of one attempt in milliseconds, pauses not counted, 1 or more; absent: no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1)]
    pub wall_ms: Option<u64>,
}

impl TaskLimits {
    /// Whether nothing is limited.
    pub fn are_none(&self) -> bool {
        *self == Self::default()
    }

    /// The stricter of both, limit by limit.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let stricter = |a: Option<u64>, b: Option<u64>| a.into_iter().chain(b).min();
        Self {
            memory_bytes: stricter(self.memory_bytes, other.memory_bytes),
            wall_ms: stricter(self.wall_ms, other.wall_ms),
        }
    }
}

/// Which of the limits a task went beyond.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskLimit {
    /// Resident memory.
    Memory,
    /// Wall time.
    WallTime,
}

/// A worker is still at it.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenewRequest {
    /// The fencing token.
    pub fence: u64,
    /// How far it is, 0 to 1.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 1)]
    pub progress: f64,
    /// What the finished pixels of a frame took so far; absent of other tasks, and with an irradiance cache, whose filling costs most.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixels: Option<FinishedPixels>,
    /// Whether it stands still, as it was ordered to.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub paused: bool,
    /// What it had to say since, at most 100 lines.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 100)]
    pub log: Vec<LogLine>,
}

/// How many pixels of a frame are finished, and what they took. With an irradiance cache, from when that is there: the part of the frame that cache and finished pixels
/// are, as so many pixels, and what both took.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FinishedPixels {
    /// Finished pixels, those that were taken over among them: at most `all`.
    pub done: u64,
    /// Pixels of the frame, 1 or more.
    #[schema(minimum = 1)]
    pub all: u64,
    /// Deterministic count of operations of the finished ones.
    pub work: u64,
    /// Their CPU time, in nanoseconds.
    pub cpu_nanos: u64,
}

/// What the worker shall do now.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LeaseOrder {
    /// Carry on.
    Continue,
    /// Stop: the job was cancelled or failed, or the task was taken away. Nothing needs to be sent.
    Stop,
    /// Stand still and keep the lease, until the order is another one.
    Pause,
}

/// The answer to a renewal.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Renewal {
    /// When the lease ends unless it is renewed again.
    pub expires_at: Timestamp,
    /// What to do.
    pub order: LeaseOrder,
    /// Whether this is the node's last task for now: it is being drained.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub drain: bool,
    /// The order to sleep: once this task is over, not to ask for another before then. Absent while the node's window is open.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sleep_until: Option<Timestamp>,
}

/// A worker gives a task back unfinished, for instance because it is being shut down. Does not count as a failure.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReleaseRequest {
    /// The fencing token.
    pub fence: u64,
}

/// What went wrong on the worker.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskError {
    /// One line for people, 1 to 2000 characters.
    #[schema(min_length = 1, max_length = 2000)]
    pub message: String,
    /// Whether trying again would give the same error, as with a malformed scene: the job fails at once.
    #[serde(default)]
    pub permanent: bool,
    /// The limit that the task went beyond, if that is what went wrong.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<TaskLimit>,
}

/// A task's end: exactly one of `result` and `error`.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ResultRequest {
    /// The fencing token.
    pub fence: u64,
    /// What came of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub result: Option<TaskResult>,
    /// Why nothing came of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<TaskError>,
    /// What the worker had to say since its last renewal, at most 100 lines.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 100)]
    pub log: Vec<LogLine>,
}

/// The answer to a task's end. The result is in the database when this is sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ResultAnswer {
    /// Whether the same result had been committed before.
    pub duplicate: bool,
    /// Where the job stood after it.
    pub job_state: JobState,
}
