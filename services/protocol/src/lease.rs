//! Leases: a worker holds a task for a bounded time.
//!
//! The *fencing token* (`fence`) grows with every lease of a task. A paused or isolated worker may lose its
//! lease without noticing; its old token is refused.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

use crate::{JobId, JobState, LeaseId, LogLine, NodeId, TaskId, TaskResult, TaskSpec, Timestamp};

/// Largest size of a checkpoint in bytes, about a million pixels. Larger frames have no checkpoints.
pub const CHECKPOINT_BYTES: usize = 64 << 20;

/// A worker's request for a task.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ClaimRequest {
    /// The worker's node.
    pub node_id: NodeId,
    /// How long to wait for a task if there is none, in milliseconds: 0 to 60000.
    #[serde(default)]
    #[schema(default = 0, maximum = 60000)]
    pub wait_ms: u32,
    /// The only task to lease, for a process started for it. Waits if another worker holds it; a conflict
    /// once it is over. If absent, the service chooses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task_id: Option<TaskId>,
    /// Number with which this process registered. A conflict if another process has taken over the node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub worker: Option<Uuid>,
}

/// A worker's hold on a task.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Lease {
    /// Its id.
    pub lease_id: LeaseId,
    /// The task.
    pub task_id: TaskId,
    /// The task's job.
    pub job_id: JobId,
    /// The fencing token. Send it with every request about the lease.
    pub fence: u64,
    /// When the lease expires unless it is renewed, by the service's clock.
    pub expires_at: Timestamp,
    /// Duration of the lease after each renewal, in milliseconds. Renew it three times in that time.
    pub ttl_ms: u64,
    /// The task to do.
    pub spec: TaskSpec,
    /// Limits on what the task may use.
    #[serde(default, skip_serializing_if = "TaskLimits::are_none")]
    pub limits: TaskLimits,
}

/// Limits on what a task of a job may use. The worker stops a task that exceeds one, and says which.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskLimits {
    /// Growth of the worker's resident memory during the task in bytes, 2²⁰ or more. If absent, unlimited.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1_048_576)]
    pub memory_bytes: Option<u64>,
    /// Wall time of one attempt in milliseconds, 1 or more, without pauses. If absent, there is no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1)]
    pub wall_ms: Option<u64>,
}

impl TaskLimits {
    /// Whether there is no limit.
    pub fn are_none(&self) -> bool {
        *self == Self::default()
    }

    /// The stricter of both, for each limit.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let stricter = |a: Option<u64>, b: Option<u64>| a.into_iter().chain(b).min();
        Self {
            memory_bytes: stricter(self.memory_bytes, other.memory_bytes),
            wall_ms: stricter(self.wall_ms, other.wall_ms),
        }
    }
}

/// The limit that a task exceeded.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskLimit {
    /// Resident memory.
    Memory,
    /// Wall time.
    WallTime,
}

/// A worker's request to renew its lease, with its progress.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenewRequest {
    /// The fencing token.
    pub fence: u64,
    /// Progress, 0 to 1.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 1)]
    pub progress: f64,
    /// Finished pixels of a frame and their cost. Absent for other tasks, and until an irradiance cache is
    /// filled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixels: Option<FinishedPixels>,
    /// Whether the worker is paused, as it was ordered to.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub paused: bool,
    /// Log lines since the last renewal, at most 100.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 100)]
    pub log: Vec<LogLine>,
}

/// Finished pixels of a frame and their cost. A filled irradiance cache counts as a number of pixels, with
/// its work.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FinishedPixels {
    /// Number of finished pixels, including those taken over from profiling. At most `all`.
    pub done: u64,
    /// Number of pixels of the frame, 1 or more.
    #[schema(minimum = 1)]
    pub all: u64,
    /// Work of the finished pixels: deterministic count of operations.
    pub work: u64,
    /// CPU time of the finished pixels, in nanoseconds.
    pub cpu_nanos: u64,
}

/// An order to the worker.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LeaseOrder {
    /// Carry on.
    Continue,
    /// Stop. The job was cancelled or failed, or the task was taken away. No result needs to be sent.
    Stop,
    /// Pause and keep the lease, until another order comes.
    Pause,
}

/// The answer to a renewal.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Renewal {
    /// When the lease expires unless it is renewed again.
    pub expires_at: Timestamp,
    /// The order to the worker.
    pub order: LeaseOrder,
    /// Whether the node is being drained, so that this is its last task for now.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub drain: bool,
    /// The node's next window: ask for no task before. Absent while its window is open.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sleep_until: Option<Timestamp>,
    /// For a part of a frame that takes longer than forecast while nodes are idle: into how many parts the
    /// pixels are divided that are not begun. Finish those that are, and report the rest. Absent otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 2, maximum = 512)]
    pub divide_rest: Option<u32>,
}

/// Returns an unfinished task, for example because the worker stops. It does not count as a failure.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReleaseRequest {
    /// The fencing token.
    pub fence: u64,
}

/// Where the cause of a failure lies, as far as the worker knows. It decides whose fault the failure is.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FailureKind {
    /// The worker does not know.
    #[default]
    Unknown,
    /// The worker's machine: its disk, its memory, its programs.
    Node,
    /// A file that the task needs is gone: its bundle, or an artefact. The service looks for itself.
    Input,
    /// The task: its scene, its settings, its limits.
    Task,
}

impl FailureKind {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            FailureKind::Unknown => "unknown",
            FailureKind::Node => "node",
            FailureKind::Input => "input",
            FailureKind::Task => "task",
        }
    }

    fn is_unknown(&self) -> bool {
        *self == FailureKind::Unknown
    }
}

/// An error of the worker.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskError {
    /// The error as one line of text, 1 to 2000 characters.
    #[schema(min_length = 1, max_length = 2000)]
    pub message: String,
    /// Whether every attempt would fail like this, as with a malformed scene. The job fails once a second
    /// node says so, or after three attempts if there is no other node.
    #[serde(default)]
    pub permanent: bool,
    /// Where the cause lies.
    #[serde(default, skip_serializing_if = "FailureKind::is_unknown")]
    pub kind: FailureKind,
    /// The limit that the task exceeded. Absent if the error has another cause.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<TaskLimit>,
}

/// The end of a task. Exactly one of `result` and `error` must be given.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ResultRequest {
    /// The fencing token.
    pub fence: u64,
    /// The result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub result: Option<TaskResult>,
    /// The error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<TaskError>,
    /// Log lines since the last renewal, at most 100.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 100)]
    pub log: Vec<LogLine>,
}

/// The answer to the end of a task. It is sent after the result is committed to the database.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ResultAnswer {
    /// Whether the same result was committed before.
    pub duplicate: bool,
    /// State of the job afterwards.
    pub job_state: JobState,
}
