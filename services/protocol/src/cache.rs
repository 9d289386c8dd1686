//! The irradiance cache of a shot: whether its frames share one, its cost, and its progress.
//!
//! ```text
//! cache_plan ──► the quote: shared or private ──► cache_fill (parts, in parallel) ──► cache_merge ──► frames
//!                                                      ▲                                    │
//!                                                      └── the next level, if there is one ─┘
//! ```

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ArtifactHash, BundleSource, JobId, Money, MoneyQuantiles, Quantiles, RenderSettings, SceneDigest, Spent,
};

/// Largest size of a shared irradiance cache or a part of it, in bytes. If a shot needs more, each frame
/// makes its own cache.
pub const CACHE_BYTES: u64 = 1 << 30;

/// Largest number of rounds of filling: one for each bounce of indirect light.
pub const CACHE_ROUNDS: u32 = 8;

/// Whether the frames of a job share one irradiance cache. Has no effect on a job without caches.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum CacheSharing {
    /// Whichever needs less work in total, for all frames and the shared cache.
    #[default]
    Auto,
    /// One cache is made for all frames, before any of them is rendered.
    Shared,
    /// Each frame makes its own cache.
    Private,
}

impl CacheSharing {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Shared => "shared",
            Self::Private => "private",
        }
    }
}

/// Task: plan one irradiance cache for all frames of a job, and check its records in each frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CachePlanSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// Expected hash of the scene's files. A worker that finds other files fails the task permanently.
    pub digest: SceneDigest,
    /// The frames, ascending. Records are planned in the scene as it is in the first of them.
    pub frames: Vec<u32>,
    /// The job's settings.
    pub settings: RenderSettings,
}

/// Task: gather the light for one part of an irradiance cache: a shared one, or that of a divided frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CacheFillSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// Expected hash of the scene's files. A worker that finds other files fails the task permanently.
    pub digest: SceneDigest,
    /// The divided frame whose own cache it is. Absent for a shared cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u32>,
    /// The job's settings.
    pub settings: RenderSettings,
    /// The cache so far: the planned one in the first round, the merged one in later rounds.
    pub cache: ArtifactHash,
    /// The round, from 0. With several parts, each round fills one level, the deepest first. One part fills
    /// all levels.
    pub round: u32,
    /// The part, from 0.
    pub part: u32,
    /// Number of equal parts in the round.
    pub parts: u32,
}

/// Task: merge the parts of a round.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CacheMergeSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// Expected hash of the scene's files. A worker that finds other files fails the task permanently.
    pub digest: SceneDigest,
    /// The divided frame whose own cache it is. Absent for a shared cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u32>,
    /// The round, from 0.
    pub round: u32,
    /// The results of the parts, in order.
    pub parts: Vec<ArtifactHash>,
}

/// Counted cost of planning a frame's irradiance cache.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PlanCount {
    /// Deterministic count of operations.
    pub work: u64,
    /// Rays by category: primary, shadow, transparent, reflected, refracted, ambient, specular.
    #[schema(min_items = 7, max_items = 7)]
    pub rays: [u64; 7],
}

/// How one frame uses the shared irradiance cache.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheFrame {
    /// Frame number.
    pub frame: u32,
    /// Number of records that the frame's image uses, by level.
    pub records: Vec<u32>,
    /// How many of them the shared cache lacks, by level. The frame gathers these itself.
    pub own: Vec<u32>,
    /// Number of records of the shared cache that are not valid here, because something moved.
    pub dropped: u64,
    /// Cost of reading the shared cache, checking its records, and planning the missing ones.
    pub plan: Spent,
    /// Rays of `plan` by category: primary, shadow, transparent, reflected, refracted, ambient, specular.
    #[schema(min_items = 7, max_items = 7)]
    pub plan_rays: [u64; 7],
}

/// Result of planning a shared irradiance cache.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CachePlanResult {
    /// The planned, unfilled cache. Absent if it would be larger than 2³⁰ bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<ArtifactHash>,
    /// Its size in bytes.
    pub bytes: u64,
    /// Number of records, by level.
    pub records: Vec<u32>,
    /// One entry per frame, in the order of the task.
    pub frames: Vec<CacheFrame>,
    /// Cost of planning.
    pub spent: Spent,
}

/// Result of filling one part.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheFillResult {
    /// The cache with this part filled.
    pub cache: ArtifactHash,
    /// Its size in bytes.
    pub bytes: u64,
    /// Number of records filled.
    pub filled: u64,
    /// Whether all records of the cache are filled.
    pub full: bool,
    /// Cost of gathering these records.
    pub spent: Spent,
}

/// Result of merging the parts of a round.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheMergeResult {
    /// The cache with all parts of the round.
    pub cache: ArtifactHash,
    /// Its size in bytes.
    pub bytes: u64,
    /// Whether all records are filled. If not, the next level is filled.
    pub full: bool,
    /// Cost of merging. It is CPU time only: no light is traced, so `work` is 0.
    pub spent: Spent,
}

/// Cost of rendering a job with one way of making its irradiance caches.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CachePrice {
    /// Number of records gathered, for the shared cache and all frames.
    pub records: u64,
    /// Expected work of all frames and the shared cache.
    pub work: f64,
    /// Expected CPU seconds of the same, on a node of speed 1.
    pub cpu_seconds: f64,
    /// Cost at the mean price of the farm's nodes. Absent if there are no nodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<Money>,
}

/// The shared irradiance cache as a line of the quote. It is not part of any frame's cost.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct SharedCacheForecast {
    /// Number of records, by level.
    pub records: Vec<u32>,
    /// Number of parts, which can be filled at the same time.
    pub parts: u32,
    /// Deterministic count of operations.
    pub work: Quantiles,
    /// CPU seconds over all threads, on a node of speed 1.
    pub cpu_seconds: Quantiles,
    /// Cost at the mean price of the farm's nodes. Absent if there are no nodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<MoneyQuantiles>,
}

/// How a job's irradiance caches are made, and why.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CacheQuote {
    /// The choice in the job's request.
    pub asked: CacheSharing,
    /// Whether the frames share one cache. The frames' forecasts assume this.
    pub shared: bool,
    /// The reason for the decision, as one line of text.
    pub reason: String,
    /// Cost if each frame makes its own cache.
    pub private_price: CachePrice,
    /// Cost if all frames share one cache. Absent if sharing was not considered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shared_price: Option<CachePrice>,
    /// The shared cache that is made before the frames. Absent if each frame makes its own.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "seed")]
    pub shared_cache: Option<SharedCacheForecast>,
}

impl CacheQuote {
    /// CPU seconds of the shared cache, on a node of speed 1. Zero if each frame makes its own.
    pub fn shared_cache_seconds(&self) -> Quantiles {
        self.shared_cache.as_ref().map(|cache| cache.cpu_seconds).unwrap_or_default()
    }
}

/// Progress of a job's shared irradiance cache.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct SharedCacheProgress {
    /// Number of parts to fill, over all rounds.
    pub parts: u32,
    /// Number of parts that are filled.
    pub parts_done: u32,
    /// Progress of the filling, 0 to 1.
    pub progress: f64,
    /// Whether the cache is complete, so that frames can be rendered: all parts are filled and merged.
    pub ready: bool,
    /// Work of the filled parts.
    pub work: u64,
    /// CPU seconds of the filled parts and of merging, converted to a node of speed 1.
    pub cpu_seconds: f64,
}
