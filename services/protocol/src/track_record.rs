//! Track record: how often quotes were right, and what is learnt from them.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{JobId, PageToken, Quantiles, Timestamp};

/// How often an actual value was at or below a forecast quantile.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct QuantileHits {
    /// Number of actual values at or below P50.
    pub p50: u64,
    /// Number of actual values at or below P80.
    pub p80: u64,
    /// Number of actual values at or below P95.
    pub p95: u64,
}

/// Accuracy of the forecasts of frames, or of whole jobs.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct Coverage {
    /// Number of forecasts.
    pub count: u64,
    /// Hits of the work quantiles.
    pub work_hits: QuantileHits,
    /// Hits of the CPU time quantiles.
    pub cpu_hits: QuantileHits,
    /// Mean of |forecast mean / actual − 1| of the work. Absent without forecasts.
    pub work_mean_absolute_error: Option<f64>,
    /// Mean of |forecast mean / actual − 1| of the CPU time. Absent without forecasts.
    pub cpu_mean_absolute_error: Option<f64>,
}

/// Accuracy of quotes of one kind. Quotes are calibrated on past jobs of the same kind.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TrackRecordKind {
    /// Renderer that measured the profiles, with its version. Absent if unknown.
    pub renderer: Option<String>,
    /// How light is simulated: `direct`, `gathered`, `cached` or `path`. Absent if the renderer is.
    pub feature_class: Option<String>,
    /// Whether the quantiles were calibrated on past jobs.
    pub calibrated: bool,
    /// Accuracy for finished frames.
    pub frames: Coverage,
    /// Accuracy for the totals of finished jobs.
    pub jobs: Coverage,
}

/// Accuracy for the frames of a project.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TrackRecordProject {
    /// The project.
    pub project: String,
    /// Accuracy for its finished frames.
    pub frames: Coverage,
    /// Sum of forecast means / sum of actual values − 1, of the work.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work_bias: Option<f64>,
    /// Sum of forecast means / sum of actual values − 1, of the CPU time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cpu_bias: Option<f64>,
}

/// Accuracy for the frames that were finished on a day.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TrackRecordDay {
    /// When the day began, in UTC.
    pub day: Timestamp,
    /// Accuracy for its frames.
    pub frames: Coverage,
}

/// Forecast and actual cost of a finished frame.
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
    /// Actual CPU seconds, converted to a node of speed 1.
    pub cpu_actual: f64,
}

/// Calibrated quantiles: distances from the logarithm of the forecast's mean, in its standard deviations (of
/// the logarithm).
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibratedQuantiles {
    /// Median.
    pub p50: f64,
    /// 80 % quantile.
    pub p80: f64,
    /// 95 % quantile.
    pub p95: f64,
}

/// Calibrated quantiles for the next quote of a kind, learnt from finished jobs.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Corrections {
    /// For the work of single frames.
    pub frame_work: CalibratedQuantiles,
    /// For the CPU time of single frames.
    pub frame_cpu: CalibratedQuantiles,
    /// For the work of the whole job.
    pub job_work: CalibratedQuantiles,
    /// For the CPU time of the whole job.
    pub job_cpu: CalibratedQuantiles,
}

/// Calibration of quotes of one kind.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibrationKind {
    /// The renderer, with its version.
    pub renderer: String,
    /// How light is simulated: `direct`, `gathered`, `cached` or `path`.
    pub feature_class: String,
    /// Number of finished jobs behind it.
    pub jobs: u64,
    /// The calibrated quantiles. Absent with fewer than 19 jobs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrections: Option<Corrections>,
}

/// Calibration of the farm's quotes, by kind. `forelight forecast --calibration` reads this document.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibrationDoc {
    /// The kinds, sorted by renderer and feature class.
    pub kinds: Vec<CalibrationKind>,
}

/// An operator's request to take a job out of the track record.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LeaveOutRequest {
    /// Why: 1 to 500 characters.
    #[schema(min_length = 1, max_length = 500)]
    pub reason: String,
}

/// A job that an operator took out of the track record. Nothing is learnt from it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct LeftOutJob {
    /// The job.
    pub job_id: JobId,
    /// Its name.
    pub name: String,
    /// Why.
    pub reason: String,
    /// Since when.
    pub at: Timestamp,
}

/// Track record over all finished frames, and one page of the frames, newest first.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TrackRecord {
    /// Number of finished frames that had a forecast.
    pub frames: u64,
    /// Hits of the work quantiles.
    pub work_hits: QuantileHits,
    /// Hits of the CPU time quantiles.
    pub cpu_hits: QuantileHits,
    /// Mean over frames of |forecast mean / actual − 1| of the work. Absent without frames.
    pub work_mean_absolute_error: Option<f64>,
    /// Mean over frames of |forecast mean / actual − 1| of the CPU time. Absent without frames.
    pub cpu_mean_absolute_error: Option<f64>,
    /// Sum of forecast means / sum of actual values − 1, of the work. Absent without frames.
    pub work_bias: Option<f64>,
    /// Sum of forecast means / sum of actual values − 1, of the CPU time. Absent without frames.
    pub cpu_bias: Option<f64>,
    /// The same by kind and calibration. Sorted by renderer, feature class and calibration.
    #[serde(default)]
    pub kinds: Vec<TrackRecordKind>,
    /// The same by project, sorted by name. Only on the first page.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub projects: Vec<TrackRecordProject>,
    /// The same by day, the newest 366 days with finished frames, oldest first. Only on the first page.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub days: Vec<TrackRecordDay>,
    /// Jobs that an operator took out of the record: none of the numbers counts them. The newest first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOutJob>,
    /// The frames.
    pub items: Vec<TrackRecordRow>,
    /// Token of the next page. Absent on the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}
