//! A farm's life, simulated: jobs come in, nodes die and come back, forecasts are wrong, and a policy decides who renders what.
//!
//! Pure and seeded: discrete events, integer time and money, random numbers that are hashes of what they are for. The same
//! world and policy give the same bits, and two policies meet the same jobs, the same true costs and the same failures.
//!
//! * [`World`]: nodes and jobs in the planner's words, and what only the simulator knows: the true work, failures, withdrawals.
//! * [`Farm`]: what happens. It enforces what holds of every farm, whatever the policy: a node does one task at a time, within its
//!   calendar; no frame starts before its shared cache; a lost worker's frame goes back when its lease expires; rented time is paid.
//! * [`Policy`]: who renders what. [`Planned`] is this project's; [`Queue`] is what farm managers do today.
//! * [`Report`]: what came of it.
//! * [`mod@reference`]: farms to measure plans on, and the optimum of small ones.

mod farm;
mod policy;
mod record;
pub mod reference;
mod report;
mod scenario;
mod world;

pub use farm::{Farm, Policy, Refusal, run};
pub use policy::PolicyKind;
pub use policy::planned::Planned;
pub use policy::queue::{Queue, QueueRule};
pub use record::{Attempt, JobRecord, Outcome, Record, Rented};
pub use report::{Report, report};
pub use scenario::{Scenario, studio};
pub use world::{Chances, World};
