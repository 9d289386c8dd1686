//! What accuracy costs in time: ladders of qualities, with what each takes and how far its image will be from the converged one.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{Confidence, Profiled, Quantiles, RenderSettings, SpentOnForecast};

/// What is changed along a ladder; all else is as it was asked for.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LadderKind {
    /// Camera samples a pixel, with the integrator `ambient` and without an irradiance cache.
    Ambient,
    /// Camera samples a pixel, with the integrator `path`.
    Path,
    /// Camera samples a pixel, with the integrator `ambient` and an irradiance cache: of the accuracy that was asked for, or the usual one.
    CachedSamples,
    /// The error that an irradiance cache may make, with the integrator `ambient`.
    Cache,
    /// Hemisphere rays of a gather, with the integrator `ambient` and without a cache.
    Divisions,
    /// Pixels, with all else as it was asked for. The error is that of the pixels that are delivered, each against its own
    /// converged self: an image of more pixels is as far from its own converged self, and shows more. So these rungs are not held
    /// against the others.
    Resolution,
}

/// Which ladders of qualities are part of a job's quote.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Ladders {
    /// Those that the job's own profile speaks of: camera samples and, without a cache, resolutions.
    #[default]
    Own,
    /// All of them: one frame is profiled with the other settings too, before the job is quoted. That takes about as much as half a million camera
    /// samples of it, whatever its size and the length of the shot: a few percent of a large frame, several times a small one. What it took is part
    /// of what the quote did.
    All,
}

impl Ladders {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Ladders::Own => "own",
            Ladders::All => "all",
        }
    }

    /// Whether they are the usual ones.
    pub fn are_own(&self) -> bool {
        *self == Ladders::Own
    }
}

impl LadderKind {
    /// All of them, in the order in which they are listed.
    pub const ALL: [LadderKind; 6] = [
        LadderKind::Ambient,
        LadderKind::Path,
        LadderKind::CachedSamples,
        LadderKind::Cache,
        LadderKind::Divisions,
        LadderKind::Resolution,
    ];

    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            LadderKind::Ambient => "ambient",
            LadderKind::Path => "path",
            LadderKind::CachedSamples => "cached_samples",
            LadderKind::Cache => "cache",
            LadderKind::Divisions => "divisions",
            LadderKind::Resolution => "resolution",
        }
    }
}

/// The error of an image that is forecast: the values that it stays below with these probabilities. The error is the root mean
/// square of (pixel − converged pixel) over all pixels and channels, as a share of the mean of the converged image. Converged is
/// the image of the same integrator with endless camera samples, and nothing interpolated.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct ImageError {
    /// 5 % quantile.
    pub p05: f64,
    /// Median.
    pub p50: f64,
    /// 80 % quantile.
    pub p80: f64,
    /// 95 % quantile.
    pub p95: f64,
}

impl ImageError {
    /// The value at a confidence.
    pub const fn at(&self, confidence: Confidence) -> f64 {
        match confidence {
            Confidence::P50 => self.p50,
            Confidence::P80 => self.p80,
            Confidence::P95 => self.p95,
        }
    }
}

/// The way from a rung that is worth taking to the next better one.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NextRung {
    /// Its index in the list of rungs.
    pub rung: u32,
    /// CPU seconds that it takes more, by the medians.
    pub more_cpu_seconds: f64,
    /// Its CPU time over that of this rung.
    pub times_cpu_seconds: f64,
    /// Its error over that of this rung.
    pub times_error: f64,
}

/// What a rung took and came to when it was rendered.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct MeasuredRung {
    /// Deterministic count of operations.
    pub work: u64,
    /// CPU seconds.
    pub cpu_seconds: f64,
    /// Error as in [`ImageError`], without that of the image that it was held against. 0 where it is too small to be told from it.
    pub error: f64,
    /// Standard deviation of that number, for want of pixels.
    pub error_deviation: f64,
}

/// A quality, what it takes and how good it is.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct AccuracyRung {
    /// The ladder that it is of. A quality that is on several ladders is listed once on each.
    pub ladder: LadderKind,
    /// All settings.
    pub settings: RenderSettings,
    /// Whether these are the settings that were asked for.
    pub asked_for: bool,
    /// Deterministic count of operations.
    pub work: Quantiles,
    /// CPU seconds over all threads, on a node of speed 1.
    pub cpu_seconds: Quantiles,
    /// How far the image will be from its converged self; absent where the profiled pixels do not tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<ImageError>,
    /// Whether it is worth taking: no other rung is both cheaper and better, by the medians. Never of a ladder of resolutions.
    pub worth_taking: bool,
    /// The next better rung that is worth taking; absent for the best, and for those that are not worth taking.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next: Option<NextRung>,
    /// What it took and came to, if it was rendered to find out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<MeasuredRung>,
}

/// A ladder that is missing, or has no errors, or a rung of it that is left out.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct MissingLadder {
    /// The ladder.
    pub ladder: LadderKind,
    /// Why.
    pub reason: String,
}

/// What accuracy costs in time, as `forelight accuracy --json` (of one frame) and `GET /v1/jobs/{id}/accuracy` (of all frames of a
/// job) give it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct AccuracyDoc {
    /// Number of frames that `work` and `cpu_seconds` are of, all together.
    pub frames: u32,
    /// The settings that were asked for.
    pub settings: RenderSettings,
    /// The rungs, ladder by ladder, from the cheapest settings to the dearest.
    pub rungs: Vec<AccuracyRung>,
    /// Ladders that are missing or have no errors, rungs that are left out, and why.
    pub missing: Vec<MissingLadder>,
    /// Frames and pixels that the predictions rest on. Errors are those of the profiled frames: root mean square over them.
    pub profiled: Profiled,
    /// What the predictions took; its fraction is that of one frame of the settings that were asked for, or of the job.
    pub spent: SpentOnForecast,
    /// Whether the quantiles have been calibrated; if not, they rest on the statistics alone.
    pub calibrated: bool,
}
