//! Quotes, stored with their jobs and frames.

pub(crate) mod calibration;
pub(crate) mod left_out;
pub(crate) mod profiling;
pub(crate) mod track_record;

use forelight_protocol::{
    Event, EventKind, ForecastDoc, FrameForecast, JobId, JobNews, JobSettings, JobState, QuotedShot,
    Timestamp,
};
use forelight_quote::{JobForecast, QuoteBasis};
use sqlx::SqliteConnection;

use crate::columns::Json;
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::events::{append, event, job_state};
use crate::jobs;
use crate::jobs::outlooks::{self, JobOutlook};
use crate::writing::run;

impl Store {
    /// Stores the quote of a job on hold, which then waits to be accepted, and what would become of it now. A
    /// [`StoreError::Conflict`] if the job is not `profiling`.
    pub async fn keep_quote(
        &self,
        job: JobId,
        (forecast, outlook): (&JobForecast, &JobOutlook),
        frames: &[FrameForecast],
        basis: Option<&QuoteBasis>,
        now: Timestamp,
    ) -> Result<()> {
        let mut write = self.write().await?;
        let state = jobs::state(write.connection().await?, job).await?;
        if state != JobState::Profiling {
            return Err(StoreError::Conflict(format!("the job is {state}, not profiling")));
        }
        keep(&mut write, job, forecast, frames, basis, now).await?;
        outlooks::keep(&mut write, &[&(job, outlook.clone())], now).await?;
        job_state(&mut write, job, JobState::Quoted, None, now);
        self.commit(write).await
    }

    /// The stored quote of a job: of all frames together, and of each. `None` before it is made.
    pub async fn kept_quote(&self, job: JobId) -> Result<Option<(JobForecast, Vec<FrameForecast>)>> {
        let mut transaction = self.read().await?;
        let row = jobs::row(&mut transaction, job).await?;
        let Some(kept) = row.forecast else { return Ok(None) };
        Ok(Some((kept.read()?, frames(&mut transaction, job).await?)))
    }

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
        let frames = frames(&mut transaction, job).await?;
        Ok(Some(kept.read()?.document(of, frames)))
    }
}

async fn frames(connection: &mut SqliteConnection, job: JobId) -> Result<Vec<FrameForecast>> {
    let frames = sqlx::query_scalar!(
        r#"SELECT forecast AS "forecast!" FROM frames WHERE job_id = ? AND forecast IS NOT NULL
           ORDER BY frame"#,
        job.0
    )
    .fetch_all(connection)
    .await?;
    Ok(frames.into_iter().map(|frame| frame.0).collect())
}

/// Stores a job's quote inside a write. Without a `basis`, nothing is learnt from it when the job is
/// finished.
pub(crate) async fn keep(
    write: &mut Write,
    job: JobId,
    forecast: &JobForecast,
    frames: &[FrameForecast],
    basis: Option<&QuoteBasis>,
    now: Timestamp,
) -> Result<()> {
    keep_frames(write, job, frames, &forecast.clock).await?;
    if let Some(basis) = basis {
        calibration::keep(write, job, forecast, frames, basis).await?;
    }
    run!(
        write,
        "UPDATE jobs SET forecast = ?, work_by_class = ?, quoted_at = ? WHERE id = ?",
        Json(forecast),
        forecast.work_by_class.map(Json),
        now.micros(),
        job.0
    );
    if let Some(spp) = forecast.chosen_spp
        && let jobs::JobRow { error_target: None, settings: Json(JobSettings::Own(mut settings)), .. } =
            jobs::row(write.connection().await?, job).await?
    {
        settings.spp = spp;
        run!(write, "UPDATE jobs SET settings = ? WHERE id = ?", Json(JobSettings::Own(settings)), job.0);
    }
    let news = JobNews { cost: forecast.cost, ..JobNews::default() };
    append(
        write,
        Event { job_id: Some(job), job: Some(news.into()), ..event(EventKind::ForecastReady, now) },
    );
    Ok(())
}

async fn keep_frames(write: &mut Write, job: JobId, frames: &[FrameForecast], clock: &[f64]) -> Result<()> {
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
