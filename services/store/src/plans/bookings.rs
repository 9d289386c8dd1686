//! Bookings of frames, and of parts of frames, that are not rendered yet.

use forelight_protocol::{Booking, BookingId, JobId, Timestamp};
use sqlx::SqliteConnection;

use crate::columns::{Id, Time};
use crate::database::Store;
use crate::error::Result;
use crate::plans::slowness::{self, HeldTask};
use crate::policy::overdue::AttemptTimes;
use crate::policy::projection::{Holder, OpenBooking};

/// A booking with its task.
struct Row {
    id: Id,
    plan_id: Id,
    job_id: Id,
    frame: u32,
    part: u32,
    parts: u32,
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
    p95: Option<i64>,
}

impl From<Row> for OpenBooking {
    fn from(row: Row) -> Self {
        let is_leased = row.state == "leased";
        let attempt = row.holder.zip(row.started_at).filter(|_| is_leased);
        let holder = attempt.map(|(node, started)| {
            let times = AttemptTimes::new(started, row.counts_from, row.progress_at);
            Holder::new(node.into(), times, row.progress, row.p95)
        });
        let booking = Booking {
            id: row.id.into(),
            plan_id: row.plan_id.into(),
            job_id: row.job_id.into(),
            frame: row.frame,
            part: row.part,
            parts: row.parts,
            node_id: row.node_id.into(),
            start: row.start_at.into(),
            end: row.end_at.into(),
        };
        OpenBooking { booking, holder, held: row.held && !is_leased }
    }
}

/// Rows of open bookings: `rows!("AND j.id = ? ORDER BY b.start_at, b.id", job.0)`.
///
/// The cross join makes SQLite begin with the job. Otherwise, it looks for the job of each booking among all
/// jobs of the same plan.
macro_rules! rows {
    ($rest:literal $(, $value:expr)* $(,)?) => {
        sqlx::query_as!(
            Row,
            "SELECT b.id, b.plan_id, b.job_id, b.frame, b.part, b.parts, b.node_id, b.start_at, b.end_at, \
             t.state, t.held, t.node_id AS holder, t.started_at, t.progress, l.progress_at AS \"progress_at?\", \
             l.counts_from AS \"counts_from?\", l.p95 AS \"p95?\" FROM jobs j \
             CROSS JOIN bookings b ON b.plan_id = j.plan_id AND b.job_id = j.id \
             JOIN tasks t INDEXED BY tasks_of_bookings \
             ON t.job_id = b.job_id AND t.frame = b.frame AND t.booked_part = b.part \
             LEFT JOIN leases l ON t.state = 'leased' AND l.task_id = t.id AND l.fence = t.fence \
             WHERE j.state IN ('booked', 'rendering') AND t.state IN ('waiting', 'ready', 'leased') "
                + $rest
            $(, $value)*
        )
    };
}

impl Store {
    /// The bookings of frames that are not rendered yet, by start.
    pub async fn open_bookings(&self) -> Result<Vec<OpenBooking>> {
        open(&mut *self.readers().acquire().await?).await
    }

    /// The open bookings that end after `from` and start before `to`, after a place in the order of start and id,
    /// at most `limit`.
    pub async fn open_bookings_page(
        &self,
        (from, to): (Option<Timestamp>, Option<Timestamp>),
        after: Option<(Timestamp, BookingId)>,
        limit: u32,
    ) -> Result<Vec<Booking>> {
        let (start, id) = after.map_or((i64::MIN, uuid::Uuid::nil()), |(start, id)| (start.micros(), id.0));
        let rows = rows!(
            "AND (b.start_at, b.id) > (?, ?) AND b.end_at > ? AND b.start_at < ? \
             ORDER BY b.start_at, b.id LIMIT ?",
            start,
            id,
            from.map_or(i64::MIN, Timestamp::micros),
            to.map_or(i64::MAX, Timestamp::micros),
            limit
        )
        .fetch_all(self.readers())
        .await?;
        Ok(rows.into_iter().map(|row| OpenBooking::from(row).booking).collect())
    }
}

pub(crate) async fn open(connection: &mut SqliteConnection) -> Result<Vec<OpenBooking>> {
    let rows = rows!("ORDER BY b.start_at, b.id").fetch_all(&mut *connection).await?;
    with_slowness(connection, rows).await
}

pub(crate) async fn open_of(connection: &mut SqliteConnection, job: JobId) -> Result<Vec<OpenBooking>> {
    let rows = rows!("AND j.id = ? ORDER BY b.start_at, b.id", job.0).fetch_all(&mut *connection).await?;
    with_slowness(connection, rows).await
}

async fn with_slowness(connection: &mut SqliteConnection, rows: Vec<Row>) -> Result<Vec<OpenBooking>> {
    let mut bookings: Vec<OpenBooking> = rows.into_iter().map(OpenBooking::from).collect();
    let held = bookings.iter_mut().filter_map(|OpenBooking { booking, holder, .. }| {
        let length = booking.end.micros_since(booking.start);
        Some(HeldTask { job: booking.job_id, booked_on: booking.node_id, length, holder: holder.as_mut()? })
    });
    slowness::set(connection, held).await?;
    Ok(bookings)
}
