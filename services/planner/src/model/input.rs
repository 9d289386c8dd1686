//! The planner's input.

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
    /// Booked time that does not move: running frames, and what others were promised.
    pub fixed: Vec<FixedBooking>,
    /// Current bookings of the input's jobs. They are kept where they are still valid, and move only if a
    /// deadline would be missed otherwise.
    pub movable: Vec<Booking>,
    /// The projects that share the farm.
    pub projects: Vec<Project>,
    /// Microseconds after which a project's past use counts half. Zero: it never decays.
    pub half_life: i64,
    /// What is to be rendered.
    pub jobs: Vec<Job>,
}
