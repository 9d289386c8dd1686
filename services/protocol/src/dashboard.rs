//! The document with everything that a farm dashboard shows first.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    Booking, Budget, Event, JobId, JobState, Money, MoneyQuantiles, NodeId, NodeState, PlanId, Promise,
    QuantileHits, SharedCacheProgress, TaskId, TaskKind, Timestamp, Verdict, Waits,
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

/// Number of jobs by state.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct JobCounts {
    /// The frames are being previewed.
    pub previewing: u64,
    /// Some frames are being profiled.
    pub profiling: u64,
    /// The quote is complete, and the job waits to be accepted.
    pub quoted: u64,
    /// Nodes are booked.
    pub booked: u64,
    /// A worker has started a frame.
    pub rendering: u64,
    /// All frames are finished.
    pub done: u64,
    /// A task failed after all attempts.
    pub failed: u64,
    /// A person cancelled it.
    pub cancelled: u64,
}

impl JobCounts {
    /// The number of jobs in a state.
    pub fn of(&mut self, state: JobState) -> &mut u64 {
        match state {
            JobState::Previewing => &mut self.previewing,
            JobState::Profiling => &mut self.profiling,
            JobState::Quoted => &mut self.quoted,
            JobState::Booked => &mut self.booked,
            JobState::Rendering => &mut self.rendering,
            JobState::Done => &mut self.done,
            JobState::Failed => &mut self.failed,
            JobState::Cancelled => &mut self.cancelled,
        }
    }
}

/// Number of nodes by state.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct NodeCounts {
    /// Without a task.
    pub idle: u64,
    /// With a task.
    pub working: u64,
    /// Ordered to pause, not confirmed yet.
    pub pausing: u64,
    /// Paused.
    pub paused: u64,
    /// Finishing their tasks before they stop.
    pub draining: u64,
    /// Drained, without a task.
    pub drained: u64,
    /// Set aside, because too much failed on them.
    pub set_aside: u64,
    /// Silent for too long.
    pub silent: u64,
    /// Asleep by their schedules or maintenance. They also count in one of the other states.
    pub asleep: u64,
}

impl NodeCounts {
    /// The number of nodes in a state.
    pub fn of(&mut self, state: NodeState) -> &mut u64 {
        match state {
            NodeState::Idle => &mut self.idle,
            NodeState::Working => &mut self.working,
            NodeState::Pausing => &mut self.pausing,
            NodeState::Paused => &mut self.paused,
            NodeState::Draining => &mut self.draining,
            NodeState::Drained => &mut self.drained,
            NodeState::SetAside => &mut self.set_aside,
            NodeState::Silent => &mut self.silent,
        }
    }
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
    /// Number of jobs by state.
    #[serde(default)]
    pub jobs: JobCounts,
    /// Open jobs whose promised deadline is at risk.
    #[serde(default)]
    pub promises_at_risk: u64,
    /// Number of tasks by state.
    pub tasks: TaskCounts,
    /// Nodes that sent a request within the last three lease times, and are neither draining nor set aside.
    pub nodes_alive: u64,
    /// All nodes.
    pub nodes: u64,
}

/// An instant that is not known for sure.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FinishQuantiles {
    /// Median.
    pub p50: Timestamp,
    /// 80 % quantile.
    pub p80: Timestamp,
    /// 95 % quantile.
    pub p95: Timestamp,
}

/// An open job on the dashboard.
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
    /// Whether it waits to be accepted once its quote is complete.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub hold: bool,
    /// Whether somebody paused it, so that nothing more of it is started.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub paused: bool,
    /// Number of frames.
    pub frames_total: u32,
    /// Number of finished frames.
    pub frames_done: u32,
    /// Number of frames that were cancelled one by one.
    #[serde(default, skip_serializing_if = "crate::is_zero")]
    pub frames_cancelled: u32,
    /// Share of the forecast work that is done, 0 to 1.
    pub progress: f64,
    /// Progress of the irradiance cache that its frames share. Absent if they do not share one.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "seed")]
    pub shared_cache: Option<SharedCacheProgress>,
    /// Its deadline. Absent if it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadline: Option<Timestamp>,
    /// Whether deadline and budget can be kept, by the newest plan. Absent until it is planned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
    /// Probability that it meets its deadline, 0 to 1, in the scenarios of the newest plan. Of a quote on hold:
    /// if it were accepted now. Absent without a deadline or a plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// Expected finish of the last frame. Of a quote on hold: if it were accepted now.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eta: Option<Timestamp>,
    /// When it will be finished, in the scenarios of the newest plan. Absent if no plan says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<FinishQuantiles>,
    /// Why it waits. Absent if it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waits: Option<Waits>,
    /// The state of its promised deadline. Absent if none was promised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub promise: Option<Promise>,
    /// Cost of its bookings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub booked_cost: Option<Money>,
    /// Its budget. Absent if it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Money>,
    /// Expected total cost: by the live estimate, or as quoted before the job is booked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<MoneyQuantiles>,
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
    /// Name of the job.
    #[serde(default)]
    pub job: String,
    /// Its frame. Absent for tasks about all frames.
    pub frame: Option<u32>,
    /// Progress, 0 to 1.
    pub progress: f64,
    /// When the node started it.
    pub started: Timestamp,
}

/// A node on the dashboard. `/v1/nodes` has all of it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct DashboardNode {
    /// Its id.
    pub id: NodeId,
    /// Its name.
    pub name: String,
    /// Its state.
    pub state: NodeState,
    /// Whether it sent a request within the last three lease times.
    pub alive: bool,
    /// What it is working on. Absent if it is idle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub activity: Option<NodeActivity>,
}

/// What a project spends.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ProjectSpending {
    /// The project.
    pub project: String,
    /// Begin of the present night: noon in the time zone of the project's budget, else in UTC.
    pub night_from: Timestamp,
    /// Cost of node time in the present night so far.
    pub tonight: Money,
    /// Its budgets, with what is spent in their periods.
    pub budgets: Vec<Budget>,
}

/// How many nodes run a version.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct WorkerVersion {
    /// The version of the worker. Absent for nodes that do not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// Number of nodes.
    pub nodes: u64,
}

/// Which versions the farm runs.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct FarmVersions {
    /// The version of the service.
    pub service: String,
    /// The versions of the workers, that of the most nodes first.
    pub workers: Vec<WorkerVersion>,
    /// The newest plan. Absent before the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plan_id: Option<PlanId>,
}

/// The farm at one instant.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Dashboard {
    /// When the document was made. It is read in one transaction, so it is consistent.
    pub at: Timestamp,
    /// Id of the newest event that is taken into account. Subscribe to events from here.
    pub last_event_id: i64,
    /// Which versions the farm runs.
    #[serde(default)]
    pub versions: FarmVersions,
    /// Counts of the farm.
    pub counts: DashboardCounts,
    /// Number of nodes by state.
    #[serde(default)]
    pub node_counts: NodeCounts,
    /// Open jobs: those at risk first, then by deadline. At most 200; `/v1/jobs?open=true` has all.
    pub jobs: Vec<DashboardJob>,
    /// Number of open jobs.
    #[serde(default)]
    pub jobs_open_total: u64,
    /// When the last booked frame of the farm will be finished. Absent if nothing is booked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<FinishQuantiles>,
    /// Projects that have a budget or spent something tonight, by name.
    #[serde(default)]
    pub spending: Vec<ProjectSpending>,
    /// The nodes: those that need somebody first, then those at work, by name. At most 200; `/v1/nodes` has
    /// all.
    pub nodes: Vec<DashboardNode>,
    /// The next open bookings by start, at most 100. `/v1/timeline` has all.
    pub bookings: Vec<Booking>,
    /// The newest events, newest first, at most 20, without those that every task writes: leases, progress,
    /// results, delays.
    pub events: Vec<Event>,
    /// Number of finished frames that had a forecast.
    pub track_frames: u64,
    /// How many of them had their work at or below the forecast quantiles.
    pub track_work_hits: QuantileHits,
    /// Mean absolute relative error of the work forecasts. Absent without finished frames.
    pub track_work_error: Option<f64>,
}

/// The farm in figures: a [`Dashboard`] without its lists. Streams of events tell it when it changed.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FarmSummary {
    /// When it was made.
    pub at: Timestamp,
    /// Id of the newest event that is taken into account.
    pub last_event_id: i64,
    /// Which versions the farm runs.
    pub versions: FarmVersions,
    /// Counts of the farm.
    pub counts: DashboardCounts,
    /// Number of nodes by state.
    pub node_counts: NodeCounts,
    /// When the last booked frame of the farm will be finished. Absent if nothing is booked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<FinishQuantiles>,
    /// Projects that have a budget or spent something tonight, by name.
    pub spending: Vec<ProjectSpending>,
}

impl From<&Dashboard> for FarmSummary {
    fn from(farm: &Dashboard) -> Self {
        Self {
            at: farm.at,
            last_event_id: farm.last_event_id,
            versions: farm.versions.clone(),
            counts: farm.counts,
            node_counts: farm.node_counts,
            finish: farm.finish,
            spending: farm.spending.clone(),
        }
    }
}
