//! A simulated farm: jobs, failures, wrong forecasts, and a policy that decides which node renders what.
//!
//! It is a pure simulation of discrete events, with integer time and money and hashes as random numbers. The
//! same world and policy give the same bits. Two policies meet the same jobs, true costs and failures.
//!
//! * [`World`]: nodes and jobs as the planner sees them, and the truth that only the simulator knows.
//! * [`Farm`]: the events. It enforces the rules of every farm, whatever the policy.
//! * [`Policy`]: which node renders what. [`Planned`] is this project's, [`Queue`] is today's farm managers.
//! * [`Report`]: the results.
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
pub use scenario::{Scenario, stills, studio};
pub use world::{Chances, World};
