//! Leases: who works on what, and for how long.
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
    Event, EventKind, FinishedPixels, JobId, JobState, Lease, LeaseId, LeaseOrder, Node, NodeId,
    RenewRequest, Renewal, TaskId, TaskKind, TaskSpec, Timestamp,
};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::database::Write;
use crate::decode::{id, json, whole, whole_opt, word};
use crate::events::{append, event, forget_old_progress, job_state};
use crate::failures::{HEAD_START, LONGEST_WAIT};
use crate::idempotency::{Answered, IdempotencyKey, earlier_answer, forget_old, record};
use crate::live::{self, Occasion};
use crate::logs::forget_old_logs;
use crate::schedule::{Opening, opening};
use crate::{Store, StoreError, jobs, logs, nodes};

/// Lost workers of a task that its job survives, plus one. More than errors: machines are switched off at night.
pub const MAX_EXPIRIES: u32 = 10;

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
    pub node_speed: f64,
    pub task_id: TaskId,
    pub job_id: JobId,
    pub kind: TaskKind,
    pub frame: Option<u32>,
    pub failures: u32,
    pub expiries: u32,
    pub progress: f64,
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

macro_rules! has_calendar {
    () => {
        "(coalesce(n.schedule_set, n.schedule) IS NOT NULL OR n.terms <> '{}') AS has_calendar"
    };
}

macro_rules! select_leases {
    ($rest:literal) => {
        concat!(
            "SELECT l.id, l.state, l.fence, l.node_id, l.node_speed, l.task_id, t.job_id, t.kind, t.frame, t.failures, \
             t.expiries, t.progress, n.pause, n.drain, ",
            has_calendar!(),
            " FROM leases l JOIN tasks t ON t.id = l.task_id \
             JOIN nodes n ON n.id = l.node_id ",
            $rest
        )
    };
}

impl Store {
    /// Hands the node its next task, if there is one and the node is not draining. Sweeps first, so that a task whose
    /// worker is gone can be handed out at once. The node counts as heard of.
    pub async fn claim(
        &self,
        node: NodeId,
        ttl: Duration,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Option<Answered<Lease>>, StoreError> {
        self.hand_out(node, None, ttl, key, now).await
    }

    /// Hands the node exactly this task, whatever was planned for the node: nothing while another holds it, a
    /// [`StoreError::Conflict`] once it is over.
    pub async fn claim_task(
        &self,
        node: NodeId,
        task: TaskId,
        ttl: Duration,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Option<Answered<Lease>>, StoreError> {
        self.hand_out(node, Some(task), ttl, key, now).await
    }

    async fn hand_out(
        &self,
        node: NodeId,
        wanted: Option<TaskId>,
        ttl: Duration,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Option<Answered<Lease>>, StoreError> {
        let mut write = self.write().await?;
        if let Some(answer) = earlier_answer(&mut write, key).await? {
            return Ok(Some(Answered::Repeated(answer)));
        }
        touch(&mut write, node, now).await?;
        sweep(&mut write, now).await?;
        let node = nodes::read(write.connection(), node).await?;
        let task = match wanted {
            Some(task) => this_task(write.connection(), task, now).await?,
            None if node.takes_tasks() => match opening(&node, now) {
                Opening::Awake(until) => next_task(write.connection(), &node, until, now).await?,
                Opening::Asleep(_) => None,
            },
            None => None,
        };
        let Some(task) = task else {
            self.commit(write).await?;
            return Ok(None);
        };
        let task_id = TaskId(id(&task, "id")?);
        let job_id = JobId(id(&task, "job_id")?);
        let spec: TaskSpec = json(&task, "spec")?;
        let fence: i64 = sqlx::query_scalar(
            "UPDATE tasks SET state = 'leased', fence = fence + 1, progress = 0, pixels_share = NULL, node_id = ?, started_at = ? \
             WHERE id = ? AND state = 'ready' RETURNING fence",
        )
        .bind(node.id.0)
        .bind(now.micros())
        .bind(task_id.0)
        .fetch_one(write.connection())
        .await?;
        let ttl_micros = i64::try_from(ttl.as_micros()).unwrap_or(i64::MAX);
        let lease = Lease {
            lease_id: LeaseId::new(),
            task_id,
            job_id,
            fence: fence.unsigned_abs(),
            expires_at: now.plus_micros(ttl_micros),
            ttl_ms: u64::try_from(ttl.as_millis()).unwrap_or(u64::MAX),
            spec,
            limits: json(&task, "limits")?,
        };
        sqlx::query(
            "INSERT INTO leases (id, task_id, node_id, fence, node_speed, state, granted_at, expires_at) \
             VALUES (?, ?, ?, ?, ?, 'active', ?, ?)",
        )
        .bind(lease.lease_id.0)
        .bind(task_id.0)
        .bind(node.id.0)
        .bind(fence)
        .bind(node.speed)
        .bind(now.micros())
        .bind(lease.expires_at.micros())
        .execute(write.connection())
        .await?;
        if lease.spec.kind().is_booked() {
            let first = sqlx::query("UPDATE jobs SET state = 'rendering' WHERE id = ? AND state = 'booked'")
                .bind(job_id.0)
                .execute(write.connection())
                .await?;
            if first.rows_affected() == 1 {
                job_state(&mut write, job_id, JobState::Rendering, None, now).await?;
            }
        }
        append(
            &mut write,
            Event {
                job_id: Some(job_id),
                task_id: Some(task_id),
                task_kind: Some(lease.spec.kind()),
                frame: lease.spec.frame(),
                node_id: Some(node.id),
                ..event(EventKind::TaskLeased, now)
            },
        )
        .await?;
        record(&mut write, key, 200, &lease, now).await?;
        self.commit(write).await?;
        Ok(Some(Answered::Fresh(lease)))
    }

    /// Whether a claim could find something: asked by those who wait, so that they need not take the write lock.
    pub async fn may_have_work(&self, now: Timestamp) -> Result<bool, StoreError> {
        Ok(sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM tasks WHERE state = 'ready' AND held = 0 AND not_before <= ?1) \
             OR EXISTS (SELECT 1 FROM leases WHERE state = 'active' AND expires_at <= ?1)",
        )
        .bind(now.micros())
        .fetch_one(self.readers())
        .await?)
    }

    /// Until when the node sleeps; `None` if it is awake.
    pub async fn sleeps_until(&self, node: NodeId, now: Timestamp) -> Result<Option<Timestamp>, StoreError> {
        let mut connection = self.readers().acquire().await?;
        let has_calendar = concat!("SELECT ", has_calendar!(), " FROM nodes n WHERE n.id = ?");
        let has_calendar: Option<bool> =
            sqlx::query_scalar(has_calendar).bind(node.0).fetch_optional(&mut *connection).await?;
        sleep_of(&mut connection, node, has_calendar.unwrap_or(false), now).await
    }

    /// A node that waits for work is alive.
    pub async fn touch_node(&self, node: NodeId, now: Timestamp) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        touch(&mut write, node, now).await?;
        self.commit(write).await
    }

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
        let row = read(write.connection(), lease).await?;
        if row.fence == fence && row.state == LeaseState::Revoked {
            let sleep_until = sleep_of(write.connection(), row.node_id, row.has_calendar, now).await?;
            return Ok(Renewal { expires_at: now, order: LeaseOrder::Stop, drain: row.drain, sleep_until });
        }
        if row.fence != fence || row.state != LeaseState::Active {
            return self.refuse(write, &row, now).await;
        }
        let expires_at = now.plus_micros(i64::try_from(ttl.as_micros()).unwrap_or(i64::MAX));
        sqlx::query("UPDATE leases SET expires_at = ? WHERE id = ?")
            .bind(expires_at.micros())
            .bind(lease.0)
            .execute(write.connection())
            .await?;
        sqlx::query("UPDATE nodes SET last_seen_at = max(last_seen_at, ?), paused = ? WHERE id = ?")
            .bind(now.micros())
            .bind(paused)
            .bind(row.node_id.0)
            .execute(write.connection())
            .await?;
        if progress >= row.progress + PROGRESS_STEP || (progress == 1.0 && row.progress < 1.0) {
            sqlx::query("UPDATE tasks SET progress = ? WHERE id = ?")
                .bind(progress)
                .bind(row.task_id.0)
                .execute(write.connection())
                .await?;
            append(&mut write, Event { progress: Some(progress), ..row.event(EventKind::TaskProgress, now) })
                .await?;
        }
        if let Some(FinishedPixels { done, all, work, cpu_nanos }) = pixels.filter(|pixels| pixels.all > 0) {
            sqlx::query("UPDATE tasks SET pixels_share = ?, pixels_work = ?, pixels_cpu = ? WHERE id = ?")
                .bind((done as f64 / all as f64).min(1.0))
                .bind(work as f64)
                .bind(cpu_nanos as f64 * 1e-9 * row.node_speed)
                .bind(row.task_id.0)
                .execute(write.connection())
                .await?;
            live::update(&mut write, row.job_id, Occasion::Pixels, now).await?;
        }
        logs::keep(&mut write, &row, log).await?;
        let sleep_until = sleep_of(write.connection(), row.node_id, row.has_calendar, now).await?;
        self.commit(write).await?;
        let order = if row.pause { LeaseOrder::Pause } else { LeaseOrder::Continue };
        Ok(Renewal { expires_at, order, drain: row.drain, sleep_until })
    }

    /// A worker gives its task back unfinished. Counts neither as an error nor as an expiry. A lease that was released
    /// or revoked before is a lease given back: nothing to do.
    pub async fn release(&self, lease: LeaseId, fence: u64, now: Timestamp) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        let row = read(write.connection(), lease).await?;
        if row.fence == fence && matches!(row.state, LeaseState::Released | LeaseState::Revoked) {
            return Ok(());
        }
        if row.fence != fence || row.state != LeaseState::Active {
            return self.refuse(write, &row, now).await;
        }
        end(&mut write, &row, "released", now).await?;
        back_to_ready(&mut write, &row, None).await?;
        append(&mut write, row.event(EventKind::LeaseReleased, now)).await?;
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

    /// Takes back the tasks whose leases have run out, and forgets what is kept for a limited time only.
    pub async fn sweep(&self, now: Timestamp) -> Result<Swept, StoreError> {
        let mut write = self.write().await?;
        let swept = sweep(&mut write, now).await?;
        nodes::stop_after_windows(&mut write, now).await?;
        forget_old(&mut write, now).await?;
        forget_old_progress(&mut write, now).await?;
        forget_old_logs(&mut write, now).await?;
        self.commit(write).await?;
        self.forget_checkpoints().await?;
        Ok(swept)
    }

    /// Gives every active lease one more term, from now. Called once when a service starts, before anything is swept:
    /// that nobody could renew while it was down is not the workers' fault. Nor does a lease last any longer because the clock was set
    /// back in the meantime; tasks that wait after a failure wait no longer than they would at most.
    pub async fn extend_leases_after_start(&self, ttl: Duration, now: Timestamp) -> Result<u64, StoreError> {
        let until = now.plus_micros(i64::try_from(ttl.as_micros()).unwrap_or(i64::MAX));
        let mut write = self.write().await?;
        let extended = sqlx::query("UPDATE leases SET expires_at = ? WHERE state = 'active'")
            .bind(until.micros())
            .execute(write.connection())
            .await?;
        sqlx::query("UPDATE tasks SET not_before = ?1 WHERE state = 'ready' AND not_before > ?1")
            .bind(now.plus_micros(LONGEST_WAIT).micros())
            .execute(write.connection())
            .await?;
        self.commit(write).await?;
        Ok(extended.rows_affected())
    }

    /// The clock was set forward by so many microseconds (back, if negative): what was to end in a minute still does.
    pub async fn clock_was_set(&self, micros: i64) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        sqlx::query("UPDATE leases SET expires_at = expires_at + ? WHERE state = 'active'")
            .bind(micros)
            .execute(write.connection())
            .await?;
        sqlx::query(
            "UPDATE tasks SET not_before = max(1, not_before + ?) WHERE state = 'ready' AND not_before > 0",
        )
        .bind(micros)
        .execute(write.connection())
        .await?;
        // A node that was heard of in what is now the future would look alive for as long.
        sqlx::query("UPDATE nodes SET last_seen_at = last_seen_at + ?1 WHERE ?1 < 0")
            .bind(micros)
            .execute(write.connection())
            .await?;
        self.commit(write).await
    }

    /// Refuses a worker that does not hold its lease any more, and remembers that it tried.
    pub(crate) async fn refuse<T>(
        &self,
        mut write: Write,
        row: &LeaseRow,
        now: Timestamp,
    ) -> Result<T, StoreError> {
        append(&mut write, row.event(EventKind::LeaseLost, now)).await?;
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
async fn sleep_of(
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

/// The task that the node should do next.
///
/// 1. Previews and profiles of any job, and plans and merges of irradiance caches: they are short, and every quote, and with it every
///    booking, waits for them. By priority, then deadline, then age of the job.
/// 2. The node's own bookings, earliest planned start first: frames, and parts of irradiance caches.
/// 3. Any of these, by the job's deadline, then priority, then age of the job, then frame: a node never
///    stands idle because a frame is booked on another that has not come to it yet.
///
/// Each of the three is one step into an index made for it, which is named because SQLite, left alone, prefers the index of
/// all ready tasks and sorts them.
///
/// A task that failed is passed over while it waits, and for a while longer on the nodes that it failed on. Such tasks are few, so
/// the steps over them are.
///
/// Before the node's window ends (`until`), frames are passed over that would not be done by then in one case of twenty.
async fn next_task(
    connection: &mut SqliteConnection,
    node: &Node,
    until: Option<Timestamp>,
    now: Timestamp,
) -> Result<Option<SqliteRow>, StoreError> {
    // CPU seconds of a node of speed 1 that this one has until then.
    let at_most =
        until.map(|until| until.micros_since(now).max(0) as f64 * 1e-6 * node.speed * f64::from(node.cores));
    for query in [NEXT_QUOTE, NEXT_BOOKED, NEXT_ANY] {
        let found = sqlx::query(query)
            .bind(node.id.0)
            .bind(now.micros())
            .bind(now.plus_micros(-HEAD_START).micros())
            .bind(at_most)
            .fetch_optional(&mut *connection)
            .await?;
        if found.is_some() {
            return Ok(found);
        }
    }
    Ok(None)
}

/// A task by its id, if it is ready; nothing while it is leased, or waits after a failure.
async fn this_task(
    connection: &mut SqliteConnection,
    task: TaskId,
    now: Timestamp,
) -> Result<Option<SqliteRow>, StoreError> {
    let row = sqlx::query("SELECT id, job_id, spec, limits, not_before, CASE WHEN state = 'ready' AND held THEN 'held back by a budget' ELSE state END AS state FROM tasks WHERE id = ?")
        .bind(task.0)
        .fetch_optional(connection)
        .await?
        .ok_or(StoreError::NotFound("task"))?;
    match row.try_get("state")? {
        "ready" => Ok((row.try_get::<i64, _>("not_before")? <= now.micros()).then_some(row)),
        "leased" | "waiting" => Ok(None),
        over => Err(StoreError::Conflict(format!("the task is {over}"))),
    }
}

macro_rules! next_task {
    ($index:literal, $which:literal, $order:literal) => {
        concat!(
            "SELECT id, job_id, spec, limits FROM tasks INDEXED BY ",
            $index,
            " WHERE state = 'ready' AND ",
            $which,
            " AND held = 0 AND not_before <= ?2 AND (failures = 0 OR not_before <= ?3 OR NOT EXISTS (SELECT 1 FROM leases f \
              WHERE f.task_id = tasks.id AND f.state = 'failed' AND f.node_id = ?1)) \
              AND (?4 IS NULL OR ?4 >= ifnull((SELECT cpu_p95 FROM frames WHERE job_id = tasks.job_id AND frame = tasks.frame), 0)) ORDER BY ",
            $order,
            " LIMIT 1"
        )
    };
}

pub(crate) const NEXT_QUOTE: &str = next_task!(
    "tasks_ready_quotes",
    "kind NOT IN ('cache_fill', 'render')",
    "priority DESC, due_at, job_id, frame"
);

pub(crate) const NEXT_BOOKED: &str = next_task!(
    "tasks_ready_booked",
    "kind IN ('cache_fill', 'render') AND booked_node = ?1",
    "booked_at, job_id, frame, part"
);

pub(crate) const NEXT_ANY: &str = next_task!(
    "tasks_ready_any",
    "kind IN ('cache_fill', 'render')",
    "due_at, priority DESC, job_id, frame, part"
);

/// Takes back the tasks whose leases have run out.
pub(crate) async fn sweep(write: &mut Write, now: Timestamp) -> Result<Swept, StoreError> {
    let rows = sqlx::query(select_leases!(
        "WHERE l.state = 'active' AND l.expires_at <= ? ORDER BY l.expires_at, l.id"
    ))
    .bind(now.micros())
    .fetch_all(write.connection())
    .await?;
    let mut swept = Swept::default();
    for row in rows {
        let row = decode(&row)?;
        // An earlier row of this sweep may have failed the job, and with it revoked this lease.
        if read(write.connection(), row.id).await?.state != LeaseState::Active {
            continue;
        }
        end(write, &row, "expired", now).await?;
        append(write, row.event(EventKind::LeaseExpired, now)).await?;
        swept.expired += 1;
        let expiries = row.expiries + 1;
        sqlx::query("UPDATE tasks SET expiries = ? WHERE id = ?")
            .bind(expiries)
            .bind(row.task_id.0)
            .execute(write.connection())
            .await?;
        if expiries >= MAX_EXPIRIES {
            let error = format!("{expiries} workers were lost on this task");
            fail_for_good(write, &row, &error, now).await?;
            swept.jobs_failed += 1;
        } else {
            back_to_ready(write, &row, None).await?;
        }
    }
    Ok(swept)
}

pub(crate) async fn back_to_ready(
    write: &mut Write,
    row: &LeaseRow,
    error: Option<&str>,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE tasks SET state = 'ready', progress = 0, node_id = NULL, error = coalesce(?, error) WHERE id = ? AND state = 'leased'",
    )
    .bind(error)
    .bind(row.task_id.0)
    .execute(write.connection())
    .await?;
    write.made_work = true;
    Ok(())
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
        .execute(write.connection())
        .await?;
    let of_frame = row.frame.map_or(String::new(), |frame| format!(" of frame {frame}"));
    jobs::fail(write, row.job_id, &format!("{}{of_frame}: {error}", row.kind), now).await
}

/// Ends an active lease.
pub(crate) async fn end(
    write: &mut Write,
    row: &LeaseRow,
    state: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE leases SET state = ?, ended_at = ? WHERE id = ? AND state = 'active'")
        .bind(state)
        .bind(now.micros())
        .bind(row.id.0)
        .execute(write.connection())
        .await?;
    Ok(())
}

pub(crate) async fn touch(write: &mut Write, node: NodeId, now: Timestamp) -> Result<(), StoreError> {
    let touched = sqlx::query("UPDATE nodes SET last_seen_at = max(last_seen_at, ?) WHERE id = ?")
        .bind(now.micros())
        .bind(node.0)
        .execute(write.connection())
        .await?;
    if touched.rows_affected() == 0 { Err(StoreError::NotFound("node")) } else { Ok(()) }
}

pub(crate) async fn read(connection: &mut SqliteConnection, lease: LeaseId) -> Result<LeaseRow, StoreError> {
    let row = sqlx::query(select_leases!("WHERE l.id = ?")).bind(lease.0).fetch_optional(connection).await?;
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
        pause: row.try_get("pause")?,
        drain: row.try_get("drain")?,
        has_calendar: row.try_get("has_calendar")?,
    })
}
