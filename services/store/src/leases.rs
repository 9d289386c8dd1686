//! Leases: who works on what, and for how long. Who is given what is in `claims`.
//!
//! The state machine of a task and of its leases:
//!
//! ```text
//! task    waiting ──what it waits for is committed──► ready
//!         ready ──claim──► leased ──commit──► done
//!           ▲                │ ├──error (on the third node, or permanent), tenth expiry──► failed (and with it the job)
//!           └─release, error,┘ └──job cancelled or failed──► cancelled
//!             expiry, taken away
//! lease   active ──► committed | failed | expired | released | revoked
//! ```
//!
//! Hazards, and what guards against them:
//!
//! * *A worker is paused for a minute, loses its lease, wakes up and reports.* Its task may have been done by another
//!   worker by now. Every hand-out raises the task's `fence`; the database holds one active lease per task, with the
//!   newest fence; what is said with another is refused ([`StoreError::LeaseLost`]) and changes nothing.
//! * *The answer to a result is lost, and the worker sends it again.* The lease is `committed` then; the same
//!   result is answered as a duplicate, another one is a conflict. The first commit wins for good.
//! * *The service was down for longer than a lease lasts.* The workers could not renew, and would all lose hours of
//!   work. So time alone ends no lease: the sweep does, in a transaction, and a service that starts gives every lease
//!   one more term before its first sweep ([`Store::extend_leases_after_start`]).
//! * *The job was cancelled while a worker renders it.* The lease is `revoked`: renewals answer with the order to stop.
//! * *A task kills every worker that touches it.* Expiries are counted: the tenth fails the job. A worker that can say
//!   what went wrong says so; what follows from that is in `failures`.
//! * *The clock is set.* While the service runs, the caller's clock is steady, and says by how much the other one was set
//!   ([`Store::clock_was_set`]). If it was set while the service was down, every lease has exactly one more term all the same.

use std::time::Duration;

use forelight_protocol::{
    Event, EventKind, FinishedPixels, JobId, JobState, LeaseId, LeaseOrder, NodeId, RenewRequest, Renewal,
    TaskId, TaskKind, TaskSpec, Timestamp,
};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::database::Write;
use crate::decode::{id, json, whole, whole_opt, word};
use crate::events::{append, event, forget_old_progress};
use crate::idempotency::forget_old;
use crate::live::{self, Occasion};
use crate::logs::forget_old_logs;
use crate::policy::availability::{Opening, opening};
use crate::policy::retries::{LONGEST_WAIT, job_error_of_lost_workers};
use crate::{Store, StoreError, jobs, logs, nodes};

/// Progress is recorded as an event in steps of a hundredth: a worker that renews twice a second must not fill the disk.
const PROGRESS_STEP: f64 = 0.01;

/// What a lease is about.
#[derive(Clone, PartialEq, Debug)]
pub struct LeaseInfo {
    /// The job.
    pub job_id: JobId,
    /// The task.
    pub task_id: TaskId,
    /// The node that holds or held it.
    pub node_id: NodeId,
    /// Its fencing token.
    pub fence: u64,
    /// What is to be done.
    pub spec: TaskSpec,
}

/// What a sweep did.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Swept {
    /// Leases that had run out.
    pub expired: u32,
    /// Jobs that failed because a task lost its worker too often.
    pub jobs_failed: u32,
}

/// A lease as the functions of this crate see it.
pub(crate) struct LeaseRow {
    pub id: LeaseId,
    pub state: LeaseState,
    pub fence: u64,
    pub node_id: NodeId,
    /// Speed of the node for work like the job's when it was leased: a CPU second there is this many on a node of speed 1.
    pub node_speed: f64,
    pub task_id: TaskId,
    pub job_id: JobId,
    pub kind: TaskKind,
    pub frame: Option<u32>,
    pub failures: u32,
    pub expiries: u32,
    pub progress: f64,
    pub job_state: JobState,
    /// What the operator wants of the node.
    pub pause: bool,
    pub drain: bool,
    /// Whether there is anything by which the node might sleep.
    pub has_calendar: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum LeaseState {
    Active,
    Committed,
    Failed,
    Expired,
    Released,
    Revoked,
}

/// Whether there is anything by which a node, `n`, might sleep.
macro_rules! has_calendar {
    () => {
        "(coalesce(n.schedule_set, n.schedule) IS NOT NULL OR n.terms <> '{}') AS has_calendar"
    };
}
pub(crate) use has_calendar;

macro_rules! select_leases {
    ($rest:literal) => {
        concat!(
            "SELECT l.id, l.state, l.fence, l.node_id, l.node_speed, l.task_id, t.job_id, t.kind, t.frame, t.failures, \
             t.expiries, t.progress, (SELECT j.state FROM jobs j WHERE j.id = t.job_id) AS job_state, n.pause, n.drain, ",
            has_calendar!(),
            " FROM leases l JOIN tasks t ON t.id = l.task_id \
             JOIN nodes n ON n.id = l.node_id ",
            $rest
        )
    };
}

impl Store {
    /// A worker is still at it: its lease ends `ttl` from now. What it says is kept, and it is told what its operator wants.
    pub async fn renew(
        &self,
        lease: LeaseId,
        renewal: &RenewRequest,
        ttl: Duration,
        now: Timestamp,
    ) -> Result<Renewal, StoreError> {
        let &RenewRequest { fence, progress, pixels, paused, ref log } = renewal;
        let mut write = self.write().await?;
        let row = read_in(&mut write, lease).await?;
        let sleep_until = sleep_of(write.connection().await?, row.node_id, row.has_calendar, now).await?;
        if row.fence == fence && row.state == LeaseState::Revoked {
            return Ok(Renewal { expires_at: now, order: LeaseOrder::Stop, drain: row.drain, sleep_until });
        }
        if row.fence != fence || row.state != LeaseState::Active {
            return self.refuse(write, &row, now).await;
        }
        let expires_at = now.plus_micros(i64::try_from(ttl.as_micros()).unwrap_or(i64::MAX));
        write
            .later("UPDATE leases SET expires_at = ?, paid_until = NULL WHERE id = ?")
            .bind(expires_at.micros())
            .bind(lease.0);
        write
            .later("UPDATE nodes SET last_seen_at = max(last_seen_at, ?), paused = ? WHERE id = ?")
            .bind(now.micros())
            .bind(paused)
            .bind(row.node_id.0);
        if progress >= row.progress + PROGRESS_STEP || (progress == 1.0 && row.progress < 1.0) {
            write.later("UPDATE tasks SET progress = ? WHERE id = ?").bind(progress).bind(row.task_id.0);
            append(
                &mut write,
                Event { progress: Some(progress), ..row.event(EventKind::TaskProgress, now) },
            )?;
        }
        if let Some(FinishedPixels { done, all, work, cpu_nanos }) = pixels.filter(|pixels| pixels.all > 0) {
            write
                .later("UPDATE tasks SET pixels_share = ?, pixels_work = ?, pixels_cpu = ? WHERE id = ?")
                .bind((done as f64 / all as f64).min(1.0))
                .bind(work as f64)
                .bind(cpu_nanos as f64 * 1e-9 * row.node_speed)
                .bind(row.task_id.0);
            live::update(&mut write, row.job_id, Occasion::Meanwhile, now).await?;
        }
        logs::keep(&mut write, &row, log).await?;
        self.commit(write).await?;
        let order = if row.pause { LeaseOrder::Pause } else { LeaseOrder::Continue };
        Ok(Renewal { expires_at, order, drain: row.drain, sleep_until })
    }

    /// A worker gives its task back unfinished. Counts neither as an error nor as an expiry. A lease that was released
    /// or revoked before is a lease given back: nothing to do.
    pub async fn release(&self, lease: LeaseId, fence: u64, now: Timestamp) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        let row = read_in(&mut write, lease).await?;
        if row.fence == fence && matches!(row.state, LeaseState::Released | LeaseState::Revoked) {
            return Ok(());
        }
        if row.fence != fence || row.state != LeaseState::Active {
            return self.refuse(write, &row, now).await;
        }
        end(&mut write, &row, "released", now);
        back_to_ready(&mut write, &row, None);
        append(&mut write, row.event(EventKind::LeaseReleased, now))?;
        self.commit(write).await
    }

    /// What a lease is about, whatever became of it.
    pub async fn lease(&self, lease: LeaseId) -> Result<LeaseInfo, StoreError> {
        let row = sqlx::query(
            "SELECT l.fence, l.node_id, l.task_id, t.job_id, t.spec FROM leases l JOIN tasks t ON t.id = l.task_id WHERE l.id = ?",
        )
        .bind(lease.0)
        .fetch_optional(self.readers())
        .await?
        .ok_or(StoreError::NotFound("lease"))?;
        Ok(LeaseInfo {
            job_id: JobId(id(&row, "job_id")?),
            task_id: TaskId(id(&row, "task_id")?),
            node_id: NodeId(id(&row, "node_id")?),
            fence: whole(&row, "fence")?,
            spec: json(&row, "spec")?,
        })
    }

    /// Takes back the tasks whose leases have run out, makes estimates again that do not know of all frames, and forgets what is kept for a
    /// limited time only.
    pub async fn sweep(&self, now: Timestamp) -> Result<Swept, StoreError> {
        let mut write = self.write().await?;
        let swept = sweep(&mut write, now).await?;
        nodes::stop_after_windows(&mut write, now).await?;
        live::catch_up(&mut write, now).await?;
        forget_old(&mut write, now).await?;
        forget_old_progress(&mut write, now).await?;
        forget_old_logs(&mut write, now).await?;
        self.commit(write).await?;
        self.forget_checkpoints().await?;
        Ok(swept)
    }

    /// Gives every active lease one more term, from now. Called once when a service starts, before anything is swept:
    /// that nobody could renew while it was down is not the workers' fault. Nor does a lease last any longer because the clock was set
    /// back in the meantime; tasks that wait after a failure wait no longer than they would at most. A worker that is not heard of any more is
    /// paid until its lease would have run out.
    pub async fn extend_leases_after_start(&self, ttl: Duration, now: Timestamp) -> Result<u64, StoreError> {
        let until = now.plus_micros(i64::try_from(ttl.as_micros()).unwrap_or(i64::MAX));
        self.set_up_since(now);
        let mut write = self.write().await?;
        let extended = sqlx::query(
            "UPDATE leases SET paid_until = min(coalesce(paid_until, expires_at), ?1), expires_at = ?2 WHERE state = 'active'",
        )
        .bind(now.micros())
        .bind(until.micros())
        .execute(write.connection().await?)
        .await?;
        sqlx::query("UPDATE tasks SET not_before = ?1 WHERE state = 'ready' AND not_before > ?1")
            .bind(now.plus_micros(LONGEST_WAIT).micros())
            .execute(write.connection().await?)
            .await?;
        self.commit(write).await?;
        Ok(extended.rows_affected())
    }

    /// The clock was set forward by so many microseconds (back, if negative): what was to end in a minute still does.
    pub async fn clock_was_set(&self, micros: i64) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        for moved in [
            "UPDATE leases SET expires_at = expires_at + ?1, paid_until = paid_until + ?1 WHERE state = 'active'",
            "UPDATE tasks SET not_before = max(1, not_before + ?) WHERE state = 'ready' AND not_before > 0",
            // A node that was heard of in what is now the future would look alive for as long.
            "UPDATE nodes SET last_seen_at = last_seen_at + ?1 WHERE ?1 < 0",
            // What runs is paid for the time that it took, not for that which the clock went.
            "UPDATE ledger SET from_at = from_at + ? WHERE until_at IS NULL",
            "UPDATE tasks SET started_at = started_at + ? WHERE state = 'leased'",
        ] {
            sqlx::query(moved).bind(micros).execute(write.connection().await?).await?;
        }
        self.set_up_since(self.up_since().plus_micros(micros));
        self.commit(write).await
    }

    /// Refuses a worker that does not hold its lease any more, and remembers that it tried.
    pub(crate) async fn refuse<T>(
        &self,
        mut write: Write,
        row: &LeaseRow,
        now: Timestamp,
    ) -> Result<T, StoreError> {
        append(&mut write, row.event(EventKind::LeaseLost, now))?;
        self.commit(write).await?;
        Err(StoreError::LeaseLost)
    }
}

impl LeaseRow {
    pub(crate) fn event(&self, kind: EventKind, now: Timestamp) -> Event {
        Event {
            job_id: Some(self.job_id),
            task_id: Some(self.task_id),
            task_kind: Some(self.kind),
            frame: self.frame,
            node_id: Some(self.node_id),
            ..event(kind, now)
        }
    }
}

/// A node of which nobody knows when it wakes up asks again after a day.
const ASLEEP_FOR_LONG: i64 = 24 * 3_600_000_000;

/// Until when a node sleeps. One without a calendar, as most are, is not read for it: every heartbeat asks.
pub(crate) async fn sleep_of(
    connection: &mut SqliteConnection,
    node: NodeId,
    has_calendar: bool,
    now: Timestamp,
) -> Result<Option<Timestamp>, StoreError> {
    if !has_calendar {
        return Ok(None);
    }
    Ok(match opening(&nodes::read(connection, node).await?, now) {
        Opening::Awake(_) => None,
        Opening::Asleep(until) => Some(until.unwrap_or(now.plus_micros(ASLEEP_FOR_LONG))),
    })
}

/// Takes back the tasks whose leases have run out.
pub(crate) async fn sweep(write: &mut Write, now: Timestamp) -> Result<Swept, StoreError> {
    let ran_out =
        select_leases!("WHERE l.state = 'active' AND l.expires_at <= ? ORDER BY l.expires_at, l.id");
    let rows = write.ask(ran_out).bind(now.micros()).rows().await?;
    let mut swept = Swept::default();
    for row in rows {
        let row = decode(&row)?;
        // An earlier row of this sweep may have failed the job, and with it revoked this lease.
        if read_in(write, row.id).await?.state != LeaseState::Active {
            continue;
        }
        end(write, &row, "expired", now);
        append(write, row.event(EventKind::LeaseExpired, now))?;
        swept.expired += 1;
        let expiries = row.expiries + 1;
        sqlx::query("UPDATE tasks SET expiries = ? WHERE id = ?")
            .bind(expiries)
            .bind(row.task_id.0)
            .execute(write.connection().await?)
            .await?;
        match job_error_of_lost_workers(expiries) {
            Some(error) => {
                fail_for_good(write, &row, &error, now).await?;
                swept.jobs_failed += 1;
            }
            None => back_to_ready(write, &row, None),
        }
    }
    Ok(swept)
}

pub(crate) fn back_to_ready(write: &mut Write, row: &LeaseRow, error: Option<&str>) {
    write
        .later("UPDATE tasks SET state = 'ready', progress = 0, node_id = NULL, error = coalesce(?, error) WHERE id = ? AND state = 'leased'")
        .bind(error.map(str::to_owned))
        .bind(row.task_id.0);
    write.made_work = true;
}

pub(crate) async fn fail_for_good(
    write: &mut Write,
    row: &LeaseRow,
    error: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE tasks SET state = 'failed', error = ?, finished_at = ? WHERE id = ?")
        .bind(error)
        .bind(now.micros())
        .bind(row.task_id.0)
        .execute(write.connection().await?)
        .await?;
    jobs::fail_for_task(write, row.job_id, (row.kind, row.frame), error, now).await
}

/// Until when a lease is paid for of whose worker nothing is heard, at this instant.
macro_rules! paid_until {
    ($now:literal) => {
        concat!("coalesce(paid_until, min(", $now, ", expires_at))")
    };
}
pub(crate) use paid_until;

/// Ends an active lease.
pub(crate) fn end(write: &mut Write, row: &LeaseRow, state: &'static str, now: Timestamp) {
    let unheard = ["expired", "revoked"].contains(&state);
    write
        .later(if unheard {
            concat!(
                "UPDATE leases SET state = ?, ended_at = ",
                paid_until!("?"),
                " WHERE id = ? AND state = 'active'"
            )
        } else {
            "UPDATE leases SET state = ?, ended_at = ? WHERE id = ? AND state = 'active'"
        })
        .bind(state)
        .bind(now.micros())
        .bind(row.id.0);
}

/// Takes back the tasks of these leases: they are ready for another, and the next renewal brings each worker the order to stop.
pub(crate) async fn take_back(
    write: &mut Write,
    leases: Vec<uuid::Uuid>,
    now: Timestamp,
) -> Result<(), StoreError> {
    for lease in leases {
        let row = read_in(write, LeaseId(lease)).await?;
        end(write, &row, "revoked", now);
        back_to_ready(write, &row, None);
        append(write, row.event(EventKind::LeaseReleased, now))?;
    }
    Ok(())
}

/// Says that a node, if it is there, was heard of.
pub(crate) fn touch(write: &mut Write, node: NodeId, now: Timestamp) {
    write
        .later("UPDATE nodes SET last_seen_at = max(last_seen_at, ?) WHERE id = ?")
        .bind(now.micros())
        .bind(node.0);
}

const BY_ID: &str = select_leases!("WHERE l.id = ?");

pub(crate) async fn read(connection: &mut SqliteConnection, lease: LeaseId) -> Result<LeaseRow, StoreError> {
    let row = sqlx::query(BY_ID).bind(lease.0).fetch_optional(connection).await?;
    decode(&row.ok_or(StoreError::NotFound("lease"))?)
}

/// As [`read`], inside a write.
pub(crate) async fn read_in(write: &mut Write, lease: LeaseId) -> Result<LeaseRow, StoreError> {
    let row = write.ask(BY_ID).bind(lease.0).first_row().await?;
    decode(&row.ok_or(StoreError::NotFound("lease"))?)
}

fn decode(row: &SqliteRow) -> Result<LeaseRow, StoreError> {
    Ok(LeaseRow {
        id: LeaseId(id(row, "id")?),
        state: word(row, "state")?,
        fence: whole(row, "fence")?,
        node_id: NodeId(id(row, "node_id")?),
        node_speed: row.try_get("node_speed")?,
        task_id: TaskId(id(row, "task_id")?),
        job_id: JobId(id(row, "job_id")?),
        kind: word(row, "kind")?,
        frame: whole_opt(row, "frame")?,
        failures: whole(row, "failures")?,
        expiries: whole(row, "expiries")?,
        progress: row.try_get("progress")?,
        job_state: word(row, "job_state")?,
        pause: row.try_get("pause")?,
        drain: row.try_get("drain")?,
        has_calendar: row.try_get("has_calendar")?,
    })
}
