//! Leases: a worker's hold on a task for a bounded time.
//!
//! A lease carries a *fencing token* (`fence`), which grows with every hand-out of the task. A worker that lost its
//! lease without noticing (it was paused, or cut off) still holds an old token, and everything it says is refused.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{JobId, JobState, LeaseId, NodeId, TaskId, TaskResult, TaskSpec, Timestamp};

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
}

/// A worker is still at it.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenewRequest {
    /// The fencing token.
    pub fence: u64,
    /// How far it is, 0 to 1.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 1)]
    pub progress: f64,
}

/// What the worker shall do now.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LeaseOrder {
    /// Carry on.
    Continue,
    /// Stop: the job was cancelled or failed. Nothing needs to be sent.
    Stop,
}

/// The answer to a renewal.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Renewal {
    /// When the lease ends unless it is renewed again.
    pub expires_at: Timestamp,
    /// What to do.
    pub order: LeaseOrder,
}

/// A worker gives a task back unfinished, for instance because it is being shut down. Does not count as a failure.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReleaseRequest {
    /// The fencing token.
    pub fence: u64,
}

/// What went wrong on the worker.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskError {
    /// One line for people, 1 to 2000 characters.
    #[schema(min_length = 1, max_length = 2000)]
    pub message: String,
    /// Whether trying again would give the same error, as with a malformed scene: the job fails at once.
    #[serde(default)]
    pub permanent: bool,
}

/// A task's end: exactly one of `result` and `error`.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
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
}

/// The answer to a task's end. The result is in the database when this is sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ResultAnswer {
    /// Whether the same result had been committed before.
    pub duplicate: bool,
    /// Where the job stood after it.
    pub job_state: JobState,
}
