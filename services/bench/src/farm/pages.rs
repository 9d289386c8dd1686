//! Open dashboard pages beside the workers of `forelight bench workers`.
//!
//! Each follows the farm's events and summaries, and asks for the dashboard each half minute, as the real page
//! does. People open pages at different times, so the pages ask one after the other.

use anyhow::{Context, Result};
use forelight_protocol::Timestamp;
use parking_lot::Mutex;
use serde::Serialize;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::task::JoinSet;
use tokio::time::Instant;

use crate::statistics::quantile;

/// How long after an answer a page asks again, as in `services/dashboard/src/state/farm.ts`.
const QUIET: Duration = Duration::from_secs(30);

/// What begins the time of an event in its JSON form. Summaries have their time first.
const AT: &[u8] = b",\"at\":\"";

/// What pages saw, in milliseconds.
#[derive(Debug, Default, Serialize)]
pub struct PagesSeen {
    /// Events that arrived, of all pages together.
    pub events: usize,
    /// From an event's time to its arrival.
    pub event_p50_ms: f64,
    pub event_p99_ms: f64,
    pub event_longest_ms: f64,
    /// From the request for the dashboard to its last byte, compressed.
    pub dashboards: usize,
    pub dashboard_p50_ms: f64,
    pub dashboard_p99_ms: f64,
    /// Streams that ended, and requests without an answer.
    pub failures: usize,
}

#[derive(Default)]
struct Seen {
    events: Vec<f64>,
    dashboards: Vec<f64>,
    failures: usize,
}

/// The pages, which go on until this is ended.
pub struct Pages {
    clients: JoinSet<()>,
    seen: Arc<Mutex<Seen>>,
}

impl Pages {
    /// Opens so many pages of a viewer with this token.
    pub fn open(number: u32, address: &str, token: &str) -> Result<Self> {
        let address: SocketAddr =
            address.trim_start_matches("http://").parse().context("the service's address")?;
        let mut pages = Self { clients: JoinSet::new(), seen: Arc::default() };
        for page in 0..number {
            let (seen, token) = (pages.seen.clone(), token.to_owned());
            let first = QUIET.mul_f64(f64::from(page) / f64::from(number));
            pages.clients.spawn(async move {
                tokio::join!(follow(address, &token, &seen), ask(address, &token, first, &seen));
            });
        }
        Ok(pages)
    }

    /// Closes the pages.
    pub fn end(mut self) -> PagesSeen {
        self.clients.abort_all();
        let mut seen = std::mem::take(&mut *self.seen.lock());
        seen.events.sort_by(f64::total_cmp);
        seen.dashboards.sort_by(f64::total_cmp);
        PagesSeen {
            events: seen.events.len(),
            event_p50_ms: quantile(&seen.events, 0.5),
            event_p99_ms: quantile(&seen.events, 0.99),
            event_longest_ms: quantile(&seen.events, 1.0),
            dashboards: seen.dashboards.len(),
            dashboard_p50_ms: quantile(&seen.dashboards, 0.5),
            dashboard_p99_ms: quantile(&seen.dashboards, 0.99),
            failures: seen.failures,
        }
    }
}

async fn request(address: SocketAddr, path: &str, token: &str) -> std::io::Result<TcpStream> {
    let mut socket = TcpStream::connect(address).await?;
    let head = format!(
        "GET {path} HTTP/1.1\r\nHost: a\r\nConnection: close\r\nAccept-Encoding: gzip\r\n\
         Authorization: Bearer {token}\r\n\r\n"
    );
    socket.write_all(head.as_bytes()).await?;
    Ok(socket)
}

/// Notes how late each event comes. Opens the stream anew when it ends.
async fn follow(address: SocketAddr, token: &str, seen: &Mutex<Seen>) {
    loop {
        if let Ok(mut socket) = request(address, "/v1/events?summaries=true", token).await {
            let mut text = Vec::new();
            let mut buffer = vec![0; 64 << 10];
            while let Ok(read @ 1..) = socket.read(&mut buffer).await {
                text.extend_from_slice(&buffer[..read]);
                let (late, used) = lateness(&text, Timestamp::now());
                text.drain(..used);
                seen.lock().events.extend(late);
            }
        }
        seen.lock().failures += 1;
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
}

/// How long ago the events of a text happened, in milliseconds, and how much of the text has been read.
fn lateness(text: &[u8], now: Timestamp) -> (Vec<f64>, usize) {
    let (mut late, mut used) = (Vec::new(), 0);
    loop {
        let Some(found) = text[used..].windows(AT.len()).position(|part| part == AT) else {
            // The last bytes may be the first ones of a time.
            return (late, used.max(text.len().saturating_sub(AT.len())));
        };
        used += found;
        let rest = &text[used + AT.len()..];
        let Some(length) = rest.iter().position(|&byte| byte == b'"') else { return (late, used) };
        let at = std::str::from_utf8(&rest[..length]).ok().and_then(|at| at.parse::<Timestamp>().ok());
        late.extend(at.map(|at| now.micros_since(at) as f64 / 1e3));
        used += AT.len() + length;
    }
}

async fn ask(address: SocketAddr, token: &str, first: Duration, seen: &Mutex<Seen>) {
    tokio::time::sleep(first).await;
    loop {
        let begun = Instant::now();
        let asked = async {
            let mut answer = Vec::new();
            request(address, "/v1/dashboard", token).await?.read_to_end(&mut answer).await?;
            std::io::Result::Ok(answer.starts_with(b"HTTP/1.1 200"))
        };
        let is_answered = asked.await.unwrap_or(false);
        {
            let mut seen = seen.lock();
            match is_answered {
                true => seen.dashboards.push(1e3 * begun.elapsed().as_secs_f64()),
                false => seen.failures += 1,
            }
        }
        tokio::time::sleep(QUIET).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_times_of_events_are_found_wherever_the_text_is_cut() {
        let at = |seconds: i64| Timestamp::from_micros(1_700_000_000_000_000 + seconds * 1_000_000);
        let event =
            |seconds| format!("id: 7\ndata: {{\"id\":7,\"at\":\"{}\",\"kind\":\"x\"}}\n\n", at(seconds));
        let text = event(1) + &event(3);
        let whole = lateness(text.as_bytes(), at(5)).0;
        assert_eq!(whole, [4000.0, 2000.0]);
        for cut in 0..text.len() {
            let (mut late, used) = lateness(&text.as_bytes()[..cut], at(5));
            late.extend(lateness(&text.as_bytes()[used..], at(5)).0);
            assert_eq!(late, whole, "cut at {cut}");
        }
    }
}
