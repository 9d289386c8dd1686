//! The ledger: what was paid for each lease. Triggers write it (`migrations/0003_budgets.sql`), so what was paid is known
//! whatever way a lease ends.

use forelight_protocol::{JobId, LedgerLine, Money, NodeId, Timestamp};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::database::Store;
use crate::decode::{id, time, time_opt};
use crate::error::StoreError;
use crate::policy::budgets as policy;

impl Store {
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

fn lines(rows: &[SqliteRow]) -> Result<Vec<LedgerLine>, StoreError> {
    rows.iter().map(line).collect()
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
pub(crate) async fn spent(
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

/// What the frames that a project has running are expected to cost from now on, at the median of their forecasts.
pub(crate) async fn committed(
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
