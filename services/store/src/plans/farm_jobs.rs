//! The farm's booked jobs as a plan needs them.

use std::collections::BTreeMap;

use forelight_protocol::{Job, JobId, Money, Timestamp};
use sqlx::Row as _;
use sqlx::sqlite::SqliteRow;

use crate::budgets::ledger::{LINES_OF_JOB, line};
use crate::database::Store;
use crate::decode::{id, json_opt, whole, whole_opt, word};
use crate::error::StoreError;
use crate::jobs;
use crate::jobs::progress;
use crate::policy::budgets::{Payment, spent_and_under_way};
use crate::quotes::JobForecast;

/// A job that is booked and not over.
#[derive(Clone, PartialEq, Debug)]
pub struct FarmJob {
    /// The job.
    pub job: Job,
    /// Its forecast; absent of a job that was booked before forecasts were kept.
    pub forecast: Option<JobForecast>,
    /// All its frames, ascending.
    pub frames: Vec<FarmFrame>,
    /// What it has cost, its quote and what was lost included, and what that will cost which is under way or stands: frames with a worker, and the
    /// irradiance cache that its frames share.
    pub spent: Money,
    /// What the newest plan multiplies the forecast by, after what finished frames took.
    pub factor: f64,
    /// Its project's budget holds it back.
    pub held: bool,
}

/// A frame of such a job. CPU seconds are those of a node of speed 1.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct FarmFrame {
    /// Its number.
    pub number: u32,
    /// Forecast CPU seconds, median.
    pub p50: f64,
    /// Forecast CPU seconds that it exceeds in one case of five.
    pub p80: f64,
    /// Forecast CPU seconds that it exceeds in one case of twenty.
    pub p95: f64,
    /// Whether it waits for a worker: neither done nor with one.
    pub waits: bool,
}

/// A job's frames that have a forecast, with what is booked for them.
pub(crate) const FRAMES: &str = "SELECT f.frame, f.cpu_p50, f.cpu_p80, f.cpu_p95, t.state NOT IN ('leased', 'done') AS waits, t.held, \
    b.end_at - b.start_at AS length, coalesce(n.price_set, n.price_per_hour) AS price \
    FROM frames f JOIN jobs j ON j.id = f.job_id \
    JOIN tasks t INDEXED BY tasks_of_frames ON t.job_id = f.job_id AND t.kind = 'render' AND t.frame = f.frame \
    LEFT JOIN bookings b ON b.plan_id = j.plan_id AND b.job_id = f.job_id AND b.frame = f.frame LEFT JOIN nodes n ON n.id = b.node_id \
    WHERE f.job_id = ? AND f.cpu_p50 IS NOT NULL ORDER BY f.frame";

/// What is booked for the parts of a job's shared irradiance cache.
const PARTS: &str = "SELECT b.end_at - b.start_at AS length, coalesce(n.price_set, n.price_per_hour) AS price \
    FROM jobs j JOIN seed_bookings b ON b.plan_id = j.plan_id AND b.job_id = j.id JOIN nodes n ON n.id = b.node_id WHERE j.id = ?";

impl Store {
    /// The jobs that are booked or being rendered, oldest first.
    pub async fn farm_jobs(&self, now: Timestamp) -> Result<Vec<FarmJob>, StoreError> {
        let mut transaction = self.read().await?;
        let rows = sqlx::query("SELECT * FROM jobs WHERE state IN ('booked', 'rendering') ORDER BY id")
            .fetch_all(&mut *transaction)
            .await?;
        let mut found = Vec::with_capacity(rows.len());
        for row in &rows {
            let job_id = JobId(id(row, "id")?);
            let done = progress::of_job(&mut transaction, job_id).await?;
            let frames = sqlx::query(FRAMES).bind(job_id.0).fetch_all(&mut *transaction).await?;
            let mut held = false;
            let mut booked: BTreeMap<u32, i64> = BTreeMap::new();
            let frames = frames
                .iter()
                .map(|row| {
                    let waits = row.try_get("waits")?;
                    held |= waits && row.try_get::<bool, _>("held")?;
                    let number = whole(row, "frame")?;
                    booked.insert(number, booked_cost(row)?);
                    Ok(FarmFrame {
                        number,
                        p50: row.try_get("cpu_p50")?,
                        p80: row.try_get("cpu_p80")?,
                        p95: row.try_get("cpu_p95")?,
                        waits,
                    })
                })
                .collect::<Result<_, StoreError>>()?;
            let is_to_be_filled = done.shared_cache.as_ref().is_some_and(|cache| !cache.ready);
            let parts = if is_to_be_filled {
                sqlx::query(PARTS).bind(job_id.0).fetch_all(&mut *transaction).await?
            } else {
                Vec::new()
            };
            let booked_cache = parts
                .iter()
                .try_fold(0i64, |sum, row| Ok::<_, StoreError>(sum.saturating_add(booked_cost(row)?)))?;
            let lines = sqlx::query(LINES_OF_JOB).bind(job_id.0).fetch_all(&mut *transaction).await?;
            let payments: Vec<Payment> = lines.iter().map(payment).collect::<Result<_, _>>()?;
            let spent = spent_and_under_way(&payments, &booked, booked_cache, now);
            found.push(FarmJob {
                job: jobs::decode(row, done)?,
                forecast: json_opt(row, "forecast")?,
                frames,
                spent,
                factor: row.try_get("factor")?,
                held,
            });
        }
        Ok(found)
    }
}

/// A line of the ledger with the task that it paid for.
fn payment(row: &SqliteRow) -> Result<Payment, StoreError> {
    Ok(Payment {
        line: line(row)?,
        kind: word(row, "kind")?,
        frame: whole_opt(row, "frame")?,
        is_active: row.try_get("is_active")?,
    })
}

fn booked_cost(row: &SqliteRow) -> Result<i64, StoreError> {
    let (length, price): (Option<i64>, Option<i64>) = (row.try_get("length")?, row.try_get("price")?);
    let cost = length.zip(price).map(|(length, price)| Money(price).for_micros_at_hourly_rate(length));
    Ok(cost.unwrap_or_default().micro_units())
}
