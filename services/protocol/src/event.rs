//! Events of the farm.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    EventId, FinishQuantiles, Job, JobId, JobState, Money, MoneyQuantiles, NodeId, NodeState, OffForecast,
    PlanId, Promise, TaskId, TaskKind, Timestamp, Verdict, Waits,
};

/// Kind of an event. It is also the `event:` field of the server-sent events.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A job was submitted.
    JobCreated,
    /// A job changed its state.
    JobState,
    /// A job's deadline, budget or confidence was changed, or frames of it are rendered again or cancelled.
    JobChanged,
    /// A job's quote is complete.
    ForecastReady,
    /// A job's live estimate exceeds what is booked: `off_forecast` has the numbers.
    JobOffForecast,
    /// A job's live estimate is back within what is booked.
    JobOnForecast,
    /// A plan was stored.
    PlanStored,
    /// A task was leased to a worker.
    TaskLeased,
    /// A task was submitted to Slurm, which will start a process for it.
    TaskSubmitted,
    /// Slurm ended the submission of an unfinished task, which is submitted again unless the job failed.
    SubmissionLost,
    /// A worker reported progress.
    TaskProgress,
    /// A task's result was committed.
    TaskDone,
    /// A worker reported an error. The task is tried again unless the job failed.
    TaskFailed,
    /// A task's result was refused, because it is not possible. The task is queued again, and the refusal is
    /// held against the node.
    ResultRefused,
    /// A task takes longer on its node than in 19 of 20 cases.
    TaskLate,
    /// A task makes no progress on its node. It is run on another node as well; the first result counts.
    TaskStalled,
    /// A task's lease expired, and the task was queued again.
    LeaseExpired,
    /// A task was queued again: returned by its worker, or taken away by an operator, a budget or a window's
    /// end.
    LeaseReleased,
    /// A request of a worker was refused, because it no longer holds the lease.
    LeaseLost,
    /// A node was registered or updated.
    NodeRegistered,
    /// A node was drained, paused, repriced, brought back or changed in another way.
    NodeChanged,
    /// A node was set aside, because too many tasks failed on it.
    NodeSetAside,
    /// A node was removed from the farm.
    NodeRemoved,
    /// A budget's action came into force, or ended.
    Budget,
    /// The engine, such as Slurm, became unavailable, came back, or refused a request.
    EngineState,
    /// A job will probably miss its promised deadline. `promise` has the probability and the cheapest rescue.
    JobPromiseAtRisk,
    /// A job whose promise was at risk will probably finish in time after all.
    JobPromiseSafe,
    /// The content of an artefact is missing or has changed. `message` has its hash and what was found.
    ArtifactDamaged,
}

impl EventKind {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            EventKind::JobCreated => "job_created",
            EventKind::JobState => "job_state",
            EventKind::JobChanged => "job_changed",
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
            EventKind::ResultRefused => "result_refused",
            EventKind::TaskLate => "task_late",
            EventKind::TaskStalled => "task_stalled",
            EventKind::LeaseExpired => "lease_expired",
            EventKind::LeaseReleased => "lease_released",
            EventKind::LeaseLost => "lease_lost",
            EventKind::NodeRegistered => "node_registered",
            EventKind::NodeChanged => "node_changed",
            EventKind::NodeSetAside => "node_set_aside",
            EventKind::NodeRemoved => "node_removed",
            EventKind::Budget => "budget",
            EventKind::EngineState => "engine_state",
            EventKind::JobPromiseAtRisk => "job_promise_at_risk",
            EventKind::JobPromiseSafe => "job_promise_safe",
            EventKind::ArtifactDamaged => "artifact_damaged",
        }
    }
}

/// What a finished frame cost.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameCost {
    /// Work: a count of operations.
    pub work: f64,
    /// CPU seconds on a node of speed 1.
    pub cpu_seconds: f64,
}

/// What a job is to be, as far as a person may change it.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct JobTerms {
    /// Whether its quote waits to be accepted.
    pub hold: bool,
    /// Its deadline. Absent if it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadline: Option<Timestamp>,
    /// Its budget. Absent if it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Money>,
    /// Whether somebody paused it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub paused: bool,
}

/// What an event says of its job, so that who shows it need not ask. Absent fields stay as they were.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct JobNews {
    /// Number of frames. Of new jobs only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames_total: Option<u32>,
    /// Its terms, if the event set them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub terms: Option<JobTerms>,
    /// The quoted cost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<MoneyQuantiles>,
    /// The verdict of a plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
    /// Expected finish of the last frame, by a plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eta: Option<Timestamp>,
    /// When it will be finished, in the scenarios of a plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<FinishQuantiles>,
    /// Cost of the bookings of a plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub booked_cost: Option<Money>,
    /// Probability that it meets its deadline, 0 to 1, in the scenarios of a plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// Why it waits, by a plan. A plan without this has it wait for nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waits: Option<Waits>,
}

impl JobNews {
    /// The terms of a job.
    pub fn of_terms(job: &Job) -> Self {
        let terms =
            JobTerms { hold: job.hold, deadline: job.deadline, budget: job.budget, paused: job.paused };
        Self { terms: Some(terms), ..Self::default() }
    }
}

/// One event. Fields that do not apply to its kind are absent.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Event {
    /// Position in the order of events.
    pub id: EventId,
    /// When it happened.
    pub at: Timestamp,
    /// What happened.
    pub kind: EventKind,
    /// The job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_id: Option<JobId>,
    /// The name of the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_name: Option<String>,
    /// The new state of the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_state: Option<JobState>,
    /// The task.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task_id: Option<TaskId>,
    /// Kind of the task.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task_kind: Option<TaskKind>,
    /// Frame of the task.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u32>,
    /// The part of the frame or of the irradiance cache, from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<u32>,
    /// The node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node_id: Option<NodeId>,
    /// The state of the node, as far as it does not depend on the clock.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node_state: Option<NodeState>,
    /// The project of the job, or of the budget.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub project: Option<String>,
    /// Number of the job's finished frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames_done: Option<u32>,
    /// What the finished frame cost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<FrameCost>,
    /// The plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plan_id: Option<PlanId>,
    /// Progress of the task, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<f64>,
    /// The quantity that exceeds what is booked or is back within it, with its numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub off_forecast: Option<OffForecast>,
    /// The state of the job's promise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub promise: Option<Promise>,
    /// What is new about the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job: Option<Box<JobNews>>,
    /// The event as one line of text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub message: Option<String>,
}
