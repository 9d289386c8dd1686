//! Validation of inputs.

use std::collections::BTreeSet;

use super::farm::{Interval, Node};
use super::input::Input;
use super::job::Job;

/// The most parts that a frame can be required to have.
const MOST_PARTS: u32 = 1 << 16;

/// Why an input is invalid. Valid demands that cannot be met have a verdict instead.
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
    /// Two projects share an id.
    #[error("project {project} is given twice")]
    DuplicateProject {
        /// The project.
        project: u64,
    },
    /// Two frames of a job share a number.
    #[error("job {job}: frame {frame} is given twice")]
    DuplicateFrame {
        /// The job.
        job: u64,
        /// Number of the frame.
        frame: i64,
    },
    /// A node has no speed.
    #[error("node {node}: the speed must be more than zero")]
    ZeroSpeed {
        /// The node.
        node: u64,
    },
    /// A node has a negative price.
    #[error("node {node}: the price must not be negative, but is {price}")]
    NegativePrice {
        /// The node.
        node: u64,
        /// The price.
        price: i64,
    },
    /// A duration is negative.
    #[error("{what} must not be negative, but is {value} microseconds")]
    NegativeTime {
        /// Which one.
        what: String,
        /// Microseconds.
        value: i64,
    },
    /// An interval of a calendar ends before it starts.
    #[error("node {node}: a calendar interval starts at {start}, after its end at {end}")]
    ReversedInterval {
        /// The node.
        node: u64,
        /// Start of the interval.
        start: i64,
        /// End of the interval.
        end: i64,
    },
    /// A fixed booking ends before it starts.
    #[error("node {node}: a fixed booking starts at {start}, after its end at {end}")]
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
    /// A job belongs to a project that does not exist.
    #[error("job {job} belongs to project {project}, which does not exist")]
    UnknownProject {
        /// The job.
        job: u64,
        /// The project.
        project: u64,
    },
    /// A job's quantiles fall.
    #[error("job {job}: the quantiles of its work must not fall from P50 to P80 to P95")]
    FallingQuantiles {
        /// The job.
        job: u64,
    },
    /// A frame must have too many parts.
    #[error("job {job}: frame {frame} must have {parts} parts, but at most {MOST_PARTS} are possible")]
    TooManyParts {
        /// The job.
        job: u64,
        /// Number of the frame.
        frame: i64,
        /// The number of parts.
        parts: u32,
    },
    /// An event names a node or job that does not exist.
    #[error("the event names {what} {id}, which does not exist")]
    UnknownEvent {
        /// Node or job.
        what: &'static str,
        /// Its identity.
        id: u64,
    },
}

impl Input {
    /// Validates the input.
    ///
    /// # Errors
    /// The first error, in the order projects, nodes, fixed bookings, jobs. Movable bookings are not checked:
    /// invalid ones are dropped later.
    pub fn check(&self) -> Result<(), InputError> {
        let mut projects = BTreeSet::new();
        if let Some(twice) = self.projects.iter().find(|project| !projects.insert(project.id)) {
            return Err(InputError::DuplicateProject { project: twice.id });
        }
        not_negative("the half-life of what projects used", self.half_life)?;
        let mut nodes = BTreeSet::new();
        for node in &self.nodes {
            if !nodes.insert(node.id) {
                return Err(InputError::DuplicateNode { node: node.id });
            }
            check_node(node)?;
        }
        for fixed in &self.fixed {
            if !nodes.contains(&fixed.node) {
                return Err(InputError::UnknownNode { node: fixed.node });
            }
            if fixed.end < fixed.start {
                let (node, start, end) = (fixed.node, fixed.start, fixed.end);
                return Err(InputError::ReversedBooking { node, start, end });
            }
        }
        let mut jobs = BTreeSet::new();
        for job in &self.jobs {
            if !jobs.insert(job.id) {
                return Err(InputError::DuplicateJob { job: job.id });
            }
            if let Some(project) = job.project.filter(|project| !projects.contains(project)) {
                return Err(InputError::UnknownProject { job: job.id, project });
            }
            check_job(job)?;
        }
        Ok(())
    }
}

fn check_node(node: &Node) -> Result<(), InputError> {
    let id = node.id;
    if node.speed == 0 && node.speeds.values().all(|&speed| speed == 0) {
        return Err(InputError::ZeroSpeed { node: id });
    }
    for price in [node.price_per_hour, node.setup_cost] {
        if price < 0 {
            return Err(InputError::NegativePrice { node: id, price });
        }
    }
    for (what, value) in [
        ("billing step", node.billing_step),
        ("minimum booking", node.minimum_booking),
        ("set-up", node.setup),
    ] {
        if value < 0 {
            return Err(InputError::NegativeTime { what: format!("node {id}: the {what}"), value });
        }
    }
    for &Interval { start, end } in node.calendar.iter().chain(&node.maintenance) {
        if let Some(end) = end.filter(|&end| end < start) {
            return Err(InputError::ReversedInterval { node: id, start, end });
        }
    }
    Ok(())
}

fn check_job(job: &Job) -> Result<(), InputError> {
    if job.total.p50 > job.total.p80 || job.total.p80 > job.total.p95 {
        return Err(InputError::FallingQuantiles { job: job.id });
    }
    let mut frames = BTreeSet::new();
    for frame in &job.frames {
        if !frames.insert(frame.number) {
            return Err(InputError::DuplicateFrame { job: job.id, frame: frame.number });
        }
        let parts = frame.division.fewest();
        if parts > MOST_PARTS {
            return Err(InputError::TooManyParts { job: job.id, frame: frame.number, parts });
        }
    }
    Ok(())
}

fn not_negative(what: &str, value: i64) -> Result<(), InputError> {
    if value < 0 { Err(InputError::NegativeTime { what: what.to_owned(), value }) } else { Ok(()) }
}
