//! Tasks: what workers are asked to do, and what they answer.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ArtifactHash, BundleSource, ByClass, CacheFillResult, CacheFillSpec, CacheMergeResult, CacheMergeSpec,
    CachePlanResult, CachePlanSpec, JobId, LeftOut, RenderSettings, RenderStats, SceneDigest,
};

/// The kinds of tasks.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskKind {
    /// See what the camera sees, in all frames.
    Preview,
    /// Trace a few pixels of one frame and measure them.
    Profile,
    /// Plan the irradiance cache of all frames.
    CachePlan,
    /// Fill a part of it.
    CacheFill,
    /// Put its parts together.
    CacheMerge,
    /// Render one frame.
    Render,
}

impl TaskKind {
    /// All kinds, in the order of a job's life.
    pub const ALL: [TaskKind; 6] = [
        TaskKind::Preview,
        TaskKind::Profile,
        TaskKind::CachePlan,
        TaskKind::CacheFill,
        TaskKind::CacheMerge,
        TaskKind::Render,
    ];

    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            TaskKind::Preview => "preview",
            TaskKind::Profile => "profile",
            TaskKind::CachePlan => "cache_plan",
            TaskKind::CacheFill => "cache_fill",
            TaskKind::CacheMerge => "cache_merge",
            TaskKind::Render => "render",
        }
    }

    /// Whether it is work that a plan books, rather than a step that a plan or a booked task waits for.
    pub const fn is_booked(self) -> bool {
        matches!(self, TaskKind::CacheFill | TaskKind::Render)
    }

    /// The kind of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

impl fmt::Display for TaskKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What is to be done. In JSON an object with one key: `{"preview": {…}}`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskSpec {
    /// See what the camera sees.
    Preview(PreviewSpec),
    /// Trace and measure a few pixels.
    Profile(ProfileSpec),
    /// Plan the shot's irradiance cache.
    CachePlan(CachePlanSpec),
    /// Fill a part of it.
    CacheFill(CacheFillSpec),
    /// Put its parts together.
    CacheMerge(CacheMergeSpec),
    /// Render a frame.
    Render(RenderSpec),
}

impl TaskSpec {
    /// The kind of task.
    pub const fn kind(&self) -> TaskKind {
        match self {
            TaskSpec::Preview(_) => TaskKind::Preview,
            TaskSpec::Profile(_) => TaskKind::Profile,
            TaskSpec::CachePlan(_) => TaskKind::CachePlan,
            TaskSpec::CacheFill(_) => TaskKind::CacheFill,
            TaskSpec::CacheMerge(_) => TaskKind::CacheMerge,
            TaskSpec::Render(_) => TaskKind::Render,
        }
    }

    /// The frame that the task is about; `None` for a preview and the shot's cache, which are about all frames.
    pub const fn frame(&self) -> Option<u32> {
        match self {
            TaskSpec::Preview(_)
            | TaskSpec::CachePlan(_)
            | TaskSpec::CacheFill(_)
            | TaskSpec::CacheMerge(_) => None,
            TaskSpec::Profile(spec) => Some(spec.frame),
            TaskSpec::Render(spec) => Some(spec.frame),
        }
    }

    /// The round of filling the shot's cache that the task is of.
    pub const fn round(&self) -> Option<u32> {
        match self {
            TaskSpec::CacheFill(spec) => Some(spec.round),
            TaskSpec::CacheMerge(spec) => Some(spec.round),
            _ => None,
        }
    }

    /// The part of the shot's cache that the task fills.
    pub const fn part(&self) -> Option<u32> {
        match self {
            TaskSpec::CacheFill(spec) => Some(spec.part),
            _ => None,
        }
    }

    /// The irradiance caches that the task is given, in its order.
    pub fn caches(&self) -> Vec<ArtifactHash> {
        match self {
            TaskSpec::Preview(_) | TaskSpec::CachePlan(_) => Vec::new(),
            TaskSpec::Profile(spec) => spec.cache.into_iter().collect(),
            TaskSpec::CacheFill(spec) => vec![spec.cache],
            TaskSpec::CacheMerge(spec) => spec.parts.clone(),
            TaskSpec::Render(spec) => spec.cache.into_iter().collect(),
        }
    }

    /// Where the bundle is.
    pub const fn bundle(&self) -> &BundleSource {
        match self {
            TaskSpec::Preview(spec) => &spec.bundle,
            TaskSpec::Profile(spec) => &spec.bundle,
            TaskSpec::CachePlan(spec) => &spec.bundle,
            TaskSpec::CacheFill(spec) => &spec.bundle,
            TaskSpec::CacheMerge(spec) => &spec.bundle,
            TaskSpec::Render(spec) => &spec.bundle,
        }
    }

    /// What the bundle has to hold.
    pub const fn digest(&self) -> SceneDigest {
        match self {
            TaskSpec::Preview(spec) => spec.digest,
            TaskSpec::Profile(spec) => spec.digest,
            TaskSpec::CachePlan(spec) => spec.digest,
            TaskSpec::CacheFill(spec) => spec.digest,
            TaskSpec::CacheMerge(spec) => spec.digest,
            TaskSpec::Render(spec) => spec.digest,
        }
    }
}

/// Preview these frames: object and material of every pixel.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PreviewSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// What the bundle has to hold: a worker that finds something else there fails the task for good.
    pub digest: SceneDigest,
    /// The frames, ascending.
    pub frames: Vec<u32>,
    /// Its settings.
    pub settings: RenderSettings,
}

/// Profile one frame: choose about `samples` pixels over the frame's strata, trace them to the end with the job's
/// settings, and measure each.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ProfileSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// What the bundle has to hold: a worker that finds something else there fails the task for good.
    pub digest: SceneDigest,
    /// The frame.
    pub frame: u32,
    /// Pixels to profile.
    pub samples: u32,
    /// Seed of the choice of pixels. The pixels' own random numbers come from `settings.seed`, as in the render.
    pub phase_seed: u64,
    /// The job's settings.
    pub settings: RenderSettings,
    /// The irradiance cache, as planned, that all frames could share: the pixels are also measured with it. Absent if there is none, and
    /// while the task waits for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<ArtifactHash>,
}

/// Render one frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct RenderSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// What the bundle has to hold: a worker that finds something else there fails the task for good.
    pub digest: SceneDigest,
    /// The frame.
    pub frame: u32,
    /// The job's settings.
    pub settings: RenderSettings,
    /// The finished pixels of this frame's profile, to be taken over; absent if the frame was not profiled.
    pub profile: Option<ArtifactHash>,
    /// The irradiance cache of the shot, full; absent if the frame makes its own, and while the task waits for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<ArtifactHash>,
}

/// What came of it. In JSON an object with one key: `{"preview": {…}}`.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskResult {
    /// Of a preview.
    Preview(PreviewResult),
    /// Of a profile.
    Profile(ProfileResult),
    /// Of planning the shot's irradiance cache.
    CachePlan(CachePlanResult),
    /// Of filling a part of it.
    CacheFill(CacheFillResult),
    /// Of putting its parts together.
    CacheMerge(CacheMergeResult),
    /// Of a render.
    Render(RenderResult),
}

impl TaskResult {
    /// The kind of task that gives such a result.
    pub const fn kind(&self) -> TaskKind {
        match self {
            TaskResult::Preview(_) => TaskKind::Preview,
            TaskResult::Profile(_) => TaskKind::Profile,
            TaskResult::CachePlan(_) => TaskKind::CachePlan,
            TaskResult::CacheFill(_) => TaskKind::CacheFill,
            TaskResult::CacheMerge(_) => TaskKind::CacheMerge,
            TaskResult::Render(_) => TaskKind::Render,
        }
    }

    /// The artefacts that the result names, which have to be there before it can be committed.
    pub fn artifacts(&self) -> Vec<ArtifactHash> {
        match self {
            TaskResult::Preview(result) => {
                result.frames.iter().filter_map(|frame| frame.preview_png).collect()
            }
            TaskResult::Profile(result) => {
                std::iter::once(result.artifacts.profile).chain(result.artifacts.preview_png).collect()
            }
            TaskResult::CachePlan(result) => result.cache.into_iter().collect(),
            TaskResult::CacheFill(result) => vec![result.cache],
            TaskResult::CacheMerge(result) => vec![result.cache],
            TaskResult::Render(result) => {
                let RenderArtifacts { image_exr, image_png, cost_map_png, preview_png } = result.artifacts;
                [image_exr, image_png, cost_map_png].into_iter().chain(preview_png).collect()
            }
        }
    }
}

/// Operations and time that something took.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Spent {
    /// Deterministic count of operations.
    pub work: u64,
    /// CPU time over all threads, in nanoseconds.
    pub cpu_nanos: u64,
}

impl Spent {
    /// Both together.
    #[must_use]
    pub const fn plus(self, other: Self) -> Self {
        Self {
            work: self.work.saturating_add(other.work),
            cpu_nanos: self.cpu_nanos.saturating_add(other.cpu_nanos),
        }
    }
}

/// A stratum: the pixels that show one material of one object.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StratumName {
    /// The object's name.
    pub object: String,
    /// The material's name.
    pub material: String,
}

/// A stratum as results speak of it. Its identity is `(object, material)`; the names are for people, and a scene may have the
/// same name twice. Tasks of one job that saw the same bundle number objects and materials alike.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Stratum {
    /// What people call it.
    pub name: StratumName,
    /// Number of the object in the scene, below 2³² − 1.
    pub object: u32,
    /// Number of the material in the scene, below 2³² − 1. Strata of one material are sampled together where they are small.
    pub material: u32,
    /// What one of its pixels is thought to cost before anything is measured, relative to a plain diffuse pixel (1): above 0,
    /// to 1000000. Whoever samples and whoever estimates must join small strata alike, and this decides which are small.
    #[schema(exclusive_minimum = 0, maximum = 1_000_000)]
    pub prior_cost: f64,
}

impl Stratum {
    /// The largest prior cost. With it no sum over an image's pixels comes near the end of a float's range.
    pub const HIGHEST_PRIOR_COST: f64 = 1e6;

    /// What tells it from other strata: object and material.
    pub const fn identity(&self) -> (u32, u32) {
        (self.object, self.material)
    }
}

/// What made the preview.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PreviewBackend {
    /// A graphics processor, or a software one.
    Gpu,
    /// The tracer's own camera rays.
    Cpu,
}

/// How many pixels of a frame show each stratum.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FrameStrata {
    /// Frame number.
    pub frame: u32,
    /// Pixels by stratum, in the order of [`PreviewResult::strata`] and as many.
    pub pixels: Vec<u32>,
    /// Pixels that show nothing. With `pixels` they make up the whole image.
    pub background: u32,
    /// Records of the frame's irradiance cache, which is planned with the preview, one number a level; empty without a cache.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cache_records: Vec<u32>,
    /// Which of the scene's lights shine, as a number that frames with the same ones share: what is in sight costs something else
    /// under other lights.
    #[serde(default)]
    pub lights: u32,
    /// The preview as an image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preview_png: Option<ArtifactHash>,
}

/// The result of a preview.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PreviewResult {
    /// All strata that any frame shows, each once.
    pub strata: Vec<Stratum>,
    /// What a pixel that shows nothing is thought to cost, in the unit of [`Stratum::prior_cost`] and within the same range.
    #[schema(exclusive_minimum = 0, maximum = 1_000_000)]
    pub background_prior_cost: f64,
    /// What a record of the irradiance cache is thought to cost, in the same unit and range; absent without a cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0, maximum = 1_000_000)]
    pub record_prior_cost: Option<f64>,
    /// One entry a frame, in the order of the spec.
    pub frames: Vec<FrameStrata>,
    /// What made it.
    pub backend: PreviewBackend,
    /// What it took.
    pub spent: Spent,
}

/// One profiled pixel.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileSample {
    /// The pixel: row × width + column, from the top left.
    pub pixel: u32,
    /// Index into [`ProfileResult::strata`]; the number of strata stands for the background.
    pub stratum: u32,
    /// Deterministic count of operations of all its camera paths.
    pub work: u64,
    /// CPU time of all its camera paths, in nanoseconds.
    pub cpu_nanos: u64,
    /// Rays by category, in the order of [`crate::Rays::NAMES`].
    #[schema(min_items = 7, max_items = 7)]
    pub rays: [u64; 7],
}

/// What a profiled pixel costs if the frame shares its irradiance cache with others: there are more records to look at.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SharedSample {
    /// Deterministic count of operations of all its camera paths.
    pub work: u64,
    /// CPU time of all its camera paths, in nanoseconds.
    pub cpu_nanos: u64,
    /// Rays by category, in the order of [`crate::Rays::NAMES`].
    #[schema(min_items = 7, max_items = 7)]
    pub rays: [u64; 7],
}

/// One record of the irradiance cache, gathered to see what that takes.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheSample {
    /// Level of the record: 0 is read by the image, each further one by the gathers of the one before.
    pub level: u32,
    /// Deterministic count of operations.
    pub work: u64,
    /// CPU time, in nanoseconds.
    pub cpu_nanos: u64,
    /// Rays by category, in the order of [`crate::Rays::NAMES`].
    #[schema(min_items = 7, max_items = 7)]
    pub rays: [u64; 7],
}

/// What the camera samples of one profiled pixel say of its error.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NoiseSample {
    /// Mean of the samples and of their three linear channels.
    pub brightness: f32,
    /// Estimates of V(1) − V(2), V(2) − V(4), V(4) − V(8), …, where V(n) is the variance of the mean of n camera samples, mean over
    /// channels: as many as the number of samples can be halved. None is negative.
    #[schema(max_items = 32)]
    pub drops: Vec<f32>,
}

/// Pixels of a frame that are alike, and some of them with what their samples say.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NoiseCell {
    /// How many pixels there are.
    pub pixels: u32,
    /// Some of them, all alike likely.
    pub samples: Vec<NoiseSample>,
}

/// Costs that a frame has whatever its pixels show.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FixedCosts {
    /// Loading the bundle and setting up the frame.
    pub load: Spent,
    /// Building the acceleration structure.
    pub build: Spent,
    /// Planning the irradiance cache; 0 without one.
    #[serde(default)]
    pub plan: Spent,
    /// Rays of the plan by category, in the order of [`crate::Rays::NAMES`].
    #[serde(default)]
    #[schema(min_items = 7, max_items = 7)]
    pub plan_rays: [u64; 7],
    /// Making the files of a finished frame: encoding its pictures, and the preview among them. In time alone: work counts
    /// tracing. All 0 where no such files are made.
    pub write: Spent,
}

impl FixedCosts {
    /// All of them together.
    pub const fn total(self) -> Spent {
        let Self { load, build, plan, plan_rays: _, write } = self;
        load.plus(build).plus(plan).plus(write)
    }
}

/// The artefacts of a profile.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileArtifacts {
    /// The finished pixels with their radiance and counters, or the irradiance cache as far as it was gathered, for the render to
    /// take over.
    pub profile: ArtifactHash,
    /// The frame's preview as an image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preview_png: Option<ArtifactHash>,
}

/// The result of a profile.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileResult {
    /// The frame.
    pub frame: u32,
    /// The strata that the samples refer to, each once. Matched with the preview's by identity: the order may differ.
    pub strata: Vec<Stratum>,
    /// The profiled pixels, each once.
    pub samples: Vec<ProfileSample>,
    /// What each of these pixels costs with the cache that the task names, in their order; empty if it names none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shared_samples: Vec<SharedSample>,
    /// Records of the irradiance cache that were gathered, some of every level; empty without a cache.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cache_samples: Vec<CacheSample>,
    /// The same of the cache that the task names: the gathers of one level look at the records of the next, of which there are more.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shared_cache_samples: Vec<CacheSample>,
    /// What the profiled pixels say of the image's error, by what they show: all pixels of the frame are in one of the cells. Empty
    /// with an irradiance cache, for it is not filled yet, and where too few camera samples were taken to tell.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub noise: Vec<NoiseCell>,
    /// The effects that the frame calls for, by name, sorted.
    #[serde(default)]
    pub effects: Vec<String>,
    /// Lights and objects that cannot matter to the frame's image.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// The renderer that measured all this, with its version: what it took is compared with that of the same alone. At most 200 characters;
    /// if it is left out, nothing is learnt from the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(max_length = 200)]
    pub renderer: Option<String>,
    /// What the frame's work is thought to be, by class: that of the profiled pixels and records, brought to all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work_by_class: Option<ByClass>,
    /// Costs beside the pixels.
    pub fixed: FixedCosts,
    /// What the whole task took.
    pub spent: Spent,
    /// Its artefacts.
    pub artifacts: ProfileArtifacts,
}

/// The artefacts of a render.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderArtifacts {
    /// The image, linear, OpenEXR.
    pub image_exr: ArtifactHash,
    /// The image, for looking at.
    pub image_png: ArtifactHash,
    /// Cost of each pixel in colour.
    pub cost_map_png: ArtifactHash,
    /// Object and material ids in colour.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preview_png: Option<ArtifactHash>,
}

/// The result of a render.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderResult {
    /// What the frame took.
    pub stats: RenderStats,
    /// Its artefacts.
    pub artifacts: RenderArtifacts,
}
