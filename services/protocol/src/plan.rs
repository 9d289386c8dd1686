//! Plans and bookings.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::division::{is_first, is_one, one};
use crate::{
    BookingId, Confidence, FramePart, JobId, Money, NodeId, PageToken, PlanEffect, PlanId, Timestamp,
};

/// Why a plan was made.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlanReason {
    /// A job got its quote.
    JobForecast,
    /// Events made the previous plan outdated: see `causes`.
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

/// Whether a plan keeps the deadline and the budget of a job.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Both are kept, at the job's confidence.
    OnTime,
    /// The deadline is missed.
    Late,
    /// The deadline is kept, but the budget is exceeded: that of the job, or what its project has left.
    OverBudget,
    /// The job cannot be planned: no node could ever do it.
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

/// What a plan says about one job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct JobVerdict {
    /// The job.
    pub job_id: JobId,
    /// Whether deadline and budget are kept.
    pub verdict: Verdict,
    /// The confidence of the verdict.
    pub confidence: Confidence,
    /// When the last frame finishes. Absent if impossible, or if somebody has to raise a budget first.
    pub finish: Option<Timestamp>,
    /// Cost of the bookings. Absent if impossible.
    pub cost: Option<Money>,
    /// The reasons, one line each, with what would help if that is known.
    pub reasons: Vec<String>,
    /// The cheapest changes that would keep deadline and budget, at most three. Empty if they are kept.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ways_out: Vec<PlanEffect>,
}

/// A node that is reserved for a frame, or a part of one, for a period of time.
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
    /// The part of the frame, from 0.
    #[serde(default, skip_serializing_if = "is_first")]
    pub part: u32,
    /// Number of parts of the frame. 1 or absent: it is booked as a whole.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    #[schema(default = 1, minimum = 1, maximum = 512)]
    pub parts: u32,
    /// The node.
    pub node_id: NodeId,
    /// Start of the booking.
    pub start: Timestamp,
    /// End of the booking (exclusive).
    pub end: Timestamp,
}

impl Booking {
    /// What is booked.
    pub const fn frame_part(&self) -> FramePart {
        FramePart { frame: self.frame, part: self.part, parts: self.parts }
    }
}

/// A node that is reserved for a part of a job's shared irradiance cache, before its frames.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct SharedCacheBooking {
    /// The job.
    pub job_id: JobId,
    /// The part, from 0.
    pub part: u32,
    /// The node.
    pub node_id: NodeId,
    /// Start of the booking.
    pub start: Timestamp,
    /// End of the booking (exclusive).
    pub end: Timestamp,
}

/// One page of open bookings, by start.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BookingPage {
    /// The bookings.
    pub items: Vec<Booking>,
    /// Token of the next page. Absent on the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}

fn is_none(number: &u64) -> bool {
    *number == 0
}

/// A plan. It never changes. It contains the jobs that it books; for all others, earlier plans apply.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Plan {
    /// Its id.
    pub id: PlanId,
    /// The previous plan. Absent for the first one.
    pub parent_id: Option<PlanId>,
    /// Why it was made.
    pub reason: PlanReason,
    /// The events that led to it, one line each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub causes: Vec<String>,
    /// When it was made.
    pub created_at: Timestamp,
    /// What it says about each job that it books.
    pub verdicts: Vec<JobVerdict>,
    /// Bookings of all frames of its jobs, by start. Finished and leased frames keep their earlier bookings.
    pub bookings: Vec<Booking>,
    /// Bookings of shared irradiance caches, by start.
    #[serde(default, skip_serializing_if = "Vec::is_empty", alias = "seeds")]
    pub shared_cache_bookings: Vec<SharedCacheBooking>,
}

/// A plan in a list.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PlanSummary {
    /// Its id.
    pub id: PlanId,
    /// The previous plan. Absent for the first one.
    pub parent_id: Option<PlanId>,
    /// Why it was made.
    pub reason: PlanReason,
    /// The events that led to it, one line each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub causes: Vec<String>,
    /// When it was made.
    pub created_at: Timestamp,
    /// Number of frames that it books.
    pub bookings: u64,
}

/// One page of plans, newest first.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PlanPage {
    /// The plans.
    pub items: Vec<PlanSummary>,
    /// Token of the next page. Absent on the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}

/// Where and when a frame is booked.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FramePlace {
    /// The node.
    pub node_id: NodeId,
    /// Name of the node.
    pub node: String,
    /// Start of the booking.
    pub start: Timestamp,
    /// End of the booking (exclusive).
    pub end: Timestamp,
}

/// A frame or a part of one whose booking a plan moves, adds or removes.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameMove {
    /// The job.
    pub job_id: JobId,
    /// The frame.
    pub frame: u32,
    /// The part of the frame, from 0.
    #[serde(default, skip_serializing_if = "is_first")]
    pub part: u32,
    /// Number of parts of the frame. 1 or absent: it is booked as a whole.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    #[schema(default = 1, minimum = 1, maximum = 512)]
    pub parts: u32,
    /// The earlier booking. Absent if it had none.
    pub before: Option<FramePlace>,
    /// The new booking. Absent if it has none any more.
    pub after: Option<FramePlace>,
}

/// What a plan and the previous one say about a job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct VerdictChange {
    /// The job.
    pub job_id: JobId,
    /// Its name.
    pub name: String,
    /// What the previous plan says. Absent if it does not book the job.
    pub before: Option<JobVerdict>,
    /// What the plan says.
    pub after: JobVerdict,
}

/// The difference between a plan and the previous one.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PlanDifference {
    /// The plan.
    pub plan_id: PlanId,
    /// The previous plan. Absent for the first one.
    pub parent_id: Option<PlanId>,
    /// The events that led to the plan, one line each.
    pub causes: Vec<String>,
    /// A summary of the difference, one line per statement.
    pub words: Vec<String>,
    /// Jobs that it books and about which it says something else.
    pub jobs: Vec<VerdictChange>,
    /// Frames that it moves, adds or removes, sorted by job and frame. At most 1,000.
    pub frames: Vec<FrameMove>,
    /// Number of such frames that are not listed.
    #[serde(default, skip_serializing_if = "is_none")]
    pub frames_left_out: u64,
    /// Number of frames of its jobs that keep their bookings.
    pub unmoved: u64,
    /// Additional cost of its jobs. Negative if they cost less.
    pub added_cost: Money,
}
