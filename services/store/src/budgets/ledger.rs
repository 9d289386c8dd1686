//! The ledger: what was paid for each lease. Triggers write it (`migrations/0003_budgets.sql`), so payments
//! are known however a lease ends.

use std::collections::BTreeMap;

use forelight_protocol::{JobId, LedgerLine, Money, Timestamp};
use sqlx::SqliteConnection;

use crate::budgets::past;
use crate::columns::{Time, hex_list};
use crate::database::Store;
use crate::error::Result;
use crate::policy::budgets::{self as policy, Payment};

/// Ledger rows: the columns of a line, more columns, and a condition.
///
/// A lease that was not renewed since the service restarted is paid until it would have expired before that.
/// Any other active lease is paid until it expires, unless it is renewed.
macro_rules! rows {
    ($more:literal, $which:literal $(, $value:expr)* $(,)?) => {
        sqlx::query!(
            "SELECT d.project, d.job_id, d.node_id, d.price_per_hour, d.from_at, \
             coalesce(d.until_at, l.paid_until, CASE l.state WHEN 'active' THEN l.expires_at END) \
             AS \"until_at?: Time\", d.until_at IS NOT NULL AS \"is_closed!: bool\""
                + $more
                + " FROM ledger d JOIN leases l ON l.id = d.lease_id "
                + $which
            $(, $value)*
        )
    };
}

macro_rules! line {
    ($row:expr) => {
        LedgerLine {
            project: $row.project,
            of: Some(($row.job_id.into(), $row.node_id.into())),
            price_per_hour: Money($row.price_per_hour),
            from: $row.from_at.into(),
            until: $row.until_at.map(Into::into),
        }
    };
    // As far as it is paid by now. What is closed was paid, whatever the clock says: sums never fall.
    ($row:expr, $now:expr) => {{
        let (is_closed, mut line) = ($row.is_closed, line!($row));
        line.until = Some(line.until.map_or($now, |until| if is_closed { until } else { until.min($now) }));
        line
    }};
}

impl Store {
    /// Payments between two instants, in the order of leases; then those of deleted jobs, by project.
    pub async fn ledger(&self, from: Timestamp, until: Timestamp) -> Result<Vec<LedgerLine>> {
        let rows = rows!(
            "",
            "WHERE d.from_at < ? AND (d.until_at IS NULL OR d.until_at > ?) ORDER BY d.from_at, d.lease_id",
            until.micros(),
            from.micros()
        )
        .fetch_all(self.readers())
        .await?;
        let mut lines: Vec<LedgerLine> = rows.into_iter().map(|row| line!(row)).collect();
        lines.extend(past::payments(&mut *self.readers().acquire().await?, from, until).await?);
        Ok(lines)
    }

    /// What a job's leases have cost so far; active leases count up to `now`.
    pub async fn spent_on(&self, job: JobId, now: Timestamp) -> Result<Money> {
        spent_on(&mut *self.readers().acquire().await?, job, now).await
    }
}

/// All ledger lines of each of these jobs as far as they are paid by now, each with its task.
pub(crate) async fn payments(
    connection: &mut SqliteConnection,
    jobs: &[JobId],
    now: Timestamp,
) -> Result<BTreeMap<JobId, Vec<Payment>>> {
    let rows = rows!(
        ", t.kind, t.frame, t.part, l.state = 'active' AS \"is_active!: bool\"",
        "JOIN tasks t ON t.id = l.task_id WHERE t.job_id IN (SELECT unhex(value) FROM json_each(?))",
        hex_list(jobs.iter().map(|job| job.0))
    )
    .fetch_all(connection)
    .await?;
    let mut payments: BTreeMap<JobId, Vec<Payment>> = BTreeMap::new();
    for row in rows {
        payments.entry(row.job_id.into()).or_default().push(Payment {
            kind: row.kind.0,
            frame: row.frame,
            part: row.part,
            is_active: row.is_active,
            line: line!(row, now),
        });
    }
    Ok(payments)
}

/// What a job's leases cost, including its quote, its frames and lost work. Active leases count up to now.
pub(crate) async fn spent_on(connection: &mut SqliteConnection, job: JobId, now: Timestamp) -> Result<Money> {
    let payments = payments(connection, &[job], now).await?;
    let payments: Vec<Payment> = payments.into_values().flatten().collect();
    Ok(policy::cost_since(payments.iter().map(|payment| &payment.line), Timestamp::from_micros(i64::MIN)))
}

/// What each project's leases cost since an instant, those of deleted jobs included. Active leases count up to
/// now.
pub(crate) async fn spent_by_project(
    connection: &mut SqliteConnection,
    from: Timestamp,
    now: Timestamp,
) -> Result<BTreeMap<String, Money>> {
    // Each line is rounded up, as in `Money::for_micros_at_hourly_rate`. Time is split into hours and the rest,
    // the price into 3,600 parts and the rest, so that nothing overflows for prices that nodes may have.
    let ended = sqlx::query!(
        r#"SELECT project,
                  sum((until_at - from_at) / 3600000000 * price_per_hour
                      + (until_at - from_at) % 3600000000 * (price_per_hour / 3600) / 1000000
                      + ((until_at - from_at) % 3600000000 * (price_per_hour / 3600) % 1000000 * 3600
                         + (until_at - from_at) % 3600000000 * (price_per_hour % 3600) + 3599999999)
                      / 3600000000) AS "cost!: i64"
           FROM ledger WHERE until_at > ?1 AND from_at >= ?1 GROUP BY project"#,
        from.micros()
    )
    .fetch_all(&mut *connection)
    .await?;
    let rest = rows!(
        "",
        "WHERE d.lease_id IN (SELECT lease_id FROM ledger WHERE until_at IS NULL \
         UNION ALL SELECT lease_id FROM ledger WHERE until_at > ?1 AND from_at < ?1)",
        from.micros()
    )
    .fetch_all(&mut *connection)
    .await?;
    let past = past::spent(connection, from).await?;
    let ended = ended.into_iter().map(|row| (row.project, Money(row.cost)));
    let rest = rest.into_iter().map(|row| {
        let line = line!(row, now);
        let cost = policy::cost_since([&line], from);
        (line.project, cost)
    });
    let mut spent: BTreeMap<String, Money> = BTreeMap::new();
    for (project, cost) in ended.chain(rest).chain(past) {
        let sum = spent.entry(project).or_default();
        *sum = Money(sum.0.saturating_add(cost.0));
    }
    Ok(spent)
}

/// The expected rest of the cost of a project's running frames, at the median of their forecasts.
pub(crate) async fn committed(
    connection: &mut SqliteConnection,
    project: &str,
    now: Timestamp,
) -> Result<Money> {
    let rows = rows!(
        ", f.cpu_p50 * ifnull(t.share, 1.0 / f.parts) AS \"cpu_p50!: f64\", l.node_speed * n.cores AS \"speed!: f64\", \
         iif(n.cores > 1, j.serial_many_cores, j.serial_one_core) AS \"serial!: i64\"",
        "JOIN tasks t ON t.id = l.task_id JOIN nodes n ON n.id = d.node_id JOIN jobs j ON j.id = d.job_id \
         JOIN frames f ON f.job_id = d.job_id AND f.frame = t.frame \
         WHERE d.project = ? AND d.until_at IS NULL AND t.booked_part IS NOT NULL AND f.cpu_p50 IS NOT NULL",
        project
    )
    .fetch_all(connection)
    .await?;
    Ok(Money(rows.into_iter().fold(0i64, |sum, row| {
        let time = policy::frame_time(row.cpu_p50, row.speed).saturating_add(row.serial);
        sum.saturating_add(policy::committed(&line!(row), time, now).0)
    })))
}
