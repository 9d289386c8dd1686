//! A proxy that loses, doubles and delays messages between workers and the service.
//!
//! Each connection carries one request. The proxy reads it completely, then passes it on or drops it.
//! Responses are passed back as they arrive. A lost message ends its connection without a response, as in a
//! real network.

use forelight_random::Random;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinHandle;

/// Longest head of a request, bytes.
const LONGEST_HEAD: usize = 1 << 16;

/// Number of times each fault was made.
#[derive(Debug, Default)]
pub struct Faults {
    /// Requests that never arrived.
    pub lost_requests: AtomicU64,
    /// Responses that never arrived, although the request did.
    pub lost_answers: AtomicU64,
    /// Requests that arrived twice in a row.
    pub doubled: AtomicU64,
    /// Requests that arrived again seconds later.
    pub late: AtomicU64,
    /// Requests that arrived late.
    pub delayed: AtomicU64,
}

/// A proxy. It stops when this value is dropped.
pub struct Proxy {
    address: SocketAddr,
    calm: Arc<AtomicBool>,
    faults: Arc<Faults>,
    listening: JoinHandle<()>,
}

impl Proxy {
    /// A proxy for the service at `address` (`http://host:port`). The faults follow from the seed and the
    /// order of connections.
    pub async fn start(address: &str, seed: u64) -> Self {
        let service: SocketAddr = address
            .strip_prefix("http://")
            .and_then(|address| address.parse().ok())
            .expect("an address of HTTP");
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("a socket has an address");
        let (calm, faults) = (Arc::new(AtomicBool::new(false)), Arc::new(Faults::default()));
        let listening = {
            let (calm, faults) = (calm.clone(), faults.clone());
            tokio::spawn(async move {
                let mut random = Random::new(seed);
                while let Ok((client, _)) = listener.accept().await {
                    let seed = random.number();
                    let faults = (!calm.load(Ordering::Relaxed)).then(|| faults.clone());
                    // A broken connection is not an error here.
                    tokio::spawn(
                        async move { drop(serve(client, service, Random::new(seed), faults).await) },
                    );
                }
            })
        };
        Self { address, calm, faults, listening }
    }

    /// `http://host:port`.
    pub fn address(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Makes no more faults.
    pub fn calm(&self) {
        self.calm.store(true, Ordering::Relaxed);
    }

    /// Number of times each fault was made.
    pub fn faults(&self) -> &Faults {
        &self.faults
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.listening.abort();
    }
}

async fn serve(
    mut client: TcpStream,
    service: SocketAddr,
    mut random: Random,
    faults: Option<Arc<Faults>>,
) -> std::io::Result<()> {
    let request = read_request(&mut client).await?;
    let count = |counter: &AtomicU64| {
        counter.fetch_add(1, Ordering::Relaxed);
    };
    let Some(faults) = faults else {
        let answer = ask(service, &request).await?;
        return client.write_all(&answer).await;
    };
    let moment = Duration::from_millis(random.below(600));
    match random.below(100) {
        0..4 => count(&faults.lost_requests),
        4..8 => {
            count(&faults.lost_answers);
            ask(service, &request).await?;
        }
        8..13 => {
            count(&faults.doubled);
            let (first, second) = tokio::join!(ask(service, &request), ask(service, &request));
            client.write_all(&first.or(second)?).await?;
        }
        13..18 => {
            count(&faults.late);
            let answer = ask(service, &request).await?;
            client.write_all(&answer).await?;
            drop(client);
            tokio::time::sleep(4 * moment).await;
            ask(service, &request).await?;
        }
        18..30 => {
            count(&faults.delayed);
            tokio::time::sleep(moment).await;
            let answer = ask(service, &request).await?;
            client.write_all(&answer).await?;
        }
        _ => {
            let answer = ask(service, &request).await?;
            client.write_all(&answer).await?;
        }
    }
    Ok(())
}

/// Reads a complete request, and asks for the connection to close after its response.
async fn read_request(client: &mut TcpStream) -> std::io::Result<Vec<u8>> {
    let broken = || std::io::Error::from(std::io::ErrorKind::InvalidData);
    let mut bytes = Vec::new();
    let head = loop {
        if let Some(end) = bytes.windows(4).position(|window| window == b"\r\n\r\n") {
            break end + 4;
        }
        if bytes.len() > LONGEST_HEAD || client.read_buf(&mut bytes).await? == 0 {
            return Err(broken());
        }
    };
    let text = std::str::from_utf8(&bytes[..head]).map_err(|_| broken())?;
    let length = text.lines().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.eq_ignore_ascii_case("content-length").then(|| value.trim().parse::<usize>())
    });
    let length = length.transpose().map_err(|_| broken())?.unwrap_or(0);
    while bytes.len() < head + length {
        if client.read_buf(&mut bytes).await? == 0 {
            return Err(broken());
        }
    }
    bytes.splice(head - 2..head - 2, *b"connection: close\r\n");
    Ok(bytes)
}

/// Sends a request, and returns the whole response.
async fn ask(service: SocketAddr, request: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut service = TcpStream::connect(service).await?;
    service.write_all(request).await?;
    let mut answer = Vec::new();
    service.read_to_end(&mut answer).await?;
    if answer.is_empty() { Err(std::io::ErrorKind::ConnectionReset.into()) } else { Ok(answer) }
}
