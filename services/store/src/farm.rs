//! The farm's booked jobs as a plan needs them.

use forelight_protocol::{Job, JobId, Money};
use sqlx::Row as _;
use sqlx::sqlite::SqliteRow;

use crate::decode::{id, json_opt, whole};
use crate::{JobForecast, Store, StoreError, jobs, progress};

/// A job that is booked and not over.
#[derive(Clone, PartialEq, Debug)]
pub struct FarmJob {
    /// The job.
    pub job: Job,
    /// Its forecast; absent of a job that was booked before forecasts were kept.
    pub forecast: Option<JobForecast>,
    /// All its frames, ascending.
    pub frames: Vec<FarmFrame>,
    /// What is booked for the irradiance cache that its frames share costs, done or not, micro-units; 0 if they do not.
    pub shared_cache_cost: i64,
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
    /// What its booking costs by the time that it takes, micro-units; 0 without one.
    pub booked_cost: i64,
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
    pub async fn farm_jobs(&self) -> Result<Vec<FarmJob>, StoreError> {
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
            let frames = frames
                .iter()
                .map(|row| {
                    let waits = row.try_get("waits")?;
                    held |= waits && row.try_get::<bool, _>("held")?;
                    Ok(FarmFrame {
                        number: whole(row, "frame")?,
                        p50: row.try_get("cpu_p50")?,
                        p80: row.try_get("cpu_p80")?,
                        p95: row.try_get("cpu_p95")?,
                        booked_cost: booked_cost(row)?,
                        waits,
                    })
                })
                .collect::<Result<_, StoreError>>()?;
            let parts = sqlx::query(PARTS).bind(job_id.0).fetch_all(&mut *transaction).await?;
            let shared_cache_cost = parts
                .iter()
                .try_fold(0i64, |sum, row| Ok::<_, StoreError>(sum.saturating_add(booked_cost(row)?)))?;
            found.push(FarmJob {
                job: jobs::decode(row, done)?,
                forecast: json_opt(row, "forecast")?,
                frames,
                shared_cache_cost,
                factor: row.try_get("factor")?,
                held,
            });
        }
        Ok(found)
    }
}

fn booked_cost(row: &SqliteRow) -> Result<i64, StoreError> {
    let (length, price): (Option<i64>, Option<i64>) = (row.try_get("length")?, row.try_get("price")?);
    let cost = length.zip(price).map(|(length, price)| Money(price).for_micros_at_hourly_rate(length));
    Ok(cost.unwrap_or_default().micro_units())
}
