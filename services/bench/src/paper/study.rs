use super::level::Level;
use super::trial::{Columns, Outcome, Score};
use forelight_forecast::Strategy;
use serde::Serialize;

/// Measurements of one frame of a bundle.
#[derive(Debug, Serialize)]
pub struct Study {
    pub bundle: String,
    /// Renderer of the frame. Absent for our own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub renderer: Option<String>,
    pub frame: u32,
    pub size: u32,
    pub samples: u32,
    pub seeds: u32,
    pub gather_rays: u32,
    /// Pairs of object and material in the preview, including the background.
    pub strata_seen: usize,
    pub levels: Vec<LevelStudy>,
    pub curves: Vec<Curve>,
}

#[derive(Debug, Serialize)]
pub struct LevelStudy {
    pub level: Level,
    pub actual: Columns<f64>,
    /// Lower bound of the root mean square error of work: see `noise::floor`.
    pub noise_floor: f64,
    /// Records of the cache, by level.
    pub records: Vec<u32>,
    /// Strategies as in the paper, and ours.
    pub outcomes: Vec<Outcome>,
    /// All strategies with planned records. Empty without a cache.
    pub planned: Vec<Outcome>,
}

/// Errors of a strategy by number of profiled pixels. With a cache the records are planned, and more are
/// gathered with more pixels.
#[derive(Debug, Serialize)]
pub struct Curve {
    pub level: Level,
    pub strategy: Strategy,
    pub points: Vec<CurvePoint>,
}

#[derive(Debug, Serialize)]
pub struct CurvePoint {
    pub pixels: usize,
    /// Mean CPU seconds of profiling these pixels and gathering their records.
    pub cpu_seconds: f64,
    pub error: Score,
}

impl Curve {
    /// Profiled pixels, and root mean square error of work.
    pub fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        self.points.iter().map(|point| (point.pixels as f64, point.error.root_mean_square))
    }
}
