//! What a shot and its frames answer.

use forelight_preview::{Counts, Preview};
use forelight_protocol::{PlanCount, PreviewBackend, SceneSummary, Spent, StratumName};
use forelight_scene::MaterialClass;
use forelight_tracer::{CacheTotals, Image, Shared};

/// An (object, material) pair of the scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StratumInfo {
    /// Names of object and material.
    pub name: StratumName,
    /// Object id.
    pub object: u32,
    /// Material index.
    pub material: u32,
    /// Class of the material, by which the first samples are spread.
    pub class: MaterialClass,
}

/// Contents of a bundle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ShotInfo {
    /// Its summary.
    pub summary: SceneSummary,
    /// The renderer, with all versions that costs or forecasts may depend on.
    pub renderer: String,
    /// All (object, material) pairs; the same for every frame of the shot.
    pub strata: Vec<StratumInfo>,
}

/// Counts of a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Counted {
    /// Pixels per stratum, and of the background.
    pub counts: Counts,
    /// Planned records of the frame's irradiance cache by level. Empty without a cache.
    pub cache_records: Vec<u32>,
    /// Cost of that plan. `None` without a cache.
    pub cache_plan: Option<PlanCount>,
    /// For each light of the scene, whether it shines.
    pub shining: Vec<bool>,
    /// Triangles, seen or not.
    pub triangles: u64,
    /// The previewer that counted.
    pub backend: PreviewBackend,
    /// Cost of counting.
    pub spent: Spent,
}

/// The preview of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Previewed {
    /// Stratum, position and normal per pixel.
    pub preview: Preview,
    /// The previewer that made it.
    pub backend: PreviewBackend,
    /// Cost of the preview.
    pub spent: Spent,
}

/// The steps of a render.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Planning the irradiance cache, as one step.
    Planning,
    /// Gathering its records.
    Filling,
    /// Tracing the pixels.
    Tracing,
    /// Removing noise, as one step.
    Denoising,
}

/// Progress of a render: `done` of `all` parts of a step. Without an irradiance cache there is only one step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// The step.
    pub step: Step,
    /// Records or pixels done.
    pub done: u64,
    /// All of them.
    pub all: u64,
}

/// A frame, rendered.
#[derive(Debug, Clone)]
pub struct Finished {
    /// The image.
    pub image: Image,
    /// Its irradiance cache, if it has one.
    pub cache: Option<CacheUse>,
}

/// Totals of an irradiance cache.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CacheUse {
    /// The whole cache.
    pub all: CacheTotals,
    /// The part that was taken over from a profile.
    pub taken_over: CacheTotals,
    /// Records of the shared cache, valid and invalid here. Their cost is the shot's.
    pub shared: Shared,
}
