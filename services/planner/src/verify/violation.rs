//! Violations that the verifier finds.

use crate::model::{Booking, InputError, Rental, Task};

/// Something that is wrong with a plan.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Violation {
    /// The input itself is invalid.
    #[error("the input is invalid: {0}")]
    Input(#[from] InputError),
    /// A booking names an unknown node, job or task.
    #[error("job {}, {} on node {}: no such job, task or node", .0.job, .0.task, .0.node)]
    Unknown(Booking),
    /// A task has more than one booking, or is both booked and listed as unplaced.
    #[error("job {job}, {task} is booked twice, or both booked and listed as unplaced")]
    Twice {
        /// The job.
        job: u64,
        /// The task.
        task: Task,
    },
    /// A task is neither booked nor listed as unplaced.
    #[error("job {job}, {task} is neither booked nor listed as unplaced")]
    Missing {
        /// The job.
        job: u64,
        /// The task.
        task: Task,
    },
    /// An unplaced task does not belong to the job.
    #[error("job {job} lists {task} as unplaced, but has no such task")]
    UnknownUnplaced {
        /// The job.
        job: u64,
        /// The task.
        task: Task,
    },
    /// A frame has a number of parts that it may not have, or one that other parts of it do not have.
    #[error("job {}, {} on node {}: the frame may not be divided like this", .0.job, .0.task, .0.node)]
    Division(Booking),
    /// The node cannot do work of this class.
    #[error("job {}, {} on node {}: the node cannot do this class of work", .0.job, .0.task, .0.node)]
    Unfit(Booking),
    /// A booking is not as long as its node needs for the work.
    #[error("job {}, {} on node {}: the booking is not as long as its work", .0.job, .0.task, .0.node)]
    Duration(Booking),
    /// A booking starts before its job's release, or before the plan is made.
    #[error("job {}, {} on node {}: starts before its release", .0.job, .0.task, .0.node)]
    Release(Booking),
    /// A frame starts before the job's shared cache ends.
    #[error("job {}, {} on node {}: starts before the shared cache is filled", .0.job, .0.task, .0.node)]
    Precedence(Booking),
    /// A booking is outside the node's calendar, or before the node is available.
    #[error("job {}, {} on node {}: the node is closed or not yet available", .0.job, .0.task, .0.node)]
    Calendar(Booking),
    /// A booking overlaps another one, or a fixed one, on its node.
    #[error("job {}, {} on node {}: overlaps another booking", .0.job, .0.task, .0.node)]
    Overlap(Booking),
    /// A booking does not lie in exactly one rental, after its set-up.
    #[error("job {}, {} on node {}: is not within one rental", .0.job, .0.task, .0.node)]
    NotRented(Booking),
    /// A rental is outside its node's free time, overlaps another, lacks its set-up, or does not end with a
    /// booking.
    #[error("node {}: the rental from {} to {} {wrong}", .rental.node, .rental.start, .rental.end)]
    Rental {
        /// The rental.
        rental: Rental,
        /// What is wrong, as the end of a sentence.
        wrong: &'static str,
    },
    /// A job has no verdict, or several.
    #[error("job {job} has {verdicts} verdicts")]
    Verdicts {
        /// The job.
        job: u64,
        /// The number of verdicts.
        verdicts: usize,
    },
    /// A verdict names a job that does not exist.
    #[error("a verdict names job {job}, which does not exist")]
    UnknownJob {
        /// The job.
        job: u64,
    },
    /// A verdict contradicts the bookings.
    #[error("job {job}: the verdict contradicts the bookings")]
    Verdict {
        /// The job.
        job: u64,
    },
    /// A job's cost or budget verdict contradicts the rentals.
    #[error(
        "job {job}: the cost is {stated}, but its part of the rentals is {found}, or within_budget is wrong"
    )]
    Cost {
        /// The job.
        job: u64,
        /// Cost in the plan.
        stated: i64,
        /// Its part of the rentals.
        found: i64,
    },
    /// The rentals' costs do not add up to the plan's cost.
    #[error("the plan's cost is {stated}, but its rentals cost {found}")]
    TotalCost {
        /// Cost in the plan.
        stated: i64,
        /// Cost of the rentals.
        found: i64,
    },
    /// Something ends before its lower bound.
    #[error("{}: ends before its lower bound", .job.map_or("the plan".into(), |job| format!("job {job}")))]
    Bound {
        /// The job. `None` for all together.
        job: Option<u64>,
    },
    /// The cost bound does not follow from its proof, or the plan costs less.
    #[error("the cost bound is {stated}, but the proof gives {found}, and the plan costs {cost}")]
    CostBound {
        /// Bound in the plan.
        stated: i64,
        /// What the proof gives.
        found: i64,
        /// What the plan costs.
        cost: i64,
    },
    /// The proof that not all deadlines can be met is not valid.
    #[error("the proof that not all deadlines can be met is not valid")]
    Infeasible,
}
