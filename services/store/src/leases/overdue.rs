//! Running tasks that take longer than forecast. [`crate::policy::overdue`] says which.

use std::collections::BTreeSet;

use forelight_protocol::{Event, EventKind, JobId, LeaseId, TaskError, Timestamp};

use crate::columns::{Id, Time};
use crate::database::{Store, Write};
use crate::error::Result;
use crate::events::append;
use crate::jobs;
use crate::leases::failing::{Report, fail};
use crate::leases::read_in;
use crate::living::{self, Occasion};
use crate::plans::replans;
use crate::policy::overdue::{AttemptTimes, LEAST_LATE, Lateness};
use crate::writing::run;

/// An active lease that has shown nothing for a while.
struct Row {
    id: Id,
    job_id: Id,
    granted_at: Time,
    counts_from: Option<Time>,
    progress: f64,
    progress_at: Option<Time>,
    p95: Option<i64>,
    lateness: Option<String>,
    node: String,
    job: String,
}

/// Active leases whose tasks run: `running!("AND l.id = ?", lease.0)`.
macro_rules! running {
    ($rest:literal $(, $value:expr)* $(,)?) => {
        sqlx::query_as!(
            Row,
            "SELECT l.id, t.job_id, l.granted_at, l.counts_from, l.progress, l.progress_at, l.p95, l.lateness, \
             n.name AS node, j.name AS job FROM leases l JOIN tasks t ON t.id = l.task_id \
             JOIN nodes n ON n.id = l.node_id JOIN jobs j ON j.id = t.job_id \
             WHERE l.state = 'active' AND NOT n.paused " + $rest
            $(, $value)*
        )
    };
}

impl Row {
    /// How late it is, if that is news.
    fn news(&self, now: Timestamp) -> Option<Lateness> {
        let times = AttemptTimes::new(self.granted_at, self.counts_from, self.progress_at);
        let lateness = times.attempt(self.progress, self.p95).lateness(now);
        let is_known = match lateness {
            Lateness::OnTime => true,
            Lateness::Late => self.lateness.is_some(),
            Lateness::Stalled => self.lateness.as_deref() == Some("stalled"),
            Lateness::Over => false,
        };
        (!is_known).then_some(lateness)
    }
}

/// Tasks that are noted in one write. On a large farm, thousands may be late at once, and workers wait while
/// somebody writes.
const AT_ONCE: usize = 20;

impl Store {
    /// Notes which running tasks are late, has stalled ones run on another node as well, and ends leases that
    /// are beyond the farm's time limit.
    pub(crate) async fn look_at_running(&self, now: Timestamp) -> Result<()> {
        let since = now.plus_micros(-LEAST_LATE).micros();
        let rows = running!("AND l.granted_at < ? ORDER BY l.granted_at, l.id", since)
            .fetch_all(&mut *self.readers().acquire().await?)
            .await?;
        let due: Vec<LeaseId> =
            rows.into_iter().filter(|row| row.news(now).is_some()).map(|row| row.id.into()).collect();
        let mut late = BTreeSet::new();
        for part in due.chunks(AT_ONCE) {
            let mut write = self.write().await?;
            for lease in part {
                late.extend(look_at(&mut write, *lease, now).await?);
            }
            self.commit(write).await?;
        }
        // Once for all late tasks of a job: an estimate reads all its bookings.
        for job in late {
            let mut write = self.write().await?;
            living::update(&mut write, job, Occasion::Overdue, now).await?;
            self.commit(write).await?;
        }
        Ok(())
    }
}

/// Looks at one lease, as it is now. Returns its job if the job's estimate is to take note.
async fn look_at(write: &mut Write, lease: LeaseId, now: Timestamp) -> Result<Option<JobId>> {
    let row = running!("AND l.id = ?", lease.0).fetch_optional(write.connection().await?).await?;
    let Some((row, lateness)) = row.and_then(|row| row.news(now).map(|news| (row, news))) else {
        return Ok(None);
    };
    match lateness {
        Lateness::OnTime => Ok(None),
        Lateness::Over => end_for_time(write, lease, now).await.map(|()| None),
        Lateness::Stalled => stall(write, &row, now).await,
        Lateness::Late => {
            let message = format!("it takes longer on {} than in 19 of 20 cases", row.node);
            note(write, &row, ("late", EventKind::TaskLate, message), now).await
        }
    }
}

/// Has the task run on another node as well. Returns its job as [`look_at`] does.
async fn stall(write: &mut Write, row: &Row, now: Timestamp) -> Result<Option<JobId>> {
    run!(
        write,
        "UPDATE tasks SET again = 1 WHERE state = 'leased' AND id = (SELECT task_id FROM leases WHERE id = ?1) \
         AND 1 = (SELECT count(*) FROM leases WHERE task_id = tasks.id AND state = 'active')",
        row.id
    );
    write.made_work = true;
    let message = format!(
        "it makes no progress on {}; it is run on another node as well, the first result counts, and both are paid for",
        row.node
    );
    note(write, row, ("stalled", EventKind::TaskStalled, message), now).await
}

/// Says how late a task is, and has the plan take note. Returns its job as [`look_at`] does.
async fn note(
    write: &mut Write,
    row: &Row,
    (lateness, kind, message): (&'static str, EventKind, String),
    now: Timestamp,
) -> Result<Option<JobId>> {
    run!(write, "UPDATE leases SET lateness = ? WHERE id = ?", lateness, row.id);
    let lease = read_in(write, row.id.into()).await?;
    append(write, Event { message: Some(message), ..lease.event(kind, now) });
    let job: JobId = row.job_id.into();
    if jobs::state(write.connection().await?, job).await?.is_final() {
        // A video is made of a job that is done: no frame waits for it.
        return Ok(None);
    }
    replans::want(write, &format!("a task of job {} is {lateness} on {}", row.job, row.node)).await?;
    Ok(Some(job))
}

/// Ends a lease that is beyond the farm's time limit. The task is tried elsewhere.
async fn end_for_time(write: &mut Write, lease: LeaseId, now: Timestamp) -> Result<()> {
    let row = read_in(write, lease).await?;
    let message = "it took many times as long as forecast, so the farm ended it; \
                   a limit of its own (limits.wall_ms) says earlier when to end it";
    let error = TaskError { message: message.to_owned(), ..TaskError::default() };
    let report = Report { error: &error, fault: None };
    fail(write, &row, &report, now).await
}
