//! The words of the planner, and the definitions that the method and the verifier share.
//!
//! Instants are microseconds UTC, money is micro-units of one currency, work is a count of operations. All are
//! integers; products are taken in 128 bits and sums that leave the range stay at its end.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

/// Everything that a plan depends on.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Input {
    /// The farm.
    pub nodes: Vec<Node>,
    /// Time that is already given away and stays so: running frames, promises of an earlier plan, maintenance.
    pub fixed: Vec<FixedBooking>,
    /// What is to be rendered.
    pub jobs: Vec<Job>,
}

/// A machine that renders one frame at a time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Node {
    /// Identity, opaque to the planner; ties go to the lower one.
    pub id: u64,
    /// Name for people.
    pub name: String,
    /// Work per second, with all cores; not zero.
    pub speed: u64,
    /// Price of a booked hour in micro-units; not negative.
    pub price_per_hour: i64,
    /// Nothing may start before this instant.
    pub available_from: i64,
    /// When the node is free for rendering, in any order; overlapping and touching intervals count as one.
    pub calendar: Vec<Interval>,
}

/// A half-open interval of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Interval {
    /// First instant.
    pub start: i64,
    /// The instant after the last, or none for an interval without end.
    pub end: Option<i64>,
}

/// Time on a node that is not to be planned again, from `start` to just before `end`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FixedBooking {
    /// The node.
    pub node: u64,
    /// First instant.
    pub start: i64,
    /// The instant after the last.
    pub end: i64,
}

/// Frames to be rendered together.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Job {
    /// Identity, opaque to the planner; ties go to the lower one.
    pub id: u64,
    /// Nothing may start before this instant.
    pub release: i64,
    /// The last frame should end by this instant.
    pub deadline: Option<i64>,
    /// Among equal deadlines the greater priority goes first.
    pub priority: i32,
    /// The quantile of the job's work for which capacity is bought.
    pub confidence: Confidence,
    /// Forecast work of all frames together.
    pub total: WorkTotal,
    /// The frames that are still to be placed.
    pub frames: Vec<Frame>,
    /// What the job may cost, in micro-units.
    pub budget: Option<i64>,
}

/// A frame's forecast.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Frame {
    /// The frame's number, unique in its job.
    pub number: i64,
    /// Median of its work.
    pub work: u64,
}

/// Quantiles of the work of a job. They hold what its frames have in common: not sums of the frames' quantiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkTotal {
    /// As likely to be more as to be less.
    pub p50: u64,
    /// Enough in four cases of five.
    pub p80: u64,
    /// Enough in nineteen cases of twenty.
    pub p95: u64,
}

/// How sure the user wants to be that the capacity is enough.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Confidence {
    /// As likely as not.
    P50,
    /// Four cases of five.
    #[default]
    P80,
    /// Nineteen cases of twenty.
    P95,
}

impl Job {
    /// Work bought for each frame: its median, scaled so that all frames together reach the job's total at
    /// its confidence, and rounded up.
    ///
    /// The forecast error that all frames share does not average out, so the whole job is scaled by one
    /// factor. The sum of the frames' own quantiles would buy too much, the sum of their medians would be
    /// late every other time.
    pub fn bought_work(&self) -> Vec<u64> {
        let total = match self.confidence {
            Confidence::P50 => self.total.p50,
            Confidence::P80 => self.total.p80,
            Confidence::P95 => self.total.p95,
        };
        let medians: u128 = self.frames.iter().map(|frame| u128::from(frame.work)).sum();
        let share = |work: u64| {
            let (part, whole) =
                if medians > 0 { (u128::from(work), medians) } else { (1, self.frames.len() as u128) };
            // The part is at most the whole, so the share is at most the total.
            u64::try_from((part * u128::from(total)).div_ceil(whole)).unwrap_or(u64::MAX)
        };
        self.frames.iter().map(|frame| share(frame.work)).collect()
    }
}

const MICROSECONDS_PER_SECOND: u128 = 1_000_000;
const MICROSECONDS_PER_HOUR: i128 = 3_600_000_000;

/// Work in units of a millionth, in which a node of speed s does s in a microsecond.
pub(crate) fn in_millionths(work: u128) -> u128 {
    work.saturating_mul(MICROSECONDS_PER_SECOND)
}

impl Node {
    /// Microseconds that the node takes for this much work, rounded up. None if that leaves the range of
    /// time, or the node stands still.
    pub fn duration(&self, work: u64) -> Option<i64> {
        (self.speed > 0)
            .then(|| in_millionths(u128::from(work)).div_ceil(u128::from(self.speed)))
            .and_then(|duration| i64::try_from(duration).ok())
    }

    /// Price of this many booked microseconds in micro-units, rounded up for each booking.
    pub fn price(&self, duration: i64) -> i64 {
        let product = i128::from(self.price_per_hour) * i128::from(duration);
        let rounded = (product + MICROSECONDS_PER_HOUR - 1).div_euclid(MICROSECONDS_PER_HOUR);
        i64::try_from(rounded).unwrap_or(i64::MAX)
    }
}

/// A plan. It never changes; a new one takes its place.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Plan {
    /// Every placed frame, by start, node, job and frame.
    pub bookings: Vec<Booking>,
    /// What the plan means for each job, by job.
    pub jobs: Vec<JobPlan>,
    /// Cost of all bookings in micro-units.
    pub cost: i64,
    /// What no plan can beat for all jobs together, given the fixed bookings; empty without jobs.
    pub bound: Bound,
}

/// A node reserved for one frame, from `start` to just before `end`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Booking {
    /// First instant.
    pub start: i64,
    /// The node.
    pub node: u64,
    /// The job.
    pub job: u64,
    /// Number of the frame.
    pub frame: i64,
    /// The instant after the last.
    pub end: i64,
}

/// What the plan means for a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobPlan {
    /// The job.
    pub job: u64,
    /// Whether and when it is done.
    pub verdict: Verdict,
    /// Cost of its bookings in micro-units.
    pub cost: i64,
    /// Whether that is within its budget, if it has one.
    pub within_budget: Option<bool>,
    /// What no plan can beat for this job, even if it had the whole farm but for the fixed bookings.
    pub bound: Bound,
}

/// Whether a job is done in time. A job without frames is done at its release.
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
    },
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

/// Why an input has no meaning. Inputs that merely cannot be met have a verdict instead.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum InputError {
    /// Two nodes share an id.
    #[error("node {node} is given twice")]
    DuplicateNode {
        /// The node.
        node: u64,
    },
    /// Two jobs share an id.
    #[error("job {job} is given twice")]
    DuplicateJob {
        /// The job.
        job: u64,
    },
    /// Two frames of a job share a number.
    #[error("job {job}: frame {frame} is given twice")]
    DuplicateFrame {
        /// The job.
        job: u64,
        /// Number of the frame.
        frame: i64,
    },
    /// A node does no work.
    #[error("node {node}: the speed must be more than zero")]
    ZeroSpeed {
        /// The node.
        node: u64,
    },
    /// A node pays for being used.
    #[error("node {node}: the price must not be negative, but is {price}")]
    NegativePrice {
        /// The node.
        node: u64,
        /// The price.
        price: i64,
    },
    /// An interval of a calendar ends before it starts.
    #[error("node {node}: a calendar interval starts at {start} and ends before, at {end}")]
    ReversedInterval {
        /// The node.
        node: u64,
        /// Start of the interval.
        start: i64,
        /// End of the interval.
        end: i64,
    },
    /// A fixed booking ends before it starts.
    #[error("node {node}: a fixed booking starts at {start} and ends before, at {end}")]
    ReversedBooking {
        /// The node.
        node: u64,
        /// Start of the booking.
        start: i64,
        /// End of the booking.
        end: i64,
    },
    /// A fixed booking is on a node that does not exist.
    #[error("a fixed booking names node {node}, which does not exist")]
    UnknownNode {
        /// The node.
        node: u64,
    },
    /// A job's quantiles fall where they should rise.
    #[error("job {job}: the quantiles of its work must not fall from P50 to P80 to P95")]
    FallingQuantiles {
        /// The job.
        job: u64,
    },
}

impl Input {
    /// Checks that the input has a meaning.
    ///
    /// # Errors
    /// The first thing found wrong, in the order nodes, fixed bookings, jobs.
    pub fn check(&self) -> Result<(), InputError> {
        let mut nodes = BTreeSet::new();
        for node in &self.nodes {
            let id = node.id;
            if !nodes.insert(id) {
                return Err(InputError::DuplicateNode { node: id });
            }
            if node.speed == 0 {
                return Err(InputError::ZeroSpeed { node: id });
            }
            if node.price_per_hour < 0 {
                return Err(InputError::NegativePrice { node: id, price: node.price_per_hour });
            }
            for interval in &node.calendar {
                if let Some(end) = interval.end.filter(|&end| end < interval.start) {
                    return Err(InputError::ReversedInterval { node: id, start: interval.start, end });
                }
            }
        }
        for fixed in &self.fixed {
            if !nodes.contains(&fixed.node) {
                return Err(InputError::UnknownNode { node: fixed.node });
            }
            if fixed.end < fixed.start {
                let FixedBooking { node, start, end } = *fixed;
                return Err(InputError::ReversedBooking { node, start, end });
            }
        }
        let mut jobs = BTreeSet::new();
        for job in &self.jobs {
            if !jobs.insert(job.id) {
                return Err(InputError::DuplicateJob { job: job.id });
            }
            if job.total.p50 > job.total.p80 || job.total.p80 > job.total.p95 {
                return Err(InputError::FallingQuantiles { job: job.id });
            }
            let mut frames = BTreeSet::new();
            if let Some(frame) = job.frames.iter().find(|frame| !frames.insert(frame.number)) {
                return Err(InputError::DuplicateFrame { job: job.id, frame: frame.number });
            }
        }
        Ok(())
    }
}
