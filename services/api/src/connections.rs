//! Accepts connections, answers them, and closes them in order.
//!
//! A farm has one connection per worker, nearly all idle, so the memory of an idle one counts. Therefore only
//! HTTP/1.1 is served without TLS, and each connection lies in one box that is never moved. With TLS,
//! browsers choose HTTP/2.
//!
//! Hazards:
//!
//! - *Sockets that are held open.* A request's head must arrive within a time, also on a connection that had
//!   other requests. See `admission` for who gives way when there are too many.
//! - *No file is left.* Then a quiet connection is ended, and the next is accepted after a pause.
//! - *A client that does not read.* An answer that cannot be written for a minute is given up.

mod admission;
mod held;
mod tls;

use std::convert::Infallible;
use std::fmt::Display;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulConnection;
use hyper_util::service::TowerToHyperService;
use rustix::process::{Resource, getrlimit};
use tokio::net::{TcpListener, TcpStream};
use tokio_io_timeout::TimeoutWriter;
use tokio_util::either::Either;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::{ServiceExt as _, service_fn};

use self::admission::{Admission, Guest};
pub(crate) use self::tls::Tls;
pub use self::tls::TlsError;
use self::tls::{answer_http_2, speaks_http_2};
use crate::config::ConnectionLimits;
use crate::extract::PeerAddress;

pub(crate) use self::admission::Standing;
pub(crate) use self::held::Holds;

/// Most bytes of a request's head, and of read-ahead into a body.
const BUFFER: usize = 64 << 10;

/// Pause when the system is out of files or memory for a connection. Others have to end first.
const NO_ROOM: Duration = Duration::from_millis(200);

/// Files that the service itself may have open: database, artefacts, uploads. With a low limit, half of it.
const OWN_FILES: u64 = 256;

/// Most connections, whatever the system allows.
const MOST_CONNECTIONS: u64 = 16_384;

/// How many connections the system's limit of open files allows.
fn allowed_by_files(limit: Option<u64>) -> usize {
    let limit = limit.unwrap_or(u64::MAX);
    let connections = limit.saturating_sub(OWN_FILES).max(limit / 2).min(MOST_CONNECTIONS);
    usize::try_from(connections).unwrap_or(usize::MAX)
}

/// Serves until `stopping` is cancelled; returns once all running requests are answered.
pub(crate) async fn serve(
    listener: TcpListener,
    router: Router,
    tls: Option<Tls>,
    limits: ConnectionLimits,
    stopping: CancellationToken,
) {
    let most = limits.at_once.unwrap_or_else(|| allowed_by_files(getrlimit(Resource::Nofile).current));
    let admission = Admission::new(most);
    let connections = TaskTracker::new();
    let mut lacks_files = false;
    loop {
        let accepted = tokio::select! {
            () = stopping.cancelled() => break,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, peer)) => {
                lacks_files = false;
                // Without a seat, the connection is closed at once.
                let Some(guest) = admission.admit(peer.ip()) else { continue };
                let peer = PeerAddress(peer.ip());
                let (router, tls, stopping) = (router.clone(), tls.clone(), stopping.clone());
                drop(connections.spawn(Box::pin(answer(stream, guest, peer, router, tls, limits, stopping))));
            }
            Err(error) if is_of_one_connection(&error) => {}
            Err(error) => {
                // It goes on until somebody leaves, so it is told once.
                if !std::mem::replace(&mut lacks_files, true) {
                    tracing::error!(%error, "a connection could not be accepted; quiet ones are ended");
                }
                admission.make_room();
                tokio::time::sleep(NO_ROOM).await;
            }
        }
    }
    drop(listener);
    connections.close();
    connections.wait().await;
}

async fn answer(
    stream: TcpStream,
    guest: Guest,
    peer: PeerAddress,
    router: Router,
    tls: Option<Tls>,
    limits: ConnectionLimits,
    stopping: CancellationToken,
) {
    // An answer is one write, so there is nothing to wait for.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "TCP_NODELAY could not be set; answers may be a little late");
    }
    let mut stream = TimeoutWriter::new(stream);
    stream.set_timeout(Some(limits.answer_silence));
    let stream = Box::pin(stream);
    let ends = Ends { gives_way: guest.gives_way.clone(), stopping };
    let guest = Arc::new(guest);
    let router = service_fn(move |mut request: Request<Incoming>| {
        let holds = Holds::new(guest.request());
        request.extensions_mut().insert(peer);
        request.extensions_mut().insert(holds.clone());
        let router = router.clone();
        async move {
            let response = router.oneshot(request).await?;
            Ok::<_, Infallible>(response.map(|body| holds.until_sent(body)))
        }
    });
    let service = TowerToHyperService::new(router);
    let stream = match tls {
        None => Either::Left(stream),
        Some(tls) => match tls.accept(stream).await {
            None => return,
            Some(stream) if speaks_http_2(&stream) => {
                // Few connections are browsers', so those of workers need no room for this.
                return Box::pin(answer_http_2(stream, service, ends)).await;
            }
            Some(stream) => Either::Right(Box::new(stream)),
        },
    };
    let connection = std::pin::pin!(
        http1::Builder::new()
            .max_buf_size(BUFFER)
            .timer(TokioTimer::new())
            .header_read_timeout(limits.head_time)
            .serve_connection(TokioIo::new(stream), service)
    );
    ends.wait(connection).await;
}

/// What ends a connection besides its client.
struct Ends {
    /// Cancelled when it has to give way to another one.
    gives_way: CancellationToken,
    /// Cancelled when the service stops: running requests are answered first.
    stopping: CancellationToken,
}

impl Ends {
    /// Serves a connection to its end. It is pinned by the caller, so it is not moved into here.
    async fn wait<C: GracefulConnection<Error: Display>>(&self, mut connection: Pin<&mut C>) {
        let ended = tokio::select! {
            ended = connection.as_mut() => ended,
            () = self.gives_way.cancelled() => return,
            () = self.stopping.cancelled() => {
                connection.as_mut().graceful_shutdown();
                connection.await
            }
        };
        if let Err(error) = ended {
            tracing::debug!(%error, "a connection broke");
        }
    }
}

/// Whether the error concerns only one connection, so the next may succeed.
fn is_of_one_connection(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_leave_files_for_the_service_itself() {
        assert_eq!(allowed_by_files(Some(400)), 200);
        assert_eq!(allowed_by_files(Some(1024)), 768);
        assert_eq!(allowed_by_files(Some(65_536)), 16_384);
        assert_eq!(allowed_by_files(None), 16_384);
    }
}
