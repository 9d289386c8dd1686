//! Finds a task for an idle node among those that are booked on other nodes. [`crate::policy::work_stealing`]
//! says which it may take.
//!
//! Each query is one step into an index for each booked job, however many frames the job has. The last one
//! reads the farm's nodes once.

use forelight_protocol::{JobId, Money, Node, Timestamp};
use sqlx::SqliteConnection;

use crate::claims::asking::{Asking, NEXT_BOOKED, Offer, Query, next_task, task_columns};
use crate::error::Result;
use crate::nodes::gone;
use crate::policy::work_stealing::{OVERDUE, is_at_risk, is_bounded, least_rate, rate, reason_to_wait};

/// A booked job, as an idle node sees it.
struct BookedJob {
    id: JobId,
    name: String,
    due: i64,
    priority: i32,
    /// Whether any node may take any of its tasks.
    for_everybody: bool,
    /// Rate of its work on the idle node.
    rate: i64,
}

/// A task that is booked elsewhere and that the node may take, or why it takes none.
pub(crate) async fn offer(connection: &mut SqliteConnection, asking: &Asking<'_>) -> Result<Offer> {
    let jobs = booked_jobs(connection, asking.node).await?;
    for job in &jobs {
        let found = if job.for_everybody {
            let of_job = |query: Query| query.bind(job.due).bind(job.priority).bind(job.id.0);
            asking.first(connection, NEXT_OF_JOB, of_job).await?
        } else {
            let overdue = asking.now.plus_micros(-OVERDUE).micros();
            let of_job = |query: Query| query.bind(job.id.0).bind(least_rate(job.rate)).bind(overdue);
            asking.first(connection, NEXT_NO_DEARER, of_job).await?
        };
        if found.is_some() {
            return Ok(found.into());
        }
    }
    for node in gone(connection, asking.up_since, asking.now).await? {
        let found = asking.first(connection, NEXT_BOOKED, |query| query.bind(node.0)).await?;
        if found.is_some() {
            return Ok(found.into());
        }
    }
    for job in jobs.iter().filter(|job| !job.for_everybody) {
        let idle_reason = job.why_not(connection).await?;
        if idle_reason.is_some() {
            return Ok(Offer { task: None, idle_reason });
        }
    }
    Ok(Offer::default())
}

impl BookedJob {
    /// Why the node leaves the job to others: the node for which its next frame is booked more cheaply.
    /// `None` if there is none.
    async fn why_not(&self, connection: &mut SqliteConnection) -> Result<Option<String>> {
        let row = sqlx::query!(
            "SELECT t.booked_rate AS \"booked_rate!\", n.name FROM tasks t INDEXED BY tasks_ready_starts \
             JOIN nodes n ON n.id = t.booked_node WHERE t.state = 'ready' AND t.booked_rate IS NOT NULL \
             AND t.job_id = ? AND t.held = 0 AND t.booked_rate < ? \
             ORDER BY t.booked_at, t.frame, t.part LIMIT 1",
            self.id.0,
            least_rate(self.rate)
        )
        .fetch_optional(connection)
        .await?;
        Ok(row.map(|row| reason_to_wait(&self.name, &row.name, row.booked_rate, self.rate)))
    }
}

/// The booked jobs, in the order in which nodes help out: by deadline, then priority, then age.
async fn booked_jobs(connection: &mut SqliteConnection, node: &Node) -> Result<Vec<BookedJob>> {
    let rows = sqlx::query!(
        "SELECT id, name, deadline_at, budget, priority, verdict, outlook, work_by_class FROM jobs \
         WHERE state IN ('booked', 'rendering') ORDER BY coalesce(deadline_at, 9223372036854775807), \
         priority DESC, id"
    )
    .fetch_all(connection)
    .await?;
    Ok(rows
        .into_iter()
        .map(|row| {
            let work = row.work_by_class.map(|it| it.0);
            let verdict = row.verdict.map(|it| it.0);
            let outlook = row.outlook.0;
            // Dearer nodes would use up the rest of its project's budget sooner.
            let lacks_money = outlook.budget_hold.is_some();
            let deadline: Option<Timestamp> = row.deadline_at.map(Into::into);
            let is_bounded = is_bounded(deadline, row.budget.map(Money));
            BookedJob {
                id: row.id.into(),
                name: row.name,
                due: deadline.map_or(i64::MAX, Timestamp::micros),
                priority: row.priority,
                for_everybody: !is_bounded
                    || (is_at_risk(outlook.promise.as_ref(), verdict.as_ref()) && !lacks_money),
                rate: rate(node, work.as_ref()),
            }
        })
        .collect())
}

/// A job's first task, wherever it is booked. `?5` to `?7` are the job's due time, priority and id.
pub(crate) const NEXT_OF_JOB: &str = next_task!(
    task_columns!(),
    "tasks_ready_any",
    "kind IN ('cache_fill', 'render_part', 'render') AND due_at = ?5 AND priority = ?6 AND job_id = ?7",
    "frame, part"
);

/// A task of the job `?5`. The first that exists of: the one that is booked at the highest rate, if that is
/// at least `?6`; one that should have begun by `?7`; one without a booking; one that failed or lost its worker.
pub(crate) const NEXT_NO_DEARER: &str = concat!(
    "SELECT ",
    task_columns!(),
    " FROM tasks WHERE id = coalesce((",
    next_task!(
        "tasks_ready_rates",
        "booked_rate IS NOT NULL AND job_id = ?5 AND booked_rate >= ?6",
        "booked_rate DESC, frame, part"
    ),
    "), (",
    next_task!(
        "tasks_ready_starts",
        "booked_rate IS NOT NULL AND job_id = ?5 AND booked_at <= ?7",
        "booked_at, frame, part"
    ),
    "), (",
    next_task!(
        "tasks_ready_booked",
        "kind IN ('cache_fill', 'render_part', 'render') AND booked_node IS NULL AND booked_at IS NULL AND job_id = ?5",
        "frame, part"
    ),
    "), (",
    next_task!(
        "tasks_backing_off",
        "not_before > 0 AND kind IN ('cache_fill', 'render_part', 'render') AND failures + expiries > 0 AND job_id = ?5",
        "not_before"
    ),
    "))"
);
