//! Quotes, as they are kept with their jobs and frames.

pub(crate) mod calibration;
pub(crate) mod profiling;
pub(crate) mod track_record;

use forelight_protocol::{ForecastDoc, FrameForecast, JobId, QuotedShot, SceneSummary};
use forelight_quote::JobForecast;

use crate::database::{Store, Write};
use crate::decode::{json, json_opt, to_json};
use crate::error::StoreError;

impl Store {
    /// The job's quote; `None` until it is there.
    pub async fn forecast(&self, job: JobId) -> Result<Option<ForecastDoc>, StoreError> {
        let mut transaction = self.read().await?;
        let row = sqlx::query("SELECT forecast, scene, settings FROM jobs WHERE id = ?")
            .bind(job.0)
            .fetch_optional(&mut *transaction)
            .await?;
        let row = row.ok_or(StoreError::NotFound("job"))?;
        let kept: Option<JobForecast> = json_opt(&row, "forecast")?;
        let Some(kept) = kept else { return Ok(None) };
        let scene: SceneSummary = json(&row, "scene")?;
        let of = QuotedShot { scene: scene.digest, settings: json(&row, "settings")? };
        let rows = sqlx::query(
            "SELECT forecast FROM frames WHERE job_id = ? AND forecast IS NOT NULL ORDER BY frame",
        )
        .bind(job.0)
        .fetch_all(&mut *transaction)
        .await?;
        let frames = rows.iter().map(|row| json(row, "forecast")).collect::<Result<_, _>>()?;
        Ok(Some(kept.document(of, frames)))
    }
}

/// Keeps the frames' forecasts inside a write.
pub(crate) async fn keep_frames(
    write: &mut Write,
    job: JobId,
    frames: &[FrameForecast],
    clock: &[f64],
) -> Result<(), StoreError> {
    for (place, forecast) in frames.iter().enumerate() {
        sqlx::query(
            "UPDATE frames SET forecast = ?, work_mean = ?, work_p50 = ?, work_p80 = ?, work_p95 = ?, \
             cpu_mean = ?, cpu_p50 = ?, cpu_p80 = ?, cpu_p95 = ?, clock = ? WHERE job_id = ? AND frame = ?",
        )
        .bind(to_json(forecast)?)
        .bind(forecast.work.mean)
        .bind(forecast.work.p50)
        .bind(forecast.work.p80)
        .bind(forecast.work.p95)
        .bind(forecast.cpu_seconds.mean)
        .bind(forecast.cpu_seconds.p50)
        .bind(forecast.cpu_seconds.p80)
        .bind(forecast.cpu_seconds.p95)
        .bind(clock.get(place))
        .bind(job.0)
        .bind(i64::from(forecast.frame))
        .execute(write.connection().await?)
        .await?;
    }
    Ok(())
}
