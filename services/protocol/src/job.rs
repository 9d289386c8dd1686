//! Jobs.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::node::given;
use crate::{
    BudgetHold, BundleRef, CacheSharing, Confidence, Division, ErrorTarget, FinishQuantiles, FrameSet, JobId,
    JobSettings, JobState, JobVerdict, JobVideo, Ladders, LiveForecast, Money, OutputPattern, PageToken,
    PlanId, Promise, RenderSettingsRequest, RenderedBy, RendererRequest, SceneSummary, SharedCacheProgress,
    TaskId, TaskLimits, Timestamp, VideoRequest, Waits,
};

/// Request for a new job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JobRequest {
    /// Name of the job: 1 to 200 characters.
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub name: String,
    /// Project that is charged for the job: 1 to 200 characters.
    #[serde(default = "default_project")]
    #[schema(default = "default", min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub project: String,
    /// The scene bundle to render.
    pub bundle: BundleRef,
    /// The renderer. If absent, forelight's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub renderer: Option<RendererRequest>,
    /// The frames to render.
    pub frames: FrameSet,
    /// Render settings. What is left out has the scene's value or the default.
    #[serde(default)]
    pub settings: RenderSettingsRequest,
    /// Whether the frames share one irradiance cache. No effect without caches.
    #[serde(default)]
    pub cache: CacheSharing,
    /// Whether frames are divided into parts that several nodes render at the same time.
    #[serde(default, skip_serializing_if = "Division::is_auto")]
    pub division: Division,
    /// Where each image is written besides, as soon as its frame is done: a pattern of paths below the service's
    /// output root, such as `{project}/{job}/{frame:04}.exr`. Absent: images are artefacts alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output: Option<OutputPattern>,
    /// Makes a video of the frames when the last of them is finished. Absent: none is made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub video: Option<VideoRequest>,
    /// Whether the noise of the images is removed by Open Image Denoise, and the error that is left is measured.
    /// Profiles and frames of the job go only to nodes that have it. Only for forelight's own renderer; cannot be
    /// combined with `within` and `error_target`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub denoise: bool,
    /// Number of pixels to profile per profiled frame, 16 to 1,000,000.
    #[serde(default = "default_samples")]
    #[schema(default = 256, minimum = 16, maximum = 1_000_000)]
    pub samples: u32,
    /// Most frames to profile, 1 to 1000. If absent: five, and up to 16 if the forecast is uncertain and the
    /// cost below 1 %.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 1000)]
    pub profile_frames: Option<u32>,
    /// Which other qualities the quote prices. `all` cannot be combined with `within` or `error_target`.
    #[serde(default, skip_serializing_if = "Ladders::are_own")]
    pub ladders: Ladders,
    /// Limit on time or money. Instead of `settings.spp`, the job uses the most camera samples that fit, at
    /// its `confidence`. If not even one per pixel fits, the job fails. A frame puts its samples where they
    /// reduce the image's error most.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within: Option<Within>,
    /// The largest error of each image. A frame gets as many camera samples as it takes, where they help most;
    /// `settings.spp` is that of the profile, at least 4. Cannot be combined with `within`, `ladders: all` and
    /// a shared cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_target: Option<ErrorTarget>,
    /// When all frames must be finished. If absent, there is no deadline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadline: Option<Timestamp>,
    /// Largest cost of the job, in micro-units. Plans keep to it if they can; else the verdict is
    /// `over_budget` and the job is still rendered. Only a project's budget stops work.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Money>,
    /// Probability with which the plan must keep deadline and budget.
    #[serde(default)]
    pub confidence: Confidence,
    /// Priority, -1000 to 1000. Of jobs with the same deadline, and of those without one, the greatest goes first. A job of
    /// lower priority may be moved past its deadline for one that would miss its own.
    #[serde(default)]
    #[schema(default = 0, minimum = -1000, maximum = 1000)]
    pub priority: i32,
    /// Weight among jobs of the same priority, 1 to 1000. A job of weight 2 counts like two of weight 1.
    #[serde(default = "default_weight")]
    #[schema(default = 1, minimum = 1, maximum = 1000)]
    pub weight: u32,
    /// Limits on what a task of the job may use.
    #[serde(default, skip_serializing_if = "TaskLimits::are_none")]
    pub limits: TaskLimits,
    /// Whether to wait with the complete quote until somebody accepts it. Nothing is booked before.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub hold: bool,
}

impl JobRequest {
    /// A job of this name for these frames, with defaults for all else.
    pub fn new(name: String, bundle: BundleRef, frames: FrameSet) -> Self {
        Self {
            name,
            project: default_project(),
            bundle,
            renderer: None,
            frames,
            settings: RenderSettingsRequest::default(),
            cache: CacheSharing::default(),
            division: Division::default(),
            output: None,
            video: None,
            denoise: false,
            samples: default_samples(),
            profile_frames: None,
            ladders: Ladders::default(),
            within: None,
            error_target: None,
            deadline: None,
            budget: None,
            confidence: Confidence::default(),
            priority: 0,
            weight: default_weight(),
            limits: TaskLimits::default(),
            hold: false,
        }
    }
}

/// Accepts the quote of a job on hold. What is left out stays as it was submitted.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AcceptRequest {
    /// When all frames must be finished.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadline: Option<Timestamp>,
    /// Largest cost of the job, in micro-units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Money>,
    /// Probability with which the plan must keep deadline and budget.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confidence: Option<Confidence>,
}

/// A change to a job. Absent fields stay; `null` removes a deadline or a budget.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JobChange {
    /// When all frames must be finished. `null`: no deadline.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "given")]
    #[schema(value_type = Option<Timestamp>)]
    pub deadline: Option<Option<Timestamp>>,
    /// Largest cost of the job, in micro-units. `null`: no limit.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "given")]
    #[schema(value_type = Option<Money>)]
    pub budget: Option<Option<Money>>,
    /// Probability with which the plan must keep deadline and budget.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confidence: Option<Confidence>,
    /// Priority, -1000 to 1000. Of jobs with the same deadline, and of those without one, the greatest goes first. A job of
    /// lower priority may be moved past its deadline for one that would miss its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = -1000, maximum = 1000)]
    pub priority: Option<i32>,
    /// Whether to pause the job: its work under way goes on, and nothing more of it is started. Plans give its nodes
    /// to others. `false`: it goes on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub paused: Option<bool>,
}

impl From<AcceptRequest> for JobChange {
    fn from(AcceptRequest { deadline, budget, confidence }: AcceptRequest) -> Self {
        Self { deadline: deadline.map(Some), budget: budget.map(Some), confidence, ..Self::default() }
    }
}

/// A limit on the cost of frames. Exactly one of `cpu_micros` and `money` must be given.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Within {
    /// CPU time over all threads on a node of speed 1, in microseconds. Above 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0)]
    pub cpu_micros: Option<i64>,
    /// Cost at the mean price of the farm's nodes, in micro-units. Above 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Money>)]
    pub money: Option<Money>,
    /// What the limit applies to.
    #[serde(default)]
    pub per: Per,
}

/// What a limit applies to.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Per {
    /// All frames together.
    #[default]
    Job,
    /// Each single frame.
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

/// A job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Job {
    /// Its id.
    pub id: JobId,
    /// Name of the job.
    pub name: String,
    /// Project that is charged for it.
    pub project: String,
    /// Its state.
    pub state: JobState,
    /// The scene bundle.
    pub bundle: BundleRef,
    /// The renderer. Absent for forelight's own. Complete once the job is previewed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub renderer: Option<RendererRequest>,
    /// Which version of forelight's own renderer renders it. Absent for other renderers, until the job is
    /// previewed, and if no node states its version.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rendered_by: Option<RenderedBy>,
    /// Summary of the scene in the bundle. With another renderer, numbers are 0 until the job is previewed.
    pub scene: SceneSummary,
    /// The frames to render.
    pub frames: FrameSet,
    /// The complete render settings. With another renderer, those of the scene are absent until the job is
    /// previewed.
    pub settings: JobSettings,
    /// The requested sharing of irradiance caches. The quote says whether the frames share one.
    #[serde(default)]
    pub cache: CacheSharing,
    /// Progress of the irradiance cache that its frames share. Absent if they do not share one.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "seed")]
    pub shared_cache: Option<SharedCacheProgress>,
    /// Whether frames are divided into parts that several nodes render at the same time.
    #[serde(default, skip_serializing_if = "Division::is_auto")]
    pub division: Division,
    /// Where each image is written besides, as soon as its frame is done: a pattern of paths below the service's
    /// output root, such as `{project}/{job}/{frame:04}.exr`. Absent: images are artefacts alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output: Option<OutputPattern>,
    /// The video of its frames. Absent if none is asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub video: Option<JobVideo>,
    /// Whether the noise of the images is removed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub denoise: bool,
    /// Number of pixels to profile per profiled frame.
    pub samples: u32,
    /// Largest number of frames to profile. Absent if the service decides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile_frames: Option<u32>,
    /// Which other qualities the quote prices.
    #[serde(default, skip_serializing_if = "Ladders::are_own")]
    pub ladders: Ladders,
    /// Limit on time or money from which `settings.spp` is chosen. Absent if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within: Option<Within>,
    /// The largest error of each image. Absent if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_target: Option<ErrorTarget>,
    /// When all frames must be finished. Absent if there is no deadline.
    pub deadline: Option<Timestamp>,
    /// Largest cost of the job. Absent if there is no limit.
    pub budget: Option<Money>,
    /// Probability with which the plan must keep deadline and budget.
    pub confidence: Confidence,
    /// Priority among jobs with the same deadline. The greatest goes first.
    pub priority: i32,
    /// Weight among jobs of the same priority.
    #[serde(default = "default_weight")]
    pub weight: u32,
    /// Limits on what a task of the job may use.
    #[serde(default, skip_serializing_if = "TaskLimits::are_none")]
    pub limits: TaskLimits,
    /// Number of frames.
    pub frames_total: u32,
    /// Number of finished frames.
    pub frames_done: u32,
    /// Number of frames that were cancelled one by one. The job is done without them.
    #[serde(default, skip_serializing_if = "crate::is_zero")]
    pub frames_cancelled: u32,
    /// Share of the forecast work that is done, 0 to 1. Without a forecast, the share of the frames.
    pub progress: f64,
    /// Whether deadline and budget can be kept, by the newest plan. Absent until the job is booked.
    pub verdict: Option<JobVerdict>,
    /// The plan that booked the job. Absent until then.
    pub plan_id: Option<PlanId>,
    /// Why the job waits. Absent if it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waits: Option<Waits>,
    /// State of its promised deadline. Absent if none was promised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub promise: Option<Promise>,
    /// Probability that it meets its deadline, 0 to 1, in the scenarios of the newest plan. Of a quote on hold:
    /// if it were accepted now. Absent without a deadline or a plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// What the budget of its project is expected to hold back of it. Of a quote on hold: if it were accepted
    /// now. Absent if nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget_hold: Option<BudgetHold>,
    /// Expected finish of the last frame. Of a quote on hold: if it were accepted now. Absent before the quote,
    /// once the job is over, and if it cannot end before somebody raises a budget.
    pub eta: Option<Timestamp>,
    /// When it will be finished, in the scenarios of the newest plan. Absent if no plan says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<FinishQuantiles>,
    /// Cost of node time so far, including quotes and lost work. Absent in lists, and while it is zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spent: Option<Money>,
    /// The live estimate, updated by finished frames. Absent until the job is booked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub live: Option<LiveForecast>,
    /// Whether the job waits to be accepted once its quote is complete.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub hold: bool,
    /// Whether somebody paused the job, so that nothing more of it is started.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub paused: bool,
    /// Why the job failed. Absent if it did not.
    pub error: Option<String>,
    /// What failed of it and is tried again. Only in the answer of `GET /v1/jobs/{id}`, and if something did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failing: Option<Failing>,
    /// When it was submitted.
    pub created_at: Timestamp,
    /// When it was done, failed or cancelled. Absent until then.
    pub finished_at: Option<Timestamp>,
}

/// Tasks of a job that failed and are tried again.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Failing {
    /// Number of such tasks.
    pub tasks: u32,
    /// The one that failed most often.
    pub task_id: TaskId,
    /// Its frame. Absent for tasks about all frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u32>,
    /// How often it failed, or its worker was lost.
    pub attempts: u32,
    /// What happened, such as `frame 3 failed 5 times, last on rack-1: exit code 3`.
    pub words: String,
    /// When it is tried again, at the earliest. Absent if it may be, or is, already.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub again_at: Option<Timestamp>,
}

impl Job {
    /// Whether every pixel gets the camera samples of the settings. Otherwise they are chosen for a limit or an
    /// error, and go where they help.
    pub fn has_even_samples(&self) -> bool {
        self.within.is_none() && self.error_target.is_none()
    }
}

/// One page of jobs, newest first.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct JobPage {
    /// The jobs.
    pub items: Vec<Job>,
    /// Token of the next page. Absent on the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}

/// The result of checking a job request. Nothing is stored.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct JobCheck {
    /// Summary of the scene in the bundle.
    pub scene: SceneSummary,
    /// The frames to render.
    pub frames: FrameSet,
    /// Number of frames.
    pub frames_total: u32,
    /// The complete render settings. With another renderer, those of the scene are absent.
    pub settings: JobSettings,
}
