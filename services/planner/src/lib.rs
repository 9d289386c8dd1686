//! Plans: which node renders which frame from when to when, whether the deadlines hold, and what it costs.
//!
//! Pure: no I/O, no clock, no chance. The crate's `README.md` states the properties that are wanted, the
//! abstraction, and the method, in this order; the files follow it.
//!
//! * `model`: farm, jobs, plan, and the definitions that method and verifier share (bought work, duration,
//!   cost);
//! * `calendar`: the free time of a node;
//! * `bound`: what no plan can beat;
//! * `schedule`: the method, behind [`plan`];
//! * `verify`: an independent check of any plan, behind [`verify`].
//!
//! ```
//! use forelight_planner::{Confidence, Frame, Input, Interval, Job, Node, Verdict, WorkTotal, plan, verify};
//!
//! let node = Node {
//!     id: 1,
//!     name: "night-1".into(),
//!     speed: 1_000,
//!     price_per_hour: 2_000_000,
//!     available_from: 0,
//!     calendar: vec![Interval { start: 0, end: None }],
//! };
//! let job = Job {
//!     id: 7,
//!     release: 0,
//!     deadline: Some(10_000_000),
//!     priority: 0,
//!     confidence: Confidence::P80,
//!     total: WorkTotal { p50: 4_000, p80: 5_000, p95: 7_000 },
//!     frames: vec![Frame { number: 0, work: 1_000 }, Frame { number: 1, work: 3_000 }],
//!     budget: None,
//! };
//! let input = Input { nodes: vec![node], fixed: vec![], jobs: vec![job] };
//! let found = plan(&input)?;
//! assert_eq!(verify(&input, &found), Ok(()));
//! assert_eq!(found.jobs[0].verdict, Verdict::Feasible { finish: 5_000_000, slack: 5_000_000 });
//! # Ok::<(), forelight_planner::InputError>(())
//! ```

mod bound;
mod calendar;
mod model;
mod schedule;
mod verify;

pub use model::{
    Booking, Bound, Confidence, FixedBooking, Frame, Input, InputError, Interval, Job, JobPlan, Node, Plan,
    Verdict, WorkTotal,
};
pub use schedule::plan;
pub use verify::{Violation, verify};
