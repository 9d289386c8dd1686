//! The parts of shared irradiance caches: where they are booked, and how far they are.

use forelight_protocol::{JobId, NodeId, SeedBooking, SeedForecast, SeedProgress, Timestamp};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::database::{Store, Write};
use crate::decode::{id, id_opt, json_opt, time, time_opt, whole};
use crate::error::StoreError;
use crate::policy::projection::{Holder, OpenCachePart};
use crate::policy::shared_cache::{self, Filled, PartDone, part_done};

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
    /// The booked parts of caches that are not full yet, by start: between its rounds, and while others are filled, a part waits.
    pub async fn open_cache_parts(&self) -> Result<Vec<OpenCachePart>, StoreError> {
        let mut connection = self.readers().acquire().await?;
        open(&mut connection).await
    }
}

macro_rules! select_open {
    ($rest:literal) => {
        concat!(
            "SELECT b.*, t.state, t.node_id AS holder, t.started_at, t.progress, t.round, \
             (SELECT count(*) FROM seed_bookings o WHERE o.plan_id = b.plan_id AND o.job_id = b.job_id) AS parts, \
             (SELECT count(*) FROM json_each(j.forecast, '$.cache.seed.records') WHERE value > 0) AS levels \
             FROM jobs j JOIN seed_bookings b ON b.plan_id = j.plan_id AND b.job_id = j.id \
             JOIN tasks t ON t.job_id = j.id AND t.kind = 'cache_fill' AND t.part = b.part AND t.round = \
             (SELECT max(l.round) FROM tasks l WHERE l.job_id = j.id AND l.kind = 'cache_fill' AND l.part = b.part) \
             WHERE j.state IN ('booked', 'rendering') AND EXISTS (SELECT 1 FROM tasks o WHERE o.job_id = j.id \
             AND o.kind IN ('cache_fill', 'cache_merge') AND o.state IN ('ready', 'leased')) ",
            $rest,
            " ORDER BY b.start_at, b.job_id, b.part"
        )
    };
}

pub(crate) async fn open(connection: &mut SqliteConnection) -> Result<Vec<OpenCachePart>, StoreError> {
    let rows = sqlx::query(select_open!("")).fetch_all(connection).await?;
    rows.iter().map(decode_open).collect()
}

/// Those of one job.
pub(crate) async fn open_of(
    connection: &mut SqliteConnection,
    job: JobId,
) -> Result<Vec<OpenCachePart>, StoreError> {
    let rows = sqlx::query(select_open!("AND j.id = ?")).bind(job.0).fetch_all(connection).await?;
    rows.iter().map(decode_open).collect()
}

fn decode_open(row: &SqliteRow) -> Result<OpenCachePart, StoreError> {
    let (round, state): (u32, &str) = (whole(row, "round")?, row.try_get("state")?);
    let (leased, filled) = (state == "leased", state == "done");
    let of_cache = (whole(row, "parts")?, whole(row, "levels")?);
    let PartDone { done, with_worker } = part_done(of_cache, round, filled, row.try_get("progress")?);
    let holder = match (leased, id_opt(row, "holder")?, time_opt(row, "started_at")?) {
        (true, Some(node), Some(started)) => {
            Some(Holder { node_id: NodeId(node), started, progress: with_worker })
        }
        _ => None,
    };
    Ok(OpenCachePart { booking: decode_booking(row)?, done, holder })
}

/// The bookings of a plan, by start.
pub(crate) async fn of_plan(
    connection: &mut SqliteConnection,
    plan: uuid::Uuid,
) -> Result<Vec<SeedBooking>, StoreError> {
    let rows = sqlx::query("SELECT * FROM seed_bookings WHERE plan_id = ? ORDER BY start_at, job_id, part")
        .bind(plan)
        .fetch_all(connection)
        .await?;
    rows.iter().map(decode_booking).collect()
}

fn decode_booking(row: &SqliteRow) -> Result<SeedBooking, StoreError> {
    Ok(SeedBooking {
        job_id: JobId(id(row, "job_id")?),
        part: whole(row, "part")?,
        node_id: NodeId(id(row, "node_id")?),
        start: time(row, "start_at")?,
        end: time(row, "end_at")?,
    })
}

/// Keeps a plan's bookings of the parts.
pub(crate) async fn keep_bookings(
    write: &mut Write,
    plan: uuid::Uuid,
    job: JobId,
    bookings: &[NewPartBooking],
) -> Result<(), StoreError> {
    for booking in bookings {
        sqlx::query(
            "INSERT INTO seed_bookings (plan_id, job_id, part, node_id, start_at, end_at) VALUES (?, ?, ?, ?, ?, ?)",
        )
        .bind(plan)
        .bind(job.0)
        .bind(i64::from(booking.part))
        .bind(booking.node.0)
        .bind(booking.start.micros())
        .bind(booking.end.micros())
        .execute(write.connection().await?)
        .await?;
    }
    Ok(())
}

/// How far the cache is that a job's frames share; `None` if they do not.
pub(crate) async fn progress(
    connection: &mut SqliteConnection,
    job: JobId,
) -> Result<Option<SeedProgress>, StoreError> {
    let row = sqlx::query("SELECT json_extract(forecast, '$.cache.seed') AS forecast FROM jobs WHERE id = ?")
        .bind(job.0)
        .fetch_optional(&mut *connection)
        .await?;
    let Some(forecast) =
        row.as_ref().map(|row| json_opt::<SeedForecast>(row, "forecast")).transpose()?.flatten()
    else {
        return Ok(None);
    };
    let row = sqlx::query(
        "SELECT count(*) FILTER (WHERE t.state = 'done') AS done, \
                total(CASE t.state WHEN 'done' THEN 1.0 WHEN 'leased' THEN t.progress ELSE 0.0 END) AS reached, \
                total(json_extract(r.body, '$.cache_fill.spent.work')) AS work, \
                (SELECT total(json_extract(r.body, '$.' || t.kind || '.spent.cpu_nanos') * l.node_speed) FROM tasks t \
                 JOIN results r ON r.task_id = t.id JOIN leases l ON l.id = r.lease_id \
                 WHERE t.job_id = ?1 AND t.kind IN ('cache_fill', 'cache_merge')) AS cpu_nanos, \
                EXISTS (SELECT 1 FROM tasks w WHERE w.job_id = ?1 AND w.kind = 'render' AND w.state NOT IN ('waiting', 'cancelled')) AS ready \
         FROM tasks t LEFT JOIN results r ON r.task_id = t.id WHERE t.job_id = ?1 AND t.kind = 'cache_fill'",
    )
    .bind(job.0)
    .fetch_one(connection)
    .await?;
    let filled = Filled {
        parts_done: whole(&row, "done")?,
        reached: row.try_get("reached")?,
        is_ready: row.try_get("ready")?,
        work: row.try_get("work")?,
        cpu_nanos: row.try_get("cpu_nanos")?,
    };
    Ok(Some(shared_cache::progress(&forecast, &filled)))
}
