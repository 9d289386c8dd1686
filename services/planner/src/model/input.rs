//! Everything that a plan depends on.

use serde::{Deserialize, Serialize};

use super::farm::{FixedBooking, Node};
use super::job::{Job, Project};
use super::plan::Booking;

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
