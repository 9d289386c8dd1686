//! Outlooks of booked jobs: why they wait, and the state of their promises.

use forelight_protocol::{
    BudgetHold, Event, FinishQuantiles, Job, JobId, JobState, Promise, Timestamp, Waits,
};
use serde::{Deserialize, Serialize};
use sqlx::SqliteConnection;

use crate::columns::{Json, Time};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::events::{append, event};
use crate::jobs;
use crate::policy::projection::{JobEnds, rounded_up};
use crate::policy::rebooking::promise_news;
use crate::writing::{later, run};

/// Why a job waits, and the state of its promise.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct JobOutlook {
    /// Why it has not begun.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waits: Option<Waits>,
    /// The state of its promise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub promise: Option<Promise>,
    /// How its end varies in the scenarios of the plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finish: Option<FinishSpread>,
    /// Probability that it meets its deadline. `None` without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// What the budget of its project is expected to hold back.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget_hold: Option<BudgetHold>,
    /// Of a quote on hold: the time until its end if it were accepted now, in microseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub takes: Option<i64>,
}

/// A budget that was expected to hold a job so long ago, and does not, lasts longer than expected: ten minutes, in
/// microseconds.
const HOLD_BEGINS_WITHIN: i64 = 600_000_000;

impl Store {
    /// The jobs with a quote that waits to be accepted, newest first, at most `limit`.
    pub async fn held_quotes(&self, limit: u32) -> Result<Vec<JobId>> {
        let ids = sqlx::query_scalar!(
            "SELECT id FROM jobs WHERE state = 'quoted' AND hold = 1 ORDER BY id DESC LIMIT ?",
            limit
        )
        .fetch_all(self.readers())
        .await?;
        Ok(ids.into_iter().map(JobId::from).collect())
    }

    /// Keeps the outlooks of quotes on hold. Those of jobs that were accepted meanwhile are dropped.
    pub async fn keep_quotes_outlooks(&self, outlooks: &[(JobId, JobOutlook)], now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        for outlook in outlooks {
            if jobs::state(write.connection().await?, outlook.0).await? == JobState::Quoted {
                keep(&mut write, &[outlook], now).await?;
            }
        }
        self.commit(write).await
    }

    /// The promises that the newest plan keeps, of booked jobs: each with the job's name and deadline.
    pub async fn kept_promises(&self) -> Result<Vec<(JobId, String, Timestamp)>> {
        let rows = sqlx::query!(
            r#"SELECT id, name, deadline_at AS "deadline!: Time" FROM jobs INDEXED BY jobs_open
               WHERE stage IN ('previewing', 'profiling', 'booked', 'rendering')
               AND state IN ('booked', 'rendering') AND deadline_at IS NOT NULL
               AND json_extract(outlook, '$.promise.kept') = 1"#
        )
        .fetch_all(self.readers())
        .await?;
        Ok(rows.into_iter().map(|row| (row.id.into(), row.name, row.deadline.into())).collect())
    }

    /// Names of booked jobs that are said to be held by a budget, where that should have begun some time ago, or is
    /// over.
    pub async fn past_budget_holds(&self, now: Timestamp) -> Result<Vec<String>> {
        let rows = sqlx::query!(
            r#"SELECT name, outlook FROM jobs INDEXED BY jobs_open
               WHERE stage IN ('previewing', 'profiling', 'booked', 'rendering')
               AND state IN ('booked', 'rendering') AND json_extract(outlook, '$.budget_hold') IS NOT NULL"#
        )
        .fetch_all(self.readers())
        .await?;
        let is_past = |hold: &BudgetHold| {
            hold.until.is_some_and(|until| until <= now) || hold.from.plus_micros(HOLD_BEGINS_WITHIN) <= now
        };
        let past = rows.into_iter().filter(|row| row.outlook.0.budget_hold.as_ref().is_some_and(is_past));
        Ok(past.map(|row| row.name).collect())
    }

    /// Fills in when jobs are expected to end, by the expected ends of the open bookings.
    pub async fn tell_ends(&self, jobs: &mut [Job], ends: &JobEnds, now: Timestamp) -> Result<()> {
        let mut transaction = self.read().await?;
        for job in jobs {
            tell_ends(&mut transaction, job, ends, now).await?;
        }
        Ok(())
    }
}

async fn tell_ends(
    connection: &mut SqliteConnection,
    job: &mut Job,
    ends: &JobEnds,
    now: Timestamp,
) -> Result<()> {
    if job.state.is_final() {
        return Ok(());
    }
    let outlook = sqlx::query_scalar!("SELECT outlook FROM jobs WHERE id = ?", job.id.0)
        .fetch_optional(connection)
        .await?;
    outlook.ok_or(StoreError::NotFound("job"))?.0.expected().tell(job, ends, now);
    Ok(())
}

/// What an outlook says of a job's end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Expected {
    finish: Option<FinishSpread>,
    takes: Option<i64>,
}

impl JobOutlook {
    pub(crate) fn expected(&self) -> Expected {
        Expected { finish: self.finish, takes: self.takes }
    }
}

impl Expected {
    /// Fills in when a job that is not over is expected to end, and how that varies.
    pub fn tell(self, job: &mut Job, ends: &JobEnds, now: Timestamp) {
        let planned = match self.takes.filter(|_| job.state == JobState::Quoted) {
            Some(_) if job.paused => None,
            Some(takes) => Some(rounded_up(now.plus_micros(takes), now)),
            None => ends.eta(job),
        };
        job.eta = match &job.budget_hold {
            Some(hold) => planned.and_then(|planned| hold.end(planned)),
            None => planned,
        };
        job.finish = job.eta.zip(self.finish).map(|(end, spread)| spread.around(end, now));
    }
}

/// How an end varies in the scenarios of a plan: quantiles less the planned end, in microseconds. Between two
/// plans, the expected end moves, and this stays.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct FinishSpread {
    /// Median.
    pub p50: i64,
    /// 80 % quantile.
    pub p80: i64,
    /// 95 % quantile.
    pub p95: i64,
}

impl FinishSpread {
    /// The quantiles around an expected end, none of them past, rounded up.
    pub(crate) fn around(self, end: Timestamp, now: Timestamp) -> FinishQuantiles {
        let at = |by: i64| rounded_up(end.plus_micros(by).max(now), now);
        FinishQuantiles { p50: at(self.p50), p80: at(self.p80), p95: at(self.p95) }
    }
}

/// The spread of the farm's last end in the newest plan; `None` before the first.
pub(crate) async fn of_farm(connection: &mut SqliteConnection) -> Result<Option<FinishSpread>> {
    let kept = sqlx::query_scalar!(r#"SELECT body AS "body: Json<FinishSpread>" FROM farm_outlook"#)
        .fetch_optional(connection)
        .await?;
    Ok(kept.map(|it| it.0))
}

/// Keeps the spread of the farm's last end.
pub(crate) async fn keep_of_farm(write: &mut Write, finish: Option<FinishSpread>) -> Result<()> {
    let Some(finish) = finish else { return Ok(()) };
    run!(
        write,
        "INSERT INTO farm_outlook (one, body) VALUES (1, ?) ON CONFLICT DO UPDATE SET body = excluded.body",
        Json(finish)
    );
    Ok(())
}

/// Keeps the outlooks of jobs, and writes an event for each promise that broke or is kept again.
pub(crate) async fn keep(write: &mut Write, outlooks: &[&(JobId, JobOutlook)], now: Timestamp) -> Result<()> {
    for (job, outlook) in outlooks {
        let row = sqlx::query!("SELECT outlook, state FROM jobs WHERE id = ?", job.0)
            .fetch_optional(write.connection().await?)
            .await?;
        let row = row.ok_or(StoreError::NotFound("job"))?;
        let before = row.outlook.0;
        // A job that ended meanwhile has no outlook.
        if before == *outlook || row.state.0.is_final() {
            continue;
        }
        later!(write, "UPDATE jobs SET outlook = ? WHERE id = ?", Json(outlook.clone()), job.0);
        let Some((kind, message)) = promise_news(before.promise.as_ref(), outlook.promise.as_ref()) else {
            continue;
        };
        let (promise, message) = (outlook.promise.clone(), Some(message));
        append(write, Event { job_id: Some(*job), promise, message, ..event(kind, now) });
    }
    Ok(())
}
