//! Server-sent events, read line by line.

use crate::http::Http;
use forelight_protocol::Event;
use reqwest::{Method, Response, StatusCode};
use std::collections::VecDeque;
use std::time::Duration;

/// An open stream.
pub struct Events {
    response: Response,
    text: Vec<u8>,
    ready: VecDeque<Event>,
}

impl Events {
    /// Follows `path` from the event after `last`. `None` if the service answers that there is nothing to
    /// come (204).
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
        Some(Self { response, text: Vec::new(), ready: VecDeque::new() })
    }

    /// The next event; `None` when the service ended the stream. Panics if nothing comes for `patience`, and
    /// if id and kind beside an event are not those inside.
    pub async fn next(&mut self, patience: Duration) -> Option<Event> {
        loop {
            if let Some(event) = self.ready.pop_front() {
                return Some(event);
            }
            let chunk =
                tokio::time::timeout(patience, self.response.chunk()).await.expect("an event in time");
            self.text.extend_from_slice(&chunk.expect("the stream does not break")?);
            while let Some(end) = self.text.windows(2).position(|pair| pair == b"\n\n") {
                let block: Vec<u8> = self.text.drain(..end + 2).collect();
                self.ready.extend(parse(std::str::from_utf8(&block).expect("events are UTF-8")));
            }
        }
    }

    /// All events until the service ends the stream, which it has to do within `patience`.
    pub async fn rest(mut self, patience: Duration) -> Vec<Event> {
        let mut events = Vec::new();
        let all = async {
            while let Some(event) = self.next(patience).await {
                events.push(event);
            }
        };
        let ended = tokio::time::timeout(patience, all).await;
        assert!(ended.is_ok(), "the stream did not end after {:?}", events.last());
        events
    }
}

/// One block of lines; `None` for a comment that keeps the connection open.
fn parse(block: &str) -> Option<Event> {
    let field = |name: &str| block.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
    let data = field("data")?;
    let event: Event = serde_json::from_str(data).unwrap_or_else(|error| panic!("{error}: {data}"));
    assert_eq!(field("id"), Some(event.id.to_string().as_str()), "{block}");
    assert_eq!(field("event"), Some(event.kind.name()), "{block}");
    Some(event)
}
