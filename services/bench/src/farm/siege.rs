//! Clients that hold what they can, beside the workers of `forelight bench workers`.

use anyhow::{Context, Result};
use serde::Serialize;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::task::JoinSet;

/// How many of each kind there are.
#[derive(Debug, Clone, Default, clap::Args, Serialize)]
#[command(next_help_heading = "Clients that hold what they can")]
pub struct Besiegers {
    /// Connections on which nothing is sent; opened again when they are closed
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=20_000))]
    pub idle: u32,
    /// Connections on which a request is sent a byte a second
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=20_000))]
    pub slow: u32,
    /// Clients that ask for costly answers, one after the other, each for another one
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=20_000))]
    pub costly: u32,
    /// Uploads of bundles, a byte every 20 seconds
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=1000))]
    pub trickled: u32,
}

/// What came of it.
#[derive(Debug, Default, Serialize)]
pub struct Besieged {
    /// Connections that the service closed, or did not accept.
    pub closed: u64,
    /// Costly answers by HTTP status; 0 if none came.
    pub answers: BTreeMap<u16, u64>,
}

/// The clients, which go on until this is dropped.
pub struct Siege {
    clients: JoinSet<()>,
    closed: Arc<AtomicU64>,
    answers: Arc<parking_lot::Mutex<BTreeMap<u16, u64>>>,
}

/// Pause after a connection was closed.
const AGAIN: Duration = Duration::from_secs(1);

impl Besiegers {
    pub fn all(&self) -> u32 {
        self.idle + self.slow + self.costly + self.trickled
    }

    /// Starts the clients. `tokens` are those of a viewer and a submitter, `jobs` have answers about their plan.
    pub fn start(&self, address: &str, tokens: [&str; 2], jobs: &[String]) -> Result<Siege> {
        let address: SocketAddr =
            address.trim_start_matches("http://").parse().context("the service's address")?;
        let mut siege = Siege { clients: JoinSet::new(), closed: Arc::default(), answers: Arc::default() };
        for _ in 0..self.idle {
            siege.hold(address, String::new(), Duration::from_secs(1));
        }
        for _ in 0..self.slow {
            let request =
                format!("GET /healthz HTTP/1.1\r\nHost: a\r\nX-Padding: {}\r\n\r\n", "x".repeat(600));
            siege.hold(address, request, Duration::from_secs(1));
        }
        let [viewer, submitter] = tokens;
        for _ in 0..self.trickled {
            let head = format!(
                "POST /v1/bundles HTTP/1.1\r\nHost: a\r\nAuthorization: Bearer {submitter}\r\n\
                 Content-Type: application/zip\r\nContent-Length: 200000000\r\n\r\n"
            );
            siege.trickle(address, head);
        }
        for number in 0..self.costly {
            siege.ask(address, viewer.to_owned(), jobs.to_vec(), number);
        }
        Ok(siege)
    }
}

impl Siege {
    /// Keeps a connection open, and sends the text byte by byte, again and again.
    fn hold(&mut self, address: SocketAddr, text: String, pause: Duration) {
        let closed = self.closed.clone();
        self.clients.spawn(async move {
            loop {
                if let Ok(mut socket) = TcpStream::connect(address).await {
                    let mut bytes = text.bytes().cycle();
                    let mut answer = [0; 512];
                    loop {
                        tokio::select! {
                            read = socket.read(&mut answer) => if !matches!(read, Ok(1..)) { break },
                            () = tokio::time::sleep(pause) => {
                                let Some(byte) = bytes.next() else { continue };
                                if socket.write_all(&[byte]).await.is_err() {
                                    break;
                                }
                            }
                        }
                    }
                }
                closed.fetch_add(1, Ordering::Relaxed);
                tokio::time::sleep(AGAIN).await;
            }
        });
    }

    /// Uploads a byte now and then.
    fn trickle(&mut self, address: SocketAddr, head: String) {
        let closed = self.closed.clone();
        self.clients.spawn(async move {
            loop {
                if let Ok(mut socket) = TcpStream::connect(address).await
                    && socket.write_all(head.as_bytes()).await.is_ok()
                {
                    let mut answer = [0; 512];
                    loop {
                        tokio::select! {
                            _ = socket.read(&mut answer) => break,
                            () = tokio::time::sleep(Duration::from_secs(20)) => {
                                if socket.write_all(b"x").await.is_err() {
                                    break;
                                }
                            }
                        }
                    }
                }
                closed.fetch_add(1, Ordering::Relaxed);
                tokio::time::sleep(AGAIN).await;
            }
        });
    }

    /// Asks for one costly answer after the other. No two are the same, so none is kept from the one before.
    fn ask(&mut self, address: SocketAddr, token: String, jobs: Vec<String>, number: u32) {
        let answers = self.answers.clone();
        self.clients.spawn(async move {
            for turn in 0u64.. {
                let job = &jobs[(u64::from(number) + turn) as usize % jobs.len()];
                let budget = u64::from(number) * 1_000_000 + turn;
                let request = format!(
                    "GET /v1/jobs/{job}/answers?budget={budget} HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\
                     Authorization: Bearer {token}\r\n\r\n"
                );
                let status = answer(address, &request).await.unwrap_or(0);
                *answers.lock().entry(status).or_insert(0) += 1;
                if status == 0 {
                    tokio::time::sleep(AGAIN).await;
                }
            }
        });
    }

    /// Ends the clients.
    pub fn end(self) -> Besieged {
        Besieged { closed: self.closed.load(Ordering::Relaxed), answers: self.answers.lock().clone() }
    }
}

/// The status of the answer, once all of it has come.
async fn answer(address: SocketAddr, request: &str) -> Option<u16> {
    let mut socket = TcpStream::connect(address).await.ok()?;
    socket.write_all(request.as_bytes()).await.ok()?;
    let mut head = Vec::new();
    let mut buffer = vec![0; 16 << 10];
    loop {
        let read = socket.read(&mut buffer).await.ok()?;
        if read == 0 {
            break;
        }
        head.extend_from_slice(&buffer[..read.min(64_usize.saturating_sub(head.len()))]);
    }
    std::str::from_utf8(head.get(9..12)?).ok()?.parse().ok()
}
