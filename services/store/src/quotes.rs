//! Quotes, stored with their jobs and frames.

pub(crate) mod calibration;
pub(crate) mod profiling;
pub(crate) mod track_record;

use forelight_protocol::{ForecastDoc, FrameForecast, JobId, QuotedShot};

use crate::columns::Json;
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::writing::run;

impl Store {
    /// The job's quote; `None` before it is made.
    pub async fn forecast(&self, job: JobId) -> Result<Option<ForecastDoc>> {
        let mut transaction = self.read().await?;
        let row = sqlx::query!("SELECT forecast, scene, renderer, settings FROM jobs WHERE id = ?", job.0)
            .fetch_optional(&mut *transaction)
            .await?;
        let row = row.ok_or(StoreError::NotFound("job"))?;
        let Some(kept) = row.forecast else { return Ok(None) };
        let renderer = row.renderer.map(|it| it.0);
        let of = QuotedShot { scene: row.scene.0.digest, renderer, settings: row.settings.0 };
        let frames = sqlx::query_scalar!(
            r#"SELECT forecast AS "forecast!" FROM frames WHERE job_id = ? AND forecast IS NOT NULL
               ORDER BY frame"#,
            job.0
        )
        .fetch_all(&mut *transaction)
        .await?;
        let frames = frames.into_iter().map(|frame| frame.0).collect();
        Ok(Some(kept.read()?.document(of, frames)))
    }
}

pub(crate) async fn keep_frames(
    write: &mut Write,
    job: JobId,
    frames: &[FrameForecast],
    clock: &[f64],
) -> Result<()> {
    for (place, forecast) in frames.iter().enumerate() {
        run!(
            write,
            "UPDATE frames SET forecast = ?, work_mean = ?, work_p50 = ?, work_p80 = ?, work_p95 = ?, \
             cpu_mean = ?, cpu_p50 = ?, cpu_p80 = ?, cpu_p95 = ?, clock = ? WHERE job_id = ? AND frame = ?",
            Json(forecast),
            forecast.work.mean,
            forecast.work.p50,
            forecast.work.p80,
            forecast.work.p95,
            forecast.cpu_seconds.mean,
            forecast.cpu_seconds.p50,
            forecast.cpu_seconds.p80,
            forecast.cpu_seconds.p95,
            clock.get(place),
            job.0,
            forecast.frame
        );
    }
    Ok(())
}
