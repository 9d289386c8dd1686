//! Tasks: what workers are asked to do. What they answer is in `result`.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ArtifactHash, BundleSource, CacheFillSpec, CacheMergeSpec, CachePlanSpec, JobId, RenderSettings,
    SceneDigest,
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
    /// Lay out the ladders of qualities around the settings too.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub ladders: bool,
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
    /// Operations that the frame may take all together: every pixel gets a camera sample, and the others go where the image shows that they
    /// pay; all pixels get those of the settings, if it is absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work: Option<u64>,
    /// The finished pixels of this frame's profile, to be taken over; absent if the frame was not profiled.
    pub profile: Option<ArtifactHash>,
    /// The irradiance cache of the shot, full; absent if the frame makes its own, and while the task waits for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<ArtifactHash>,
}
