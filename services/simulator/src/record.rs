//! What happened, in order.

use forelight_planner::Task;
use serde::Serialize;

/// Everything that happened under one policy.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Record {
    /// In the order in which they were handed out; the place is the fencing token.
    pub attempts: Vec<Attempt>,
    /// In the order in which they ended.
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
    /// What of the job.
    pub task: Task,
    /// When work began; a set-up comes before.
    pub start: i64,
    /// When it ended, whatever the outcome.
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

/// A stretch of time for which a node was paid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Rented {
    /// The node's id.
    pub node: u64,
    /// First instant; a set-up begins here.
    pub start: i64,
    /// The end of the last attempt.
    pub end: i64,
    /// Whether it began with a set-up.
    pub setup: bool,
    /// Micro-units: [`forelight_planner::Node::price`].
    pub cost: i64,
}

/// What came of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct JobRecord {
    /// The job's id.
    pub job: u64,
    /// Whether its deadline was promised.
    pub promised: bool,
    /// When its last frame was done.
    pub finish: Option<i64>,
    /// When it was withdrawn, if it was before it was done.
    pub withdrawn: Option<i64>,
}
