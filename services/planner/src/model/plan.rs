//! What a plan says.

use serde::{Deserialize, Serialize};

/// A plan. It never changes; a new one takes its place and names it as its parent.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Plan {
    /// The plan in whose place this one came.
    pub parent: Option<PlanId>,
    /// What is rendered where and when, by start, node, job and task.
    pub bookings: Vec<Booking>,
    /// What is paid for, by node and start. Every booking lies in one rental of its node.
    pub rentals: Vec<Rental>,
    /// What the plan means for each job, by job.
    pub jobs: Vec<JobPlan>,
    /// Cost of all rentals in micro-units.
    pub cost: i64,
    /// When no plan could be done earlier, for all jobs together, given the fixed bookings; empty without jobs.
    pub bound: Bound,
    /// What no plan can cost less than, if it meets the deadlines that this one meets, in micro-units.
    pub cost_bound: i64,
    /// Why nothing can be cheaper: the value of these prices is `cost_bound`.
    pub proof: Proof,
    /// Why no plan can meet all deadlines, where that is known.
    pub infeasible: Option<Infeasible>,
}

/// Identity of a plan: a digest of what it says, so that equal plans have equal identities.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PlanId(pub u64);

impl std::fmt::Display for PlanId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

impl Plan {
    /// The plan's identity: the first eight bytes of the BLAKE3 digest of its parent and bookings.
    pub fn id(&self) -> PlanId {
        let mut digest = blake3::Hasher::new();
        digest.update(&self.parent.map_or(0, |parent| parent.0).to_le_bytes());
        for booking in &self.bookings {
            let (kind, frame, part, parts) = match booking.task {
                Task::SharedCache => (0u32, 0, 0, 0),
                Task::SharedCachePart { part, parts } => (3, 0, part, parts),
                Task::Frame(frame) => (1, frame, 0, 1),
            };
            digest.update(&booking.start.to_le_bytes());
            digest.update(&booking.end.to_le_bytes());
            digest.update(&booking.node.to_le_bytes());
            digest.update(&booking.job.to_le_bytes());
            digest.update(&frame.to_le_bytes());
            [kind, part, parts].iter().for_each(|number| {
                digest.update(&number.to_le_bytes());
            });
        }
        let mut first = [0; 8];
        first.copy_from_slice(&digest.finalize().as_bytes()[..8]);
        PlanId(u64::from_le_bytes(first))
    }

    /// What the plan means for a job.
    pub fn job(&self, id: u64) -> Option<&JobPlan> {
        self.jobs.iter().find(|job| job.job == id)
    }

    /// The bookings of the job's shared cache and frames.
    pub fn bookings_of(&self, job: u64) -> impl Iterator<Item = &Booking> {
        self.bookings.iter().filter(move |booking| booking.job == job)
    }
}

/// What is done in one go on one node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Task {
    /// What comes before all frames.
    SharedCache,
    /// A part of what comes before all frames.
    SharedCachePart {
        /// Which part, from zero.
        part: u32,
        /// Into how many parts the shared cache is split.
        parts: u32,
    },
    /// A frame, by its number.
    Frame(i64),
}

impl Task {
    /// The frame that it belongs to; none for a shared cache.
    pub fn frame(self) -> Option<i64> {
        match self {
            Task::SharedCache | Task::SharedCachePart { .. } => None,
            Task::Frame(frame) => Some(frame),
        }
    }

    /// Whether it is a shared cache or a part of one.
    pub fn is_shared_cache(self) -> bool {
        self.frame().is_none()
    }
}

impl std::fmt::Display for Task {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Task::SharedCache => write!(f, "shared cache"),
            Task::SharedCachePart { part, parts } => write!(f, "shared cache, part {} of {parts}", part + 1),
            Task::Frame(frame) => write!(f, "frame {frame}"),
        }
    }
}

/// A node reserved for one task, from `start` to just before `end`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Booking {
    /// First instant.
    pub start: i64,
    /// The node.
    pub node: u64,
    /// The job.
    pub job: u64,
    /// What of the job.
    pub task: Task,
    /// The instant after the last.
    pub end: i64,
}

/// A stretch of time for which a node is paid, from `start` to just before `end`: its set-up, frames, and the
/// idle time between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Rental {
    /// The node.
    pub node: u64,
    /// First instant; a set-up begins here.
    pub start: i64,
    /// The end of the last frame.
    pub end: i64,
    /// Whether it begins with a set-up. It need not if the node runs already: because it is on, or because a
    /// fixed booking ends just then.
    pub setup: bool,
    /// See [`super::Node::price`].
    pub cost: i64,
}

/// What the plan means for a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobPlan {
    /// The job.
    pub job: u64,
    /// Whether and when it is done.
    pub verdict: Verdict,
    /// Its part of the rentals' cost in micro-units, in proportion to time.
    pub cost: i64,
    /// Whether that is within its budget, if it has one.
    pub within_budget: Option<bool>,
    /// What no plan can beat for this job, even if it had the whole farm but for the fixed bookings.
    pub bound: Bound,
}

/// Whether a job is done in time. A job without frames is done at its release, or when its shared cache is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Verdict {
    /// All frames end by the deadline.
    Feasible {
        /// End of the last frame.
        finish: i64,
        /// Microseconds left before the deadline.
        slack: i64,
    },
    /// There is no deadline.
    NoDeadline {
        /// End of the last frame.
        finish: i64,
    },
    /// The last frame ends after the deadline.
    Late {
        /// End of the last frame in this plan.
        finish: i64,
        /// Microseconds after the deadline.
        by: i64,
        /// Whether no plan at all could be in time: the job's bound is after the deadline.
        unavoidable: bool,
    },
    /// Some frames fit into no free time of any node.
    Unplaced {
        /// Numbers of the frames without a booking, in order.
        frames: Vec<i64>,
        /// Whether the shared cache has none either.
        shared_cache: bool,
    },
}

impl Verdict {
    /// End of the last frame, if all have a place.
    pub fn finish(&self) -> Option<i64> {
        match self {
            Verdict::Feasible { finish, .. }
            | Verdict::NoDeadline { finish }
            | Verdict::Late { finish, .. } => Some(*finish),
            Verdict::Unplaced { .. } => None,
        }
    }

    /// Whether the job keeps its deadline, or has none and a place for every frame.
    pub fn is_kept(&self) -> bool {
        matches!(self, Verdict::Feasible { .. } | Verdict::NoDeadline { .. })
    }
}

/// Earliest conceivable ends. None stands for never.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bound {
    /// When all nodes together, working without a gap in their free time, would have done all the work (Σ w /
    /// Σ s).
    pub by_capacity: Option<i64>,
    /// When the longest frame would end on the node that finishes it first.
    pub by_longest_frame: Option<i64>,
}

impl Bound {
    /// The later of the two; none if either is never.
    pub fn earliest_finish(&self) -> Option<i64> {
        Some(self.by_capacity?.max(self.by_longest_frame?))
    }
}

/// Prices of time that prove a bound: no plan can be cheaper than what its work would at least cost if free time
/// had these prices on top of its own, less what all free time would then bring in (weak duality of linear
/// programming).
///
/// Slot i is the time from `slots[i]` to just before `slots[i + 1]`; there is one price fewer than instants.
/// Outside of all slots, prices are zero.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proof {
    /// Instants, rising.
    pub slots: Vec<i64>,
    /// Prices of node time.
    pub nodes: Vec<Prices>,
}

/// What an hour is worth, slot by slot, on top of what it costs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Prices {
    /// The nodes that have these prices.
    pub of: Vec<u64>,
    /// Micro-units per hour by slot; not negative.
    pub per_hour: Vec<i64>,
}

/// Why no plan meets all deadlines: at the prices of `proof`, the work that has to be done by then is worth more than all
/// free time.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Infeasible {
    /// The prices; node time costs nothing but them.
    pub proof: Proof,
    /// The jobs that compete for what is too little: their work is worth something at these prices.
    pub jobs: Vec<u64>,
    /// Where it is too little.
    pub short: Vec<Reserved>,
}

/// Time on some nodes that is fully needed.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reserved {
    /// The nodes.
    pub nodes: Vec<u64>,
    /// First instant.
    pub start: i64,
    /// The instant after the last.
    pub end: i64,
}
