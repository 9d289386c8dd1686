//! What workers answer when a task is done: of previews and renders. Profiles are in `profile`, irradiance caches in `cache`.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ArtifactHash, CacheFillResult, CacheMergeResult, CachePlanResult, PlanCount, ProfileResult, RenderStats,
    TaskKind,
};

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

    /// The mean of some; none of none.
    pub fn mean(all: impl ExactSizeIterator<Item = Self>) -> Option<Self> {
        let count = u64::try_from(all.len()).ok().filter(|&count| count > 0)?;
        let sum = all.fold(Self::default(), Self::plus);
        Some(Self { work: sum.work / count, cpu_nanos: sum.cpu_nanos / count })
    }

    /// The same on a node of speed 1, if a node of this speed took it.
    #[must_use]
    pub fn at_speed_one(self, speed: f64) -> Self {
        Self { cpu_nanos: crate::at_speed_one(self.cpu_nanos, speed), ..self }
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
    /// What planning it takes; absent without a cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache_plan: Option<PlanCount>,
    /// Which of the scene's lights shine, as a number that frames with the same ones share: what is in sight costs something else
    /// under other lights.
    #[serde(default)]
    pub lights: u32,
    /// How many of them shine, the environment being one.
    #[serde(default)]
    pub shining: u32,
    /// Triangles of the frame, seen or not: a tree is built over all of them. 0 if nobody counted.
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
