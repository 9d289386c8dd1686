//! How often the quotes were right.

use std::collections::BTreeMap;

use forelight_protocol::{
    Coverage, JobId, QuantileHits, Quantiles, Timestamp, TrackRecord, TrackRecordDay, TrackRecordKind,
    TrackRecordProject, TrackRecordRow,
};
use sqlx::{SqliteConnection, query, query_as};

use crate::columns::{Json, Time};
use crate::database::Store;
use crate::error::Result;
use crate::quotes::left_out;

/// Rows with hits and errors, counted over frames or jobs with forecast and actual.
macro_rules! coverage_rows {
    ($head:literal, $($from:tt)+) => {
        query!(
            "SELECT " + $head + ", count(*) AS \"count!: u64\", \
             coalesce(sum(actual_work <= work_p50), 0) AS \"work_p50!: u64\", \
             coalesce(sum(actual_work <= work_p80), 0) AS \"work_p80!: u64\", \
             coalesce(sum(actual_work <= work_p95), 0) AS \"work_p95!: u64\", \
             coalesce(sum(actual_cpu <= cpu_p50), 0) AS \"cpu_p50!: u64\", \
             coalesce(sum(actual_cpu <= cpu_p80), 0) AS \"cpu_p80!: u64\", \
             coalesce(sum(actual_cpu <= cpu_p95), 0) AS \"cpu_p95!: u64\", \
             avg(abs(work_mean / nullif(actual_work, 0) - 1)) AS \"work_error?: f64\", \
             avg(abs(cpu_mean / nullif(actual_cpu, 0) - 1)) AS \"cpu_error?: f64\" "
                + $($from)+
        )
    };
}

macro_rules! coverage {
    ($row:expr) => {
        Coverage {
            count: $row.count,
            work_hits: QuantileHits { p50: $row.work_p50, p80: $row.work_p80, p95: $row.work_p95 },
            cpu_hits: QuantileHits { p50: $row.cpu_p50, p80: $row.cpu_p80, p95: $row.cpu_p95 },
            work_mean_absolute_error: $row.work_error,
            cpu_mean_absolute_error: $row.cpu_error,
        }
    };
}

/// A statement over the finished jobs, with the quantiles of their totals and their actual cost. Arguments:
/// the macro that makes it, the text before the jobs, and the text after them.
macro_rules! of_finished_jobs {
    ($make:ident!($($before:tt)*), $after:literal $(, $value:expr)*) => {
        $make!(
            $($before)* "SELECT j.id AS job_id, j.finished_at, \
             json_extract(j.forecast, '$.calibrated') AS calibrated, \
             json_extract(j.forecast, '$.total.work.mean') AS work_mean, \
             json_extract(j.forecast, '$.total.work.p50') AS work_p50, \
             json_extract(j.forecast, '$.total.work.p80') AS work_p80, \
             json_extract(j.forecast, '$.total.work.p95') AS work_p95, \
             json_extract(j.forecast, '$.total.cpu_seconds.mean') AS cpu_mean, \
             json_extract(j.forecast, '$.total.cpu_seconds.p50') AS cpu_p50, \
             json_extract(j.forecast, '$.total.cpu_seconds.p80') AS cpu_p80, \
             json_extract(j.forecast, '$.total.cpu_seconds.p95') AS cpu_p95, \
             (SELECT sum(actual_work) FROM frames WHERE job_id = j.id) AS actual_work, \
             (SELECT sum(actual_cpu) FROM frames WHERE job_id = j.id) AS actual_cpu FROM jobs j \
             WHERE j.state = 'done' AND j.id NOT IN (SELECT job_id FROM left_out_jobs) "
                + $after
            $(, $value)*
        )
    };
}

/// A finished job: when, and forecast means over actuals, minus one.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct FinishedJob {
    /// When its last frame was finished.
    pub finished: Timestamp,
    /// Whether its quantiles were calibrated on past jobs.
    pub calibrated: bool,
    /// Error of work; `None` if it took none.
    pub work_error: Option<f64>,
    /// Error of CPU time; `None` if it took none.
    pub cpu_error: Option<f64>,
}

/// Days of which the record tells.
const DAYS: i64 = 366;

/// A day in microseconds.
const DAY: i64 = 86_400_000_000;

impl Store {
    /// The record over all finished frames, without any of them. Only of `projects`, if they are given.
    pub async fn track_record_totals(&self, projects: Option<&[String]>) -> Result<TrackRecord> {
        totals(&mut *self.readers().acquire().await?, projects).await
    }

    /// The newest finished jobs, at most `limit`, the oldest of them first; those of `projects`, if they are
    /// given.
    pub async fn finished_jobs(&self, limit: u32, projects: Option<&[String]>) -> Result<Vec<FinishedJob>> {
        Ok(of_finished_jobs!(
            query_as!(
                FinishedJob,
                "SELECT finished_at AS \"finished!: Time\", coalesce(calibrated, 0) AS \"calibrated!: bool\", \
                 work_mean / nullif(actual_work, 0) - 1 AS \"work_error?: f64\", \
                 cpu_mean / nullif(actual_cpu, 0) - 1 AS \"cpu_error?: f64\" FROM (" +
            ),
            "AND (?1 IS NULL OR j.project IN (SELECT value FROM json_each(?1))) \
             ORDER BY j.finished_at DESC, j.id DESC LIMIT ?2) ORDER BY finished_at, job_id",
            projects.map(Json),
            limit
        )
        .fetch_all(self.readers())
        .await?)
    }

    /// The record over all finished frames, and the frames that finished before `before` (a place in the
    /// order of time, job and frame), newest first, at most `limit`. Only of `projects`, if they are given.
    pub async fn track_record(
        &self,
        before: Option<(Timestamp, JobId, u32)>,
        limit: u32,
        projects: Option<&[String]>,
    ) -> Result<TrackRecord> {
        let mut transaction = self.read().await?;
        let mut record = totals(&mut transaction, projects).await?;
        if before.is_none() {
            record.projects = by_project(&mut transaction, projects).await?;
            record.days = by_day(&mut transaction, projects).await?;
        }
        let (at, job, frame) = before.map_or((i64::MAX, uuid::Uuid::max(), i64::MAX), |(at, job, frame)| {
            (at.micros(), job.0, i64::from(frame))
        });
        let rows = query!(
            r#"SELECT job_id, frame, finished_at AS "finished_at!", work_mean AS "work_mean!",
                      work_p50 AS "work_p50!", work_p80 AS "work_p80!", work_p95 AS "work_p95!",
                      cpu_mean AS "cpu_mean!", cpu_p50 AS "cpu_p50!", cpu_p80 AS "cpu_p80!",
                      cpu_p95 AS "cpu_p95!", actual_work AS "actual_work!", actual_cpu AS "actual_cpu!"
               FROM frames WHERE finished_at IS NOT NULL AND forecast IS NOT NULL
                    AND job_id NOT IN (SELECT job_id FROM left_out_jobs) AND (finished_at, job_id, frame) < (?2, ?3, ?4)
                    AND (?1 IS NULL OR job_id IN (SELECT id FROM jobs WHERE project IN (SELECT value FROM json_each(?1))))
               ORDER BY finished_at DESC, job_id DESC, frame DESC LIMIT ?5"#,
            projects.map(Json),
            at,
            job,
            frame,
            limit
        )
        .fetch_all(&mut *transaction)
        .await?;
        record.kinds = kinds(&mut transaction, projects).await?;
        record.left_out = left_out::list(&mut transaction, projects).await?;
        record.items = rows
            .into_iter()
            .map(|row| TrackRecordRow {
                job_id: row.job_id.into(),
                frame: row.frame,
                finished: row.finished_at.into(),
                work_forecast: quantiles([row.work_mean, row.work_p50, row.work_p80, row.work_p95]),
                work_actual: row.actual_work,
                cpu_forecast: quantiles([row.cpu_mean, row.cpu_p50, row.cpu_p80, row.cpu_p95]),
                cpu_actual: row.actual_cpu,
            })
            .collect();
        Ok(record)
    }
}

fn quantiles([mean, p50, p80, p95]: [f64; 4]) -> Quantiles {
    Quantiles { mean, p50, p80, p95 }
}

/// The record over all finished frames, without any of them.
async fn totals(connection: &mut SqliteConnection, projects: Option<&[String]>) -> Result<TrackRecord> {
    let row = coverage_rows!(
        "sum(work_mean) / nullif(sum(actual_work), 0) - 1 AS \"work_bias?: f64\", \
         sum(cpu_mean) / nullif(sum(actual_cpu), 0) - 1 AS \"cpu_bias?: f64\"",
        "FROM frames WHERE finished_at IS NOT NULL AND forecast IS NOT NULL \
         AND job_id NOT IN (SELECT job_id FROM left_out_jobs) AND (?1 IS NULL OR job_id IN (SELECT id FROM jobs WHERE project IN (SELECT value FROM json_each(?1))))",
        projects.map(Json)
    )
    .fetch_one(connection)
    .await?;
    let Coverage { count, work_hits, cpu_hits, work_mean_absolute_error, cpu_mean_absolute_error } =
        coverage!(row);
    Ok(TrackRecord {
        frames: count,
        work_hits,
        cpu_hits,
        work_mean_absolute_error,
        cpu_mean_absolute_error,
        work_bias: row.work_bias,
        cpu_bias: row.cpu_bias,
        kinds: Vec::new(),
        projects: Vec::new(),
        days: Vec::new(),
        left_out: Vec::new(),
        items: Vec::new(),
        next_page_token: None,
    })
}

async fn by_project(
    connection: &mut SqliteConnection,
    projects: Option<&[String]>,
) -> Result<Vec<TrackRecordProject>> {
    let rows = coverage_rows!(
        "j.project AS \"project!\", \
         sum(work_mean) / nullif(sum(actual_work), 0) - 1 AS \"work_bias?: f64\", \
         sum(cpu_mean) / nullif(sum(actual_cpu), 0) - 1 AS \"cpu_bias?: f64\"",
        "FROM frames f JOIN jobs j ON j.id = f.job_id \
         WHERE f.finished_at IS NOT NULL AND f.forecast IS NOT NULL \
         AND f.job_id NOT IN (SELECT job_id FROM left_out_jobs) \
         AND (?1 IS NULL OR j.project IN (SELECT value FROM json_each(?1))) GROUP BY 1 ORDER BY 1",
        projects.map(Json)
    )
    .fetch_all(connection)
    .await?;
    let project = rows.into_iter().map(|row| TrackRecordProject {
        frames: coverage!(row),
        project: row.project,
        work_bias: row.work_bias,
        cpu_bias: row.cpu_bias,
    });
    Ok(project.collect())
}

async fn by_day(
    connection: &mut SqliteConnection,
    projects: Option<&[String]>,
) -> Result<Vec<TrackRecordDay>> {
    let rows = coverage_rows!(
        "finished_at / ?1 AS \"day!: i64\"",
        "FROM frames WHERE finished_at IS NOT NULL AND forecast IS NOT NULL \
         AND job_id NOT IN (SELECT job_id FROM left_out_jobs) \
         AND (?3 IS NULL OR job_id IN (SELECT id FROM jobs WHERE project IN (SELECT value FROM json_each(?3)))) \
         GROUP BY 1 ORDER BY 1 DESC LIMIT ?2",
        DAY,
        DAYS,
        projects.map(Json)
    )
    .fetch_all(connection)
    .await?;
    let day = |number: i64| Timestamp::from_micros(number.saturating_mul(DAY));
    let days = rows.into_iter().rev().map(|row| TrackRecordDay { day: day(row.day), frames: coverage!(row) });
    Ok(days.collect())
}

async fn kinds(
    connection: &mut SqliteConnection,
    projects: Option<&[String]>,
) -> Result<Vec<TrackRecordKind>> {
    let of_frames = coverage_rows!(
        "q.renderer AS \"renderer?\", q.feature_class AS \"feature_class?\", \
         coalesce(json_extract(j.forecast, '$.calibrated'), 0) AS \"calibrated!: bool\"",
        "FROM frames f JOIN jobs j ON j.id = f.job_id LEFT JOIN quotes q ON q.job_id = f.job_id \
         WHERE f.finished_at IS NOT NULL AND f.forecast IS NOT NULL \
         AND f.job_id NOT IN (SELECT job_id FROM left_out_jobs) \
         AND (?1 IS NULL OR j.project IN (SELECT value FROM json_each(?1))) GROUP BY 1, 2, 3",
        projects.map(Json)
    )
    .fetch_all(&mut *connection)
    .await?;
    let of_jobs = of_finished_jobs!(
        coverage_rows!(
            "q.renderer AS \"renderer?\", q.feature_class AS \"feature_class?\", \
             coalesce(d.calibrated, 0) AS \"calibrated!: bool\"",
            "FROM (" +
        ),
        "AND (?1 IS NULL OR j.project IN (SELECT value FROM json_each(?1)))) d \
         LEFT JOIN quotes q ON q.job_id = d.job_id GROUP BY 1, 2, 3",
        projects.map(Json)
    )
    .fetch_all(connection)
    .await?;
    let mut kinds: BTreeMap<(Option<String>, Option<String>, bool), [Coverage; 2]> = BTreeMap::new();
    for row in of_frames {
        let coverage = coverage!(row);
        kinds.entry((row.renderer, row.feature_class, row.calibrated)).or_default()[0] = coverage;
    }
    for row in of_jobs {
        let coverage = coverage!(row);
        kinds.entry((row.renderer, row.feature_class, row.calibrated)).or_default()[1] = coverage;
    }
    let kinds = kinds.into_iter().map(|((renderer, feature_class, calibrated), [frames, jobs])| {
        TrackRecordKind { renderer, feature_class, calibrated, frames, jobs }
    });
    Ok(kinds.collect())
}
