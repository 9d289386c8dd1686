//! Ladders of qualities: the cost of each, and the expected error of its image.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{Confidence, Profiled, Quantiles, RenderSettings, SpentOnForecast};

/// The setting that changes along a ladder. All others are as requested.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LadderKind {
    /// Camera samples per pixel, with the integrator `ambient` and no irradiance cache.
    Ambient,
    /// Camera samples per pixel, with the integrator `path`.
    Path,
    /// Camera samples per pixel, with the integrator `ambient` and an irradiance cache.
    CachedSamples,
    /// Allowed error of an irradiance cache, with the integrator `ambient`.
    Cache,
    /// Hemisphere rays per gather, with the integrator `ambient` and no cache.
    Divisions,
    /// Number of pixels. Each image is compared with its own converged image, so these errors are not
    /// comparable with others.
    Resolution,
}

/// Which ladders a job's quote contains.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Ladders {
    /// Those that the job's own profile covers: camera samples and, without a cache, resolutions.
    #[default]
    Own,
    /// All. One frame is also profiled with the other settings before the quote. This costs about 500,000
    /// camera samples, which are part of the cost of quoting. If the job asks for denoising, it costs up to 2.5
    /// million more, and every rung has a `denoised_error`.
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

    /// Whether only the job's own ladders are wanted.
    pub fn are_own(&self) -> bool {
        *self == Ladders::Own
    }
}

impl LadderKind {
    /// All ladders, in the order in which they are listed.
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

/// Forecast error of an image, as quantiles. The error is the root mean square of (pixel − converged pixel)
/// over all pixels and channels, divided by the mean of the converged image. The converged image has endless
/// camera samples and no interpolation.
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

/// Comparison of a rung with the next better one.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NextRung {
    /// Index of the better rung in the list.
    pub rung: u32,
    /// Its additional CPU seconds, by the medians.
    pub more_cpu_seconds: f64,
    /// Its CPU time divided by that of this rung.
    pub times_cpu_seconds: f64,
    /// Its error divided by that of this rung.
    pub times_error: f64,
}

/// Cost and error of a rung that was rendered.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct MeasuredRung {
    /// Deterministic count of operations.
    pub work: u64,
    /// CPU seconds.
    pub cpu_seconds: f64,
    /// Error as in [`ImageError`], less that of the reference image. 0 if it is too small to be measured.
    pub error: f64,
    /// Standard deviation of `error`, from the number of pixels.
    pub error_deviation: f64,
    /// The same image after its noise was removed. Absent if it was not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub denoised: Option<DenoisedRung>,
}

impl MeasuredRung {
    /// CPU seconds and error of the image as it is delivered: denoised, if it was.
    pub fn delivered(&self) -> (f64, f64) {
        match self.denoised {
            Some(denoised) => (self.cpu_seconds + denoised.cpu_seconds, denoised.error),
            None => (self.cpu_seconds, self.error),
        }
    }
}

/// Cost and error of a denoised image.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct DenoisedRung {
    /// CPU seconds of denoising and of measuring what is left, beside those of the image.
    pub cpu_seconds: f64,
    /// Error as in [`ImageError`], less that of the reference image. 0 if it is too small to be measured.
    pub error: f64,
    /// Standard deviation of `error`, from the number of pixels.
    pub error_deviation: f64,
}

/// A quality with its cost and error.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct AccuracyRung {
    /// Its ladder. A quality on several ladders is listed once on each.
    pub ladder: LadderKind,
    /// All settings.
    pub settings: RenderSettings,
    /// Whether these are the requested settings.
    pub asked_for: bool,
    /// Deterministic count of operations.
    pub work: Quantiles,
    /// CPU seconds over all threads, on a node of speed 1.
    pub cpu_seconds: Quantiles,
    /// Expected error of the image. Absent if the profiled pixels do not show it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<ImageError>,
    /// Expected error once the noise was removed. Present if denoising and all ladders were asked for.
    /// `cpu_seconds` include denoising then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub denoised_error: Option<ImageError>,
    /// Whether no other rung is both cheaper and better, by the medians. Always false for resolutions.
    pub worth_taking: bool,
    /// The next better rung that is worth taking. Absent for the best one, and if this one is not worth
    /// taking.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next: Option<NextRung>,
    /// Measured cost and error, if it was rendered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<MeasuredRung>,
}

impl AccuracyRung {
    /// Expected error of the image as it is delivered: denoised, if that was asked for.
    pub fn delivered_error(&self) -> Option<ImageError> {
        self.denoised_error.or(self.error)
    }
}

/// A ladder that is missing or has no errors, or a rung that is left out.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct MissingLadder {
    /// The ladder.
    pub ladder: LadderKind,
    /// The reason.
    pub reason: String,
}

/// Ladders of one frame (`forelight accuracy --json`) or of a job (`GET /v1/jobs/{id}/accuracy`).
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct AccuracyDoc {
    /// Number of frames that `work` and `cpu_seconds` cover.
    pub frames: u32,
    /// The requested settings.
    pub settings: RenderSettings,
    /// The rungs by ladder, cheapest settings first.
    pub rungs: Vec<AccuracyRung>,
    /// Missing ladders, ladders without errors and left-out rungs, with reasons.
    pub missing: Vec<MissingLadder>,
    /// Profiled frames and pixels. Errors are root mean squares over these frames.
    pub profiled: Profiled,
    /// Cost of the predictions. Its fraction relates to one frame of the requested settings, or to the job.
    pub spent: SpentOnForecast,
    /// Whether the quantiles were calibrated. If not, they are based on sampling statistics only.
    pub calibrated: bool,
}
