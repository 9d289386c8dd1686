//! Plans: which node renders which frame from when to when, whether the deadlines hold, and what it costs.
//!
//! Pure: no I/O, no clock, no chance. The crate's `README.md` states the properties that are wanted, the
//! abstraction, and the method, in this order; the files follow it.
//!
//! ```
//! use forelight_planner::{Confidence, Frame, Input, Interval, Job, Node, Verdict, WorkTotal, plan, verify};
//!
//! let node = Node {
//!     id: 1,
//!     name: "night-1".into(),
//!     speed: 1_000,
//!     price_per_hour: 2_000_000,
//!     calendar: vec![Interval { start: 0, end: None }],
//!     ..Node::default()
//! };
//! let job = Job {
//!     id: 7,
//!     deadline: Some(10_000_000),
//!     confidence: Confidence::P80,
//!     total: WorkTotal { p50: 4_000, p80: 5_000, p95: 7_000 },
//!     frames: vec![
//!         Frame { number: 0, work: 1_000, ..Frame::default() },
//!         Frame { number: 1, work: 3_000, ..Frame::default() },
//!     ],
//!     ..Job::default()
//! };
//! let input = Input { nodes: vec![node], jobs: vec![job], ..Input::default() };
//! let found = plan(&input)?;
//! assert_eq!(verify(&input, &found), Ok(()));
//! assert_eq!(found.jobs[0].verdict, Verdict::Feasible { finish: 5_000_000, slack: 5_000_000 });
//! # Ok::<(), forelight_planner::InputError>(())
//! ```

mod admission;
mod answers;
mod bound;
mod calendar;
pub mod chance;
mod civil;
mod description;
mod difference;
mod exact;
mod exchange;
mod explain;
mod fairness;
mod gaps;
mod improve;
mod intervals;
mod lane;
mod least;
mod looks;
mod model;
mod outcome;
mod parts;
mod places;
mod pool;
mod problem;
mod proof;
mod rental;
mod replan;
mod rescue;
mod schedule;
mod score;
mod simulate;
mod slots;
mod state;
mod supply;
mod transport;
mod verify;

pub use answers::{
    Change, Effect, Offer, Outlook, changed, curve, earliest_for_budget, effect, kinds, outlook, ways_out,
    what_if,
};
pub use calendar::free_time;
pub use civil::{CalendarError, Weekly, expand};
pub use description::{Description, DescriptionError};
pub use difference::{Difference, JobDifference, difference};
pub use explain::{Explanation, Precedence, Reason, explain};
pub use fairness::decayed_usage;
pub use least::least_cost;
pub use model::{
    Booking, Bound, Confidence, Division, FixedBooking, Frame, Infeasible, Input, InputError, Interval, Job,
    JobPlan, Node, Plan, PlanId, Power, Prices, Project, Proof, Rental, Reserved, SharedCache, Task, Usage,
    Verdict, WorkTotal,
};
pub use replan::{AtRisk, Event, Replanned, mend, replan};
pub use rescue::Rescue;
pub use schedule::{plan, plan_and_count, plan_quickly};
pub use simulate::{JobRisk, Simulation, Stretch, scenarios, simulate};
pub use verify::{Violation, verify};
