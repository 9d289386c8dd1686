//! How often the quotes were right.

use forelight_protocol::{JobId, QuantileHits, Quantiles, Timestamp, TrackRecord, TrackRecordRow};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::decode::{id, time, whole};
use crate::{Store, StoreError};

impl Store {
    /// The record over all finished frames, and those of them that finished before `before` (a place in the order of
    /// time, job and frame), newest first, at most `limit`.
    pub async fn track_record(
        &self,
        before: Option<(Timestamp, JobId, u32)>,
        limit: u32,
    ) -> Result<TrackRecord, StoreError> {
        let mut transaction = self.read().await?;
        let mut record = totals(&mut transaction).await?;
        let (at, job, frame) = before.map_or((i64::MAX, uuid::Uuid::max(), i64::MAX), |(at, job, frame)| {
            (at.micros(), job.0, i64::from(frame))
        });
        let rows = sqlx::query(
            "SELECT * FROM frames WHERE finished_at IS NOT NULL AND forecast IS NOT NULL \
             AND (finished_at, job_id, frame) < (?, ?, ?) ORDER BY finished_at DESC, job_id DESC, frame DESC LIMIT ?",
        )
        .bind(at)
        .bind(job)
        .bind(frame)
        .bind(limit)
        .fetch_all(&mut *transaction)
        .await?;
        record.items = rows.iter().map(decode).collect::<Result<_, _>>()?;
        Ok(record)
    }
}

/// The record over all finished frames, without any of them.
pub(crate) async fn totals(connection: &mut SqliteConnection) -> Result<TrackRecord, StoreError> {
    let row = sqlx::query(
        "SELECT count(*) AS frames, \
         coalesce(sum(actual_work <= work_p50), 0) AS work_p50, coalesce(sum(actual_work <= work_p80), 0) AS work_p80, \
         coalesce(sum(actual_work <= work_p95), 0) AS work_p95, \
         coalesce(sum(actual_cpu <= cpu_p50), 0) AS cpu_p50, coalesce(sum(actual_cpu <= cpu_p80), 0) AS cpu_p80, \
         coalesce(sum(actual_cpu <= cpu_p95), 0) AS cpu_p95, \
         avg(abs(work_mean / nullif(actual_work, 0) - 1)) AS work_error, avg(abs(cpu_mean / nullif(actual_cpu, 0) - 1)) AS cpu_error, \
         sum(work_mean) / nullif(sum(actual_work), 0) - 1 AS work_bias, sum(cpu_mean) / nullif(sum(actual_cpu), 0) - 1 AS cpu_bias \
         FROM frames WHERE finished_at IS NOT NULL AND forecast IS NOT NULL",
    )
    .fetch_one(connection)
    .await?;
    Ok(TrackRecord {
        frames: whole(&row, "frames")?,
        work_hits: QuantileHits {
            p50: whole(&row, "work_p50")?,
            p80: whole(&row, "work_p80")?,
            p95: whole(&row, "work_p95")?,
        },
        cpu_hits: QuantileHits {
            p50: whole(&row, "cpu_p50")?,
            p80: whole(&row, "cpu_p80")?,
            p95: whole(&row, "cpu_p95")?,
        },
        work_mean_absolute_error: row.try_get("work_error")?,
        cpu_mean_absolute_error: row.try_get("cpu_error")?,
        work_bias: row.try_get("work_bias")?,
        cpu_bias: row.try_get("cpu_bias")?,
        items: Vec::new(),
        next_page_token: None,
    })
}

fn decode(row: &SqliteRow) -> Result<TrackRecordRow, StoreError> {
    let quantiles = |mean: &str, p50: &str, p80: &str, p95: &str| -> Result<Quantiles, StoreError> {
        Ok(Quantiles {
            mean: row.try_get(mean)?,
            p50: row.try_get(p50)?,
            p80: row.try_get(p80)?,
            p95: row.try_get(p95)?,
        })
    };
    Ok(TrackRecordRow {
        job_id: JobId(id(row, "job_id")?),
        frame: whole(row, "frame")?,
        finished: time(row, "finished_at")?,
        work_forecast: quantiles("work_mean", "work_p50", "work_p80", "work_p95")?,
        work_actual: row.try_get("actual_work")?,
        cpu_forecast: quantiles("cpu_mean", "cpu_p50", "cpu_p80", "cpu_p95")?,
        cpu_actual: row.try_get("actual_cpu")?,
    })
}
