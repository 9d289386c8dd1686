//! What people ask about a job's plan, and what they are told.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{Confidence, ImageError, JobId, Money, NodeId, PlanId, RenderSettings, Timestamp};

/// Something that could be different.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlanChange {
    /// More nodes like one that there is.
    MoreNodes {
        /// The node that they are like.
        node_id: NodeId,
        /// How many.
        count: u32,
    },
    /// A node is gone from now on.
    NodeGone {
        /// The node.
        node_id: NodeId,
    },
    /// The deadline is later.
    Later {
        /// The job whose deadline it is.
        job_id: JobId,
        /// Milliseconds.
        by_ms: i64,
    },
    /// Capacity is bought at another quantile.
    Confidence {
        /// The job.
        job_id: JobId,
        /// How sure.
        confidence: Confidence,
    },
    /// A job gives up its deadline and makes way.
    MakeWay {
        /// The job.
        job_id: JobId,
    },
    /// The job is rendered with other settings.
    Quality {
        /// Camera samples a pixel.
        spp: u32,
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// All of its settings; absent in answers of older versions.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        settings: Option<Box<RenderSettings>>,
    },
    /// The job is not there.
    WithoutJob {
        /// The job.
        job_id: JobId,
    },
}

/// A job that would end at another time.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct MovedJob {
    /// The job.
    pub job_id: JobId,
    /// Its name.
    pub name: String,
    /// Milliseconds later, or, if negative, earlier.
    pub later_ms: i64,
    /// Whether it would miss a deadline that it keeps now.
    pub breaks_promise: bool,
}

/// What a change would do.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PlanEffect {
    /// The change.
    pub change: PlanChange,
    /// The change and its effect, in a line for people.
    pub words: String,
    /// What all jobs together cost more, or, if negative, less.
    pub added_cost: Money,
    /// When the job that was asked about would end; absent: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<Timestamp>,
    /// Whether that would be by its deadline (a moved one, if that is the change); true without a deadline, if it ends.
    pub in_time: bool,
    /// Other jobs that would end at another time.
    pub moved: Vec<MovedJob>,
}

/// What is left of a promise: a deadline at a confidence that a plan said it keeps.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Promise {
    /// Whether the newest plan keeps it.
    pub kept: bool,
    /// Probability of being ready by the deadline, as of the newest plan: the share of scenarios that are.
    pub probability: f64,
    /// When the job ends in the newest plan; absent: never.
    pub finish: Option<Timestamp>,
    /// Since when it is so.
    pub since: Timestamp,
    /// The cheapest change that was found to keep it after all, if it is at risk.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rescue: Option<PlanEffect>,
}

/// What kind of thing a job waits for.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WaitKind {
    /// A node that could ever render it; of a job without a quote, a node that takes tasks.
    Node,
    /// A node that could do it to be awake.
    Calendar,
    /// A licence or another limit that others hold.
    Limit,
    /// Nodes that are booked for other jobs.
    Others,
    /// Nothing: it is cheaper later, and still in time.
    Cheaper,
    /// Its project's budget.
    Budget,
    /// Room on the disk where the farm's data are: no task is handed out.
    Room,
}

/// Why a job that is booked has not begun, why one that has to be quoted before does not go on, or that no job does for want of room.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Waits {
    /// What kind of reason it is.
    pub kind: WaitKind,
    /// The reason, in a line for people that begins with "waits because".
    pub because: String,
    /// When its first frame is booked; of a job without a quote, when the first node wakes. Absent: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<Timestamp>,
    /// The jobs that go first, those that hold most of the nodes' time first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub behind: Vec<JobId>,
    /// What its project had of the farm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share: Option<ProjectShare>,
}

impl Waits {
    /// Whether nothing is begun before somebody changes a budget: then nobody knows when.
    pub fn is_for_money(&self) -> bool {
        self.kind == WaitKind::Budget
    }
}

/// A project's share of the farm, and what it had of it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ProjectShare {
    /// The project.
    pub project: String,
    /// Its share, relative to the others'.
    pub share: u32,
    /// Node hours that it had, as they count now: half after each half-life.
    pub used_hours: f64,
}

/// All projects that have a share or used the farm.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ProjectList {
    /// Hours after which what was used counts half.
    pub half_life_hours: u32,
    /// By name.
    pub items: Vec<ProjectShare>,
}

/// Sets a project's share. Setting it again replaces it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProjectRequest {
    /// The project: 1 to 200 characters.
    #[schema(min_length = 1, max_length = 200)]
    pub project: String,
    /// Its share, relative to the others', 1 to 1,000,000. A project without one has 1.
    #[schema(minimum = 1, maximum = 1_000_000)]
    pub share: u32,
}

/// The job at one confidence.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct OutlookLine {
    /// How sure.
    pub confidence: Confidence,
    /// When it is done; absent: never.
    pub finish: Option<Timestamp>,
    /// Whether that is by the deadline; absent if there is none.
    pub in_time: Option<bool>,
    /// What the rest of it costs in the cheapest plan that was found.
    pub cost: Money,
    /// What it costs at least in any plan that is as good.
    pub cost_at_least: Money,
}

/// A deadline and its price.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PriceOffer {
    /// By when.
    pub deadline: Timestamp,
    /// When it would be done.
    pub finish: Timestamp,
    /// For how much.
    pub cost: Money,
    /// And not for less than this.
    pub cost_at_least: Money,
}

/// What a budget buys.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct BudgetAnswer {
    /// The budget that was asked about, for what is left of the job.
    pub budget: Money,
    /// The earliest deadline that it pays for; absent if none is cheap enough.
    pub offer: Option<PriceOffer>,
}

/// The job at another quality, from its own profile.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct QualityOffer {
    /// The settings.
    pub settings: RenderSettings,
    /// Whether these are the job's own.
    pub asked_for: bool,
    /// How far images would be from their converged selves, where that is known.
    pub error: Option<ImageError>,
    /// When it would be done; absent: never.
    pub finish: Option<Timestamp>,
    /// For how much.
    pub cost: Money,
    /// Whether that fits deadline and budget.
    pub fits: bool,
}

/// What is known of a job's plan. It rests on the newest plan and the farm's state at `at`, and is worked out anew when either changes.
/// Costs are of what is left of the job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct AnswersDoc {
    /// The job.
    pub job_id: JobId,
    /// The newest plan.
    pub plan_id: Option<PlanId>,
    /// The instant that this is seen from: the minute that had begun when it was asked for.
    pub at: Timestamp,
    /// The deadline that was asked about: the job's own if none was given.
    pub deadline: Option<Timestamp>,
    /// Whether it can be done by then at P50, P80 and P95, and for how much.
    pub outlook: Vec<OutlookLine>,
    /// The cheapest plan by the deadline at the job's own confidence; absent without a deadline, or if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cheapest: Option<PriceOffer>,
    /// The earliest finish for the budget: the one that was asked about, or what is left of the job's own; absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub for_budget: Option<BudgetAnswer>,
    /// The price against the deadline, from the earliest end on.
    pub curve: Vec<PriceOffer>,
    /// Other qualities, the best first.
    pub qualities: Vec<QualityOffer>,
    /// What one more node, an hour more, and the death of the node with most of its bookings would do.
    pub what_if: Vec<PlanEffect>,
    /// Jobs that end later because this one is there.
    pub pushes_back: Vec<MovedJob>,
    /// Why it cannot be done as asked for, a line each; empty if it can.
    pub why_not: Vec<String>,
    /// The cheapest ways out, at most three; empty if it can be done.
    pub ways_out: Vec<PlanEffect>,
    /// Questions for which there was no time on so large a farm, or for some of whose answers.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
}
