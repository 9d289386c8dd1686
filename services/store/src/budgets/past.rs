//! What deleted jobs cost: sums by project and quarter of an hour.

use std::collections::BTreeMap;

use forelight_protocol::{JobId, LedgerLine, Money, Timestamp};
use sqlx::SqliteConnection;

use crate::budgets::ledger;
use crate::database::Write;
use crate::error::Result;
use crate::policy::budgets::{QUARTER, by_quarter};
use crate::writing::run;

/// Adds the payments of a job, whose rows are deleted next.
pub(crate) async fn add(write: &mut Write, job: JobId, now: Timestamp) -> Result<()> {
    let mut sums: BTreeMap<(String, Timestamp), (i64, i64)> = BTreeMap::new();
    let payments = ledger::payments(write.connection().await?, &[job], now).await?;
    for payment in payments.into_values().flatten() {
        for (begin, cost, used) in by_quarter(&payment.line) {
            let sum = sums.entry((payment.line.project.clone(), begin)).or_default();
            *sum = (sum.0.saturating_add(cost.0), sum.1.saturating_add(used));
        }
    }
    for ((project, begin), (cost, used)) in sums {
        run!(
            write,
            "INSERT INTO past_payments (project, from_at, cost, used) VALUES (?, ?, ?, ?) \
             ON CONFLICT (project, from_at) DO UPDATE SET cost = cost + excluded.cost, used = used + excluded.used",
            project,
            begin.micros(),
            cost,
            used
        );
    }
    Ok(())
}

/// The quarters that begin between two instants, as lines of the ledger.
pub(crate) async fn payments(
    connection: &mut SqliteConnection,
    from: Timestamp,
    until: Timestamp,
) -> Result<Vec<LedgerLine>> {
    let rows = sqlx::query!(
        "SELECT project, from_at, cost FROM past_payments WHERE from_at >= ? AND from_at < ? \
         ORDER BY project, from_at",
        from.micros(),
        until.micros()
    )
    .fetch_all(connection)
    .await?;
    let line = |(project, begin, cost): (String, i64, i64)| LedgerLine {
        project,
        of: None,
        price_per_hour: Money(cost.saturating_mul(4)),
        from: Timestamp::from_micros(begin),
        until: Some(Timestamp::from_micros(begin.saturating_add(QUARTER))),
    };
    Ok(rows.into_iter().map(|row| line((row.project, row.from_at, row.cost))).collect())
}

/// What each project spent on deleted jobs since an instant.
pub(crate) async fn spent(
    connection: &mut SqliteConnection,
    from: Timestamp,
) -> Result<Vec<(String, Money)>> {
    let rows = sqlx::query!(
        r#"SELECT project, sum(cost) AS "cost!: i64" FROM past_payments WHERE from_at >= ? GROUP BY project"#,
        from.micros()
    )
    .fetch_all(connection)
    .await?;
    Ok(rows.into_iter().map(|row| (row.project, Money(row.cost))).collect())
}

/// Node time in microseconds that projects used for deleted jobs since an instant, by periods of `period`
/// microseconds: the project, the end of the period, and the time.
pub(crate) async fn used(
    connection: &mut SqliteConnection,
    from: Timestamp,
    period: i64,
) -> Result<Vec<(String, Timestamp, i64)>> {
    let rows = sqlx::query!(
        r#"SELECT project, (from_at / ?2 + 1) * ?2 AS "until!: i64", sum(used) AS "used!: i64"
           FROM past_payments WHERE from_at >= ?1 GROUP BY 1, 2 ORDER BY 1, 2"#,
        from.micros(),
        period
    )
    .fetch_all(connection)
    .await?;
    Ok(rows.into_iter().map(|row| (row.project, Timestamp::from_micros(row.until), row.used)).collect())
}
