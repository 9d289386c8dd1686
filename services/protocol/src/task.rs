//! Tasks for workers. Their results are in `result`.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ArtifactHash, BundleSource, CacheFillSpec, CacheMergeSpec, CachePlanSpec, DivideSpec, ErrorTarget, JobId,
    JobSettings, Passes, RenderPartSpec, RendererRequest, SceneDigest, VideoSpec,
};

/// Kind of a task.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskKind {
    /// Find what each pixel shows, in all frames.
    Preview,
    /// Trace a few pixels of one frame, and measure their cost.
    Profile,
    /// Plan one irradiance cache for all frames.
    CachePlan,
    /// Fill a part of the shared cache.
    CacheFill,
    /// Merge the parts of the shared cache.
    CacheMerge,
    /// Find parts of equal cost in one frame.
    Divide,
    /// Render one part of a frame.
    RenderPart,
    /// Render one frame, or put it together from its parts.
    Render,
    /// Encode the finished frames as a video.
    Video,
}

impl TaskKind {
    /// All kinds, in the order of a job's life.
    pub const ALL: [TaskKind; 9] = [
        TaskKind::Preview,
        TaskKind::Profile,
        TaskKind::CachePlan,
        TaskKind::CacheFill,
        TaskKind::CacheMerge,
        TaskKind::Divide,
        TaskKind::RenderPart,
        TaskKind::Render,
        TaskKind::Video,
    ];

    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            TaskKind::Preview => "preview",
            TaskKind::Profile => "profile",
            TaskKind::CachePlan => "cache_plan",
            TaskKind::CacheFill => "cache_fill",
            TaskKind::CacheMerge => "cache_merge",
            TaskKind::Divide => "divide",
            TaskKind::RenderPart => "render_part",
            TaskKind::Render => "render",
            TaskKind::Video => "video",
        }
    }

    /// Whether plans book this kind of task. Other tasks are steps that plans or booked tasks wait for.
    pub const fn is_booked(self) -> bool {
        matches!(self, TaskKind::CacheFill | TaskKind::RenderPart | TaskKind::Render)
    }
}

impl fmt::Display for TaskKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What a task has to do. In JSON an object with one key: `{"preview": {…}}`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskSpec {
    /// Find what each pixel shows, in all frames.
    Preview(PreviewSpec),
    /// Trace a few pixels of one frame, and measure their cost.
    Profile(ProfileSpec),
    /// Plan one irradiance cache for all frames.
    CachePlan(CachePlanSpec),
    /// Fill a part of the shared cache.
    CacheFill(CacheFillSpec),
    /// Merge the parts of the shared cache.
    CacheMerge(CacheMergeSpec),
    /// Find parts of equal cost in one frame.
    Divide(DivideSpec),
    /// Render one part of a frame.
    RenderPart(RenderPartSpec),
    /// Render one frame, or put it together from its parts.
    Render(RenderSpec),
    /// Encode the finished frames as a video.
    Video(VideoSpec),
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
            TaskSpec::Divide(_) => TaskKind::Divide,
            TaskSpec::RenderPart(_) => TaskKind::RenderPart,
            TaskSpec::Render(_) => TaskKind::Render,
            TaskSpec::Video(_) => TaskKind::Video,
        }
    }

    /// The frame of the task. `None` for previews, the shared cache and videos, which are about all frames.
    pub const fn frame(&self) -> Option<u32> {
        match self {
            TaskSpec::Preview(_) | TaskSpec::CachePlan(_) | TaskSpec::Video(_) => None,
            TaskSpec::CacheFill(spec) => spec.frame,
            TaskSpec::CacheMerge(spec) => spec.frame,
            TaskSpec::Profile(spec) => Some(spec.frame),
            TaskSpec::Divide(spec) => Some(spec.frame),
            TaskSpec::RenderPart(spec) => Some(spec.frame),
            TaskSpec::Render(spec) => Some(spec.frame),
        }
    }

    /// The round of filling a cache. `None` for other tasks.
    pub const fn round(&self) -> Option<u32> {
        match self {
            TaskSpec::CacheFill(spec) => Some(spec.round),
            TaskSpec::CacheMerge(spec) => Some(spec.round),
            _ => None,
        }
    }

    /// The part of the cache that the task fills, or of the frame that it renders. `None` for other tasks.
    pub const fn part(&self) -> Option<u32> {
        match self {
            TaskSpec::CacheFill(spec) => Some(spec.part),
            TaskSpec::RenderPart(spec) => Some(spec.part),
            _ => None,
        }
    }

    /// The irradiance caches that the task reads, in its order: that of a frame follows the shared one.
    pub fn caches(&self) -> Vec<ArtifactHash> {
        match self {
            TaskSpec::Preview(_) | TaskSpec::CachePlan(_) | TaskSpec::Video(_) => Vec::new(),
            TaskSpec::Profile(spec) => spec.cache.into_iter().collect(),
            TaskSpec::CacheFill(spec) => vec![spec.cache],
            TaskSpec::CacheMerge(spec) => spec.parts.clone(),
            TaskSpec::Divide(spec) => spec.cache.into_iter().chain(spec.frame_cache).collect(),
            TaskSpec::RenderPart(spec) => spec.cache.into_iter().chain(spec.frame_cache).collect(),
            TaskSpec::Render(spec) => spec.cache.into_iter().chain(spec.frame_cache).collect(),
        }
    }

    /// Finished pixels of the frame's profile that the task takes over.
    pub const fn profile(&self) -> Option<ArtifactHash> {
        match self {
            TaskSpec::Divide(spec) => spec.profile,
            TaskSpec::RenderPart(spec) => spec.profile,
            TaskSpec::Render(spec) => spec.profile,
            _ => None,
        }
    }

    /// Pixels of the frame's parts, finished or not, that the task takes over, in its order.
    pub fn parts(&self) -> &[ArtifactHash] {
        match self {
            TaskSpec::Divide(spec) => spec.passes.as_ref().map_or(&[], |passes| &passes.before),
            TaskSpec::RenderPart(spec) => spec.pass.as_ref().map_or(&[], |pass| &pass.before),
            TaskSpec::Render(spec) => &spec.parts,
            _ => &[],
        }
    }

    /// The number of samples of each pixel, if the task is a part of a pass.
    pub fn samples(&self) -> Option<ArtifactHash> {
        match self {
            TaskSpec::RenderPart(spec) => spec.pass.as_ref().map(|pass| pass.samples),
            _ => None,
        }
    }

    /// The images that the task shows, as PNG files, in order.
    pub fn pictures(&self) -> &[ArtifactHash] {
        match self {
            TaskSpec::Video(spec) => &spec.pictures,
            _ => &[],
        }
    }

    /// Where to get the bundle. `None` for videos.
    pub const fn bundle(&self) -> Option<&BundleSource> {
        match self {
            TaskSpec::Preview(spec) => Some(&spec.bundle),
            TaskSpec::Profile(spec) => Some(&spec.bundle),
            TaskSpec::CachePlan(spec) => Some(&spec.bundle),
            TaskSpec::CacheFill(spec) => Some(&spec.bundle),
            TaskSpec::CacheMerge(spec) => Some(&spec.bundle),
            TaskSpec::Divide(spec) => Some(&spec.bundle),
            TaskSpec::RenderPart(spec) => Some(&spec.bundle),
            TaskSpec::Render(spec) => Some(&spec.bundle),
            TaskSpec::Video(_) => None,
        }
    }

    /// The renderer; `None` for our own.
    pub const fn renderer(&self) -> Option<&RendererRequest> {
        match self {
            TaskSpec::Preview(PreviewSpec { renderer, .. })
            | TaskSpec::Profile(ProfileSpec { renderer, .. })
            | TaskSpec::RenderPart(RenderPartSpec { renderer, .. })
            | TaskSpec::Render(RenderSpec { renderer, .. }) => renderer.as_ref(),
            TaskSpec::CachePlan(_)
            | TaskSpec::CacheFill(_)
            | TaskSpec::CacheMerge(_)
            | TaskSpec::Divide(_)
            | TaskSpec::Video(_) => None,
        }
    }

    /// Expected hash of the scene's files. `None` for videos.
    pub const fn digest(&self) -> Option<SceneDigest> {
        match self {
            TaskSpec::Preview(spec) => Some(spec.digest),
            TaskSpec::Profile(spec) => Some(spec.digest),
            TaskSpec::CachePlan(spec) => Some(spec.digest),
            TaskSpec::CacheFill(spec) => Some(spec.digest),
            TaskSpec::CacheMerge(spec) => Some(spec.digest),
            TaskSpec::Divide(spec) => Some(spec.digest),
            TaskSpec::RenderPart(spec) => Some(spec.digest),
            TaskSpec::Render(spec) => Some(spec.digest),
            TaskSpec::Video(_) => None,
        }
    }
}

/// Task: find object and material of every pixel of these frames.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PreviewSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// Expected hash of the scene's files. A worker that finds other files fails the task permanently.
    pub digest: SceneDigest,
    /// The frames, ascending.
    pub frames: Vec<u32>,
    /// The job's settings.
    pub settings: JobSettings,
    /// The renderer. Absent for forelight's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub renderer: Option<RendererRequest>,
}

/// Task: profile one frame. About `samples` pixels, chosen over the strata, are traced and measured.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ProfileSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// Expected hash of the scene's files. A worker that finds other files fails the task permanently.
    pub digest: SceneDigest,
    /// The frame.
    pub frame: u32,
    /// Number of pixels to profile.
    pub samples: u32,
    /// Seed for choosing the pixels. The pixels' own random numbers use `settings.seed`, as in the render. For
    /// another renderer, the number of frames that are measured before this one: its regions differ.
    pub phase_seed: u64,
    /// The job's settings.
    pub settings: JobSettings,
    /// The renderer. Absent for forelight's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub renderer: Option<RendererRequest>,
    /// Whether to measure ladders of other qualities around the settings as well.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub ladders: bool,
    /// Whether the noise of the image will be removed. The profile then prices that, too.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub denoise: bool,
    /// Error target of the job. The profile then says how many samples reach it. Any irradiance cache is
    /// filled first, and goes into the profile. Absent without a target.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_target: Option<ErrorTarget>,
    /// Planned irradiance cache that all frames could share; pixels are also measured with it. Absent without
    /// one, and while waiting.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<ArtifactHash>,
}

/// Task: render one frame, or put it together from its finished parts.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct RenderSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// Expected hash of the scene's files. A worker that finds other files fails the task permanently.
    pub digest: SceneDigest,
    /// The frame.
    pub frame: u32,
    /// The job's settings.
    pub settings: JobSettings,
    /// The renderer. Absent for forelight's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub renderer: Option<RendererRequest>,
    /// Largest work of the frame, or with an error target its forecast. Every pixel gets one camera sample (two
    /// with an error target); others go where they reduce the error most. If absent, the settings' samples.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work: Option<u64>,
    /// The image is finished when its error is small enough. Absent: when the work is spent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_target: Option<ErrorTarget>,
    /// Whether to remove the noise of the image, and to measure the error that is left.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub denoise: bool,
    /// Finished pixels of this frame's profile, to take over. Absent if the frame was not profiled.
    pub profile: Option<ArtifactHash>,
    /// The complete shared irradiance cache. Absent without one, and while the task waits for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<ArtifactHash>,
    /// The complete irradiance cache of a divided frame. Absent if the frame makes its own, or needs none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_cache: Option<ArtifactHash>,
    /// Finished pixels of the frame's parts, to take over, in their order. Empty if it is not divided.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<ArtifactHash>,
    /// Finished shares of this frame's samples, to take over, in the order of their samples.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shares: Vec<SampleShare>,
}

impl RenderSpec {
    /// How the frame is rendered in passes. `None` if every pixel gets the settings' samples.
    pub fn passes(&self) -> Option<Passes> {
        self.work.map(|work| Passes { work, error_target: self.error_target, before: Vec::new() })
    }
}

/// A share of a frame's samples that is finished.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SampleShare {
    /// Number of samples before it.
    pub offset: u32,
    /// Number of samples.
    pub count: u32,
    /// CPU time of these samples in nanoseconds, without what does not depend on samples.
    pub cpu_nanos: u64,
    /// The file with these samples.
    pub hash: ArtifactHash,
}
