//! Server-sent events. A stream is a place in the table of events. So a client that returns with
//! `Last-Event-ID` misses nothing and sees nothing twice, even after a restart of the service.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use forelight_protocol::{EventId, EventKind, JobId, ProblemKind};
use forelight_store::StoreError;
use forelight_store::tokens::Principal;
use futures::stream;
use serde::Deserialize;
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use utoipa::{IntoParams, ToSchema};

use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{QueryParameters, Reader, SeenJob};
use crate::feed::{BATCH, Batch, Feed};
use crate::schema::LastEventIdHeader;
use crate::state::App;

/// Interval of comments on a quiet stream. They keep proxies open and reveal dead clients.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// Events that come within this time of others are sent together. A farm of thousands of workers writes
/// hundreds a second, and hundreds of pages are told of them.
const TOGETHER: Duration = Duration::from_millis(100);

/// Where to start, and what to tell.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct OfFarm {
    /// The last event seen, for clients that cannot set `Last-Event-ID`. The header takes precedence.
    pub last_event_id: Option<EventId>,
    /// Whether the stream also has messages named `farm`, without an id: each is a `FarmSummary` as JSON, some
    /// seconds after events. Only who reaches all projects gets them.
    #[serde(default)]
    pub summaries: bool,
}

/// Where to start.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct FromEvent {
    /// The last event seen, for clients that cannot set `Last-Event-ID`. The header takes precedence.
    pub last_event_id: Option<EventId>,
}

/// Fields of each event on the stream.
#[derive(ToSchema)]
#[allow(dead_code, reason = "describes the lines of a stream")]
pub(crate) struct EventMessage {
    /// The event's id. Send it back as `Last-Event-ID`.
    id: String,
    /// The event's kind.
    event: EventKind,
    /// The event, an `Event` in JSON.
    #[schema(content_media_type = "application/json")]
    data: String,
}

/// All events of the farm after `Last-Event-ID`. Without it, from now on.
#[utoipa::path(get, path = "/v1/events", operation_id = "event_list",
    tag = "farm", params(OfFarm, LastEventIdHeader),
    responses((status = 200, description = "The events, each an `Event` as JSON", body = EventMessage, content_type = "text/event-stream"), Problems))]
pub(crate) async fn of_farm(
    State(app): State<App>,
    Reader(caller): Reader,
    QueryParameters(query): QueryParameters<OfFarm>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let newest = app.store.last_event_id().await?;
    let after = start(&headers, query.last_event_id, newest)?.unwrap_or(newest);
    let summaries = (query.summaries && caller.reaches_all()).then(|| app.summaries.follow());
    Ok(respond(Cursor { summaries, ..Cursor::new(&app, caller, None, (after, false)) }))
}

/// All events of a job after `Last-Event-ID`. Without it, from its beginning.
///
/// The stream ends when the job is over. A request after that gets 204, which tells a browser to stop asking.
#[utoipa::path(get, path = "/v1/jobs/{id}/events", operation_id = "job_events", tag = "jobs",
    params(("id" = JobId, Path), FromEvent, LastEventIdHeader),
    responses((status = 200, description = "The events, each an `Event` as JSON", body = EventMessage, content_type = "text/event-stream"),
              (status = 204, description = "The job is over and all its events were seen"), Problems))]
pub(crate) async fn of_job(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    Reader(caller): Reader,
    QueryParameters(query): QueryParameters<FromEvent>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let newest = app.store.last_event_id().await?;
    let after = start(&headers, query.last_event_id, newest)?.unwrap_or(0);
    let state = app.store.job(job).await?.state;
    if state.is_final() && app.store.events_after(Some(job), after, 1).await?.is_empty() {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    Ok(respond(Cursor::new(&app, caller, Some(job), (after, state.is_final()))))
}

/// The last event that a client has seen. Numbers beyond the newest are of a farm that was restored from a backup
/// since: such a client goes on with what is new here.
fn start(headers: &HeaderMap, in_query: Option<EventId>, newest: EventId) -> ApiResult<Option<EventId>> {
    let seen = match headers.get("last-event-id") {
        None => in_query,
        Some(header) => {
            let id = header.to_str().ok().and_then(|text| text.trim().parse().ok());
            Some(id.ok_or_else(|| {
                ApiError::new(ProblemKind::Malformed, "Last-Event-ID is the number of an event")
                    .in_parameter("Last-Event-ID")
            })?)
        }
    };
    Ok(seen.map(|id| id.min(newest)))
}

/// The stream of events after the cursor's place.
fn respond(cursor: Cursor) -> Response {
    let body = Body::from_stream(stream::unfold(cursor, |mut cursor| async move {
        let text = cursor.next().await?;
        Some((Ok::<_, Infallible>(text), cursor))
    }));
    let headers = [(CONTENT_TYPE, "text/event-stream"), (CACHE_CONTROL, "no-cache")];
    (headers, body).into_response()
}

struct Cursor {
    /// He is told of his projects' jobs only.
    caller: Principal,
    feed: Arc<Feed>,
    job: Option<JobId>,
    /// The last event that was read.
    after: EventId,
    changes: watch::Receiver<u64>,
    /// Summaries of the farm, if it tells them.
    summaries: Option<watch::Receiver<Arc<str>>>,
    stopping: CancellationToken,
    /// Whether the job is over. Existing later events, such as refusals of late workers, are still sent; none
    /// are waited for.
    over: bool,
    /// When it last sent all that there was.
    caught_up: Option<Instant>,
}

impl Cursor {
    fn new(app: &App, caller: Principal, job: Option<JobId>, (after, over): (EventId, bool)) -> Self {
        Self {
            caller,
            feed: app.feed.clone(),
            job,
            after,
            changes: app.store.watch_events(),
            summaries: None,
            stopping: app.stopping.clone(),
            over,
            caught_up: None,
        }
    }

    /// The next events, or a comment if there are none for long. `None` when the job is over, the service
    /// stops, or the database fails.
    async fn next(&mut self) -> Option<Bytes> {
        let quiet_until = Instant::now() + KEEP_ALIVE;
        loop {
            if let Some(before) = self.caught_up.take() {
                tokio::select! {
                    () = tokio::time::sleep_until(before + TOGETHER) => {}
                    () = self.stopping.cancelled() => return None,
                }
            }
            // Marked as seen before reading, so that anything written after the read wakes this stream again.
            self.changes.borrow_and_update();
            let Batch { events, until } = match self.read().await {
                Ok(batch) => batch,
                Err(error) => {
                    tracing::warn!(%error, "an event stream ends");
                    return None;
                }
            };
            self.after = until;
            self.over |= self.job.is_some() && events.iter().any(|event| event.is_last);
            let mine = events.iter().filter_map(|event| event.lines_for(&self.caller));
            let mut text: String = mine.map(String::as_str).collect();
            self.add_new_summary(&mut text);
            if !text.is_empty() {
                self.caught_up = (events.len() < BATCH as usize && !self.over).then(Instant::now);
                return Some(text.into());
            }
            if !events.is_empty() {
                continue;
            }
            if self.over {
                return None;
            }
            tokio::select! {
                changed = self.changes.changed() => changed.ok()?,
                () = self.stopping.cancelled() => return None,
                () = summarized(self.summaries.as_ref()) => {}
                () = tokio::time::sleep_until(quiet_until) => return Some(Bytes::from_static(b":\n\n")),
            }
        }
    }

    /// Adds the summary to a text, unless it was told already.
    fn add_new_summary(&mut self, text: &mut String) {
        if let Some(summaries) = &mut self.summaries
            && summaries.has_changed().is_ok_and(|is_new| is_new)
        {
            text.push_str(&summaries.borrow_and_update());
        }
    }

    async fn read(&self) -> Result<Batch, StoreError> {
        // Nothing wakes the stream of a job that is over. So it takes also what nobody was told of yet.
        if self.over {
            return self.feed.stored_after(self.job, self.after).await;
        }
        self.feed.after(self.job, self.after).await
    }
}

/// Returns when there is a new summary, and leaves it new.
async fn summarized(summaries: Option<&watch::Receiver<Arc<str>>>) {
    let Some(summaries) = summaries else { return std::future::pending().await };
    if summaries.clone().changed().await.is_err() {
        std::future::pending().await
    }
}
