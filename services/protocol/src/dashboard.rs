//! The one document that a farm dashboard needs.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    Booking, Event, JobId, JobState, LiveForecast, Money, MoneyQuantiles, Node, Promise, QuantileHits,
    Quantiles, SeedProgress, TaskId, TaskKind, Timestamp, Verdict, Waits,
};

/// Tasks by state.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct TaskCounts {
    /// Waiting for others: frames, for the irradiance cache that they share.
    #[serde(default)]
    pub waiting: u64,
    /// To be handed out.
    pub ready: u64,
    /// With workers.
    pub leased: u64,
    /// Committed.
    pub done: u64,
    /// Failed too often.
    pub failed: u64,
    /// No longer wanted.
    pub cancelled: u64,
}

/// The farm in numbers.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct DashboardCounts {
    /// Jobs that are not final.
    pub jobs_active: u64,
    /// Jobs done.
    pub jobs_done: u64,
    /// Jobs failed.
    pub jobs_failed: u64,
    /// Jobs cancelled.
    pub jobs_cancelled: u64,
    /// Tasks by state.
    pub tasks: TaskCounts,
    /// Nodes heard of within the last three lease times that are neither draining nor set aside.
    pub nodes_alive: u64,
    /// All nodes.
    pub nodes: u64,
}

/// A job as the dashboard shows it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct DashboardJob {
    /// Its id.
    pub id: JobId,
    /// Its name.
    pub name: String,
    /// The project that it is booked on.
    pub project: String,
    /// Where it stands.
    pub state: JobState,
    /// Frames in all.
    pub frames_total: u32,
    /// Frames that are there.
    pub frames_done: u32,
    /// The part of the forecast work that is done, 0 to 1.
    pub progress: f64,
    /// How far the irradiance cache is that its frames share and wait for; absent if they do not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<SeedProgress>,
    /// When it has to be there.
    pub deadline: Option<Timestamp>,
    /// Whether it can be had as asked for.
    pub verdict: Option<Verdict>,
    /// When the last frame is expected.
    pub eta: Option<Timestamp>,
    /// Why it has not begun, or does not go on because nobody quotes it or there is no room.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waits: Option<Waits>,
    /// What is left of its promise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub promise: Option<Promise>,
    /// What its bookings cost.
    pub booked_cost: Option<Money>,
    /// The most that it may cost.
    pub budget: Option<Money>,
    /// Forecast total work.
    pub work: Option<Quantiles>,
    /// Forecast total CPU seconds.
    pub cpu_seconds: Option<Quantiles>,
    /// Forecast total in money.
    pub cost: Option<MoneyQuantiles>,
    /// What it will have cost, as far as its frames are finished; absent until booked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub live: Option<LiveForecast>,
}

/// What a node does right now.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NodeActivity {
    /// The task.
    pub task_id: TaskId,
    /// Its kind.
    pub kind: TaskKind,
    /// Its job.
    pub job_id: JobId,
    /// Its frame.
    pub frame: Option<u32>,
    /// How far it is, 0 to 1.
    pub progress: f64,
    /// Since when.
    pub started: Timestamp,
}

/// A node as the dashboard shows it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct DashboardNode {
    /// The node.
    pub node: Node,
    /// Whether it was heard of within the last three lease times.
    pub alive: bool,
    /// What it does; absent if it is idle.
    pub activity: Option<NodeActivity>,
}

/// The farm at one instant.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Dashboard {
    /// When this was read. All of it was read in one transaction.
    pub at: Timestamp,
    /// The id of the newest event that this document takes into account: subscribe from here.
    pub last_event_id: i64,
    /// The farm in numbers.
    pub counts: DashboardCounts,
    /// The jobs that are not final and the newest that are: at most 200.
    pub jobs: Vec<DashboardJob>,
    /// The nodes, at most 1000.
    pub nodes: Vec<DashboardNode>,
    /// The open bookings by start, at most 1000.
    pub bookings: Vec<Booking>,
    /// The newest events, newest first, at most 50.
    pub events: Vec<Event>,
    /// Finished frames that had a forecast.
    pub track_frames: u64,
    /// How many of these had their work at or below the forecast quantiles.
    pub track_work_hits: QuantileHits,
    /// Mean absolute relative error of the work forecasts; absent without finished frames.
    pub track_work_error: Option<f64>,
}
