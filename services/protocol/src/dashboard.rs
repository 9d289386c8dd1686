//! The document with everything that a farm dashboard shows.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    Booking, Event, JobId, JobState, LiveForecast, Money, MoneyQuantiles, Node, Promise, QuantileHits,
    Quantiles, SharedCacheProgress, TaskId, TaskKind, Timestamp, Verdict, Waits,
};

/// Number of tasks by state.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct TaskCounts {
    /// Waiting for other tasks, for example frames that wait for their shared irradiance cache.
    #[serde(default)]
    pub waiting: u64,
    /// Ready to be handed out.
    pub ready: u64,
    /// Leased by workers.
    pub leased: u64,
    /// Done, with a committed result.
    pub done: u64,
    /// Failed, after all attempts.
    pub failed: u64,
    /// Cancelled.
    pub cancelled: u64,
}

/// Counts of the farm.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct DashboardCounts {
    /// Jobs that are neither done, failed nor cancelled.
    pub jobs_active: u64,
    /// Jobs done.
    pub jobs_done: u64,
    /// Jobs failed.
    pub jobs_failed: u64,
    /// Jobs cancelled.
    pub jobs_cancelled: u64,
    /// Number of tasks by state.
    pub tasks: TaskCounts,
    /// Nodes that sent a request within the last three lease times, and are neither draining nor set aside.
    pub nodes_alive: u64,
    /// All nodes.
    pub nodes: u64,
}

/// A job on the dashboard.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct DashboardJob {
    /// Its id.
    pub id: JobId,
    /// Its name.
    pub name: String,
    /// The project that is charged for it.
    pub project: String,
    /// Its state.
    pub state: JobState,
    /// Number of frames.
    pub frames_total: u32,
    /// Number of finished frames.
    pub frames_done: u32,
    /// Share of the forecast work that is done, 0 to 1.
    pub progress: f64,
    /// Progress of the irradiance cache that its frames share. Absent if they do not share one.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "seed")]
    pub shared_cache: Option<SharedCacheProgress>,
    /// Its deadline. Absent if it has none.
    pub deadline: Option<Timestamp>,
    /// Whether deadline and budget can be kept, by the newest plan. Absent until it is planned.
    pub verdict: Option<Verdict>,
    /// Expected finish of the last frame.
    pub eta: Option<Timestamp>,
    /// Why it waits. Absent if it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waits: Option<Waits>,
    /// The state of its promised deadline. Absent if none was promised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub promise: Option<Promise>,
    /// Cost of its bookings.
    pub booked_cost: Option<Money>,
    /// Its budget. Absent if it has none.
    pub budget: Option<Money>,
    /// Quoted total work.
    pub work: Option<Quantiles>,
    /// Quoted total CPU seconds, on a node of speed 1.
    pub cpu_seconds: Option<Quantiles>,
    /// Quoted total cost.
    pub cost: Option<MoneyQuantiles>,
    /// The live estimate, updated by finished frames. Absent until the job is booked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub live: Option<LiveForecast>,
}

/// The task that a node is working on.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NodeActivity {
    /// The task.
    pub task_id: TaskId,
    /// Its kind.
    pub kind: TaskKind,
    /// Its job.
    pub job_id: JobId,
    /// Its frame. Absent for tasks about all frames.
    pub frame: Option<u32>,
    /// Progress, 0 to 1.
    pub progress: f64,
    /// When the node started it.
    pub started: Timestamp,
}

/// A node on the dashboard.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct DashboardNode {
    /// The node.
    pub node: Node,
    /// Whether it sent a request within the last three lease times.
    pub alive: bool,
    /// What it is working on. Absent if it is idle.
    pub activity: Option<NodeActivity>,
}

/// The farm at one instant.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Dashboard {
    /// When the document was read. It is read in one transaction, so it is consistent.
    pub at: Timestamp,
    /// Id of the newest event that is taken into account. Subscribe to events from here.
    pub last_event_id: i64,
    /// Counts of the farm.
    pub counts: DashboardCounts,
    /// All active jobs, and the newest finished ones: at most 200.
    pub jobs: Vec<DashboardJob>,
    /// The nodes, at most 1000.
    pub nodes: Vec<DashboardNode>,
    /// The open bookings by start, at most 1000.
    pub bookings: Vec<Booking>,
    /// The newest events, newest first, at most 50.
    pub events: Vec<Event>,
    /// Number of finished frames that had a forecast.
    pub track_frames: u64,
    /// How many of them had their work at or below the forecast quantiles.
    pub track_work_hits: QuantileHits,
    /// Mean absolute relative error of the work forecasts. Absent without finished frames.
    pub track_work_error: Option<f64>,
}
