//! Answers about the plan of a job: what changes would do, when it would finish, and what it would cost.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{Confidence, ImageError, JobId, Money, NodeId, PlanId, RenderSettings, Timestamp};

/// A hypothetical change to the farm or to a job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlanChange {
    /// The farm has more nodes like an existing one.
    MoreNodes {
        /// The existing node.
        node_id: NodeId,
        /// Number of additional nodes.
        count: u32,
    },
    /// A node is gone from now on.
    NodeGone {
        /// The node.
        node_id: NodeId,
    },
    /// The deadline of a job is later.
    Later {
        /// The job.
        job_id: JobId,
        /// How much later, in milliseconds.
        by_ms: i64,
    },
    /// A job is planned at another confidence.
    Confidence {
        /// The job.
        job_id: JobId,
        /// The new confidence.
        confidence: Confidence,
    },
    /// A job gives up its deadline, and other jobs go first.
    MakeWay {
        /// The job.
        job_id: JobId,
    },
    /// The job is rendered with other settings.
    Quality {
        /// Camera samples per pixel.
        spp: u32,
        /// Image width in pixels.
        width: u32,
        /// Image height in pixels.
        height: u32,
        /// The complete settings. Absent in answers of older versions.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        settings: Option<Box<RenderSettings>>,
    },
    /// A job does not exist.
    WithoutJob {
        /// The job.
        job_id: JobId,
    },
}

/// A job whose finish a change would move.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct MovedJob {
    /// The job.
    pub job_id: JobId,
    /// Its name.
    pub name: String,
    /// How much later it would finish, in milliseconds. Negative if earlier.
    pub later_ms: i64,
    /// Whether the job would miss a deadline that it keeps now.
    pub breaks_promise: bool,
}

/// The effect of a hypothetical change.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PlanEffect {
    /// The change.
    pub change: PlanChange,
    /// The change and its effect, as one line of text.
    pub words: String,
    /// Additional cost of all jobs together. Negative if they would cost less.
    pub added_cost: Money,
    /// When the job in question would finish. Absent if it never would.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<Timestamp>,
    /// Whether it meets its deadline, or the moved one. Without a deadline, whether it would finish at all.
    pub in_time: bool,
    /// Other jobs that would finish at another time.
    pub moved: Vec<MovedJob>,
}

/// Asks what a change would do to the plan. Nothing is stored.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WhatIfRequest {
    /// The change.
    pub change: PlanChange,
    /// The job in question, whose finish the answer gives.
    pub job_id: JobId,
}

/// What a change would do to the plan.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct WhatIf {
    /// The effect on the job in question, on others and on the cost.
    pub effect: PlanEffect,
    /// The difference between the plans, one line per statement.
    pub words: Vec<String>,
}

/// The state of a promise: a deadline that a plan said it keeps, at the job's confidence.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Promise {
    /// Whether the newest plan keeps the deadline.
    pub kept: bool,
    /// Share of simulated scenarios in which it finishes by the deadline, 0 to 1.
    pub probability: f64,
    /// When the job finishes in the newest plan. Absent if it never does.
    pub finish: Option<Timestamp>,
    /// Since when the promise is in this state.
    pub since: Timestamp,
    /// The cheapest change found that would keep the deadline. Absent unless the promise is at risk.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rescue: Option<PlanEffect>,
}

/// Kind of reason why a job waits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WaitKind {
    /// No suitable node: for a job with a quote, one that could render it; otherwise, one that takes tasks.
    Node,
    /// All suitable nodes are asleep by their calendars, or none is free for long enough.
    Calendar,
    /// Other jobs hold a licence or another limited resource.
    Limit,
    /// The nodes are booked for other jobs, or its place in the plan is on a node that is not free yet.
    Others,
    /// Waiting is cheaper, and the job still finishes in time.
    Cheaper,
    /// The budget of its project holds it back.
    Budget,
    /// Somebody paused it.
    Paused,
    /// The disk with the farm's data is nearly full, so no tasks are handed out.
    Room,
}

/// Why a job waits: its frames, its quote or the whole farm cannot go on.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Waits {
    /// Kind of reason.
    pub kind: WaitKind,
    /// The reason, as one line of text that begins with "waits because".
    pub because: String,
    /// Expected end of the wait: first booked frame or, without a quote, next node awake. Absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<Timestamp>,
    /// Jobs that go first. Those that hold the most node time come first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub behind: Vec<JobId>,
    /// The project's use of its share of the farm. Absent if it does not matter here.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share: Option<ProjectShare>,
}

impl Waits {
    /// The budget of the job's project holds it back, until somebody changes the budget.
    pub fn for_budget(project: &str) -> Self {
        let because = format!("waits because the budget of project {project} is used up");
        Self { kind: WaitKind::Budget, because, until: None, behind: Vec::new(), share: None }
    }

    /// Somebody paused the job, which waits until somebody resumes it.
    pub fn for_resuming() -> Self {
        let because = "waits because it is paused".to_owned();
        Self { kind: WaitKind::Paused, because, until: None, behind: Vec::new(), share: None }
    }

    /// A job of this project whose tasks are not handed out waits to be resumed, or for the budget.
    pub fn of_held(paused: bool, project: &str) -> Self {
        if paused { Self::for_resuming() } else { Self::for_budget(project) }
    }

    /// Whether nothing more of the job is started until somebody changes its budget, or resumes it. It has no end then.
    pub fn is_held(&self) -> bool {
        matches!(self.kind, WaitKind::Budget | WaitKind::Paused)
    }
}

/// A project's share of the farm, and how much of the farm it has used.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ProjectShare {
    /// The project.
    pub project: String,
    /// Share relative to those of other projects.
    pub share: u32,
    /// Node hours used, with exponential decay: they count half after each half-life.
    pub used_hours: f64,
}

/// All projects that have a share or have used the farm.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ProjectList {
    /// Half-life of past use, in hours.
    pub half_life_hours: u32,
    /// The projects, in the order of their names.
    pub items: Vec<ProjectShare>,
}

/// Sets the share of a project. Replaces an earlier share.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProjectRequest {
    /// The project: 1 to 200 characters.
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub project: String,
    /// Share relative to those of other projects, 1 to 1,000,000. The default for a project is 1.
    #[schema(minimum = 1, maximum = 1_000_000)]
    pub share: u32,
}

/// When a job would finish, and for how much, at one confidence.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct OutlookLine {
    /// The confidence.
    pub confidence: Confidence,
    /// When the job finishes. Absent if it never does.
    pub finish: Option<Timestamp>,
    /// Whether that is by the deadline. Absent without a deadline.
    pub in_time: Option<bool>,
    /// Cost of what is left of the job, in the cheapest plan found.
    pub cost: Money,
    /// Lower bound on that cost, for any plan that is as good.
    pub cost_at_least: Money,
}

/// A deadline and its price.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PriceOffer {
    /// The deadline.
    pub deadline: Timestamp,
    /// When the job would finish.
    pub finish: Timestamp,
    /// What it would cost.
    pub cost: Money,
    /// Lower bound on that cost.
    pub cost_at_least: Money,
}

/// The earliest finish for a budget.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BudgetAnswer {
    /// The budget in question, for what is left of the job.
    pub budget: Money,
    /// The earliest deadline that the budget pays for. Absent if no plan is cheap enough.
    pub offer: Option<PriceOffer>,
}

/// The job at another quality, estimated from its own profile.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct QualityOffer {
    /// The settings of this quality.
    pub settings: RenderSettings,
    /// Whether these are the job's own settings.
    pub asked_for: bool,
    /// Expected error of the images against converged ones. It is that of denoised images if the job asks for
    /// denoising and for all `ladders`. Absent if unknown.
    pub error: Option<ImageError>,
    /// When the job would finish. Absent if it never would.
    pub finish: Option<Timestamp>,
    /// Probability that the job would meet its deadline, 0 to 1. Absent without a deadline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// What it would cost.
    pub cost: Money,
    /// Whether that fits the deadline and the budget.
    pub fits: bool,
}

/// Answers about the plan of a job at `at`. Costs are for what is left of the job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct AnswersDoc {
    /// The job.
    pub job_id: JobId,
    /// The newest plan. Absent if there is none.
    pub plan_id: Option<PlanId>,
    /// The instant that the answers refer to: the start of the minute in which they were requested.
    pub at: Timestamp,
    /// The deadline in question: that of the request, or the job's own. Absent if there is neither.
    pub deadline: Option<Timestamp>,
    /// Probability that the job meets that deadline, 0 to 1. Absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// Finish and cost at P50, P80 and P95.
    pub outlook: Vec<OutlookLine>,
    /// The cheapest plan that keeps the deadline at the job's confidence. Absent if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cheapest: Option<PriceOffer>,
    /// The earliest finish for the requested budget, or for the rest of the job's own. Absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub for_budget: Option<BudgetAnswer>,
    /// Price against deadline, from the earliest possible finish on.
    pub curve: Vec<PriceOffer>,
    /// Other qualities, the best first.
    pub qualities: Vec<QualityOffer>,
    /// Effects of one more node, one more hour, and the loss of the node with most of the job's bookings.
    pub what_if: Vec<PlanEffect>,
    /// Jobs that finish later because of this one.
    pub pushes_back: Vec<MovedJob>,
    /// Why the job cannot be done as requested, one line per reason. Empty if it can.
    pub why_not: Vec<String>,
    /// The cheapest changes that would make it possible, at most three. Empty if it is possible already.
    pub ways_out: Vec<PlanEffect>,
    /// Questions that were left out, fully or in part, because the farm is too large to answer all in time.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
}
