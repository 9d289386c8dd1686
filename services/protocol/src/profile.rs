//! What a profile says: pixels that were traced to the end, each with what it took.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{ArtifactHash, ByClass, LeftOut, Spent, Stratum};

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

/// One record of the irradiance cache, gathered and averaged with others to see what that takes.
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
    /// Planning the irradiance cache, and reading the one that is shared, if there is one; 0 without.
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
