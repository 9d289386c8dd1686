//! What happened on the farm.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{EventId, JobId, JobState, NodeId, OffForecast, PlanId, Promise, TaskId, TaskKind, Timestamp};

/// The kinds of events: also the `event:` field of the server-sent events.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A job was submitted.
    JobCreated,
    /// A job went into another state.
    JobState,
    /// A job's forecast is there.
    ForecastReady,
    /// A job's living estimate has left what is booked for it: `off_forecast` says what and how far.
    JobOffForecast,
    /// It has come back to what is booked.
    JobOnForecast,
    /// A plan was stored.
    PlanStored,
    /// A task was handed to a worker.
    TaskLeased,
    /// A task was handed to Slurm, which is to start a process for it.
    TaskSubmitted,
    /// Slurm ended what it had for a task, and the task is not done; it is handed to Slurm again unless the job failed.
    SubmissionLost,
    /// A worker reported progress.
    TaskProgress,
    /// A task's result was committed.
    TaskDone,
    /// A worker reported an error; the task will be tried again unless the job failed.
    TaskFailed,
    /// A task went back because its lease ran out.
    LeaseExpired,
    /// A task was given back by its worker, or taken back from it by an operator, a budget, or the end of its node's window.
    LeaseReleased,
    /// A worker without a lease spoke up and was refused.
    LeaseLost,
    /// A node was registered or updated.
    NodeRegistered,
    /// A node was given an order, repriced, or brought back.
    NodeChanged,
    /// A node was set aside, because too much failed on it.
    NodeSetAside,
    /// A budget's action came into force, or is over.
    Budget,
    /// What runs the farm's processes, such as Slurm, went away, came back, or refused something.
    EngineState,
    /// A job that was to be ready by its deadline will not be, at its confidence: `promise` says how sure that is, and the cheapest rescue.
    JobPromiseAtRisk,
    /// A job whose promise was at risk will be ready in time after all.
    JobPromiseSafe,
}

impl EventKind {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            EventKind::JobCreated => "job_created",
            EventKind::JobState => "job_state",
            EventKind::ForecastReady => "forecast_ready",
            EventKind::JobOffForecast => "job_off_forecast",
            EventKind::JobOnForecast => "job_on_forecast",
            EventKind::PlanStored => "plan_stored",
            EventKind::TaskLeased => "task_leased",
            EventKind::TaskSubmitted => "task_submitted",
            EventKind::SubmissionLost => "submission_lost",
            EventKind::TaskProgress => "task_progress",
            EventKind::TaskDone => "task_done",
            EventKind::TaskFailed => "task_failed",
            EventKind::LeaseExpired => "lease_expired",
            EventKind::LeaseReleased => "lease_released",
            EventKind::LeaseLost => "lease_lost",
            EventKind::NodeRegistered => "node_registered",
            EventKind::NodeChanged => "node_changed",
            EventKind::NodeSetAside => "node_set_aside",
            EventKind::Budget => "budget",
            EventKind::EngineState => "engine_state",
            EventKind::JobPromiseAtRisk => "job_promise_at_risk",
            EventKind::JobPromiseSafe => "job_promise_safe",
        }
    }
}

/// One event. The fields that do not apply to its kind are absent.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Event {
    /// Its place in the order of events.
    pub id: EventId,
    /// When it happened.
    pub at: Timestamp,
    /// What happened.
    pub kind: EventKind,
    /// The job that it is about.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_id: Option<JobId>,
    /// The state that the job went into.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_state: Option<JobState>,
    /// The task that it is about.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task_id: Option<TaskId>,
    /// That task's kind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task_kind: Option<TaskKind>,
    /// That task's frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u32>,
    /// The node that it is about.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node_id: Option<NodeId>,
    /// The plan that it is about.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plan_id: Option<PlanId>,
    /// How far the task is, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<f64>,
    /// What left the booking or came back to it, with its numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub off_forecast: Option<OffForecast>,
    /// What is left of the job's promise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub promise: Option<Promise>,
    /// A line for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub message: Option<String>,
}
