//! The planner's types, and the definitions that the method and the verifier share.
//!
//! Instants are microseconds UTC, money is micro-units of one currency, work is a count of operations. All
//! are integers. Products use 128 bits, and sums saturate.

mod check;
mod farm;
mod input;
mod job;
mod plan;
mod units;

pub use check::InputError;
pub use farm::{FixedBooking, Interval, Node, Power};
pub use input::Input;
pub use job::{Confidence, Division, Frame, Job, Project, SharedCache, Usage, WorkTotal};
pub use plan::{
    Booking, Bound, Infeasible, JobPlan, Plan, PlanId, Prices, Proof, Rental, Reserved, Task, Verdict,
};

pub(crate) use farm::price_of;
pub(crate) use units::{MICROSECONDS_PER_HOUR, in_millionths};
