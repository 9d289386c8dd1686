//! Events as they happen.

use crate::client::Client;
use crate::error::ClientError;
use crate::server_events::{EventParser, ServerEvent};
use crate::transport::Request;
use forelight_protocol::{Event, EventId, JobId};
use reqwest::header::{HeaderName, HeaderValue};

impl Client {
    /// A job's events after `after`, until the service closes the stream. Without `after`, all of them.
    pub async fn events(&self, id: JobId, after: Option<EventId>) -> Result<EventStream, ClientError> {
        self.stream(format!("/v1/jobs/{id}/events"), after).await
    }

    /// The farm's events after `after`, until the service closes the stream. Without `after`, from now on.
    pub async fn farm_events(&self, after: Option<EventId>) -> Result<EventStream, ClientError> {
        self.stream("/v1/events".to_owned(), after).await
    }

    async fn stream(&self, path: String, after: Option<EventId>) -> Result<EventStream, ClientError> {
        let mut request = Request::get(path).timeout(None);
        if let Some(after) = after {
            request.headers.insert(HeaderName::from_static("last-event-id"), HeaderValue::from(after));
        }
        let response = self.transport.send(&request).await?;
        Ok(EventStream { response, parser: EventParser::default(), ready: Vec::new().into_iter() })
    }
}

/// An open stream of events.
#[derive(Debug)]
pub struct EventStream {
    response: reqwest::Response,
    parser: EventParser,
    ready: std::vec::IntoIter<ServerEvent>,
}

impl EventStream {
    /// The next event. `None` if the service ended the stream or the connection broke. Open a new stream
    /// after the last event then. Events of unknown kinds are skipped.
    pub async fn next(&mut self) -> Option<Event> {
        loop {
            for event in self.ready.by_ref() {
                match serde_json::from_str(&event.data) {
                    Ok(event) => return Some(event),
                    Err(error) => tracing::debug!(%error, kind = event.kind, "an event of an unknown kind"),
                }
            }
            match self.response.chunk().await {
                Ok(Some(chunk)) => self.ready = self.parser.feed(&chunk).into_iter(),
                Ok(None) => return None,
                Err(error) => {
                    tracing::debug!(error = %error.without_url(), "the event stream broke");
                    return None;
                }
            }
        }
    }
}
