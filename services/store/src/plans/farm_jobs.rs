//! The farm's booked jobs, as input of a plan. Large farms have thousands, so each statement reads all rows of
//! its kind.

use std::collections::BTreeMap;

use forelight_protocol::{FramePart, Job, JobId, Money, Timestamp};
use sqlx::SqliteConnection;

use crate::budgets::ledger;
use crate::columns::{Unread, hex_list};
use crate::database::Store;
use crate::error::Result;
use crate::jobs::progress::{self, Progress};
use crate::jobs::{JobRow, job_rows};
use crate::policy::budgets::{Payment, spent_and_under_way};
use forelight_quote::JobForecast;
use forelight_quote::serial_time::SerialTime;

/// A job that is booked and not over.
#[derive(Clone, PartialEq, Debug)]
pub struct FarmJob {
    /// The job.
    pub job: Job,
    /// Its forecast; `None` for a job that was booked before forecasts were stored.
    pub forecast: Option<JobForecast>,
    /// All its frames, or the parts of those that are divided, ascending.
    pub frames: Vec<FarmFrame>,
    /// Its cost so far, including its quote and lost work, and the booked rest of work under way: frames with
    /// a worker, and the shared irradiance cache.
    pub spent: Money,
    /// The factor that the newest plan applies to the forecast, learnt from finished frames.
    pub factor: f64,
    /// How long its frames keep a node beyond their CPU time.
    pub serial_time: SerialTime,
    /// Its project's budget holds it back, or it is paused.
    pub held: bool,
    /// How often its deadline, budget or confidence were changed.
    pub terms: i64,
    /// Whether that was since its newest plan was made.
    pub has_new_terms: bool,
}

/// A frame of such a job, or a part of one. CPU seconds are those of a node of speed 1.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct FarmFrame {
    /// Which one.
    pub frame: FramePart,
    /// Share of the frame's forecast cost. 1: it is the whole frame.
    pub share: f64,
    /// Forecast CPU seconds of the whole frame, median.
    pub p50: f64,
    /// Forecast CPU seconds, 80 % quantile.
    pub p80: f64,
    /// Forecast CPU seconds, 95 % quantile.
    pub p95: f64,
    /// Whether it waits for a worker: neither done nor with one.
    pub waits: bool,
    /// Whether no worker ever had it, so that the frame may still be divided.
    pub untouched: bool,
}

impl Store {
    /// The jobs that are booked or being rendered, oldest first.
    pub async fn farm_jobs(&self, now: Timestamp) -> Result<Vec<FarmJob>> {
        let mut transaction = self.read().await?;
        let rows = job_rows!("WHERE state IN ('booked', 'rendering') ORDER BY id")
            .fetch_all(&mut *transaction)
            .await?;
        let jobs: Vec<JobId> = rows.iter().map(|row| row.id.into()).collect();
        let mut done = progress::of_jobs(&mut transaction, &jobs).await?;
        let mut frames = frames_of(&mut transaction, &jobs).await?;
        let mut payments = ledger::payments(&mut transaction, &jobs, now).await?;
        let mut found = Vec::with_capacity(rows.len());
        for (row, job) in rows.into_iter().zip(&jobs) {
            let done = done.remove(job).unwrap_or_default();
            let is_to_be_filled = done.shared_cache.as_ref().is_some_and(|cache| !cache.ready);
            let for_cache = if is_to_be_filled { booked_for_cache(&mut transaction, *job).await? } else { 0 };
            let frames = frames.remove(job).unwrap_or_default();
            let payments = payments.remove(job).unwrap_or_default();
            found.push(farm_job(row, done, frames, (&payments, for_cache))?);
        }
        Ok(found)
    }
}

/// A frame, or a part of one, with its booking.
struct BookedFrame {
    frame: FarmFrame,
    held: bool,
    /// What it is booked for, in micro-units.
    cost: i64,
}

/// The frames of these jobs that have a forecast, and the parts of those that are divided, in their order.
async fn frames_of(
    connection: &mut SqliteConnection,
    jobs: &[JobId],
) -> Result<BTreeMap<JobId, Vec<BookedFrame>>> {
    let rows = sqlx::query!(
        r#"SELECT f.job_id, f.frame, f.parts AS "parts!: u32", coalesce(p.part, 0) AS "part!: u32",
                  ifnull(p.share, 1.0 / f.parts) AS "share!: f64", f.cpu_p50 AS "cpu_p50!", f.cpu_p80 AS "cpu_p80!", f.cpu_p95 AS "cpu_p95!",
                  coalesce(p.state, t.state) NOT IN ('leased', 'done') AND NOT f.dropped AS "waits!: bool",
                  coalesce(p.held, t.held) AS "held!: bool",
                  p.id IS NULL AND t.fence = 0 AS "untouched!: bool",
                  b.end_at - b.start_at AS "length?: i64",
                  coalesce(n.price_set, n.price_per_hour) AS "price?: i64"
           FROM frames f JOIN jobs j ON j.id = f.job_id
           JOIN tasks t INDEXED BY tasks_of_frames
                ON t.job_id = f.job_id AND t.kind = 'render' AND t.frame = f.frame
           LEFT JOIN tasks p INDEXED BY tasks_of_parts
                ON p.job_id = f.job_id AND p.kind = 'render_part' AND p.frame = f.frame
           LEFT JOIN bookings b ON b.plan_id = j.plan_id AND b.job_id = f.job_id AND b.frame = f.frame
                AND b.part = coalesce(p.part, 0)
           LEFT JOIN nodes n ON n.id = b.node_id
           WHERE f.job_id IN (SELECT unhex(value) FROM json_each(?)) AND f.cpu_p50 IS NOT NULL
           ORDER BY f.job_id, f.frame, p.part"#,
        hex_list(jobs.iter().map(|job| job.0))
    )
    .fetch_all(connection)
    .await?;
    let mut frames: BTreeMap<JobId, Vec<BookedFrame>> = BTreeMap::new();
    for row in rows {
        let frame = FarmFrame {
            frame: FramePart { frame: row.frame, part: row.part, parts: row.parts },
            share: row.share,
            p50: row.cpu_p50,
            p80: row.cpu_p80,
            p95: row.cpu_p95,
            waits: row.waits,
            untouched: row.untouched,
        };
        let cost = booked_cost(row.length, row.price);
        frames.entry(row.job_id.into()).or_default().push(BookedFrame { frame, held: row.held, cost });
    }
    Ok(frames)
}

/// A job of the farm, with what it paid, and what is booked for its shared irradiance cache in micro-units.
fn farm_job(
    mut row: JobRow,
    done: Progress,
    frames: Vec<BookedFrame>,
    (payments, for_cache): (&[Payment], i64),
) -> Result<FarmJob> {
    let (forecast, factor) = (row.forecast.take(), row.factor);
    let serial_time = SerialTime { one_core: row.serial_one_core, many_cores: row.serial_many_cores };
    let (terms, has_new_terms) = (row.terms, row.has_new_terms());
    let held = frames.iter().any(|row| row.frame.waits && row.held);
    let booked = frames.iter().map(|row| ((row.frame.frame.frame, row.frame.frame.part), row.cost)).collect();
    Ok(FarmJob {
        job: row.job(done)?,
        forecast: forecast.map(Unread::read).transpose()?,
        frames: frames.into_iter().map(|row| row.frame).collect(),
        spent: spent_and_under_way(payments, &booked, for_cache),
        factor,
        serial_time,
        held,
        terms,
        has_new_terms,
    })
}

/// Booked cost of the parts of a job's shared irradiance cache, in micro-units.
async fn booked_for_cache(connection: &mut SqliteConnection, job: JobId) -> Result<i64> {
    let parts = sqlx::query!(
        r#"SELECT b.end_at - b.start_at AS "length?: i64",
                  coalesce(n.price_set, n.price_per_hour) AS "price?: i64"
           FROM jobs j JOIN shared_cache_bookings b ON b.plan_id = j.plan_id AND b.job_id = j.id
           JOIN nodes n ON n.id = b.node_id
           WHERE j.id = ?"#,
        job.0
    )
    .fetch_all(connection)
    .await?;
    Ok(parts.iter().fold(0i64, |sum, part| sum.saturating_add(booked_cost(part.length, part.price))))
}

/// Cost of a booking of this many microseconds at this price an hour, in micro-units; 0 without a booking.
fn booked_cost(length: Option<i64>, price: Option<i64>) -> i64 {
    let cost = length.zip(price).map(|(length, price)| Money(price).for_micros_at_hourly_rate(length));
    cost.unwrap_or_default().micro_units()
}
