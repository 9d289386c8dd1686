//! The irradiance cache of a shot: whether its frames share one, what that costs, and how far it is made.
//!
//! ```text
//! cache_plan ──► the quote: shared or private ──► cache_fill (parts, in parallel) ──► cache_merge ──► frames
//!                                                   ▲                                    │
//!                                                   └── the next level, if there is one ─┘
//! ```

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ArtifactHash, BundleSource, JobId, Money, MoneyQuantiles, Quantiles, RenderSettings, SceneDigest, Spent,
};

/// Most bytes of a shot's irradiance cache, and of a part of one: what the service takes for an artefact unless it was told otherwise.
/// Frames of a shot that needs more make their own.
pub const CACHE_BYTES: u64 = 1 << 30;

/// Most rounds of filling: one for each bounce of indirect light.
pub const CACHE_ROUNDS: u32 = 8;

/// Whether the frames of a job share one irradiance cache. Without effect on a job without caches.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CacheSharing {
    /// Whatever takes less work, all frames and the shared cache together.
    #[default]
    Auto,
    /// One is made for all frames before any of them is rendered.
    Shared,
    /// Every frame makes its own.
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

/// Find out what records the frames of a job need together, and which of them hold in each frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CachePlanSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// What the bundle has to hold: a worker that finds something else there fails the task for good.
    pub digest: SceneDigest,
    /// The frames, ascending; the records are in the world of the first.
    pub frames: Vec<u32>,
    /// The job's settings.
    pub settings: RenderSettings,
}

/// Gather the light of a part of a shot's cache.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CacheFillSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// What the bundle has to hold: a worker that finds something else there fails the task for good.
    pub digest: SceneDigest,
    /// The job's settings.
    pub settings: RenderSettings,
    /// The cache as far as it is made: as planned in the first round, as merged in later ones.
    pub cache: ArtifactHash,
    /// Which round, from 0: with several parts each fills one level of the cache, the deepest first; with one part the first fills all.
    pub round: u32,
    /// Which part, from 0.
    pub part: u32,
    /// Into how many equal parts the round is split.
    pub parts: u32,
}

/// Put the parts of a round together.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CacheMergeSpec {
    /// The job.
    pub job_id: JobId,
    /// Its bundle.
    pub bundle: BundleSource,
    /// What the bundle has to hold: a worker that finds something else there fails the task for good.
    pub digest: SceneDigest,
    /// Which round, from 0.
    pub round: u32,
    /// What each part made of it, in their order.
    pub parts: Vec<ArtifactHash>,
}

/// What planning a frame's irradiance cache takes, counted.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PlanCount {
    /// Deterministic count of operations.
    pub work: u64,
    /// Rays by category, in the order of [`crate::Rays::NAMES`].
    #[schema(min_items = 7, max_items = 7)]
    pub rays: [u64; 7],
}

/// What a shot's cache is to one frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheFrame {
    /// Frame number.
    pub frame: u32,
    /// Records that the frame's image is made with, one number a level.
    pub records: Vec<u32>,
    /// Those of them that the shot's cache has not, and that the frame makes itself, one number a level.
    pub own: Vec<u32>,
    /// Records of the shot's cache whose light is changed by what has moved in this frame.
    pub dropped: u64,
    /// Reading the shot's cache, finding out what of it holds in the frame, and planning what the frame needs beyond it.
    pub plan: Spent,
    /// Rays of that by category, in the order of [`crate::Rays::NAMES`].
    #[schema(min_items = 7, max_items = 7)]
    pub plan_rays: [u64; 7],
}

/// The result of planning a shot's cache.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CachePlanResult {
    /// The cache, planned and not filled; absent if it would be larger than 2³⁰ bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<ArtifactHash>,
    /// Its size in bytes.
    pub bytes: u64,
    /// Its records, one number a level.
    pub records: Vec<u32>,
    /// One entry a frame, in the order of the spec.
    pub frames: Vec<CacheFrame>,
    /// What planning took.
    pub spent: Spent,
}

/// The result of filling a part.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheFillResult {
    /// The cache with this part filled.
    pub cache: ArtifactHash,
    /// Its size in bytes.
    pub bytes: u64,
    /// Records that were filled.
    pub filled: u64,
    /// Whether the cache is full.
    pub full: bool,
    /// What gathering these records took.
    pub spent: Spent,
}

/// The result of putting parts together.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheMergeResult {
    /// The cache with all parts of the round.
    pub cache: ArtifactHash,
    /// Its size in bytes.
    pub bytes: u64,
    /// Whether the cache is full; if not, the next level is filled.
    pub full: bool,
    /// What it took. No light is traced, so there is no work.
    pub spent: Spent,
}

/// What it takes to render a job with one way of making its irradiance caches.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CachePrice {
    /// Records that are gathered, for the shot and for all of its frames.
    pub records: u64,
    /// Mean work of all frames, and of the shot's cache.
    pub work: f64,
    /// Mean CPU seconds of the same, on a node of speed 1.
    pub cpu_seconds: f64,
    /// These in money, at the mean price of the farm's nodes; absent without nodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<Money>,
}

/// The line of a quote for the shot's cache, which no frame is charged for.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct SeedForecast {
    /// Records, one number a level.
    pub records: Vec<u32>,
    /// Into how many parts it is split, to be filled at the same time.
    pub parts: u32,
    /// Deterministic count of operations.
    pub work: Quantiles,
    /// CPU seconds over all threads, on a node of speed 1.
    pub cpu_seconds: Quantiles,
    /// In money, at the mean price of the farm's nodes; absent without nodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<MoneyQuantiles>,
}

/// How a job's irradiance caches are made, and why so.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct CacheQuote {
    /// What the job asked for.
    pub asked: CacheSharing,
    /// Whether the frames share one cache. The forecasts of the frames are those of this way.
    pub shared: bool,
    /// Why, in a line.
    pub reason: String,
    /// What it takes if every frame makes its own.
    pub private_price: CachePrice,
    /// What it takes if one is made for all of them; absent where that was not found out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shared_price: Option<CachePrice>,
    /// The cache that is made before the frames; absent if each makes its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<SeedForecast>,
}

impl CacheQuote {
    /// CPU seconds of the cache that is made before the frames; zero if each makes its own.
    pub fn seed_seconds(&self) -> Quantiles {
        self.seed.as_ref().map(|seed| seed.cpu_seconds).unwrap_or_default()
    }
}

/// How far a job's shared cache is made.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct SeedProgress {
    /// Parts to be filled, over all rounds.
    pub parts: u32,
    /// Those that are filled.
    pub parts_done: u32,
    /// How far all of them are, 0 to 1.
    pub progress: f64,
    /// Whether the frames can be rendered: all parts are filled and put together.
    pub ready: bool,
    /// Work of the parts that are filled.
    pub work: u64,
    /// CPU seconds of the same and of putting parts together, brought to a node of speed 1.
    pub cpu_seconds: f64,
}
