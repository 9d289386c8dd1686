//! What happened, in order.

use forelight_planner::Task;
use serde::Serialize;

/// Everything that happened under one policy.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Record {
    /// In order of their leases. The index is the fencing token.
    pub attempts: Vec<Attempt>,
    /// In order of their ends.
    pub rentals: Vec<Rented>,
    /// By job id.
    pub jobs: Vec<JobRecord>,
    /// Node failures.
    pub failures: u64,
    /// When the last job was done or withdrawn, or the simulation's end.
    pub end: i64,
}

/// One task, handed to one node once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Attempt {
    /// The node's id.
    pub node: u64,
    /// The job's id.
    pub job: u64,
    /// The task of the job.
    pub task: Task,
    /// When work began, after any set-up.
    pub start: i64,
    /// End, whatever the outcome.
    pub end: i64,
    /// How it ended.
    pub outcome: Outcome,
}

/// How an attempt ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// It still runs.
    Running,
    /// The task is done.
    Done,
    /// The node died.
    Lost,
    /// The node's window closed.
    Evicted,
    /// The job was withdrawn.
    Withdrawn,
}

/// An interval for which a node was paid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Rented {
    /// The node's id.
    pub node: u64,
    /// Start, with any set-up.
    pub start: i64,
    /// End of the last attempt.
    pub end: i64,
    /// Whether it began with a set-up.
    pub setup: bool,
    /// In micro-units, see [`forelight_planner::Node::price`].
    pub cost: i64,
}

/// Outcome of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct JobRecord {
    /// The job's id.
    pub job: u64,
    /// Whether its deadline was promised.
    pub promised: bool,
    /// When its last frame was done.
    pub finish: Option<i64>,
    /// When it was withdrawn before it was done.
    pub withdrawn: Option<i64>,
}
