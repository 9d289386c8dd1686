//! Plans and bookings.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{BookingId, Confidence, JobId, Money, NodeId, PageToken, PlanId, Timestamp};

/// Why a plan was made.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlanReason {
    /// A job got its forecast.
    JobForecast,
}

/// Whether a job can be had as asked for.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// In time and within the budget, at the job's confidence.
    OnTime,
    /// After the deadline.
    Late,
    /// In time, but above the budget.
    OverBudget,
    /// Not at all: there is no node that could do it.
    Impossible,
}

impl Verdict {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Verdict::OnTime => "on_time",
            Verdict::Late => "late",
            Verdict::OverBudget => "over_budget",
            Verdict::Impossible => "impossible",
        }
    }
}

/// A plan's word on one job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct JobVerdict {
    /// The job.
    pub job_id: JobId,
    /// Whether it can be had as asked for.
    pub verdict: Verdict,
    /// The confidence at which this was said.
    pub confidence: Confidence,
    /// When the last frame ends; absent if impossible.
    pub finish: Option<Timestamp>,
    /// What the bookings cost; absent if impossible.
    pub cost: Option<Money>,
    /// The reasons, a line each; what would help, where that is known.
    pub reasons: Vec<String>,
}

/// A node reserved for a frame from one instant to another.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Booking {
    /// Its id.
    pub id: BookingId,
    /// The plan that made it.
    pub plan_id: PlanId,
    /// The job.
    pub job_id: JobId,
    /// The frame.
    pub frame: u32,
    /// The node.
    pub node_id: NodeId,
    /// From when.
    pub start: Timestamp,
    /// Until when (exclusive).
    pub end: Timestamp,
}

/// A node reserved for a part of a job's irradiance cache, before its frames.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct SeedBooking {
    /// The job.
    pub job_id: JobId,
    /// Which part, from 0.
    pub part: u32,
    /// The node.
    pub node_id: NodeId,
    /// From when.
    pub start: Timestamp,
    /// Until when (exclusive).
    pub end: Timestamp,
}

/// One page of bookings that are still open, by start.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BookingPage {
    /// The bookings.
    pub items: Vec<Booking>,
    /// Where the next page starts; absent on the last.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}

/// A plan. It never changes.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Plan {
    /// Its id.
    pub id: PlanId,
    /// The plan before it; absent for the first.
    pub parent_id: Option<PlanId>,
    /// Why it was made.
    pub reason: PlanReason,
    /// When it was made.
    pub created_at: Timestamp,
    /// Its word on each job that it books.
    pub verdicts: Vec<JobVerdict>,
    /// What it books, by start.
    pub bookings: Vec<Booking>,
    /// What it books for irradiance caches that frames share, by start.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub seeds: Vec<SeedBooking>,
}
