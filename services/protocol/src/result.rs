//! Results of preview and render tasks.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ArtifactHash, CacheFillResult, CacheMergeResult, CachePlanResult, DivideResult, PlanCount, ProfileResult,
    RenderPartResult, RenderStats, RendererId, SampleShare, SceneSummary, ShotSettings, Spent, Stratum,
    TaskKind, VideoResult,
};

/// Result of a task. In JSON an object with one key: `{"preview": {…}}`.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskResult {
    /// Result of a preview.
    Preview(PreviewResult),
    /// Result of a profile.
    Profile(ProfileResult),
    /// Result of a profile by another renderer.
    Measured(MeasuredFrame),
    /// Result of planning a shared irradiance cache.
    CachePlan(CachePlanResult),
    /// Result of filling a part of the cache.
    CacheFill(CacheFillResult),
    /// Result of merging the parts of the cache.
    CacheMerge(CacheMergeResult),
    /// Result of dividing a frame into parts.
    Divide(DivideResult),
    /// Result of rendering a part of a frame.
    RenderPart(RenderPartResult),
    /// Result of a render.
    Render(RenderResult),
    /// Result of encoding a video.
    Video(VideoResult),
}

impl TaskResult {
    /// Kind of task with such a result.
    pub const fn kind(&self) -> TaskKind {
        match self {
            TaskResult::Preview(_) => TaskKind::Preview,
            TaskResult::Profile(_) | TaskResult::Measured(_) => TaskKind::Profile,
            TaskResult::CachePlan(_) => TaskKind::CachePlan,
            TaskResult::CacheFill(_) => TaskKind::CacheFill,
            TaskResult::CacheMerge(_) => TaskKind::CacheMerge,
            TaskResult::Divide(_) => TaskKind::Divide,
            TaskResult::RenderPart(_) => TaskKind::RenderPart,
            TaskResult::Render(_) => TaskKind::Render,
            TaskResult::Video(_) => TaskKind::Video,
        }
    }

    /// Artefacts that the result names. They must exist before the result can be committed.
    pub fn artifacts(&self) -> Vec<ArtifactHash> {
        match self {
            TaskResult::Preview(result) => {
                result.frames.iter().filter_map(|frame| frame.preview_png).collect()
            }
            TaskResult::Profile(result) => {
                std::iter::once(result.artifacts.profile).chain(result.artifacts.preview_png).collect()
            }
            TaskResult::Measured(result) => {
                let shares = result.shares.iter().filter_map(|share| share.hash);
                shares.chain(result.preview_png).collect()
            }
            TaskResult::CachePlan(result) => result.cache.into_iter().collect(),
            TaskResult::CacheFill(result) => vec![result.cache],
            TaskResult::CacheMerge(result) => vec![result.cache],
            TaskResult::Divide(result) => {
                let cache = result.cache.map(|cache| cache.hash).into_iter();
                cache.chain(result.coarse_png).chain(result.samples).collect()
            }
            TaskResult::RenderPart(result) => vec![result.finished.hash()],
            TaskResult::Render(result) => {
                let RenderArtifacts { image_exr, image_png, cost_map_png, preview_png } = result.artifacts;
                [image_exr, image_png, cost_map_png].into_iter().chain(preview_png).collect()
            }
            TaskResult::Video(result) => vec![result.file.hash],
        }
    }
}

/// How previews were made.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PreviewBackend {
    /// On a Vulkan device: a GPU or a software driver.
    Gpu,
    /// On the CPU, by camera rays.
    Cpu,
    /// By an id pass of the job's renderer.
    Renderer,
}

/// Pixel counts of a frame by stratum.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FrameStrata {
    /// Frame number.
    pub frame: u32,
    /// Number of pixels of each stratum, in the order of `strata` of the preview's result.
    pub pixels: Vec<u32>,
    /// Number of pixels that show no surface. The sum of `pixels` and this is the whole image.
    pub background: u32,
    /// Number of irradiance cache records by level, planned with the preview. Empty without a cache.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cache_records: Vec<u32>,
    /// Cost of planning the cache. Absent without a cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache_plan: Option<PlanCount>,
    /// Number of the set of shining lights. Costs depend on it.
    #[serde(default)]
    pub lights: u32,
    /// Number of shining lights, including the environment.
    #[serde(default)]
    pub shining: u32,
    /// Number of triangles in the acceleration structure, visible or not. 0 if unknown.
    #[serde(default)]
    pub triangles: u64,
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
    /// Expected cost of a pixel that shows no surface, in the unit and range of `prior_cost` of a stratum.
    #[schema(exclusive_minimum = 0, maximum = 1_000_000)]
    pub background_prior_cost: f64,
    /// Expected cost of an irradiance cache record, in the same unit and range. Absent without a cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0, maximum = 1_000_000)]
    pub record_prior_cost: Option<f64>,
    /// One entry per frame, in the order of the task.
    pub frames: Vec<FrameStrata>,
    /// How the previews were made.
    pub backend: PreviewBackend,
    /// Cost of the previews.
    pub spent: Spent,
    /// What the job's renderer found in the scene. Absent with forelight's own renderer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub described: Option<Box<Described>>,
}

/// What a renderer found in a scene.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Described {
    /// The renderer.
    pub renderer: RendererId,
    /// Summary of the scene.
    pub scene: SceneSummary,
    /// The complete settings: the scene's, changed by the job's.
    pub settings: ShotSettings,
    /// What a user should know, such as scripts that are not run. At most 100.
    #[schema(max_items = 100)]
    pub notes: Vec<String>,
}

/// Measured cost of a part of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SampleCost {
    /// How much the part has of what is varied, such as samples. With 0, the costs that do not depend on it.
    pub amount: u32,
    /// CPU time over all threads, in nanoseconds.
    pub cpu_nanos: u64,
}

/// A part of a frame's cost that does not depend on what is varied.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FixedPart {
    /// What the renderer did: `scene`, `tree`, `textures`, `kernels`, `images`, `pixels` (what the first
    /// sample of a pixel takes longer), `finish`, `write`, and `prepare` for what is not told apart. Or a word
    /// of its own, 1 to 50 characters.
    #[schema(min_length = 1, max_length = 50, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub name: String,
    /// CPU time over all threads, in nanoseconds.
    pub cpu_nanos: u64,
}

/// A measured share of a frame's samples.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MeasuredShare {
    /// Number of samples before it.
    pub offset: u32,
    /// Number of samples.
    pub count: u32,
    /// CPU time of these samples in nanoseconds, without what does not depend on samples.
    pub cpu_nanos: u64,
    /// The file with these samples, which the render takes over. Absent if it cannot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hash: Option<ArtifactHash>,
}

impl MeasuredShare {
    /// The share as a render takes it over.
    pub fn taken_over(&self) -> Option<SampleShare> {
        let Self { offset, count, cpu_nanos, hash } = *self;
        Some(SampleShare { offset, count, cpu_nanos, hash: hash? })
    }
}

/// Time that a renderer spent on one stratum of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StratumTime {
    /// Number of the object in the scene. Absent for the background.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<u32>,
    /// Number of the material in the scene. Absent if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<u32>,
    /// Time in nanoseconds. It says how the cost divides, not how large it is.
    pub nanos: u64,
}

/// In what the measured parts of a frame differ. The frame's cost is a line in it.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Varied {
    /// Samples per pixel.
    Samples,
    /// The size of the image, in pixels.
    Size,
    /// The number of pixels in regions of the image.
    Regions,
    /// Nothing: whole frames are measured, which count as 1.
    Nothing,
}

/// Result of a profile by another renderer: costs of cheap parts of the frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MeasuredFrame {
    /// The frame.
    pub frame: u32,
    /// The renderer.
    pub renderer: RendererId,
    /// In what the measured parts differ.
    pub varied: Varied,
    /// How much of that the whole frame has: samples per pixel, pixels, or 1. With adaptive sampling, it is
    /// 1,000,000, and amounts are millionths of the frame's mean samples per pixel.
    pub whole: u32,
    /// Measured costs, at two different amounts at least. At most 1000.
    #[schema(max_items = 1000)]
    pub costs: Vec<SampleCost>,
    /// What the costs consist of that do not depend on what is varied. At most 20. Empty if the renderer does
    /// not say.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 20)]
    pub fixed: Vec<FixedPart>,
    /// Where the time went. Empty if the renderer does not know.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub strata: Vec<StratumTime>,
    /// The measured shares of the samples. At most 100.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 100)]
    pub shares: Vec<MeasuredShare>,
    /// Object and material of each pixel as a colour. Absent if the renderer does not know them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preview_png: Option<ArtifactHash>,
    /// Cost of the whole task.
    pub spent: Spent,
    /// Largest resident memory in bytes. 0 if unknown.
    #[serde(default)]
    pub peak_memory_bytes: u64,
}

/// The artefacts of a render.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderArtifacts {
    /// The image with linear values, as OpenEXR.
    pub image_exr: ArtifactHash,
    /// The image, for display.
    pub image_png: ArtifactHash,
    /// The cost of each pixel as a colour.
    pub cost_map_png: ArtifactHash,
    /// The preview: object and material ids as colours.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preview_png: Option<ArtifactHash>,
}

/// The result of a render.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderResult {
    /// Cost of the frame.
    pub stats: RenderStats,
    /// Its artefacts.
    pub artifacts: RenderArtifacts,
}
