//! Bookings of frames that are not rendered yet.

use forelight_protocol::{Booking, BookingId, JobId, NodeId, PlanId, Timestamp};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::database::Store;
use crate::decode::{id, id_opt, time, time_opt, whole};
use crate::error::StoreError;
use crate::policy::projection::{Holder, OpenBooking};

macro_rules! select_open {
    ($rest:literal) => {
        concat!(
            "SELECT b.*, t.state, t.node_id AS holder, t.started_at, t.progress FROM jobs j \
             JOIN bookings b ON b.plan_id = j.plan_id AND b.job_id = j.id \
             JOIN tasks t INDEXED BY tasks_of_frames ON t.job_id = b.job_id AND t.kind = 'render' AND t.frame = b.frame \
             WHERE j.state IN ('booked', 'rendering') AND t.state IN ('waiting', 'ready', 'leased') ",
            $rest
        )
    };
}

/// The open bookings of one job.
pub(crate) const OPEN_OF: &str = select_open!("AND j.id = ? ORDER BY b.start_at, b.id");

impl Store {
    /// The bookings of frames that are not rendered yet, by start.
    pub async fn open_bookings(&self) -> Result<Vec<OpenBooking>, StoreError> {
        let mut connection = self.readers().acquire().await?;
        open(&mut connection).await
    }

    /// The open bookings that start after `after` (or with it, and have a greater id), by start, at most `limit`.
    pub async fn open_bookings_page(
        &self,
        after: Option<(Timestamp, BookingId)>,
        limit: u32,
    ) -> Result<Vec<Booking>, StoreError> {
        let (start, id) = after.map_or((i64::MIN, uuid::Uuid::nil()), |(start, id)| (start.micros(), id.0));
        let rows =
            sqlx::query(select_open!("AND (b.start_at, b.id) > (?, ?) ORDER BY b.start_at, b.id LIMIT ?"))
                .bind(start)
                .bind(id)
                .bind(limit)
                .fetch_all(self.readers())
                .await?;
        rows.iter().map(decode_booking).collect()
    }
}

pub(crate) async fn open(connection: &mut SqliteConnection) -> Result<Vec<OpenBooking>, StoreError> {
    let rows = sqlx::query(select_open!("ORDER BY b.start_at, b.id")).fetch_all(connection).await?;
    rows.iter().map(decode_open).collect()
}

/// The bookings of a job's frames that are not rendered yet, by start.
pub(crate) async fn open_of(
    connection: &mut SqliteConnection,
    job: JobId,
) -> Result<Vec<OpenBooking>, StoreError> {
    let rows = sqlx::query(OPEN_OF).bind(job.0).fetch_all(connection).await?;
    rows.iter().map(decode_open).collect()
}

fn decode_open(row: &SqliteRow) -> Result<OpenBooking, StoreError> {
    let leased = row.try_get::<&str, _>("state")? == "leased";
    let holder = match (leased, id_opt(row, "holder")?, time_opt(row, "started_at")?) {
        (true, Some(node), Some(started)) => {
            Some(Holder { node_id: NodeId(node), started, progress: row.try_get("progress")? })
        }
        _ => None,
    };
    Ok(OpenBooking { booking: decode_booking(row)?, holder })
}

pub(crate) fn decode_booking(row: &SqliteRow) -> Result<Booking, StoreError> {
    Ok(Booking {
        id: BookingId(id(row, "id")?),
        plan_id: PlanId(id(row, "plan_id")?),
        job_id: JobId(id(row, "job_id")?),
        frame: whole(row, "frame")?,
        node_id: NodeId(id(row, "node_id")?),
        start: time(row, "start_at")?,
        end: time(row, "end_at")?,
    })
}
