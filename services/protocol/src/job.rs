//! Jobs and their frames.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ArtifactHash, BundleRef, CacheSharing, Confidence, FrameForecast, FrameSet, JobId, JobVerdict, Ladders,
    LiveForecast, Money, NodeId, PageToken, PlanId, Promise, Quantiles, RenderSettings,
    RenderSettingsRequest, RenderStats, SceneSummary, SeedProgress, TaskLimits, Timestamp, Waits,
};

/// A new job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JobRequest {
    /// A name for people: 1 to 200 characters.
    #[schema(min_length = 1, max_length = 200)]
    pub name: String,
    /// The project that the job is booked on: 1 to 200 characters.
    #[serde(default = "default_project")]
    #[schema(default = "default", min_length = 1, max_length = 200)]
    pub project: String,
    /// What to render.
    pub bundle: BundleRef,
    /// Which frames.
    pub frames: FrameSet,
    /// How good.
    #[serde(default)]
    pub settings: RenderSettingsRequest,
    /// Whether the frames share one irradiance cache, if they have any.
    #[serde(default)]
    pub cache: CacheSharing,
    /// Pixels to profile per profiled frame, 16 to 1,000,000.
    #[serde(default = "default_samples")]
    #[schema(default = 256, minimum = 16, maximum = 1_000_000)]
    pub samples: u32,
    /// Frames to profile at most, 1 to 1000. Absent: five, and up to 16 if that leaves the forecast unsure and more would cost less than a
    /// hundredth of the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 1000)]
    pub profile_frames: Option<u32>,
    /// Which other qualities the quote prices; `all` cannot be had together with `within`, which chooses the samples itself.
    #[serde(default, skip_serializing_if = "Ladders::are_own")]
    pub ladders: Ladders,
    /// Take the most camera samples that fit into this time or money, in place of `settings.spp`, which is then only what is profiled with. Chosen
    /// when the profiles are there, as sure as `confidence` says; a job into which not even one sample fits fails, and says what would. Each frame may
    /// then take the work of so many samples, and spends it where its image shows that it pays.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within: Option<Within>,
    /// When all frames have to be there; absent: whenever.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadline: Option<Timestamp>,
    /// The most that the job is to cost, micro-units; absent: no limit. Plans keep to it if any can. If none can, the job is rendered all the
    /// same, and its verdict says `over_budget`: what stops work is the budget of a project.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Money>,
    /// How sure the plan has to be of deadline and budget.
    #[serde(default)]
    pub confidence: Confidence,
    /// Among jobs with the same deadline the greater goes first: -1000 to 1000.
    #[serde(default)]
    #[schema(default = 0, minimum = -1000, maximum = 1000)]
    pub priority: i32,
    /// Among jobs of equal priority, one of weight two is worth two of weight one: 1 to 1000.
    #[serde(default = "default_weight")]
    #[schema(default = 1, minimum = 1, maximum = 1000)]
    pub weight: u32,
    /// What one of its tasks may use at most.
    #[serde(default, skip_serializing_if = "TaskLimits::are_none")]
    pub limits: TaskLimits,
}

/// What frames may take. Exactly one of `cpu_micros` and `money`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Within {
    /// CPU time over all threads on a node of speed 1, microseconds; above 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0)]
    pub cpu_micros: Option<i64>,
    /// Money at the mean price of the farm's nodes, micro-units; above 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Money>)]
    pub money: Option<Money>,
    /// What may take so much.
    #[serde(default)]
    pub per: Per,
}

/// What a limit is for.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Per {
    /// All frames together.
    #[default]
    Job,
    /// Each frame.
    Frame,
}

fn default_project() -> String {
    "default".to_owned()
}

fn default_samples() -> u32 {
    256
}

fn default_weight() -> u32 {
    1
}

/// Where a job stands.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// The frames are being previewed.
    Previewing,
    /// Some frames are being profiled.
    Profiling,
    /// The forecast is there and the farm is booked.
    Booked,
    /// At least one frame has been handed to a worker, or a part of the irradiance cache that the frames share.
    Rendering,
    /// All frames are there.
    Done,
    /// A task failed too often; `error` says how.
    Failed,
    /// Someone cancelled it.
    Cancelled,
}

impl JobState {
    /// All states, in the order of a job's life.
    pub const ALL: [JobState; 7] = [
        JobState::Previewing,
        JobState::Profiling,
        JobState::Booked,
        JobState::Rendering,
        JobState::Done,
        JobState::Failed,
        JobState::Cancelled,
    ];

    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            JobState::Previewing => "previewing",
            JobState::Profiling => "profiling",
            JobState::Booked => "booked",
            JobState::Rendering => "rendering",
            JobState::Done => "done",
            JobState::Failed => "failed",
            JobState::Cancelled => "cancelled",
        }
    }

    /// The state of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.name() == name)
    }

    /// Whether nothing will change any more.
    pub const fn is_final(self) -> bool {
        matches!(self, JobState::Done | JobState::Failed | JobState::Cancelled)
    }
}

impl fmt::Display for JobState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Job {
    /// Its id.
    pub id: JobId,
    /// Name for people.
    pub name: String,
    /// The project that it is booked on.
    pub project: String,
    /// Where it stands.
    pub state: JobState,
    /// What it renders.
    pub bundle: BundleRef,
    /// What is in the bundle.
    pub scene: SceneSummary,
    /// Which frames.
    pub frames: FrameSet,
    /// How good, complete.
    pub settings: RenderSettings,
    /// Whether its frames are to share one irradiance cache; the quote says whether they do.
    #[serde(default)]
    pub cache: CacheSharing,
    /// How far the cache is that its frames share and wait for; absent if they do not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<SeedProgress>,
    /// Pixels to profile per profiled frame.
    pub samples: u32,
    /// Frames to profile at most; absent: as many as pay.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile_frames: Option<u32>,
    /// Which other qualities its quote prices.
    #[serde(default, skip_serializing_if = "Ladders::are_own")]
    pub ladders: Ladders,
    /// What its frames may take, from which `settings.spp` was or will be chosen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within: Option<Within>,
    /// When all frames have to be there.
    pub deadline: Option<Timestamp>,
    /// The most that it may cost.
    pub budget: Option<Money>,
    /// How sure the plan has to be.
    pub confidence: Confidence,
    /// Among jobs with the same deadline the greater goes first.
    pub priority: i32,
    /// What it is worth among jobs of its priority.
    #[serde(default = "default_weight")]
    pub weight: u32,
    /// What one of its tasks may use at most.
    #[serde(default, skip_serializing_if = "TaskLimits::are_none")]
    pub limits: TaskLimits,
    /// Frames in all.
    pub frames_total: u32,
    /// Frames that are there.
    pub frames_done: u32,
    /// The part of the forecast work that is done, 0 to 1: of the frames where there is no forecast yet.
    pub progress: f64,
    /// The plan's word on deadline and budget; absent until booked.
    pub verdict: Option<JobVerdict>,
    /// The plan that booked it.
    pub plan_id: Option<PlanId>,
    /// Why it has not begun, or does not go on because nobody quotes it or there is no room.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waits: Option<Waits>,
    /// What is left of its promise; absent if its deadline was never promised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub promise: Option<Promise>,
    /// When the last frame is expected; absent until booked, and once final.
    pub eta: Option<Timestamp>,
    /// What the time of its nodes has cost so far, quotes and lost work included; absent in lists, and while it has cost nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spent: Option<Money>,
    /// What it will have cost, as far as its frames are finished, beside the quote; absent until booked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub live: Option<LiveForecast>,
    /// What went wrong, if it failed.
    pub error: Option<String>,
    /// When it was submitted.
    pub created_at: Timestamp,
    /// When it was done, failed or cancelled.
    pub finished_at: Option<Timestamp>,
}

/// One page of jobs, newest first.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct JobPage {
    /// The jobs.
    pub items: Vec<Job>,
    /// Where the next page starts; absent on the last.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}

/// What a POST of the same job would say; nothing was kept.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct JobCheck {
    /// What is in the bundle.
    pub scene: SceneSummary,
    /// Which frames.
    pub frames: FrameSet,
    /// How many.
    pub frames_total: u32,
    /// How good, complete.
    pub settings: RenderSettings,
}

/// Where a frame stands.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrameState {
    /// Not yet to be rendered: the job is being forecast, or the irradiance cache made that its frames share.
    Waiting,
    /// To be rendered.
    Ready,
    /// With a worker.
    Leased,
    /// There.
    Done,
    /// Failed too often.
    Failed,
    /// Its job failed or was cancelled before it was rendered.
    Cancelled,
}

/// Where and when a frame is to be rendered.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameBooking {
    /// On which node.
    pub node_id: NodeId,
    /// That node's name.
    pub node: String,
    /// From when.
    pub start: Timestamp,
    /// Until when.
    pub end: Timestamp,
}

/// The artefacts of a frame, as far as they are there.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct FrameArtifacts {
    /// Object and material ids in colour.
    pub preview_png: Option<ArtifactHash>,
    /// Cost of each pixel in colour.
    pub cost_map_png: Option<ArtifactHash>,
    /// The image, for looking at.
    pub image_png: Option<ArtifactHash>,
    /// The image, linear.
    pub image_exr: Option<ArtifactHash>,
}

/// Forecast against actual for one number.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameFigure {
    /// What was forecast.
    pub forecast: Quantiles,
    /// What it was; absent until the frame is done.
    pub actual: Option<f64>,
    /// Forecast mean over actual, minus one; absent until the frame is done, or if the actual is 0.
    pub error: Option<f64>,
}

/// One frame of a job: what was said, and what was.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameRow {
    /// Frame number.
    pub frame: u32,
    /// Where it stands.
    pub state: FrameState,
    /// What was forecast, in full; absent until the job is forecast.
    pub forecast: Option<FrameForecast>,
    /// What it took, in full; absent until the frame is done.
    pub actual: Option<RenderStats>,
    /// Work: forecast, actual, error.
    pub work: Option<FrameFigure>,
    /// CPU seconds: forecast (on a node of speed 1), actual (brought to a node of speed 1), error.
    pub cpu_seconds: Option<FrameFigure>,
    /// Where and when it was to be rendered.
    pub booked: Option<FrameBooking>,
    /// The node that has it or rendered it.
    pub node: Option<NodeId>,
    /// How often it was handed out.
    pub attempts: u32,
    /// How far the worker is, 0 to 1.
    pub progress: f64,
    /// When the last worker started.
    pub started: Option<Timestamp>,
    /// When the result was committed.
    pub finished: Option<Timestamp>,
    /// Its images.
    pub artifacts: FrameArtifacts,
    /// The last error, if there was one.
    pub error: Option<String>,
}

/// One page of frames, ascending.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FramePage {
    /// The frames.
    pub items: Vec<FrameRow>,
    /// Where the next page starts; absent on the last.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}
