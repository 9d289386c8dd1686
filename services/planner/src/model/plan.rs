//! Plans: bookings, rentals, verdicts and proofs.

use serde::{Deserialize, Serialize};

/// A plan. It never changes; a new plan names it as its parent.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Plan {
    /// The plan that this one replaces.
    pub parent: Option<PlanId>,
    /// Every booking, by start, node, job and task.
    pub bookings: Vec<Booking>,
    /// Everything that is paid for, by node and start. Each booking lies in one rental of its node.
    pub rentals: Vec<Rental>,
    /// What the plan means for each job, by job id.
    pub jobs: Vec<JobPlan>,
    /// Cost of all rentals in micro-units.
    pub cost: i64,
    /// The earliest end of all jobs together under any plan, given the fixed bookings. Default without jobs.
    pub bound: Bound,
    /// Lower bound on the cost of any plan that meets the deadlines that this one meets, micro-units.
    pub cost_bound: i64,
    /// Proof of `cost_bound`.
    pub proof: Proof,
    /// Proof that no plan can meet all deadlines, if there is one.
    pub infeasible: Option<Infeasible>,
}

/// Identity of a plan: a digest, so that equal plans have equal identities.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PlanId(pub u64);

impl std::fmt::Display for PlanId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

/// Bytes of a booking in the digest.
const BYTES_OF_BOOKING: usize = 52;

impl Plan {
    /// The plan's identity: the first eight bytes of the BLAKE3 digest of its parent and bookings.
    pub fn id(&self) -> PlanId {
        // In one piece, since many short updates take several times as long.
        let mut bytes = Vec::with_capacity(8 + self.bookings.len() * BYTES_OF_BOOKING);
        bytes.extend(self.parent.map_or(0, |parent| parent.0).to_le_bytes());
        for booking in &self.bookings {
            let (kind, frame, part, parts) = match booking.task {
                Task::SharedCache => (0u32, 0, 0, 0),
                Task::SharedCachePart { part, parts } => (3, 0, part, parts),
                Task::Frame(frame) => (1, frame, 0, 1),
                Task::Part { frame, part, parts } => (2, frame, part, parts),
            };
            let mut record = [0; BYTES_OF_BOOKING];
            let (long, short) = record.split_at_mut(5 * 8);
            let numbers =
                [booking.start, booking.end, booking.node.cast_signed(), booking.job.cast_signed(), frame];
            for (at, number) in long.chunks_exact_mut(8).zip(numbers) {
                at.copy_from_slice(&number.to_le_bytes());
            }
            for (at, number) in short.chunks_exact_mut(4).zip([kind, part, parts]) {
                at.copy_from_slice(&number.to_le_bytes());
            }
            bytes.extend_from_slice(&record);
        }
        let mut first = [0; 8];
        first.copy_from_slice(&blake3::hash(&bytes).as_bytes()[..8]);
        PlanId(u64::from_le_bytes(first))
    }

    /// The entry of a job.
    pub fn job(&self, id: u64) -> Option<&JobPlan> {
        self.jobs.iter().find(|job| job.job == id)
    }
}

/// A piece of a job that one node does in one go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Task {
    /// Work before all frames, in one piece.
    SharedCache,
    /// A part of the work before all frames.
    SharedCachePart {
        /// Which part, from zero.
        part: u32,
        /// The number of parts.
        parts: u32,
    },
    /// A whole frame, by its number.
    Frame(i64),
    /// A part of a frame.
    Part {
        /// Number of the frame.
        frame: i64,
        /// Which part, from zero.
        part: u32,
        /// The number of parts, at least two.
        parts: u32,
    },
}

impl Task {
    /// The frame's number. `None` for work before the frames.
    pub fn frame(self) -> Option<i64> {
        match self {
            Task::SharedCache | Task::SharedCachePart { .. } => None,
            Task::Frame(frame) | Task::Part { frame, .. } => Some(frame),
        }
    }

    /// Whether this is a shared cache or a part of one.
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
            Task::Part { frame, part, parts } => write!(f, "frame {frame}, part {} of {parts}", part + 1),
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
    /// The task.
    pub task: Task,
    /// The instant after the last.
    pub end: i64,
}

/// A stretch of time for which a node is paid, from `start` to just before `end`: set-up, bookings, and the
/// idle time between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Rental {
    /// The node.
    pub node: u64,
    /// First instant. A set-up begins here.
    pub start: i64,
    /// End of the last booking.
    pub end: i64,
    /// Whether it begins with a set-up. A node that runs already needs none: it is on, or a fixed booking
    /// ends at this instant.
    pub setup: bool,
    /// In micro-units; see [`super::Node::price`].
    pub cost: i64,
}

/// What the plan means for a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobPlan {
    /// The job.
    pub job: u64,
    /// Whether and when it is done.
    pub verdict: Verdict,
    /// Its part of the rentals' cost in micro-units, in proportion to booked time.
    pub cost: i64,
    /// Whether the cost is within the budget. `None` without a budget.
    pub within_budget: Option<bool>,
    /// The earliest end under any plan, even with the whole farm but for the fixed bookings.
    pub bound: Bound,
}

/// Whether a job is done in time. A job without frames ends at its release, or with its shared cache.
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
        /// Whether no plan could be in time: the job's bound is after the deadline.
        unavoidable: bool,
    },
    /// Some tasks fit into no free time of any node.
    Unplaced {
        /// Numbers of the frames without a booking, in order.
        frames: Vec<i64>,
        /// Whether the shared cache, or a part of it, has no booking.
        shared_cache: bool,
    },
}

impl Verdict {
    /// End of the last frame. `None` if a task has no booking.
    pub fn finish(&self) -> Option<i64> {
        match self {
            Verdict::Feasible { finish, .. }
            | Verdict::NoDeadline { finish }
            | Verdict::Late { finish, .. } => Some(*finish),
            Verdict::Unplaced { .. } => None,
        }
    }

    /// Whether the job keeps its deadline, or has none and every task is booked.
    pub fn is_kept(&self) -> bool {
        matches!(self, Verdict::Feasible { .. } | Verdict::NoDeadline { .. })
    }
}

/// Lower bounds on an end. `None`: it never ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bound {
    /// When all nodes together, without a gap in their free time, would have done all the work (Σ w / Σ s).
    pub by_capacity: Option<i64>,
    /// When the longest frame would end on the node that finishes it first.
    pub by_longest_frame: Option<i64>,
}

impl Bound {
    /// The later of the two. `None` if either is.
    pub fn earliest_finish(&self) -> Option<i64> {
        Some(self.by_capacity?.max(self.by_longest_frame?))
    }
}

/// Prices of time that prove a bound by weak duality of linear programming; `proof.rs` states the inequality.
///
/// Slot i is the time from `slots[i]` to just before `slots[i + 1]`, so there is one price fewer than
/// instants. Outside all slots, prices are zero.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proof {
    /// Instants, rising.
    pub slots: Vec<i64>,
    /// Prices of the nodes' time.
    pub nodes: Vec<Prices>,
}

/// What an hour is worth by slot, on top of its price.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Prices {
    /// The nodes that have these prices.
    pub of: Vec<u64>,
    /// Micro-units per hour by slot. Not negative.
    pub per_hour: Vec<i64>,
}

/// Proof that no plan meets all deadlines: at these prices, the work due by the deadlines is worth more than
/// all free time.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Infeasible {
    /// The prices. Nodes themselves cost nothing here.
    pub proof: Proof,
    /// The jobs that compete for scarce time: those whose work has a price.
    pub jobs: Vec<u64>,
    /// Where time is scarce.
    pub short: Vec<Reserved>,
}

/// Time on some nodes that is needed in full.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reserved {
    /// The nodes.
    pub nodes: Vec<u64>,
    /// First instant.
    pub start: i64,
    /// The instant after the last.
    pub end: i64,
}
