//! Budgets, the ledger that they are held against, and what was said of nights to come.
//!
//! The ledger has a row for each lease, written by triggers (`migrations/0003_budgets.sql`): what was paid for is known whatever way a lease
//! ends. A budget that is used up holds its project's tasks back: they stay `ready`, and `held` keeps them from being handed out.
//!
//! An action, once in force, stays so until its period is over or the budget is set again. Without that, stopping what runs would free what was
//! committed for it, and so start it again.

use std::collections::BTreeSet;

use forelight_protocol::{
    Budget, BudgetAction, BudgetForecast, BudgetRequest, Event, EventKind, Job, JobId, JobState, LedgerLine,
    Money, NodeId, Timestamp,
};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::database::Write;
use crate::decode::{corrupt, id, json, time, time_opt, to_json, word};
use crate::events::{append, event};
use crate::policy::budgets as policy;
use crate::{JobForecast, Store, StoreError, jobs, leases, progress, replans};

/// A job that is booked and not done, with what its forecast says.
#[derive(Clone, PartialEq, Debug)]
pub struct OpenJob {
    /// The job.
    pub job: Job,
    /// Its forecast; none before it is booked.
    pub forecast: Option<JobForecast>,
    /// CPU seconds of its frames that are not there yet, at P50 and P80.
    pub frames: Vec<(u32, f64, f64)>,
    /// Its project's budget holds it back.
    pub held: bool,
}

/// A night that was forecast.
#[derive(Clone, PartialEq, Debug)]
pub struct KeptNight {
    /// First instant.
    pub from: Timestamp,
    /// The instant after the last.
    pub until: Timestamp,
    /// What was said.
    pub forecast: BudgetForecast,
}

/// A budget as it is kept.
struct Kept {
    request: BudgetRequest,
    action: Option<BudgetAction>,
    period_at: Option<Timestamp>,
    updated_at: Timestamp,
}

impl Store {
    /// Sets a budget; one of the same project and period is replaced, and what it had in force is over. The time zone must be known.
    pub async fn set_budget(&self, request: &BudgetRequest, now: Timestamp) -> Result<Budget, StoreError> {
        let mut write = self.write().await?;
        sqlx::query(
            "INSERT INTO budgets (project, period, amount, zone, thresholds, updated_at) VALUES (?, ?, ?, ?, ?, ?) \
             ON CONFLICT (project, period) DO UPDATE SET amount = excluded.amount, zone = excluded.zone, \
             thresholds = excluded.thresholds, updated_at = excluded.updated_at, action = NULL, period_at = NULL",
        )
        .bind(&request.project)
        .bind(request.period.name())
        .bind(request.amount.0)
        .bind(&request.zone)
        .bind(to_json(&request.thresholds)?)
        .bind(now.micros())
        .execute(write.connection().await?)
        .await?;
        enforce(&mut write, now).await?;
        let found = budgets(write.connection().await?, now)
            .await?
            .into_iter()
            .find(|budget| budget.project == request.project && budget.period == request.period);
        let budget = found.ok_or(StoreError::NotFound("budget"))?;
        self.commit(write).await?;
        Ok(budget)
    }

    /// All budgets and how they stand, by project and period.
    pub async fn budgets(&self, now: Timestamp) -> Result<Vec<Budget>, StoreError> {
        let mut transaction = self.read().await?;
        budgets(&mut transaction, now).await
    }

    /// Puts into force what spending calls for, and ends what is over. Writes only if something changes. Says how many budgets changed.
    pub async fn enforce_budgets(&self, now: Timestamp) -> Result<u32, StoreError> {
        // Most farms have no budget, and most of the time nothing changes: that is found without the write lock.
        let mut transaction = self.read().await?;
        let due = due(&mut transaction, now).await?;
        drop(transaction);
        if due.is_empty() {
            return Ok(0);
        }
        let mut write = self.write().await?;
        let changed = enforce(&mut write, now).await?;
        self.commit(write).await?;
        Ok(changed)
    }

    /// What was paid for between two instants, in the order of leases.
    pub async fn ledger(&self, from: Timestamp, until: Timestamp) -> Result<Vec<LedgerLine>, StoreError> {
        let rows = sqlx::query(concat!(
            "SELECT ",
            line_columns!(),
            " FROM ledger d JOIN leases l ON l.id = d.lease_id \
             WHERE d.from_at < ? AND (d.until_at IS NULL OR d.until_at > ?) ORDER BY d.from_at, d.lease_id"
        ))
        .bind(until.micros())
        .bind(from.micros())
        .fetch_all(self.readers())
        .await?;
        lines(&rows)
    }

    /// What a job's leases have cost so far, those that end at `now` and those that go on.
    pub async fn spent_on(&self, job: JobId, now: Timestamp) -> Result<Money, StoreError> {
        spent_on(&mut *self.readers().acquire().await?, job, now).await
    }

    /// The jobs that are neither done, failed nor cancelled, oldest first.
    pub async fn open_jobs(&self) -> Result<Vec<OpenJob>, StoreError> {
        let mut transaction = self.read().await?;
        let rows = sqlx::query(
            "SELECT * FROM jobs WHERE state IN ('previewing', 'profiling', 'booked', 'rendering') ORDER BY id",
        )
        .fetch_all(&mut *transaction)
        .await?;
        let mut open = Vec::with_capacity(rows.len());
        for row in &rows {
            let job_id = JobId(id(row, "id")?);
            let done = progress::of_job(&mut transaction, job_id).await?;
            let job = jobs::decode(row, done)?;
            let frames = sqlx::query(
                "SELECT frame, cpu_p50, cpu_p80 FROM frames WHERE job_id = ? AND finished_at IS NULL AND cpu_p50 IS NOT NULL \
                 ORDER BY frame",
            )
            .bind(job_id.0)
            .fetch_all(&mut *transaction)
            .await?;
            let held: bool =
                sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM tasks WHERE job_id = ? AND held = 1)")
                    .bind(job_id.0)
                    .fetch_one(&mut *transaction)
                    .await?;
            let is_booked = matches!(job.state, JobState::Booked | JobState::Rendering);
            open.push(OpenJob {
                forecast: if is_booked { crate::decode::json_opt(row, "forecast")? } else { None },
                frames: frames
                    .iter()
                    .map(|row| Ok((crate::decode::whole(row, "frame")?, row.try_get(1)?, row.try_get(2)?)))
                    .collect::<Result<_, StoreError>>()?,
                job,
                held,
            });
        }
        Ok(open)
    }

    /// Keeps what is said of a night, unless something was said before and the night is past its middle. One row a night, however often
    /// this is called.
    pub async fn keep_budget_forecast(&self, night: &KeptNight) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        let middle = night.from.plus_micros(night.until.micros_since(night.from) / 2);
        sqlx::query(
            "INSERT INTO budget_forecasts (date, zone, begin_at, end_at, made_at, body) VALUES (?1, ?2, ?3, ?4, ?5, ?6) \
             ON CONFLICT (date, zone) DO UPDATE SET made_at = excluded.made_at, body = excluded.body WHERE ?5 < ?7",
        )
        .bind(night.forecast.date.to_string())
        .bind(&night.forecast.zone)
        .bind(night.from.micros())
        .bind(night.until.micros())
        .bind(night.forecast.made_at.micros())
        .bind(to_json(&night.forecast)?)
        .bind(middle.micros())
        .execute(write.connection().await?)
        .await?;
        self.commit(write).await
    }

    /// The nights of a zone that were forecast and begin before an instant, newest first, at most `limit`.
    pub async fn budget_forecasts_before(
        &self,
        zone: &str,
        before: Timestamp,
        limit: u32,
    ) -> Result<Vec<KeptNight>, StoreError> {
        let rows = sqlx::query(
            "SELECT * FROM budget_forecasts WHERE zone = ? AND begin_at < ? ORDER BY begin_at DESC LIMIT ?",
        )
        .bind(zone)
        .bind(before.micros())
        .bind(limit)
        .fetch_all(self.readers())
        .await?;
        rows.iter()
            .map(|row| {
                Ok(KeptNight {
                    from: time(row, "begin_at")?,
                    until: time(row, "end_at")?,
                    forecast: json(row, "body")?,
                })
            })
            .collect()
    }
}

/// Columns of a line of the ledger. A worker that was not heard of since the service began again is paid until then, and no other longer than its
/// lease goes, unless it is renewed.
macro_rules! line_columns {
    () => {
        "d.*, coalesce(l.paid_until, CASE l.state WHEN 'active' THEN l.expires_at END) AS paid_until"
    };
}
use line_columns;

/// All lines of a job, each with what was done.
pub(crate) const LINES_OF_JOB: &str = concat!(
    "SELECT ",
    line_columns!(),
    ", t.kind, t.frame, l.state = 'active' AS is_active FROM tasks t JOIN leases l ON l.task_id = t.id JOIN ledger d ON d.lease_id = l.id WHERE t.job_id = ?"
);

pub(crate) fn line(row: &SqliteRow) -> Result<LedgerLine, StoreError> {
    Ok(LedgerLine {
        project: row.try_get("project")?,
        job_id: JobId(id(row, "job_id")?),
        node_id: NodeId(id(row, "node_id")?),
        price_per_hour: Money(row.try_get("price_per_hour")?),
        from: time(row, "from_at")?,
        until: time_opt(row, "until_at")?.or(time_opt(row, "paid_until")?),
    })
}

async fn kept(connection: &mut SqliteConnection) -> Result<Vec<Kept>, StoreError> {
    let rows = sqlx::query("SELECT * FROM budgets ORDER BY project, period").fetch_all(connection).await?;
    let decode = |row: &SqliteRow| {
        let action: Option<&str> = row.try_get("action")?;
        Ok(Kept {
            request: BudgetRequest {
                project: row.try_get("project")?,
                period: word(row, "period")?,
                amount: Money(row.try_get("amount")?),
                zone: row.try_get("zone")?,
                thresholds: json(row, "thresholds")?,
            },
            action: action.map(|_| word(row, "action")).transpose()?,
            period_at: time_opt(row, "period_at")?,
            updated_at: time(row, "updated_at")?,
        })
    };
    rows.iter().map(decode).collect()
}

async fn budgets(connection: &mut SqliteConnection, now: Timestamp) -> Result<Vec<Budget>, StoreError> {
    let mut found = Vec::new();
    for kept in kept(connection).await? {
        found.push(as_it_stands(connection, kept, now).await?);
    }
    Ok(found)
}

async fn as_it_stands(
    connection: &mut SqliteConnection,
    kept: Kept,
    now: Timestamp,
) -> Result<Budget, StoreError> {
    let Kept { request, action, period_at, updated_at } = kept;
    let BudgetRequest { project, period, amount, zone, thresholds } = request;
    let (from, until) =
        period.bounds(&zone, now).ok_or_else(|| corrupt("zone", format!("{zone} is no time zone")))?;
    let spent = spent(connection, &project, from, now).await?;
    let committed = committed(connection, &project, now).await?;
    let action = action.filter(|_| period_at == Some(from));
    Ok(Budget {
        project,
        period,
        amount,
        zone,
        thresholds,
        from,
        until,
        spent,
        committed,
        action,
        updated_at,
    })
}

/// What a job's leases cost, those that run up to now: its quote, its frames, and what was lost.
pub(crate) async fn spent_on(
    connection: &mut SqliteConnection,
    job: JobId,
    now: Timestamp,
) -> Result<Money, StoreError> {
    let rows = sqlx::query(LINES_OF_JOB).bind(job.0).fetch_all(connection).await?;
    Ok(policy::cost_since(&lines(&rows)?, Timestamp::from_micros(i64::MIN), now))
}

/// What a project's leases cost since an instant; those that run, up to now.
async fn spent(
    connection: &mut SqliteConnection,
    project: &str,
    from: Timestamp,
    now: Timestamp,
) -> Result<Money, StoreError> {
    let rows = sqlx::query(concat!(
        "SELECT ",
        line_columns!(),
        " FROM ledger d JOIN leases l ON l.id = d.lease_id \
         WHERE d.project = ? AND (d.until_at IS NULL OR d.until_at > ?)"
    ))
    .bind(project)
    .bind(from.micros())
    .fetch_all(connection)
    .await?;
    Ok(policy::cost_since(&lines(&rows)?, from, now))
}

fn lines(rows: &[SqliteRow]) -> Result<Vec<LedgerLine>, StoreError> {
    rows.iter().map(line).collect()
}

/// What the frames that a project has running are expected to cost from now on, at the median of their forecasts.
async fn committed(
    connection: &mut SqliteConnection,
    project: &str,
    now: Timestamp,
) -> Result<Money, StoreError> {
    let rows = sqlx::query(
        concat!("SELECT ", line_columns!(), ", f.cpu_p50, l.node_speed * n.cores AS rate FROM ledger d \
         JOIN leases l ON l.id = d.lease_id JOIN tasks t ON t.id = l.task_id JOIN nodes n ON n.id = d.node_id \
         JOIN frames f ON f.job_id = d.job_id AND f.frame = t.frame \
         WHERE d.project = ? AND d.until_at IS NULL AND t.kind = 'render' AND f.cpu_p50 IS NOT NULL"),
    )
    .bind(project)
    .fetch_all(connection)
    .await?;
    let mut sum = 0i64;
    for row in &rows {
        let (cpu, speed) = (row.try_get("cpu_p50")?, row.try_get("rate")?);
        sum = sum.saturating_add(policy::committed(&line(row)?, cpu, speed, now).0);
    }
    Ok(Money(sum))
}

/// The budgets of which something has to be written, as they stand, with the action that comes into force.
async fn due(
    connection: &mut SqliteConnection,
    now: Timestamp,
) -> Result<Vec<(Budget, Option<BudgetAction>)>, StoreError> {
    let mut due = Vec::new();
    for kept in kept(connection).await? {
        let written = (kept.action, kept.period_at);
        let budget = as_it_stands(connection, kept, now).await?;
        let action = policy::action(&budget);
        if policy::is_news(&budget, action, written) {
            due.push((budget, action));
        }
    }
    Ok(due)
}

async fn enforce(write: &mut Write, now: Timestamp) -> Result<u32, StoreError> {
    let due = due(write.connection().await?, now).await?;
    for (budget, action) in &due {
        sqlx::query("UPDATE budgets SET action = ?, period_at = ? WHERE project = ? AND period = ?")
            .bind(action.map(BudgetAction::name))
            .bind(action.map(|_| budget.from.micros()))
            .bind(&budget.project)
            .bind(budget.period.name())
            .execute(write.connection().await?)
            .await?;
        let message = policy::message(budget, *action);
        append(write, Event { message: Some(message), ..event(EventKind::Budget, now) })?;
    }
    // A budget that was just set again has no action in force, and may have had one.
    let kept = kept(write.connection().await?).await?;
    let in_force = policy::strongest(kept.into_iter().map(|kept| (kept.request.project, kept.action)));
    let held: Vec<String> = sqlx::query_scalar(
        "SELECT DISTINCT j.project FROM tasks t JOIN jobs j ON j.id = t.job_id WHERE t.held = 1",
    )
    .fetch_all(write.connection().await?)
    .await?;
    let held: BTreeSet<String> = held.into_iter().collect();
    for (project, action) in in_force {
        match action {
            Some(BudgetAction::Drain | BudgetAction::Stop) => {
                hold(write, &project).await?;
                if action == Some(BudgetAction::Stop) {
                    stop(write, &project, now).await?;
                }
            }
            _ if held.contains(&project) => {
                let_go(write, &project).await?;
                write.made_work = true;
            }
            _ => {}
        }
    }
    Ok(u32::try_from(due.len()).unwrap_or(u32::MAX))
}

/// Keeps a project's tasks from being handed out.
async fn hold(write: &mut Write, project: &str) -> Result<(), StoreError> {
    let held = sqlx::query(
        "UPDATE tasks SET held = 1 WHERE held = 0 AND state IN ('waiting', 'ready', 'leased') AND job_id IN (SELECT id FROM jobs WHERE project = ?)",
    )
    .bind(project)
    .execute(write.connection().await?)
    .await?;
    // Plans say what waits, and why.
    if held.rows_affected() > 0 {
        replans::want(write, &format!("the budget of project {project} holds its tasks")).await?;
    }
    Ok(())
}

/// Lets a project's tasks be handed out again; what ended meanwhile is not held either.
async fn let_go(write: &mut Write, project: &str) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE tasks SET held = 0 WHERE held = 1 AND job_id IN (SELECT id FROM jobs WHERE project = ?)",
    )
    .bind(project)
    .execute(write.connection().await?)
    .await?;
    replans::want(write, &format!("the budget of project {project} holds its tasks no more")).await?;
    Ok(())
}

/// Takes back what a project has running: the next renewal brings the order to stop, and the task goes back, held.
async fn stop(write: &mut Write, project: &str, now: Timestamp) -> Result<(), StoreError> {
    let running = sqlx::query_scalar(
        "SELECT l.id FROM leases l JOIN tasks t ON t.id = l.task_id JOIN jobs j ON j.id = t.job_id \
         WHERE l.state = 'active' AND j.project = ? ORDER BY l.id",
    )
    .bind(project)
    .fetch_all(write.connection().await?)
    .await?;
    leases::take_back(write, running, now).await
}
