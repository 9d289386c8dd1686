//! What is kept of living estimates: the newest of each job, and its history.
//!
//! The history holds at most [`MOST_POINTS`] estimates of a job. Once it is full, every second one is deleted, except
//! the first, which is the quote. So the distant past is known coarsely and the recent past finely, and the disk space
//! of a job is bounded.

use forelight_protocol::{ForecastHistory, HistoryPoint, JobId, JobState, LiveFigure, LiveForecast, PlanId};
use forelight_quote::living::{Baseline, Last, Off};
use sqlx::{Row as _, SqliteConnection};

use crate::database::Store;
use crate::database::Write;
use crate::decode::{id_opt, json, json_opt, time, to_json, whole, word};
use crate::error::StoreError;

/// Most estimates of a job that are kept.
const MOST_POINTS: i64 = 512;

impl Store {
    /// How the job's estimate moved; `None` before the job is booked.
    pub async fn forecast_history(&self, job: JobId) -> Result<Option<ForecastHistory>, StoreError> {
        let mut transaction = self.read().await?;
        let row = sqlx::query(
            "SELECT j.state, j.frames_total, l.body FROM jobs j LEFT JOIN live_forecasts l ON l.job_id = j.id WHERE j.id = ?",
        )
        .bind(job.0)
        .fetch_optional(&mut *transaction)
        .await?;
        let row = row.ok_or(StoreError::NotFound("job"))?;
        let Some(now) = json_opt(&row, "body")? else { return Ok(None) };
        let points = sqlx::query("SELECT body FROM forecast_history WHERE job_id = ? ORDER BY point")
            .bind(job.0)
            .fetch_all(&mut *transaction)
            .await?;
        Ok(Some(ForecastHistory {
            job_id: job,
            state: word(&row, "state")?,
            frames_total: whole(&row, "frames_total")?,
            now,
            points: points.iter().map(|row| json(row, "body")).collect::<Result<_, _>>()?,
        }))
    }
}

/// The job's newest estimate.
pub(crate) async fn newest(
    connection: &mut SqliteConnection,
    job: JobId,
) -> Result<Option<LiveForecast>, StoreError> {
    let row = sqlx::query("SELECT body FROM live_forecasts WHERE job_id = ?")
        .bind(job.0)
        .fetch_optional(connection)
        .await?;
    row.as_ref().map(|row| json(row, "body")).transpose()
}

/// What is kept beside an estimate.
pub(super) struct Kept {
    /// The plan that it was compared with.
    pub plan: PlanId,
    pub baseline: Baseline,
    pub last: Last,
    pub was_off: Off,
    pub cpu_seconds: LiveFigure,
}

/// What there is before an estimate is made.
pub(crate) struct Before {
    /// The estimate before, if there is one.
    pub(super) estimate: Option<Kept>,
    /// The job's state.
    pub job_state: JobState,
}

/// Reads what there is before an estimate is made.
pub(crate) async fn before(write: &mut Write, job: JobId) -> Result<Before, StoreError> {
    let row = write
        .ask("SELECT l.*, j.frames_total, j.state FROM jobs j LEFT JOIN live_forecasts l ON l.job_id = j.id WHERE j.id = ?")
        .bind(job.0)
        .first_row()
        .await?
        .ok_or(StoreError::NotFound("job"))?;
    let estimate = match id_opt(&row, "plan_id")? {
        None => None,
        Some(plan) => Some(Kept {
            plan: PlanId(plan),
            baseline: Baseline {
                cpu_seconds: row.try_get("booked_cpu")?,
                rest: row.try_get("booked_rest")?,
                share: row.try_get("booked_share")?,
            },
            last: Last {
                at: time(&row, "updated_at")?,
                frames_done: whole(&row, "frames_done")?,
                frames_since: whole(&row, "frames_since")?,
                frames_total: whole(&row, "frames_total")?,
            },
            was_off: Off { cost: row.try_get("cost_is_off")?, finish: row.try_get("finish_is_off")? },
            cpu_seconds: json::<LiveForecast>(&row, "body")?.cpu_seconds,
        }),
    };
    Ok(Before { estimate, job_state: word(&row, "state")? })
}

/// Counts a finished frame that is left for the next estimate.
pub(super) fn count_frame(write: &mut Write, job: JobId) {
    write.later("UPDATE live_forecasts SET frames_since = frames_since + 1 WHERE job_id = ?").bind(job.0);
}

/// Keeps an estimate, as the newest and in the history.
pub(super) async fn keep(
    write: &mut Write,
    job: JobId,
    plan: PlanId,
    baseline: &Baseline,
    live: &LiveForecast,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO live_forecasts (job_id, plan_id, booked_cpu, booked_rest, booked_share, frames_done, cost_is_off, finish_is_off, body, updated_at) \
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (job_id) DO UPDATE SET plan_id = excluded.plan_id, \
         booked_cpu = excluded.booked_cpu, booked_rest = excluded.booked_rest, booked_share = excluded.booked_share, \
         frames_done = excluded.frames_done, frames_since = 0, cost_is_off = excluded.cost_is_off, finish_is_off = excluded.finish_is_off, \
         body = excluded.body, updated_at = excluded.updated_at",
    )
    .bind(job.0)
    .bind(plan.0)
    .bind(baseline.cpu_seconds)
    .bind(baseline.rest)
    .bind(baseline.share)
    .bind(live.frames_done)
    .bind(live.cost_is_off)
    .bind(live.finish_is_off)
    .bind(to_json(live)?)
    .bind(live.at.micros())
    .execute(write.connection().await?)
    .await?;
    let points: i64 = sqlx::query_scalar("SELECT count(*) FROM forecast_history WHERE job_id = ?")
        .bind(job.0)
        .fetch_one(write.connection().await?)
        .await?;
    if points >= MOST_POINTS {
        sqlx::query(
            "DELETE FROM forecast_history WHERE job_id = ?1 AND point IN (SELECT point FROM \
             (SELECT point, row_number() OVER (ORDER BY point) AS place FROM forecast_history WHERE job_id = ?1) WHERE place % 2 = 0)",
        )
        .bind(job.0)
        .execute(write.connection().await?)
        .await?;
    }
    sqlx::query(
        "INSERT INTO forecast_history (job_id, point, body) \
         VALUES (?1, (SELECT ifnull(max(point) + 1, 0) FROM forecast_history WHERE job_id = ?1), ?2)",
    )
    .bind(job.0)
    .bind(to_json(&HistoryPoint::of(live))?)
    .execute(write.connection().await?)
    .await?;
    Ok(())
}
