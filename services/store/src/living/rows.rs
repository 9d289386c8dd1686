//! Rows of living estimates: the newest of each job, and its history.
//!
//! The history holds at most [`MOST_POINTS`] estimates of a job. Once it is full, every second one is
//! deleted, except the first, which is the quote. So old points are sparse, recent ones are dense, and the
//! disk space of a job is bounded.

use std::collections::BTreeMap;

use forelight_protocol::{ForecastHistory, HistoryPoint, JobId, JobState, LiveFigure, LiveForecast, PlanId};
use forelight_quote::living::{Baseline, Last, Off};
use sqlx::sqlite::SqliteRow;
use sqlx::{FromRow, Row as _, SqliteConnection};

use crate::columns::{Id, Json, Time, Word, hex_list};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::writing::{ask, later, run};

/// Most points in a job's history.
const MOST_POINTS: i64 = 512;

impl Store {
    /// The history of the job's estimate; `None` before the job is booked.
    pub async fn forecast_history(&self, job: JobId) -> Result<Option<ForecastHistory>> {
        let mut transaction = self.read().await?;
        let row = sqlx::query!(
            "SELECT j.state, j.frames_total, l.body AS \"body?: Json<LiveForecast>\" FROM jobs j LEFT \
             JOIN live_forecasts l ON l.job_id = j.id WHERE j.id = ?",
            job.0
        )
        .fetch_optional(&mut *transaction)
        .await?;
        let row = row.ok_or(StoreError::NotFound("job"))?;
        let Some(now) = row.body.map(|it| it.0) else { return Ok(None) };
        let points =
            sqlx::query_scalar!("SELECT body FROM forecast_history WHERE job_id = ? ORDER BY point", job.0)
                .fetch_all(&mut *transaction)
                .await?;
        Ok(Some(ForecastHistory {
            job_id: job,
            state: row.state.0,
            frames_total: row.frames_total,
            now,
            points: points.into_iter().map(|point| point.0).collect(),
        }))
    }
}

pub(crate) async fn newest(
    connection: &mut SqliteConnection,
    jobs: &[JobId],
) -> Result<BTreeMap<JobId, LiveForecast>> {
    let rows = sqlx::query!(
        "SELECT job_id, body FROM live_forecasts WHERE job_id IN (SELECT unhex(value) FROM json_each(?))",
        hex_list(jobs.iter().map(|job| job.0))
    )
    .fetch_all(connection)
    .await?;
    Ok(rows.into_iter().map(|row| (row.job_id.into(), row.body.0)).collect())
}

/// An estimate as stored.
pub(super) struct Kept {
    /// The plan that it was compared with.
    pub plan: PlanId,
    pub baseline: Baseline,
    pub last: Last,
    pub was_off: Off,
    pub cpu_seconds: LiveFigure,
}

/// What is stored before an update.
pub(crate) struct Before {
    /// The last estimate, if there is one.
    pub(super) estimate: Option<Kept>,
    pub job_state: JobState,
}

impl Before {
    /// Number of frames that were finished before; `None` without an estimate.
    pub(crate) fn frames_done(&self) -> Option<u32> {
        self.estimate.as_ref().map(|kept| kept.last.frames_done + kept.last.frames_since)
    }
}

/// Reads what is stored before an update.
pub(crate) async fn before(write: &mut Write, job: JobId) -> Result<Before> {
    ask!(
        write,
        "SELECT l.*, j.frames_total, j.state FROM jobs j LEFT JOIN live_forecasts l ON l.job_id = j.id \
         WHERE j.id = ?",
        job.0
    )
    .first_row()
    .await?
    .ok_or(StoreError::NotFound("job"))
}

impl FromRow<'_, SqliteRow> for Before {
    fn from_row(row: &SqliteRow) -> Result<Self, sqlx::Error> {
        let kept = |plan: Id| {
            Ok::<_, sqlx::Error>(Kept {
                plan: plan.into(),
                baseline: Baseline {
                    cpu_seconds: row.try_get("booked_cpu")?,
                    rest: row.try_get("booked_rest")?,
                    share: row.try_get("booked_share")?,
                },
                last: Last {
                    at: row.try_get::<Time, _>("updated_at")?.into(),
                    frames_done: row.try_get("frames_done")?,
                    frames_since: row.try_get("frames_since")?,
                    frames_total: row.try_get("frames_total")?,
                },
                was_off: Off { cost: row.try_get("cost_is_off")?, finish: row.try_get("finish_is_off")? },
                cpu_seconds: row.try_get::<Json<LiveForecast>, _>("body")?.0.cpu_seconds,
            })
        };
        let plan: Option<Id> = row.try_get("plan_id")?;
        let state: Word<JobState> = row.try_get("state")?;
        Ok(Self { estimate: plan.map(kept).transpose()?, job_state: state.0 })
    }
}

/// Counts a finished frame that the estimate leaves out for now.
pub(super) fn count_frame(write: &mut Write, job: JobId) {
    later!(write, "UPDATE live_forecasts SET frames_since = frames_since + 1 WHERE job_id = ?", job.0);
}

/// Stores an estimate, as the newest and in the history.
pub(super) async fn keep(
    write: &mut Write,
    job: JobId,
    plan: PlanId,
    baseline: &Baseline,
    live: &LiveForecast,
) -> Result<()> {
    run!(
        write,
        "INSERT INTO live_forecasts (job_id, plan_id, booked_cpu, booked_rest, booked_share, \
         frames_done, cost_is_off, finish_is_off, body, updated_at) \
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (job_id) DO UPDATE \
         SET plan_id = excluded.plan_id, booked_cpu = excluded.booked_cpu, booked_rest = \
         excluded.booked_rest, booked_share = excluded.booked_share, frames_done = \
         excluded.frames_done, frames_since = 0, cost_is_off = excluded.cost_is_off, finish_is_off = \
         excluded.finish_is_off, body = excluded.body, updated_at = excluded.updated_at",
        job.0,
        plan.0,
        baseline.cpu_seconds,
        baseline.rest,
        baseline.share,
        live.frames_done,
        live.cost_is_off,
        live.finish_is_off,
        Json(live),
        live.at.micros()
    );
    let points = sqlx::query_scalar!("SELECT count(*) FROM forecast_history WHERE job_id = ?", job.0)
        .fetch_one(write.connection().await?)
        .await?;
    if points >= MOST_POINTS {
        run!(
            write,
            "DELETE FROM forecast_history WHERE job_id = ?1 AND point IN (SELECT point FROM \
             (SELECT point, row_number() OVER (ORDER BY point) AS place FROM forecast_history \
             WHERE job_id = ?1) WHERE place % 2 = 0)",
            job.0
        );
    }
    run!(
        write,
        "INSERT INTO forecast_history (job_id, point, body) \
         VALUES (?1, (SELECT ifnull(max(point) + 1, 0) FROM forecast_history WHERE job_id = ?1), ?2)",
        job.0,
        Json(HistoryPoint::of(live))
    );
    Ok(())
}
