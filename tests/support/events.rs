//! Reads a stream of server-sent events.

use super::http::Http;
use forelight_client::{EventParser, ServerEvent};
use forelight_protocol::Event;
use reqwest::{Method, Response, StatusCode};
use std::collections::VecDeque;
use std::time::Duration;

/// An open stream.
pub struct Events {
    response: Response,
    parser: EventParser,
    ready: VecDeque<Event>,
}

impl Events {
    /// Follows `path` from the event after `last`. `None` if no events follow (status 204).
    pub async fn open(http: &Http, path: &str, last: Option<i64>) -> Option<Self> {
        let mut request = http.request(Method::GET, path).header("accept", "text/event-stream");
        if let Some(last) = last {
            request = request.header("last-event-id", last);
        }
        let response = request.send().await.unwrap_or_else(|error| panic!("{path}: {error}"));
        if response.status() == StatusCode::NO_CONTENT {
            return None;
        }
        assert_eq!(response.status(), StatusCode::OK, "{path}");
        assert_eq!(response.headers()["content-type"], "text/event-stream", "{path}");
        Some(Self { response, parser: EventParser::default(), ready: VecDeque::new() })
    }

    /// The next event, or `None` at the end of the stream. Panics after `patience`, or if an event's id or
    /// kind differs from the one in its data.
    pub async fn next(&mut self, patience: Duration) -> Option<Event> {
        loop {
            if let Some(event) = self.ready.pop_front() {
                return Some(event);
            }
            let chunk =
                tokio::time::timeout(patience, self.response.chunk()).await.expect("an event in time");
            let events = self.parser.feed(&chunk.expect("the stream does not break")?);
            self.ready.extend(events.iter().map(checked));
        }
    }

    /// The next `count` events, or fewer at the end of the stream. Panics like [`Events::next`].
    pub async fn take(&mut self, count: usize, patience: Duration) -> Vec<Event> {
        let mut events = Vec::new();
        while events.len() < count
            && let Some(event) = self.next(patience).await
        {
            events.push(event);
        }
        events
    }

    /// All events to the end of the stream. Panics if it does not end within `patience`.
    pub async fn rest(mut self, patience: Duration) -> Vec<Event> {
        let all = tokio::time::timeout(patience, self.take(usize::MAX, patience)).await;
        all.unwrap_or_else(|_| panic!("the stream did not end within {patience:?}"))
    }
}

/// The event in the data. Its id and kind must match the ones beside it.
fn checked(sent: &ServerEvent) -> Event {
    let event: Event =
        serde_json::from_str(&sent.data).unwrap_or_else(|error| panic!("{error}: {}", sent.data));
    assert_eq!(sent.id.as_deref(), Some(event.id.to_string().as_str()), "{sent:?}");
    assert_eq!(sent.kind, event.kind.name(), "{sent:?}");
    event
}
