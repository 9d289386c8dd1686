//! The measurements.

use super::level::Level;
use super::trial::{Columns, Outcome, Score};
use forelight_forecast::Strategy;
use serde::Serialize;

/// One bundle's frame.
#[derive(Debug, Serialize)]
pub struct Study {
    pub bundle: String,
    pub frame: u32,
    pub size: u32,
    pub samples: u32,
    pub seeds: u32,
    pub gather_rays: u32,
    /// Pairs of object and material that the preview shows, the background among them.
    pub strata_seen: usize,
    pub levels: Vec<LevelStudy>,
    pub curves: Vec<Curve>,
}

/// One ambient level.
#[derive(Debug, Serialize)]
pub struct LevelStudy {
    pub level: Level,
    pub actual: Columns<f64>,
    /// The least root mean square error of work that pixels of known surfaces can have: see `noise::floor`.
    pub noise_floor: f64,
    /// Records of the cache, by level.
    pub records: Vec<u32>,
    /// As the paper has its strategies; ours as it is.
    pub outcomes: Vec<Outcome>,
    /// All strategies with the cache's records planned; empty without a cache.
    pub planned: Vec<Outcome>,
}

/// Errors of a strategy by number of profiled pixels. With a cache its records are planned, and more of them are gathered the more
/// pixels are profiled.
#[derive(Debug, Serialize)]
pub struct Curve {
    pub level: Level,
    pub strategy: Strategy,
    pub points: Vec<CurvePoint>,
}

/// A point of it.
#[derive(Debug, Serialize)]
pub struct CurvePoint {
    /// Pixels profiled.
    pub pixels: usize,
    /// CPU seconds of profiling: of these pixels, and of the records that were gathered; the mean over the seeds.
    pub cpu_seconds: f64,
    /// Errors of work.
    pub error: Score,
}

impl Curve {
    /// Pixels profiled, and root mean square of the errors of work.
    pub fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        self.points.iter().map(|point| (point.pixels as f64, point.error.root_mean_square))
    }
}
