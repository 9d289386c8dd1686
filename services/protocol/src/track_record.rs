//! How often the quotes were right.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{JobId, PageToken, Quantiles, Timestamp};

/// How many actuals were at or below a forecast quantile.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct QuantileHits {
    /// Actual at or below the P50, frames.
    pub p50: u64,
    /// Actual at or below the P80, frames.
    pub p80: u64,
    /// Actual at or below the P95, frames.
    pub p95: u64,
}

/// Forecasts of frames or of whole jobs against what they took.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct Coverage {
    /// How many there are.
    pub count: u64,
    /// Hits of the work quantiles.
    pub work_hits: QuantileHits,
    /// Hits of the CPU time quantiles.
    pub cpu_hits: QuantileHits,
    /// Mean of |forecast mean / actual − 1| of work; absent of none.
    pub work_mean_absolute_error: Option<f64>,
    /// Mean of |forecast mean / actual − 1| of CPU time; absent of none.
    pub cpu_mean_absolute_error: Option<f64>,
}

/// The record of quotes of one kind. Past jobs say how sure a quote can be within a kind alone.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TrackRecordKind {
    /// The renderer that measured the profiles, with its version; absent where it did not say.
    pub renderer: Option<String>,
    /// How light is simulated: `direct`, `gathered`, `cached` or `path`; absent where the renderer is.
    pub feature_class: Option<String>,
    /// Whether the quantiles were calibrated on past jobs.
    pub calibrated: bool,
    /// Finished frames.
    pub frames: Coverage,
    /// Finished jobs, their totals.
    pub jobs: Coverage,
}

/// One finished frame: forecast against actual.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TrackRecordRow {
    /// The job.
    pub job_id: JobId,
    /// The frame.
    pub frame: u32,
    /// When it was finished.
    pub finished: Timestamp,
    /// Forecast work.
    pub work_forecast: Quantiles,
    /// Actual work.
    pub work_actual: f64,
    /// Forecast CPU seconds on a node of speed 1.
    pub cpu_forecast: Quantiles,
    /// Actual CPU seconds, brought to a node of speed 1.
    pub cpu_actual: f64,
}

/// Where quantiles lie above the forecast's mean, in its own standard deviations of the logarithm.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibratedQuantiles {
    /// Of one in two.
    pub p50: f64,
    /// Of four in five.
    pub p80: f64,
    /// Of nineteen in twenty.
    pub p95: f64,
}

/// What finished jobs of one kind teach of the next job's quote.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Corrections {
    /// Work of single frames.
    pub frame_work: CalibratedQuantiles,
    /// CPU time of single frames.
    pub frame_cpu: CalibratedQuantiles,
    /// Work of the whole job.
    pub job_work: CalibratedQuantiles,
    /// CPU time of the whole job.
    pub job_cpu: CalibratedQuantiles,
}

/// What is known of quotes of one kind.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibrationKind {
    /// The renderer, with its version.
    pub renderer: String,
    /// How light is simulated.
    pub feature_class: String,
    /// Finished jobs that it rests on.
    pub jobs: u64,
    /// Absent while these are too few, which is below 19.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrections: Option<Corrections>,
}

/// What the farm's finished jobs teach, by kind of quote; `forelight forecast --calibration` reads it too.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibrationDoc {
    /// In order of renderer and class.
    pub kinds: Vec<CalibrationKind>,
}

/// The record of all finished frames, and a page of them, newest first.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TrackRecord {
    /// Finished frames that had a forecast.
    pub frames: u64,
    /// Hits of the work quantiles.
    pub work_hits: QuantileHits,
    /// Hits of the CPU time quantiles.
    pub cpu_hits: QuantileHits,
    /// Mean over frames of |forecast mean / actual − 1| of work; absent without frames.
    pub work_mean_absolute_error: Option<f64>,
    /// Mean over frames of |forecast mean / actual − 1| of CPU time; absent without frames.
    pub cpu_mean_absolute_error: Option<f64>,
    /// Sum of forecast means over sum of actuals, minus one, of work; absent without frames.
    pub work_bias: Option<f64>,
    /// Sum of forecast means over sum of actuals, minus one, of CPU time; absent without frames.
    pub cpu_bias: Option<f64>,
    /// The same by kind, the calibrated quotes apart from those that were not; in order of renderer, class and calibration.
    #[serde(default)]
    pub kinds: Vec<TrackRecordKind>,
    /// The frames.
    pub items: Vec<TrackRecordRow>,
    /// Where the next page starts; absent on the last.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}
