//! The words of the planner, and the definitions that the method and the verifier share.
//!
//! Instants are microseconds UTC, money is micro-units of one currency, work is a count of operations. All are
//! integers; products are taken in 128 bits and sums that leave the range stay at its end.

mod check;
mod farm;
mod job;
mod plan;

pub use check::InputError;
pub use farm::{FixedBooking, Interval, Node, Power};
pub use job::{Confidence, Frame, Job, Project, Seed, Usage, WorkTotal};
pub use plan::{
    Booking, Bound, Infeasible, JobPlan, Plan, PlanId, Prices, Proof, Rental, Reserved, Task, Verdict,
};

pub(crate) use farm::price_of;

use serde::{Deserialize, Serialize};

/// Everything that a plan depends on.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Input {
    /// The instant at which the plan is made. Nothing starts before it.
    pub now: i64,
    /// The farm.
    pub nodes: Vec<Node>,
    /// Time that is already given away and stays so: running frames, promises of others.
    pub fixed: Vec<FixedBooking>,
    /// Bookings of jobs of this input as they stand. They are kept where they are still right, and move only
    /// if a deadline would be missed otherwise.
    pub movable: Vec<Booking>,
    /// Who shares the farm.
    pub projects: Vec<Project>,
    /// After this many microseconds, what a project has used counts half. Zero: it counts for ever.
    pub half_life: i64,
    /// What is to be rendered.
    pub jobs: Vec<Job>,
}

pub(crate) const MICROSECONDS_PER_SECOND: u128 = 1_000_000;
pub(crate) const MICROSECONDS_PER_HOUR: i128 = 3_600_000_000;

/// Work in units of a millionth, in which a node of speed s does s in a microsecond.
pub(crate) fn in_millionths(work: u128) -> u128 {
    work.saturating_mul(MICROSECONDS_PER_SECOND)
}
