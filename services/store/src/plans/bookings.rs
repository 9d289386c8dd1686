//! Bookings of frames, and of parts of frames, that are not rendered yet.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use forelight_protocol::{Booking, BookingId, JobId, Node, NodeId, Timestamp};
use sqlx::SqliteConnection;

use crate::columns::{Id, Time};
use crate::database::Store;
use crate::error::Result;
use crate::nodes::read_any;
use crate::policy::overdue::AttemptTimes;
use crate::policy::projection::{Holder, OpenBooking};
use crate::policy::work_stealing::Rates;
use crate::tasks::rates;

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
    let mut speeds = Speeds::default();
    for OpenBooking { booking, holder, .. } in &mut bookings {
        if let Some(holder) = holder {
            let nodes = (booking.node_id, holder.node_id);
            let length = booking.end.micros_since(booking.start);
            holder.slowness = speeds.slowness(connection, booking.job_id, nodes, length).await?;
        }
    }
    Ok(bookings)
}

/// Speeds of nodes for the work of jobs, each read once.
#[derive(Default)]
pub(crate) struct Speeds {
    nodes: BTreeMap<NodeId, Node>,
    jobs: BTreeMap<JobId, Rates>,
}

impl Speeds {
    /// How many times as long a task of the job takes on the second of these nodes as on the first, where it is
    /// booked for `length` microseconds.
    pub async fn slowness(
        &mut self,
        connection: &mut SqliteConnection,
        job: JobId,
        (booked, holder): (NodeId, NodeId),
        length: i64,
    ) -> Result<f64> {
        if booked == holder {
            return Ok(1.0);
        }
        let of_job = match self.jobs.entry(job) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(unknown) => unknown.insert(rates(connection, job).await?),
        };
        let (mut speeds, mut serial) = ([0.0; 2], [0; 2]);
        for ((speed, serial), id) in speeds.iter_mut().zip(&mut serial).zip([booked, holder]) {
            let node = match self.nodes.entry(id) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(unknown) => unknown.insert(read_any(connection, id).await?),
            };
            *speed = node.speed_for(of_job.work.as_ref()) * f64::from(node.cores);
            *serial = of_job.serial.on(node.cores);
        }
        // A booking that was made before serial time was learnt has none.
        let shared = length.saturating_sub(serial[0]).max(length / 10) as f64;
        let slowness = (shared * speeds[0] / speeds[1] + serial[1] as f64) / length as f64;
        Ok(if slowness.is_finite() && slowness > 0.0 { slowness } else { 1.0 })
    }
}
