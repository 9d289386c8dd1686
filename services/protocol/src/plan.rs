//! Plans and bookings.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{BookingId, Confidence, JobId, Money, NodeId, PageToken, PlanEffect, PlanId, Timestamp};

/// Why a plan was made.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlanReason {
    /// A job got its forecast.
    JobForecast,
    /// Something happened that the plan before it did not know of: see `causes`.
    Events,
}

impl PlanReason {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            PlanReason::JobForecast => "job_forecast",
            PlanReason::Events => "events",
        }
    }
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
    /// The cheapest ways out, at most three, if it cannot be had as asked for.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ways_out: Vec<PlanEffect>,
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

/// A plan. It never changes. It holds the jobs that it books; all others are booked as the plans before it say.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Plan {
    /// Its id.
    pub id: PlanId,
    /// The plan before it; absent for the first.
    pub parent_id: Option<PlanId>,
    /// Why it was made.
    pub reason: PlanReason,
    /// What had happened, a line each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub causes: Vec<String>,
    /// When it was made.
    pub created_at: Timestamp,
    /// Its word on each job that it books.
    pub verdicts: Vec<JobVerdict>,
    /// What it books, by start: all frames of its jobs. Frames that were rendered, or with a worker, when it was made stand as they were
    /// booked before.
    pub bookings: Vec<Booking>,
    /// What it books for irradiance caches that frames share, by start.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub seeds: Vec<SeedBooking>,
}

/// A plan in a list.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PlanSummary {
    /// Its id.
    pub id: PlanId,
    /// The plan before it; absent for the first.
    pub parent_id: Option<PlanId>,
    /// Why it was made.
    pub reason: PlanReason,
    /// What had happened, a line each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub causes: Vec<String>,
    /// When it was made.
    pub created_at: Timestamp,
    /// How many frames it books.
    pub bookings: u64,
}

/// One page of plans, newest first.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PlanPage {
    /// The plans.
    pub items: Vec<PlanSummary>,
    /// Where the next page starts; absent on the last.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}

/// Where a frame is booked.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FramePlace {
    /// The node.
    pub node_id: NodeId,
    /// Its name.
    pub node: String,
    /// From when.
    pub start: Timestamp,
    /// Until when (exclusive).
    pub end: Timestamp,
}

/// A frame that a plan books elsewhere, for the first time, or not any more.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameMove {
    /// The job.
    pub job_id: JobId,
    /// The frame.
    pub frame: u32,
    /// Where it was; absent if it had no booking.
    pub before: Option<FramePlace>,
    /// Where it is; absent if it has none any more.
    pub after: Option<FramePlace>,
}

/// What a plan says of a job, and what the plan before it said.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct VerdictChange {
    /// The job.
    pub job_id: JobId,
    /// Its name.
    pub name: String,
    /// What was said; absent if it was not booked before.
    pub before: Option<JobVerdict>,
    /// What is said.
    pub after: JobVerdict,
}

/// What a plan changed.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PlanDifference {
    /// The plan.
    pub plan_id: PlanId,
    /// The plan before it; absent for the first.
    pub parent_id: Option<PlanId>,
    /// What had happened, a line each.
    pub causes: Vec<String>,
    /// The whole in words, a line each.
    pub words: Vec<String>,
    /// Of the jobs that it books, those of which it says something else.
    pub jobs: Vec<VerdictChange>,
    /// Frames that it moved, added or took away, by job and frame.
    pub frames: Vec<FrameMove>,
    /// Frames of its jobs that stayed where they were.
    pub unmoved: u64,
    /// What its jobs cost more, or, if negative, less.
    pub added_cost: Money,
}
