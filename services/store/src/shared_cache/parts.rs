//! The parts of shared irradiance caches: their bookings and progress.

use std::collections::BTreeMap;

use forelight_protocol::{
    JobId, NodeId, SharedCacheBooking, SharedCacheForecast, SharedCacheProgress, Timestamp,
};
use sqlx::SqliteConnection;

use crate::columns::{Id, Json, Time, hex_list};
use crate::database::{Store, Write};
use crate::error::Result;
use crate::plans::slowness::{self, HeldTask};
use crate::policy::overdue::AttemptTimes;
use crate::policy::projection::{Holder, OpenCachePart};
use crate::policy::shared_cache::{self, Filled, PartDone, part_done};
use crate::writing::run;

/// A booking of a part.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct NewPartBooking {
    /// Which part, from 0.
    pub part: u32,
    /// The node.
    pub node: NodeId,
    /// From when.
    pub start: Timestamp,
    /// Until when (exclusive).
    pub end: Timestamp,
}

impl Store {
    /// The booked parts of caches that are not full yet, by start. A part stays open between its rounds, and
    /// while other parts are filled.
    pub async fn open_cache_parts(&self) -> Result<Vec<OpenCachePart>> {
        open(&mut *self.readers().acquire().await?).await
    }
}

/// A booked part with its newest task, and the size of its cache.
struct Row {
    job_id: Id,
    part: u32,
    node_id: Id,
    start_at: Time,
    end_at: Time,
    state: String,
    held: bool,
    holder: Option<Id>,
    started_at: Option<Time>,
    progress: f64,
    progress_at: Option<Time>,
    counts_from: Option<Time>,
    round: u32,
    parts: u32,
    levels: u32,
}

impl From<Row> for OpenCachePart {
    fn from(row: Row) -> Self {
        let (is_leased, is_filled) = (row.state == "leased", row.state == "done");
        let PartDone { done, with_worker } =
            part_done((row.parts, row.levels), row.round, is_filled, row.progress);
        let attempt = row.holder.zip(row.started_at).filter(|_| is_leased);
        let holder = attempt.map(|(node, started)| {
            let times = AttemptTimes::new(started, row.counts_from, row.progress_at);
            Holder::new(node.into(), times, with_worker, None)
        });
        let booking = SharedCacheBooking {
            job_id: row.job_id.into(),
            part: row.part,
            node_id: row.node_id.into(),
            start: row.start_at.into(),
            end: row.end_at.into(),
        };
        OpenCachePart { booking, done, holder, held: row.held && !is_leased }
    }
}

/// Rows of booked parts of caches that are not full yet.
macro_rules! rows {
    ($which:literal $(, $value:expr)* $(,)?) => {
        sqlx::query_as!(
            Row,
            "SELECT b.job_id, b.part AS \"part!\", b.node_id, b.start_at, b.end_at, t.state, t.held, \
             t.node_id AS holder, t.started_at, t.progress, h.progress_at AS \"progress_at?\", \
             h.counts_from AS \"counts_from?\", t.round AS \"round!\", \
             (SELECT count(*) FROM shared_cache_bookings o \
              WHERE o.plan_id = b.plan_id AND o.job_id = b.job_id) AS \"parts!: u32\", \
             (SELECT count(*) FROM json_each(j.forecast, '$.cache.shared_cache.records') \
              WHERE value > 0) AS \"levels!: u32\" \
             FROM jobs j JOIN shared_cache_bookings b ON b.plan_id = j.plan_id AND b.job_id = j.id \
             JOIN tasks t ON t.job_id = j.id AND t.kind = 'cache_fill' AND t.frame IS NULL AND t.part = b.part AND t.round = \
             (SELECT max(l.round) FROM tasks l WHERE l.job_id = j.id AND l.kind = 'cache_fill' AND l.frame IS NULL AND l.part = b.part) \
             LEFT JOIN leases h ON t.state = 'leased' AND h.task_id = t.id AND h.fence = t.fence \
             WHERE j.state IN ('booked', 'rendering') AND EXISTS (SELECT 1 FROM tasks o WHERE o.job_id = j.id \
             AND o.frame IS NULL AND o.kind IN ('cache_fill', 'cache_merge') AND o.state IN ('ready', 'leased')) "
                + $which
                + " ORDER BY b.start_at, b.job_id, b.part"
            $(, $value)*
        )
    };
}

pub(crate) async fn open(connection: &mut SqliteConnection) -> Result<Vec<OpenCachePart>> {
    let rows = rows!("").fetch_all(&mut *connection).await?;
    with_slowness(connection, rows).await
}

pub(crate) async fn open_of(connection: &mut SqliteConnection, job: JobId) -> Result<Vec<OpenCachePart>> {
    let rows = rows!("AND j.id = ?", job.0).fetch_all(&mut *connection).await?;
    with_slowness(connection, rows).await
}

async fn with_slowness(connection: &mut SqliteConnection, rows: Vec<Row>) -> Result<Vec<OpenCachePart>> {
    let mut parts: Vec<OpenCachePart> = rows.into_iter().map(OpenCachePart::from).collect();
    let held = parts.iter_mut().filter_map(|OpenCachePart { booking, holder, .. }| {
        let length = booking.end.micros_since(booking.start);
        Some(HeldTask { job: booking.job_id, booked_on: booking.node_id, length, holder: holder.as_mut()? })
    });
    slowness::set(connection, held).await?;
    Ok(parts)
}

/// The bookings of a plan, by start.
pub(crate) async fn of_plan(
    connection: &mut SqliteConnection,
    plan: uuid::Uuid,
) -> Result<Vec<SharedCacheBooking>> {
    Ok(sqlx::query_as!(
        SharedCacheBooking,
        r#"SELECT job_id, part, node_id, start_at AS start, end_at AS "end" FROM shared_cache_bookings
           WHERE plan_id = ? ORDER BY start_at, job_id, part"#,
        plan
    )
    .fetch_all(connection)
    .await?)
}

pub(crate) async fn keep_bookings(
    write: &mut Write,
    plan: uuid::Uuid,
    job: JobId,
    bookings: &[NewPartBooking],
) -> Result<()> {
    for booking in bookings {
        run!(
            write,
            "INSERT INTO shared_cache_bookings (plan_id, job_id, part, node_id, start_at, end_at) \
             VALUES (?, ?, ?, ?, ?, ?)",
            plan,
            job.0,
            booking.part,
            booking.node.0,
            booking.start.micros(),
            booking.end.micros()
        );
    }
    Ok(())
}

/// Progress of the cache that a job's frames share; `None` if they share none.
pub(crate) async fn progress(
    connection: &mut SqliteConnection,
    job: JobId,
) -> Result<Option<SharedCacheProgress>> {
    Ok(progress_of_jobs(connection, &[job]).await?.remove(&job))
}

/// The same of each of these jobs whose frames share a cache.
pub(crate) async fn progress_of_jobs(
    connection: &mut SqliteConnection,
    jobs: &[JobId],
) -> Result<BTreeMap<JobId, SharedCacheProgress>> {
    let rows = sqlx::query!(
        r#"SELECT id, json_extract(forecast, '$.cache.shared_cache') AS "forecast!: Json<SharedCacheForecast>"
           FROM jobs WHERE id IN (SELECT unhex(value) FROM json_each(?))
           AND json_extract(forecast, '$.cache.shared_cache') IS NOT NULL"#,
        hex_list(jobs.iter().map(|job| job.0))
    )
    .fetch_all(&mut *connection)
    .await?;
    let mut found = BTreeMap::new();
    for row in rows {
        let job = row.id.into();
        found.insert(job, filled(connection, job, &row.forecast.0).await?);
    }
    Ok(found)
}

/// How far a cache with this forecast is filled.
async fn filled(
    connection: &mut SqliteConnection,
    job: JobId,
    forecast: &SharedCacheForecast,
) -> Result<SharedCacheProgress> {
    let row = sqlx::query!(
        r#"SELECT count(*) FILTER (WHERE t.state = 'done') AS "done!: u32",
                  total(CASE t.state WHEN 'done' THEN 1.0 WHEN 'leased' THEN t.progress ELSE 0.0 END) AS "reached!: f64",
                  total(json_extract(r.body, '$.cache_fill.spent.work')) AS "work!: f64",
                  (SELECT total(json_extract(r.body, '$.' || t.kind || '.spent.cpu_nanos') * l.node_speed) FROM tasks t
                   JOIN results r ON r.task_id = t.id JOIN leases l ON l.id = r.lease_id
                   WHERE t.job_id = ?1 AND t.frame IS NULL AND t.kind IN ('cache_fill', 'cache_merge')) AS "cpu_nanos!: f64",
                  EXISTS (SELECT 1 FROM tasks w WHERE w.job_id = ?1 AND w.kind IN ('divide', 'render')
                          AND w.state NOT IN ('waiting', 'cancelled')) AS "ready!: bool"
           FROM tasks t LEFT JOIN results r ON r.task_id = t.id WHERE t.job_id = ?1 AND t.frame IS NULL AND t.kind = 'cache_fill'"#,
        job.0
    )
    .fetch_one(connection)
    .await?;
    let filled = Filled {
        parts_done: row.done,
        reached: row.reached,
        is_ready: row.ready,
        work: row.work,
        cpu_nanos: row.cpu_nanos,
    };
    Ok(shared_cache::progress(forecast, &filled))
}
