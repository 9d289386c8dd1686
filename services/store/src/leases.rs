//! Leases: which worker holds which task, and for how long. `claims` hands tasks out.
//!
//! The state machine of a task and of its leases:
//!
//! ```text
//! task    waiting ──what it waits for is committed──► ready
//!         ready ──claim──► leased ──commit──► done
//!           ▲                │ ├──error that others share, 10th expiry──► failed with its job
//!           └─release, error,┘ └──job cancelled or failed──► cancelled
//!             expiry, taken away
//! lease   active ──► committed | failed | expired | released | revoked
//! ```
//!
//! Hazards, and what guards against them:
//!
//! * *A worker is paused for a minute, loses its lease, wakes up and reports.* Another worker may have done
//!   its task by then. Every hand-out raises the task's fencing token. A report with another token is refused
//!   ([`StoreError::LeaseLost`]) and changes nothing.
//! * *The answer to a result is lost, and the worker sends it again.* The lease is `committed` then. The same
//!   result is answered as a duplicate; another one is a conflict. The first commit is final.
//! * *The service was down for longer than a lease lasts.* All workers would lose hours of work. So time
//!   alone ends no lease: the sweep does. A service that starts first gives every lease one more term
//!   ([`Store::extend_leases_after_start`]).
//! * *The job was cancelled while a worker renders it.* The lease is `revoked`: renewals answer with the
//!   order to stop.
//! * *A task kills every worker that touches it.* Other nodes get it first, and the tenth loss fails the job.
//! * *A worker renews its lease and does nothing.* The task is leased a second time, beside the first lease,
//!   under a higher fencing token. The first result is committed, and the other lease is `revoked`. Both are
//!   paid for. The database allows no third. See [`overdue`].
//! * *The clock is set.* While the service runs, its own clock is steady, and [`Store::clock_was_set`]
//!   corrects times. If the clock was set while the service was down, every lease still has exactly one more
//!   term.

pub(crate) mod checkpoints;
pub(crate) mod failing;
pub(crate) mod logs;
pub(crate) mod losing;
pub(crate) mod overdue;
pub(crate) mod renewing;
pub(crate) mod state;
pub(crate) mod sweeping;

use forelight_protocol::{
    Event, EventKind, JobId, JobState, LeaseId, NodeId, OWN_RENDERER, TaskId, TaskKind, TaskSpec, Timestamp,
};
use sqlx::{FromRow, SqliteConnection};

use self::state::LeaseState;
use crate::columns::{Id, Time, Word};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::events::{append, event};
use crate::writing::later;

/// The task of a lease, and its holder.
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
    /// The task's specification.
    pub spec: TaskSpec,
}

/// A lease as the functions of this crate see it.
#[derive(FromRow)]
pub(crate) struct LeaseRow {
    #[sqlx(try_from = "Id")]
    pub id: LeaseId,
    #[sqlx(try_from = "Word<LeaseState>")]
    pub state: LeaseState,
    pub fence: u64,
    #[sqlx(try_from = "Id")]
    pub node_id: NodeId,
    /// Speed of the node for the job's classes of work when the lease began, relative to speed 1.
    pub node_speed: f64,
    #[sqlx(try_from = "Time")]
    pub granted_at: Timestamp,
    /// Whether it was interrupted: its node was paused, or the service was down.
    pub is_interrupted: bool,
    #[sqlx(try_from = "Id")]
    pub task_id: TaskId,
    #[sqlx(try_from = "Id")]
    pub job_id: JobId,
    #[sqlx(try_from = "Word<TaskKind>")]
    pub kind: TaskKind,
    pub frame: Option<u32>,
    pub part: Option<u32>,
    /// The renderer that a node must have for the task. `None`: any version of our own.
    pub renderer: Option<String>,
    pub failures: u32,
    pub expiries: u32,
    /// Of this attempt.
    pub progress: f64,
    #[sqlx(try_from = "Word<JobState>")]
    pub job_state: JobState,
    /// The operator's orders for the node.
    pub pause: bool,
    pub drain: bool,
    /// Whether the node has a schedule or terms, so that it may sleep.
    pub has_calendar: bool,
    /// Whether the task is run a second time beside this lease, or beside which this one runs.
    pub has_another: bool,
    /// Whether the task's frame is divided into parts.
    pub is_divided: bool,
    /// Into how many parts the worker is to divide what it has not begun.
    pub divide_rest: Option<u32>,
}

impl LeaseRow {
    /// Whether a renderer other than our own does the task.
    pub(crate) fn is_of_another_renderer(&self) -> bool {
        let name = self.renderer.as_deref().and_then(|renderer| renderer.split(' ').next());
        name.is_some_and(|name| name != OWN_RENDERER)
    }
}

/// A statement for rows of leases. It is composed, so it is not checked at compile time: the same text is run
/// by itself and as a question after deferred statements.
macro_rules! select_leases {
    ($rest:literal) => {
        concat!(
            "SELECT l.id, l.state, l.fence, l.node_id, l.node_speed, l.granted_at, l.counts_from IS NOT NULL AS is_interrupted, \
             l.task_id, t.job_id, t.kind, t.frame, t.part, t.renderer, t.failures, \
             t.expiries, l.progress, l.divide_rest, (SELECT j.state FROM jobs j WHERE j.id = t.job_id) AS job_state, n.pause, n.drain, \
             (coalesce(n.schedule_set, n.schedule) IS NOT NULL OR n.terms <> '{}') AS has_calendar, \
             EXISTS (SELECT 1 FROM leases o WHERE o.task_id = t.id AND o.state = 'active' AND o.id <> l.id) \
             AS has_another, coalesce((SELECT f.parts > 1 FROM frames f WHERE f.job_id = t.job_id AND f.frame = t.frame), 0) \
             AS is_divided \
             FROM leases l JOIN tasks t ON t.id = l.task_id JOIN nodes n ON n.id = l.node_id ",
            $rest
        )
    };
}

impl Store {
    /// The task of a lease, in any state of the lease.
    pub async fn lease(&self, lease: LeaseId) -> Result<LeaseInfo> {
        let lease = sqlx::query_as!(
            LeaseInfo,
            "SELECT l.fence, l.node_id, l.task_id, t.job_id, t.spec FROM leases l \
             JOIN tasks t ON t.id = l.task_id WHERE l.id = ?",
            lease.0
        )
        .fetch_optional(self.readers())
        .await?;
        lease.ok_or(StoreError::NotFound("lease"))
    }

    /// The node that holds or held a lease.
    pub async fn lease_holder(&self, lease: LeaseId) -> Result<NodeId> {
        let node = sqlx::query_scalar!("SELECT node_id FROM leases WHERE id = ?", lease.0);
        let node = node.fetch_optional(self.readers()).await?;
        Ok(node.ok_or(StoreError::NotFound("lease"))?.into())
    }

    /// Refuses a worker that no longer holds its lease, and records the attempt.
    pub(crate) async fn refuse<T>(&self, mut write: Write, row: &LeaseRow, now: Timestamp) -> Result<T> {
        append(&mut write, row.event(EventKind::LeaseLost, now));
        self.commit(write).await?;
        Err(StoreError::LeaseLost)
    }
}

pub(crate) async fn ran_out(write: &mut Write, now: Timestamp, most: u32) -> Result<Vec<LeaseRow>> {
    let ran_out =
        select_leases!("WHERE l.state = 'active' AND l.expires_at <= ? ORDER BY l.expires_at, l.id LIMIT ?");
    Ok(sqlx::query_as(ran_out).bind(now.micros()).bind(most).fetch_all(write.connection().await?).await?)
}

impl LeaseRow {
    pub(crate) fn event(&self, kind: EventKind, now: Timestamp) -> Event {
        Event {
            job_id: Some(self.job_id),
            task_id: Some(self.task_id),
            task_kind: Some(self.kind),
            frame: self.frame,
            part: self.part,
            node_id: Some(self.node_id),
            ..event(kind, now)
        }
    }
}

/// Makes the task of an ended lease ready again, or leaves it to another attempt that goes on.
pub(crate) fn back_to_ready(write: &mut Write, row: &LeaseRow, error: Option<&str>) {
    later!(
        write,
        "UPDATE tasks SET state = 'ready', progress = 0, node_id = NULL, again = 0, error = coalesce(?, error) \
         WHERE id = ? AND state = 'leased' \
         AND NOT EXISTS (SELECT 1 FROM leases WHERE task_id = tasks.id AND state = 'active')",
        error,
        row.task_id.0
    );
    later!(
        write,
        "UPDATE tasks SET (node_id, started_at, progress) = (SELECT node_id, granted_at, progress FROM leases \
         WHERE task_id = tasks.id AND state = 'active' ORDER BY fence DESC LIMIT 1) \
         WHERE id = ? AND state = 'leased'",
        row.task_id.0
    );
    write.made_work = true;
}

/// Ends an active lease. If its worker fell silent, it is paid only until it expired.
pub(crate) fn end(write: &mut Write, row: &LeaseRow, state: &'static str, now: Timestamp) {
    let (now, lease) = (now.micros(), row.id.0);
    if ["expired", "revoked"].contains(&state) {
        later!(
            write,
            "UPDATE leases SET state = ?, ended_at = coalesce(paid_until, min(?, expires_at)) \
             WHERE id = ? AND state = 'active'",
            state,
            now,
            lease
        );
    } else {
        later!(
            write,
            "UPDATE leases SET state = ?, ended_at = ? WHERE id = ? AND state = 'active'",
            state,
            now,
            lease
        );
    }
}

/// The leases that a node holds.
pub(crate) async fn active_leases_of(write: &mut Write, node: NodeId) -> Result<Vec<LeaseId>> {
    let held = sqlx::query_scalar!(
        "SELECT id FROM leases WHERE node_id = ? AND state = 'active' ORDER BY id",
        node.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    Ok(held.into_iter().map(LeaseId::from).collect())
}

/// Takes back the tasks of these leases. They are ready again; the next renewal tells each worker to stop.
pub(crate) async fn take_back(
    write: &mut Write,
    leases: impl IntoIterator<Item = LeaseId>,
    now: Timestamp,
) -> Result<()> {
    for lease in leases {
        let row = read_in(write, lease).await?;
        end(write, &row, "revoked", now);
        back_to_ready(write, &row, None);
        append(write, row.event(EventKind::LeaseReleased, now));
    }
    Ok(())
}

/// Takes a task back from every worker that has it.
pub(crate) async fn take_task_back(write: &mut Write, task: Id, now: Timestamp) -> Result<()> {
    let held = sqlx::query_scalar!(
        "SELECT id FROM leases WHERE task_id = ? AND state = 'active' ORDER BY fence",
        task
    )
    .fetch_all(write.connection().await?)
    .await?;
    take_back(write, held.into_iter().map(LeaseId::from), now).await
}

/// Records that a node, if it exists, was heard of.
pub(crate) fn touch(write: &mut Write, node: NodeId, now: Timestamp) {
    later!(write, "UPDATE nodes SET last_seen_at = max(last_seen_at, ?) WHERE id = ?", now.micros(), node.0);
}

const BY_ID: &str = select_leases!("WHERE l.id = ?");

pub(crate) async fn read(connection: &mut SqliteConnection, lease: LeaseId) -> Result<LeaseRow> {
    let row = sqlx::query_as(BY_ID).bind(lease.0).fetch_optional(connection).await?;
    row.ok_or(StoreError::NotFound("lease"))
}

/// As [`read`], inside a write.
pub(crate) async fn read_in(write: &mut Write, lease: LeaseId) -> Result<LeaseRow> {
    let row = write.ask(BY_ID).bind(lease.0).first_row().await?;
    row.ok_or(StoreError::NotFound("lease"))
}
