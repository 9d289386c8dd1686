//! Quotes, as they are kept with their jobs and frames.

pub(crate) mod calibration;
pub(crate) mod profiling;
pub(crate) mod track_record;

use forelight_protocol::{
    ByClass, CacheQuote, FixedCosts, ForecastDoc, ForecastTotals, FrameForecast, JobId, LeftOut,
    MoneyQuantiles, NodeSeconds, ProcessCosts, Profiled, Quantiles, QuotedShot, SpentOnForecast,
};
use serde::{Deserialize, Serialize};

use crate::columns::Json;
use crate::database::{Store, Write};
use crate::error::StoreError;

/// A job's quote without its frames, as it is kept with the job.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct JobForecast {
    /// All frames together.
    pub total: ForecastTotals,
    /// What the quote rests on.
    pub profiled: Profiled,
    /// What the quote took.
    pub spent: SpentOnForecast,
    /// Whether the quantiles have been calibrated on past jobs.
    pub calibrated: bool,
    /// The effects that any of the profiled frames calls for.
    #[serde(default)]
    pub effects: Vec<String>,
    /// What is left out of all of them.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Camera samples that were chosen for a time or an amount of money: what its frames are given work for.
    #[serde(default)]
    pub chosen_spp: Option<u32>,
    /// What a frame costs whatever its pixels show: the mean of the profiled ones.
    #[serde(default)]
    pub fixed: Option<FixedCosts>,
    /// What every process pays once that renders its frames.
    #[serde(default)]
    pub once: Option<ProcessCosts>,
    /// The work of the profiled frames by class.
    #[serde(default)]
    pub work_by_class: Option<ByClass>,
    /// The total on calibrated nodes.
    #[serde(default)]
    pub cpu_seconds_on: Vec<NodeSeconds>,
    /// How the irradiance caches are made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<CacheQuote>,
    /// The total in money, with the shared irradiance cache if there is one.
    pub cost: Option<MoneyQuantiles>,
    /// Which lights shine in each frame, in their order, as a number that frames with the same ones share; empty if those of all do.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lights: Vec<u32>,
    /// When each frame is on the shot's own clock, in their order. Kept with the frames, and so empty when it is read back.
    #[serde(skip)]
    pub clock: Vec<f64>,
}

impl Store {
    /// The job's quote; `None` until it is there.
    pub async fn forecast(&self, job: JobId) -> Result<Option<ForecastDoc>, StoreError> {
        let mut transaction = self.read().await?;
        let row = sqlx::query!("SELECT forecast, scene, settings FROM jobs WHERE id = ?", job.0)
            .fetch_optional(&mut *transaction)
            .await?;
        let row = row.ok_or(StoreError::NotFound("job"))?;
        let Some(kept) = row.forecast else { return Ok(None) };
        let of = QuotedShot { scene: row.scene.0.digest, settings: row.settings.0 };
        let frames = sqlx::query_scalar!(
            r#"SELECT forecast AS "forecast!" FROM frames WHERE job_id = ? AND forecast IS NOT NULL ORDER BY frame"#,
            job.0
        )
        .fetch_all(&mut *transaction)
        .await?;
        let frames = frames.into_iter().map(|frame| frame.0).collect();
        Ok(Some(kept.read()?.document(of, frames)))
    }
}

impl JobForecast {
    /// CPU seconds for the irradiance cache that its frames share; zero if they do not.
    pub fn shared_cache_seconds(&self) -> Quantiles {
        self.cache.as_ref().map(CacheQuote::seed_seconds).unwrap_or_default()
    }

    /// As it is shown, with what it is of and the forecasts of the frames.
    pub fn document(self, of: QuotedShot, frames: Vec<FrameForecast>) -> ForecastDoc {
        ForecastDoc {
            of: Some(of),
            frames,
            total: self.total,
            profiled: self.profiled,
            spent: self.spent,
            calibrated: self.calibrated,
            effects: self.effects,
            left_out: self.left_out,
            chosen_spp: self.chosen_spp,
            fixed: self.fixed,
            once: self.once,
            work_by_class: self.work_by_class,
            cpu_seconds_on: self.cpu_seconds_on,
            cache: self.cache,
            cost: self.cost,
        }
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
        sqlx::query!(
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
        )
        .execute(write.connection().await?)
        .await?;
    }
    Ok(())
}
