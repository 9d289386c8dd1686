//! What may be wrong with a plan.

use crate::model::{Booking, InputError, Rental, Task};

/// Something that is wrong with a plan.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Violation {
    /// The input itself has no meaning, so no plan can be right.
    #[error("the input has no meaning: {0}")]
    Input(#[from] InputError),
    /// A booking of an unknown node, job or task.
    #[error("job {}, {} on node {}: no such thing", .0.job, .0.task, .0.node)]
    Unknown(Booking),
    /// A task has more than one booking, or is also said to be unplaced.
    #[error("job {job}, {task} is booked twice, or booked and called unplaced")]
    Twice {
        /// The job.
        job: u64,
        /// The task.
        task: Task,
    },
    /// A task is neither booked nor called unplaced.
    #[error("job {job}, {task} is missing")]
    Missing {
        /// The job.
        job: u64,
        /// The task.
        task: Task,
    },
    /// A task is called unplaced although the job has no such task.
    #[error("job {job} has no {task} that could be unplaced")]
    UnknownUnplaced {
        /// The job.
        job: u64,
        /// The task.
        task: Task,
    },
    /// A node cannot do work of this class.
    #[error("job {}, {} on node {}: the node cannot render it", .0.job, .0.task, .0.node)]
    Unfit(Booking),
    /// A booking does not last as long as its node takes for the task's work.
    #[error("job {}, {} on node {}: not as long as its work takes", .0.job, .0.task, .0.node)]
    Duration(Booking),
    /// A booking starts before its job is released, or before the plan is made.
    #[error("job {}, {} on node {}: starts before its release", .0.job, .0.task, .0.node)]
    Release(Booking),
    /// A frame starts before the job's shared cache ends.
    #[error("job {}, {} on node {}: starts before the shared cache is filled", .0.job, .0.task, .0.node)]
    Precedence(Booking),
    /// A booking is not within the node's calendar, or before the node is available.
    #[error("job {}, {} on node {}: the node is not free for rendering", .0.job, .0.task, .0.node)]
    Calendar(Booking),
    /// A booking overlaps another one, or a fixed one, on its node.
    #[error("job {}, {} on node {}: overlaps another booking", .0.job, .0.task, .0.node)]
    Overlap(Booking),
    /// A booking is not within exactly one rental after its set-up.
    #[error("job {}, {} on node {}: is not within one rental", .0.job, .0.task, .0.node)]
    NotRented(Booking),
    /// A rental is not in its node's free time, overlaps another, begins without the set-up that it needs, or is
    /// longer than its frames.
    #[error("node {}: the rental from {} to {} {wrong}", .rental.node, .rental.start, .rental.end)]
    Rental {
        /// The rental.
        rental: Rental,
        /// What is wrong with it.
        wrong: &'static str,
    },
    /// A job has no verdict, or more than one.
    #[error("job {job} has {verdicts} verdicts")]
    Verdicts {
        /// The job.
        job: u64,
        /// How many it has.
        verdicts: usize,
    },
    /// A verdict for a job that does not exist.
    #[error("a verdict names job {job}, which does not exist")]
    UnknownJob {
        /// The job.
        job: u64,
    },
    /// A verdict does not follow from the bookings.
    #[error("job {job}: the verdict is not what the bookings say")]
    Verdict {
        /// The job.
        job: u64,
    },
    /// A job's cost, or whether it is within budget, does not follow from the rentals.
    #[error(
        "job {job}: the cost is {stated}, but its part of the rentals is {found}, or the budget is judged wrongly"
    )]
    Cost {
        /// The job.
        job: u64,
        /// Cost in the plan.
        stated: i64,
        /// Its part of the rentals.
        found: i64,
    },
    /// The costs of the rentals do not add up to the plan's.
    #[error("the plan's cost is {stated}, but its rentals cost {found}")]
    TotalCost {
        /// Cost in the plan.
        stated: i64,
        /// Cost of the rentals.
        found: i64,
    },
    /// Something ends before the bound that nothing can beat.
    #[error("{}: ends before its bound", .job.map_or("the plan".into(), |job| format!("job {job}")))]
    Bound {
        /// The job, or none for all together.
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
    /// The plan says that no plan keeps all deadlines, but does not prove it.
    #[error("the proof that not all deadlines can be met proves nothing")]
    Infeasible,
}
