//! All frames of a job in a few arrays.

use std::collections::BTreeMap;

use forelight_protocol::{FrameSet, FrameStrip, JobId, Money, StripQuantity};
use sqlx::SqliteConnection;

use crate::database::Store;
use crate::error::Result;
use crate::jobs;

/// A frame with its task.
struct Row {
    frame: u32,
    state: Option<String>,
    is_booked: bool,
    is_divided: bool,
    /// Whether a worker has had one of its parts.
    is_begun: bool,
    dropped: bool,
    values: [Option<f64>; 3],
    actual: Option<f64>,
}

macro_rules! rows {
    ($connection:expr, $job:expr, $columns:literal) => {
        sqlx::query!(
            "SELECT f.frame, t.state AS \"state?\", t.booked_node IS NOT NULL AS \"is_booked!: bool\", f.parts > 1 AS \"is_divided!: bool\", \
             EXISTS (SELECT 1 FROM tasks p INDEXED BY tasks_of_parts WHERE f.parts > 1 AND p.kind = 'render_part' \
             AND p.job_id = f.job_id AND p.frame = f.frame AND p.state IN ('leased', 'done')) AS \"is_begun!: bool\", \
             f.dropped, "
                + $columns
                + " FROM frames f LEFT JOIN tasks t INDEXED BY tasks_of_frames \
                   ON t.job_id = f.job_id AND t.kind = 'render' AND t.frame = f.frame \
                   WHERE f.job_id = ? ORDER BY f.frame",
            $job.0
        )
        .fetch_all(&mut *$connection)
        .await?
        .into_iter()
        .map(|row| Row {
            frame: row.frame,
            state: row.state,
            is_booked: row.is_booked,
            is_divided: row.is_divided,
            is_begun: row.is_begun,
            dropped: row.dropped,
            values: [row.p50, row.p80, row.p95],
            actual: row.actual,
        })
        .collect::<Vec<Row>>()
    };
}

impl Store {
    /// The states, forecasts and true costs of all frames of a job.
    pub async fn strip(&self, job: JobId, quantity: StripQuantity) -> Result<FrameStrip> {
        let mut transaction = self.read().await?;
        let connection = &mut *transaction;
        let row = jobs::row(connection, job).await?;
        let is_final = row.state.0.is_final();
        let mut rows = match quantity {
            StripQuantity::Work => rows!(
                connection,
                job,
                "f.work_p50 AS p50, f.work_p80 AS p80, f.work_p95 AS p95, f.actual_work AS actual"
            ),
            StripQuantity::CpuSeconds | StripQuantity::Cost => rows!(
                connection,
                job,
                "f.cpu_p50 AS p50, f.cpu_p80 AS p80, f.cpu_p95 AS p95, f.actual_cpu AS actual"
            ),
        };
        if quantity == StripQuantity::Cost {
            in_money(connection, job, &mut rows).await?;
        }
        let states = rows.iter().map(|row| letter(row, is_final)).collect();
        let column =
            |at: usize| -> Vec<Option<f64>> { rows.iter().map(|row| row.values[at].map(short)).collect() };
        Ok(FrameStrip {
            job_id: job,
            quantity,
            frames: row.frame_set()?,
            states,
            profiled: profiled(connection, job).await?,
            p50: column(0),
            p80: column(1),
            p95: column(2),
            actual: rows.iter().map(|row| row.actual.map(short)).collect(),
        })
    }
}

fn letter(row: &Row, job_is_final: bool) -> char {
    match row.state.as_deref() {
        _ if row.dropped => 'c',
        Some("done") => 'd',
        Some("leased") => 'r',
        Some("waiting") if row.is_begun => 'r',
        Some("waiting") if row.is_divided => 'b',
        Some("failed") => 'f',
        Some("cancelled") => 'c',
        Some("ready") if row.is_booked => 'b',
        None if job_is_final => 'c',
        _ => 'w',
    }
}

/// To three digits that count: what a chart shows, and what compresses well.
fn short(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return 0.0;
    }
    let digits = 2 - value.abs().log10().floor() as i32;
    let scale = 10f64.powi(digits.abs());
    if digits >= 0 { (value * scale).round() / scale } else { (value / scale).round() * scale }
}

/// Forecasts at the quoted price of a CPU second, and what leases of the frames cost, lost ones too.
async fn in_money(connection: &mut SqliteConnection, job: JobId, rows: &mut [Row]) -> Result<()> {
    let price = sqlx::query_scalar!(
        r#"SELECT json_extract(forecast, '$.cost.mean') / nullif(json_extract(forecast, '$.total.cpu_seconds.mean')
                  + coalesce(json_extract(forecast, '$.cache.shared_cache.cpu_seconds.mean'), 0.0), 0.0)
                  AS "price?: f64" FROM jobs WHERE id = ?"#,
        job.0
    )
    .fetch_one(&mut *connection)
    .await?;
    let paid = sqlx::query!(
        r#"SELECT t.frame AS "frame!: u32", d.price_per_hour, d.until_at - d.from_at AS "length!: i64"
           FROM tasks t JOIN leases l ON l.task_id = t.id JOIN ledger d ON d.lease_id = l.id
           WHERE t.job_id = ? AND t.frame IS NOT NULL AND t.kind <> 'profile' AND d.until_at IS NOT NULL"#,
        job.0
    )
    .fetch_all(connection)
    .await?;
    let mut cost: BTreeMap<u32, i64> = BTreeMap::new();
    for row in paid {
        let sum = cost.entry(row.frame).or_default();
        *sum = sum.saturating_add(Money(row.price_per_hour).for_micros_at_hourly_rate(row.length).0);
    }
    for row in rows {
        row.values = row.values.map(|value| Some(value? * price?));
        row.actual = row.actual.map(|_| cost.get(&row.frame).copied().unwrap_or_default() as f64);
    }
    Ok(())
}

/// The frames whose profiles are finished.
async fn profiled(connection: &mut SqliteConnection, job: JobId) -> Result<Option<FrameSet>> {
    let frames = sqlx::query_scalar!(
        r#"SELECT frame AS "frame!" FROM tasks WHERE job_id = ? AND kind = 'profile' AND state = 'done'"#,
        job.0
    )
    .fetch_all(connection)
    .await?;
    Ok(FrameSet::from_frames(frames))
}

#[cfg(test)]
mod tests {
    use super::short;

    #[test]
    fn three_digits_are_kept_of_large_and_small_numbers() {
        let of = |value: f64| short(value).to_string();
        assert_eq!(of(1234.567), "1230");
        assert_eq!(of(0.0012345), "0.00123");
        assert_eq!((of(9.999), of(0.0), of(f64::NAN)), ("10".to_owned(), "0".to_owned(), "0".to_owned()));
        assert_eq!(of(270_374_592.13), "270000000");
    }
}
