//! What an idle node may take of what is booked on others.
//!
//! The plan has put each frame where it costs least while the deadlines are kept. A node that stands idle beside it may cost more, so it takes a frame
//! from the node that has it booked only if the money that the plan meant to spend is not exceeded, or if there is a reason:
//!
//! * the job has neither a deadline nor a budget: nothing was weighed against the money, and sooner is better;
//! * the plan does not keep the job's deadline, or will not any more;
//! * the idle node is no dearer for an hour of such work than the node where the frame is booked;
//! * the frame should have begun [`OVERDUE`] ago, or is booked nowhere;
//! * the frame has failed on another node;
//! * the node where it is booked gets no tasks, or is lost.
//!
//! Otherwise the node waits, and says for what. Each question is a step into an index for each booked job, whatever number of frames it has;
//! the last one reads the farm's nodes once.

use forelight_protocol::{ByClass, JobId, JobVerdict, Money, Node, NodeId, Timestamp, Verdict};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::StoreError;
use crate::claims::{Asking, NEXT_BOOKED, Offer, Query, next_task, task_columns};
use crate::decode::{id, json, json_opt, time_opt, whole};
use crate::nodes::{SAME_SPEED, gone};
use crate::plans::JobOutlook;

/// A frame that has not begun so long after its planned start is for whoever is idle: a minute, in microseconds. Its node is late; plans are made of
/// longer stretches.
pub const OVERDUE: i64 = 60_000_000;

/// Thousandths of a micro-unit in a micro-unit.
const THOUSANDTHS: f64 = 1e3;

/// What an hour of a core of speed 1 of such work costs on the node, in thousandths of a micro-unit.
pub(crate) fn rate(node: &Node, work: Option<&ByClass>) -> i64 {
    let speed = node.speed_for(work) * f64::from(node.cores);
    // Speeds are above zero; what is beyond the range becomes its end.
    (node.price_per_hour.micro_units() as f64 * THOUSANDTHS / speed).round() as i64
}

/// A booked job that an idle node looks at.
struct Looked {
    id: JobId,
    name: String,
    due: i64,
    priority: i64,
    /// Whether any node may have any of its tasks.
    for_everybody: bool,
    /// What an hour of its work costs on the node that asks.
    rate: i64,
}

/// What the node may take of what is booked elsewhere, or why it takes nothing.
pub(crate) async fn offer(
    connection: &mut SqliteConnection,
    asking: &Asking<'_>,
) -> Result<Offer, StoreError> {
    let jobs = booked_jobs(connection, asking.node).await?;
    for job in &jobs {
        let found = if job.for_everybody {
            let of_job = |query: Query| query.bind(job.due).bind(job.priority).bind(job.id.0);
            asking.first(connection, NEXT_OF_JOB, of_job).await?
        } else {
            let overdue = asking.now.plus_micros(-OVERDUE).micros();
            let of_job = |query: Query| query.bind(job.id.0).bind(job.least_rate()).bind(overdue);
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

impl Looked {
    /// The node may have what is booked at this rate or a higher one. Measured speeds are never quite the same: two equal machines must help each other.
    fn least_rate(&self) -> i64 {
        (self.rate as f64 / (1.0 + SAME_SPEED)) as i64
    }

    /// Where a frame of the job is booked for less, in words.
    async fn why_not(&self, connection: &mut SqliteConnection) -> Result<Option<String>, StoreError> {
        let row = sqlx::query(
            "SELECT t.booked_rate, n.name FROM tasks t INDEXED BY tasks_ready_starts JOIN nodes n ON n.id = t.booked_node \
             WHERE t.state = 'ready' AND t.booked_rate IS NOT NULL AND t.job_id = ? AND t.held = 0 AND t.booked_rate < ? \
             ORDER BY t.booked_at, t.frame, t.part LIMIT 1",
        )
        .bind(self.id.0)
        .bind(self.least_rate())
        .fetch_optional(connection)
        .await?;
        row.map(|row| {
            let there: i64 = whole(&row, "booked_rate")?;
            let name: String = row.try_get("name")?;
            Ok(self.in_words(&name, there))
        })
        .transpose()
    }

    fn in_words(&self, node: &str, there: i64) -> String {
        let money = |rate: i64| Money((rate as f64 / THOUSANDTHS).round() as i64);
        format!(
            "cheaper to wait for {node}: an hour of a core of speed 1 of job {} costs {} there and {} here",
            self.name,
            money(there),
            money(self.rate)
        )
    }
}

/// The booked jobs in the order in which nodes help out: by deadline, then priority, then age.
async fn booked_jobs(connection: &mut SqliteConnection, node: &Node) -> Result<Vec<Looked>, StoreError> {
    let rows = sqlx::query(
        "SELECT id, name, deadline_at, budget, priority, verdict, outlook, work_by_class FROM jobs \
         WHERE state IN ('booked', 'rendering') ORDER BY coalesce(deadline_at, 9223372036854775807), priority DESC, id",
    )
    .fetch_all(connection)
    .await?;
    rows.iter().map(|row| decode(row, node)).collect()
}

fn decode(row: &SqliteRow, node: &Node) -> Result<Looked, StoreError> {
    let deadline = time_opt(row, "deadline_at")?;
    let work: Option<ByClass> = json_opt(row, "work_by_class")?;
    Ok(Looked {
        id: JobId(id(row, "id")?),
        name: row.try_get("name")?,
        due: deadline.map_or(i64::MAX, Timestamp::micros),
        priority: row.try_get("priority")?,
        for_everybody: !is_bounded(row)? || is_at_risk(row)?,
        rate: rate(node, work.as_ref()),
    })
}

/// Whether anything was weighed against the money of a job, by its row.
pub(crate) fn is_bounded(row: &SqliteRow) -> Result<bool, StoreError> {
    Ok(time_opt(row, "deadline_at")?.is_some() || row.try_get::<Option<i64>, _>("budget")?.is_some())
}

/// Whether the plan does not keep the job's deadline, or will not any more.
fn is_at_risk(row: &SqliteRow) -> Result<bool, StoreError> {
    let outlook: JobOutlook = json(row, "outlook")?;
    if let Some(promise) = outlook.promise {
        return Ok(!promise.kept);
    }
    let verdict: Option<JobVerdict> = json_opt(row, "verdict")?;
    Ok(verdict.is_some_and(|verdict| matches!(verdict.verdict, Verdict::Late | Verdict::Impossible)))
}

/// Where a task is booked: node, planned start, and what the plan pays there; see `0010_idle_nodes.sql`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slot {
    pub node: NodeId,
    pub start: Timestamp,
    pub rate: Option<i64>,
}

/// What plans pay for the work of one job, node by node.
pub(crate) struct Rates {
    work: Option<ByClass>,
    is_bounded: bool,
}

impl Rates {
    /// By the job's row.
    pub(crate) fn of(row: &SqliteRow) -> Result<Self, StoreError> {
        Ok(Self { work: json_opt(row, "work_by_class")?, is_bounded: is_bounded(row)? })
    }

    /// Read from the database.
    pub(crate) async fn read(connection: &mut SqliteConnection, job: JobId) -> Result<Self, StoreError> {
        let row = sqlx::query("SELECT deadline_at, budget, work_by_class FROM jobs WHERE id = ?")
            .bind(job.0)
            .fetch_optional(connection)
            .await?;
        Self::of(&row.ok_or(StoreError::NotFound("job"))?)
    }

    /// What is paid on this node; nothing that counts if the job is not bounded.
    pub(crate) fn on(&self, node: &Node) -> Option<i64> {
        self.is_bounded.then(|| rate(node, self.work.as_ref()))
    }
}

/// A job's first task: of any node, with its due time, priority and id as `?5` to `?7`.
pub(crate) const NEXT_OF_JOB: &str = next_task!(
    task_columns!(),
    "tasks_ready_any",
    "kind IN ('cache_fill', 'render') AND due_at = ?5 AND priority = ?6 AND job_id = ?7",
    "frame, part"
);

/// Of the job `?5`: what is booked dearest, if for `?6` or more; what should have begun by `?7`; what is booked nowhere; what has failed.
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
        "kind IN ('cache_fill', 'render') AND booked_node IS NULL AND booked_at IS NULL AND job_id = ?5",
        "frame, part"
    ),
    "), (",
    next_task!(
        "tasks_backing_off",
        "not_before > 0 AND kind IN ('cache_fill', 'render') AND failures > 0 AND job_id = ?5",
        "not_before"
    ),
    "))"
);
