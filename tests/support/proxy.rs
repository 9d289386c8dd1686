//! A proxy that loses, doubles and delays messages between workers and service.
//!
//! One request a connection: what a client sends is read whole (head, and as many bytes as it announces),
//! then passed on or not; the answer is passed back as it comes. A message that is lost ends its connection
//! without an answer, which is what a network does.

use forelight_random::Random;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinHandle;

/// Longest head of a request.
const LONGEST_HEAD: usize = 1 << 16;

/// How often each fault was made.
#[derive(Debug, Default)]
pub struct Faults {
    /// Requests that never arrived.
    pub lost_requests: AtomicU64,
    /// Answers that never arrived: the request did.
    pub lost_answers: AtomicU64,
    /// Requests that arrived twice, one right after the other.
    pub doubled: AtomicU64,
    /// Requests that arrived once more, seconds later.
    pub late: AtomicU64,
    /// Requests that arrived late.
    pub delayed: AtomicU64,
}

/// A proxy. It ends with this value.
pub struct Proxy {
    address: SocketAddr,
    calm: Arc<AtomicBool>,
    faults: Arc<Faults>,
    listening: JoinHandle<()>,
}

impl Proxy {
    /// A proxy for the service at `address` (`http://host:port`); the faults follow from the seed and the
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
                    // A broken connection is no error here.
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

    /// No more faults from here on.
    pub fn calm(&self) {
        self.calm.store(true, Ordering::Relaxed);
    }

    /// How often each fault was made.
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

/// A request, whole, with the wish that the connection ends after its answer.
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

/// Sends a request, and returns all that comes back.
async fn ask(service: SocketAddr, request: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut service = TcpStream::connect(service).await?;
    service.write_all(request).await?;
    let mut answer = Vec::new();
    service.read_to_end(&mut answer).await?;
    if answer.is_empty() { Err(std::io::ErrorKind::ConnectionReset.into()) } else { Ok(answer) }
}
