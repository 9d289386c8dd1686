//! The farm's events, in one order.

mod reading;

use forelight_protocol::{Event, EventId, EventKind, JobId, JobState, Node, Timestamp};
use sqlx::SqliteConnection;

use crate::columns::Json;
use crate::error::Result;
use crate::writing::{Write, later, run};

/// How long progress events are kept: an hour, in microseconds. For all others see `retention`.
const PROGRESS_KEPT: i64 = 3_600_000_000;

/// An event with only its kind and time.
pub(crate) fn event(kind: EventKind, now: Timestamp) -> Event {
    Event {
        id: 0,
        at: now,
        kind,
        job_id: None,
        job_name: None,
        job_state: None,
        task_id: None,
        task_kind: None,
        frame: None,
        part: None,
        node_id: None,
        node_state: None,
        project: None,
        frames_done: None,
        cost: None,
        plan_id: None,
        progress: None,
        off_forecast: None,
        promise: None,
        job: None,
        message: None,
    }
}

/// Appends an event. The database assigns its id.
pub(crate) fn append(write: &mut Write, event: Event) {
    later!(
        write,
        "INSERT INTO events (at, kind, job_id, body) VALUES (?, ?, ?, ?)",
        event.at.micros(),
        event.kind.name(),
        event.job_id.map(|job| job.0),
        Json(&event)
    );
    write.wrote_events = true;
}

pub(crate) fn job_state(
    write: &mut Write,
    job: JobId,
    state: JobState,
    message: Option<String>,
    now: Timestamp,
) {
    let of_job = Event { job_id: Some(job), job_state: Some(state), ..event(EventKind::JobState, now) };
    append(write, Event { message, ..of_job });
}

/// An event about a node, with the state that it has now.
pub(crate) fn node_event(write: &mut Write, kind: EventKind, node: &Node, message: String, now: Timestamp) {
    let of_node = Event { node_id: Some(node.id), node_state: Some(node.state), ..event(kind, now) };
    append(write, Event { message: Some(message), ..of_node });
}

pub(crate) async fn forget_old_progress(write: &mut Write, now: Timestamp) -> Result<()> {
    run!(
        write,
        "DELETE FROM events WHERE kind = 'task_progress' AND at < ?",
        now.plus_micros(-PROGRESS_KEPT).micros()
    );
    Ok(())
}

pub(crate) struct EventRow {
    pub id: EventId,
    pub body: Json<Event>,
    /// The project of its job.
    pub project: Option<String>,
    /// The name of its job.
    pub job_name: Option<String>,
}

impl From<EventRow> for Event {
    fn from(EventRow { id, body, project, job_name }: EventRow) -> Self {
        Event { id, project: body.0.project.or(project), job_name, ..body.0 }
    }
}

/// Rows of events: `event_rows!("WHERE e.id > ?", after)`.
macro_rules! event_rows {
    ($rest:literal $(, $value:expr)* $(,)?) => {
        sqlx::query_as!(
            $crate::events::EventRow,
            "SELECT e.id, e.body, j.project AS \"project?\", j.name AS \"job_name?\" \
             FROM events e LEFT JOIN jobs j ON j.id = e.job_id "
                + $rest
            $(, $value)*
        )
    };
}
pub(crate) use event_rows;

/// The newest events of the farm, newest first, without those that every task writes. However many these are, the
/// index has the others.
pub(crate) async fn newest(connection: &mut SqliteConnection, limit: u32) -> Result<Vec<Event>> {
    let rows = event_rows!(
        "WHERE e.id IN (SELECT id FROM events INDEXED BY events_told WHERE kind NOT IN ('task_leased', \
         'task_submitted', 'task_progress', 'task_done', 'task_late', 'task_stalled', 'lease_released', \
         'lease_lost') ORDER BY id DESC LIMIT ?) ORDER BY e.id DESC",
        limit
    )
    .fetch_all(connection)
    .await?;
    Ok(rows.into_iter().map(Event::from).collect())
}

/// The id of the newest event; 0 if there is none.
pub(crate) async fn last_id(connection: &mut SqliteConnection) -> Result<EventId> {
    Ok(sqlx::query_scalar!(r#"SELECT coalesce(max(id), 0) AS "id!" FROM events"#)
        .fetch_one(connection)
        .await?)
}
