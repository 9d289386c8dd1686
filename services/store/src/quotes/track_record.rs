//! How often the quotes were right.

use std::collections::BTreeMap;

use forelight_protocol::{
    Coverage, JobId, QuantileHits, Quantiles, Timestamp, TrackRecord, TrackRecordKind, TrackRecordRow,
};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::database::Store;
use crate::decode::{id, time, whole};
use crate::error::StoreError;

/// What hits and errors are counted over: frames or jobs, with forecast and actual.
macro_rules! coverage_columns {
    () => {
        "count(*) AS count, \
         coalesce(sum(actual_work <= work_p50), 0) AS work_p50, coalesce(sum(actual_work <= work_p80), 0) AS work_p80, \
         coalesce(sum(actual_work <= work_p95), 0) AS work_p95, \
         coalesce(sum(actual_cpu <= cpu_p50), 0) AS cpu_p50, coalesce(sum(actual_cpu <= cpu_p80), 0) AS cpu_p80, \
         coalesce(sum(actual_cpu <= cpu_p95), 0) AS cpu_p95, \
         avg(abs(work_mean / nullif(actual_work, 0) - 1)) AS work_error, avg(abs(cpu_mean / nullif(actual_cpu, 0) - 1)) AS cpu_error "
    };
}

/// Finished jobs with the quantiles of their totals and what they took.
macro_rules! finished_jobs {
    () => {
        "SELECT j.id AS job_id, j.finished_at, json_extract(j.forecast, '$.calibrated') AS calibrated, \
         json_extract(j.forecast, '$.total.work.mean') AS work_mean, json_extract(j.forecast, '$.total.work.p50') AS work_p50, \
         json_extract(j.forecast, '$.total.work.p80') AS work_p80, json_extract(j.forecast, '$.total.work.p95') AS work_p95, \
         json_extract(j.forecast, '$.total.cpu_seconds.mean') AS cpu_mean, json_extract(j.forecast, '$.total.cpu_seconds.p50') AS cpu_p50, \
         json_extract(j.forecast, '$.total.cpu_seconds.p80') AS cpu_p80, json_extract(j.forecast, '$.total.cpu_seconds.p95') AS cpu_p95, \
         (SELECT sum(actual_work) FROM frames WHERE job_id = j.id) AS actual_work, \
         (SELECT sum(actual_cpu) FROM frames WHERE job_id = j.id) AS actual_cpu FROM jobs j WHERE j.state = 'done' "
    };
}

/// A finished job: when, and forecast means over actuals, minus one.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct FinishedJob {
    /// When its last frame was finished.
    pub finished: Timestamp,
    /// Whether its quantiles were calibrated on past jobs.
    pub calibrated: bool,
    /// Of work; absent if it took none.
    pub work_error: Option<f64>,
    /// Of CPU time; absent if it took none.
    pub cpu_error: Option<f64>,
}

impl Store {
    /// The newest finished jobs, at most `limit`, the oldest of them first.
    pub async fn finished_jobs(&self, limit: u32) -> Result<Vec<FinishedJob>, StoreError> {
        let rows = sqlx::query(concat!(
            "SELECT finished_at, coalesce(calibrated, 0) AS calibrated, \
             work_mean / nullif(actual_work, 0) - 1 AS work_error, cpu_mean / nullif(actual_cpu, 0) - 1 AS cpu_error FROM (",
            finished_jobs!(),
            "ORDER BY j.finished_at DESC, j.id DESC LIMIT ?) ORDER BY finished_at, job_id"
        ))
        .bind(limit)
        .fetch_all(self.readers())
        .await?;
        let job = |row: &SqliteRow| {
            Ok(FinishedJob {
                finished: time(row, "finished_at")?,
                calibrated: whole::<i64>(row, "calibrated")? != 0,
                work_error: row.try_get("work_error")?,
                cpu_error: row.try_get("cpu_error")?,
            })
        };
        rows.iter().map(job).collect()
    }

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
        record.kinds = kinds(&mut transaction).await?;
        record.items = rows.iter().map(decode).collect::<Result<_, _>>()?;
        Ok(record)
    }
}

/// The record over all finished frames, without any of them.
pub(crate) async fn totals(connection: &mut SqliteConnection) -> Result<TrackRecord, StoreError> {
    let row = sqlx::query(
        concat!(
            "SELECT sum(work_mean) / nullif(sum(actual_work), 0) - 1 AS work_bias, sum(cpu_mean) / nullif(sum(actual_cpu), 0) - 1 AS cpu_bias, ",
            coverage_columns!(),
            "FROM frames WHERE finished_at IS NOT NULL AND forecast IS NOT NULL"
        ),
    )
    .fetch_one(connection)
    .await?;
    let Coverage { count, work_hits, cpu_hits, work_mean_absolute_error, cpu_mean_absolute_error } =
        coverage(&row)?;
    Ok(TrackRecord {
        frames: count,
        work_hits,
        cpu_hits,
        work_mean_absolute_error,
        cpu_mean_absolute_error,
        work_bias: row.try_get("work_bias")?,
        cpu_bias: row.try_get("cpu_bias")?,
        kinds: Vec::new(),
        items: Vec::new(),
        next_page_token: None,
    })
}

/// The record by kind of quote.
async fn kinds(connection: &mut SqliteConnection) -> Result<Vec<TrackRecordKind>, StoreError> {
    let of_frames = sqlx::query(concat!(
        "SELECT q.renderer, q.feature_class, coalesce(json_extract(j.forecast, '$.calibrated'), 0) AS calibrated, ",
        coverage_columns!(),
        "FROM frames f JOIN jobs j ON j.id = f.job_id LEFT JOIN quotes q ON q.job_id = f.job_id \
         WHERE f.finished_at IS NOT NULL AND f.forecast IS NOT NULL GROUP BY 1, 2, 3"
    ))
    .fetch_all(&mut *connection)
    .await?;
    let of_jobs = sqlx::query(concat!(
        "SELECT q.renderer, q.feature_class, coalesce(d.calibrated, 0) AS calibrated, ",
        coverage_columns!(),
        "FROM (",
        finished_jobs!(),
        ") d LEFT JOIN quotes q ON q.job_id = d.job_id GROUP BY 1, 2, 3"
    ))
    .fetch_all(connection)
    .await?;
    let mut kinds: BTreeMap<(Option<String>, Option<String>, bool), [Coverage; 2]> = BTreeMap::new();
    for (place, rows) in [of_frames, of_jobs].iter().enumerate() {
        for row in rows {
            let calibrated = whole::<i64>(row, "calibrated")? != 0;
            let kind = (row.try_get("renderer")?, row.try_get("feature_class")?, calibrated);
            kinds.entry(kind).or_default()[place] = coverage(row)?;
        }
    }
    let kinds = kinds.into_iter().map(|((renderer, feature_class, calibrated), [frames, jobs])| {
        TrackRecordKind { renderer, feature_class, calibrated, frames, jobs }
    });
    Ok(kinds.collect())
}

fn coverage(row: &SqliteRow) -> Result<Coverage, StoreError> {
    Ok(Coverage {
        count: whole(row, "count")?,
        work_hits: QuantileHits {
            p50: whole(row, "work_p50")?,
            p80: whole(row, "work_p80")?,
            p95: whole(row, "work_p95")?,
        },
        cpu_hits: QuantileHits {
            p50: whole(row, "cpu_p50")?,
            p80: whole(row, "cpu_p80")?,
            p95: whole(row, "cpu_p95")?,
        },
        work_mean_absolute_error: row.try_get("work_error")?,
        cpu_mean_absolute_error: row.try_get("cpu_error")?,
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
