//! Shared by the steps of a claim: the claiming node, and how a statement finds a task for it.

use forelight_protocol::{ByClass, JobState, Node, TaskLimits, TaskSpec, Timestamp};
use sqlx::query::QueryAs;
use sqlx::sqlite::SqliteArguments;
use sqlx::{FromRow, Sqlite, SqliteConnection};

use crate::columns::{Id, Json, Word};
use crate::error::Result;
use crate::policy::retries::HEAD_START;

/// A task that a node may be given.
#[derive(FromRow)]
pub(crate) struct OfferedTask {
    pub id: Id,
    pub job_id: Id,
    pub spec: Json<TaskSpec>,
    pub limits: Json<TaskLimits>,
    pub fence: i64,
    pub job_state: Word<JobState>,
    pub work_by_class: Option<Json<ByClass>>,
    /// Whether the task is run a second time, beside an attempt that makes no progress.
    #[sqlx(default)]
    pub is_again: bool,
    /// Whether the task is booked on another node and not free for every node.
    #[sqlx(default)]
    pub is_booked_elsewhere: bool,
}

/// A task for a node, or the reason why it gets none although there is work.
#[derive(Default)]
pub(crate) struct Offer {
    pub task: Option<OfferedTask>,
    /// For people. `None` if there is a task, or no work for any node.
    pub idle_reason: Option<String>,
}

impl From<Option<OfferedTask>> for Offer {
    fn from(task: Option<OfferedTask>) -> Self {
        Self { task, idle_reason: None }
    }
}

/// The claiming node and the time of the claim.
pub(crate) struct Asking<'a> {
    pub node: &'a Node,
    pub now: Timestamp,
    /// When the service started: no node could be heard of before.
    pub up_since: Timestamp,
    /// How much of each booked job the node does until its window ends, see [`at_most`](super::at_most).
    pub at_most: Option<String>,
}

impl Asking<'_> {
    /// The first task of a query. `?1` to `?4` are the node, now, since when a node that failed may have the
    /// task again, and the limits of the node's window. `more` binds further parameters.
    pub(crate) async fn first(
        &self,
        connection: &mut SqliteConnection,
        query: &'static str,
        more: impl FnOnce(Query) -> Query,
    ) -> Result<Option<OfferedTask>> {
        let common = sqlx::query_as(query)
            .bind(self.node.id.0)
            .bind(self.now.micros())
            .bind(self.now.plus_micros(-HEAD_START).micros())
            .bind(self.at_most.clone());
        Ok(more(common).fetch_optional(connection).await?)
    }
}

/// A query that parameters are bound to.
pub(crate) type Query = QueryAs<'static, Sqlite, OfferedTask, SqliteArguments>;

/// Whether the node probably ends a task before its window does: a frame, or its part of one. All others are short.
macro_rules! ends_in_time {
    () => {
        "(?4 IS NULL OR (SELECT CASE tasks.kind WHEN 'render_part' THEN f.cpu_p95 * ifnull(tasks.share, 1.0 / f.parts) \
         WHEN 'render' THEN iif(f.parts = 1, f.cpu_p95, NULL) END \
         FROM frames f WHERE f.job_id = tasks.job_id AND f.frame = tasks.frame) \
         > ?4 ->> ('$.\"' || hex(tasks.job_id) || '\"') IS NOT TRUE)"
    };
}
pub(crate) use ends_in_time;

/// A statement for the first task, by an index, that meets a condition and that the node `?1` may have now.
/// The node must have the task's renderer.
///
/// Such statements are composed of shared pieces, so they are not checked at compile time. Tests run each of
/// them and examine its query plan.
macro_rules! next_task {
    ($index:literal, $which:literal, $order:literal) => {
        $crate::claims::asking::next_task!("id", $index, $which, $order)
    };
    ($columns:expr, $index:literal, $which:literal, $order:literal) => {
        concat!(
            "SELECT ",
            $columns,
            " FROM tasks INDEXED BY ",
            $index,
            " WHERE state = 'ready' AND ",
            $which,
            " AND held = 0 AND not_before <= ?2 AND (renderer IS NULL OR renderer IN (SELECT value FROM \
             json_each((SELECT renderers FROM nodes WHERE id = ?1)))) AND (failures + expiries = 0 OR not_before <= ?3 OR NOT EXISTS \
             (SELECT 1 FROM leases f WHERE f.task_id = tasks.id AND f.state IN ('failed', 'expired') AND f.node_id = ?1 \
             AND NOT f.alone)) AND ",
            $crate::claims::asking::ends_in_time!(),
            " ORDER BY ",
            $order,
            " LIMIT 1"
        )
    };
}
pub(crate) use next_task;

/// A statement for the first stalled task that the node `?1` may run a second time: it has its renderer, and
/// has not tried it.
macro_rules! next_stalled_task {
    () => {
        concat!(
            "SELECT id FROM tasks INDEXED BY tasks_again WHERE state = 'leased' AND again = 1 AND held = 0 AND \
         (renderer IS NULL OR renderer IN (SELECT value FROM json_each((SELECT renderers FROM nodes WHERE id = ?1)))) \
         AND NOT EXISTS (SELECT 1 FROM leases f WHERE f.task_id = tasks.id AND f.node_id = ?1 \
         AND f.state IN ('active', 'failed')) AND ",
            $crate::claims::asking::ends_in_time!(),
            " ORDER BY due_at, priority DESC, job_id, frame LIMIT 1"
        )
    };
}
pub(crate) use next_stalled_task;

/// The columns of an [`OfferedTask`].
macro_rules! task_columns {
    () => {
        "id, job_id, spec, limits, fence, (SELECT j.state FROM jobs j WHERE j.id = tasks.job_id) AS job_state, \
         (SELECT j.work_by_class FROM jobs j WHERE j.id = tasks.job_id) AS work_by_class"
    };
}
pub(crate) use task_columns;

/// The next task that is booked on the node `?5`.
pub(crate) const NEXT_BOOKED: &str = next_task!(
    task_columns!(),
    "tasks_ready_booked",
    "kind IN ('cache_fill', 'render_part', 'render') AND booked_node = ?5",
    "booked_at, job_id, frame, part"
);
