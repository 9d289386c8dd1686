//! Quotes: choosing to profile, and keeping what was forecast.

use forelight_protocol::{
    ForecastDoc, FrameForecast, FrameSet, JobId, JobState, Ladders, QuotedShot, SceneSummary, Timestamp,
};
use forelight_quote::JobForecast;
use sqlx::Row as _;

use crate::database::Write;
use crate::decode::{corrupt, json, json_opt, to_json, whole, word};
use crate::events::job_state;
use crate::tasks::{Common, ProfileAsked};
use crate::{PlannedCache, Store, StoreError, jobs};

impl Store {
    /// Has these frames of the job profiled, and the cache planned that all of its frames could share, if that is wanted. Nothing if the job is not, or no longer, being previewed, so that doing
    /// it again after a crash is harmless.
    pub async fn start_profiling(
        &self,
        job: JobId,
        frames: &[u32],
        plan_cache: bool,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        let row = jobs::row(write.connection().await?, job).await?;
        if word::<JobState>(&row, "state")? != JobState::Previewing {
            return Ok(());
        }
        let common = Common::of(job, &row)?;
        // The frame in their middle stands for all where other qualities are asked for.
        let with_ladders = match word::<Ladders>(&row, "ladders")? {
            Ladders::All => frames.get(frames.len() / 2),
            Ladders::Own => None,
        };
        for frame in frames {
            let asked = ProfileAsked {
                frame: *frame,
                samples: whole(&row, "samples")?,
                ladders: with_ladders == Some(frame),
                cache: None,
            };
            common.profile(&mut write, asked, plan_cache).await?;
        }
        if plan_cache {
            let all: FrameSet =
                row.try_get::<&str, _>("frames")?.parse().map_err(|error| corrupt("frames", error))?;
            common.cache_plan(&mut write, all.iter().collect()).await?;
        }
        sqlx::query("UPDATE jobs SET state = 'profiling' WHERE id = ?")
            .bind(job.0)
            .execute(write.connection().await?)
            .await?;
        job_state(&mut write, job, JobState::Profiling, None, now)?;
        self.commit(write).await
    }

    /// Has more frames of the job profiled, with the cache that all of its frames could share if one was planned. Nothing if the job is not, or no
    /// longer, being profiled, or if one of the frames was asked for already, so that doing it again after a crash is harmless.
    pub async fn profile_more(
        &self,
        job: JobId,
        frames: &[u32],
        planned: &PlannedCache,
    ) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        let row = jobs::row(write.connection().await?, job).await?;
        let asked: Vec<u32> =
            sqlx::query_scalar("SELECT frame FROM tasks WHERE job_id = ? AND kind = 'profile'")
                .bind(job.0)
                .fetch_all(write.connection().await?)
                .await?;
        if word::<JobState>(&row, "state")? != JobState::Profiling
            || frames.iter().any(|frame| asked.contains(frame))
        {
            return Ok(());
        }
        let common = Common::of(job, &row)?;
        let cache = match planned {
            PlannedCache::There { plan, .. } => plan.cache,
            PlannedCache::NotAsked | PlannedCache::Pending => None,
        };
        for &frame in frames {
            let samples = whole(&row, "samples")?;
            let asked = ProfileAsked { frame, samples, ladders: false, cache };
            common.profile(&mut write, asked, false).await?;
        }
        self.commit(write).await
    }

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
