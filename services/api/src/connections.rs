//! Accepts connections, answers them, and closes them in order.
//!
//! A farm has one connection per worker, nearly all idle, so the memory of an idle one counts. Therefore only
//! HTTP/1.1 is served without TLS, and each connection lies in one box that is never moved. With TLS,
//! browsers choose HTTP/2.

mod tls;

use std::time::Duration;

use axum::Router;
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper_util::rt::TokioIo;
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio_util::either::Either;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt as _;

pub(crate) use self::tls::Tls;
pub use self::tls::TlsError;
use self::tls::{answer_http_2, speaks_http_2};
use crate::extract::PeerAddress;

/// Most bytes of a request's head, and of read-ahead into a body.
const BUFFER: usize = 64 << 10;

/// Pause when the system is out of files or memory for a connection. Others have to end first.
const NO_ROOM: Duration = Duration::from_millis(200);

/// Serves until `stopping` is cancelled; returns once all running requests are answered.
pub(crate) async fn serve(
    listener: TcpListener,
    router: Router,
    tls: Option<Tls>,
    stopping: CancellationToken,
) {
    let connections = TaskTracker::new();
    loop {
        let accepted = tokio::select! {
            () = stopping.cancelled() => break,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, peer)) => {
                let peer = PeerAddress(peer.ip());
                let (router, tls, stopping) = (router.clone(), tls.clone(), stopping.clone());
                drop(connections.spawn(Box::pin(answer(stream, peer, router, tls, stopping))))
            }
            Err(error) if is_of_one_connection(&error) => {}
            Err(error) => {
                tracing::error!(%error, "a connection could not be accepted");
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
    peer: PeerAddress,
    router: Router,
    tls: Option<Tls>,
    stopping: CancellationToken,
) {
    // An answer is one write, so there is nothing to wait for.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "TCP_NODELAY could not be set; answers may be a little late");
    }
    let router = router.map_request(move |mut request: Request<Incoming>| {
        request.extensions_mut().insert(peer);
        request
    });
    let service = TowerToHyperService::new(router);
    let stream = match tls {
        None => Either::Left(stream),
        Some(tls) => match tls.accept(stream).await {
            None => return,
            Some(stream) if speaks_http_2(&stream) => {
                // Few connections are browsers', so those of workers need no room for this.
                return Box::pin(answer_http_2(stream, service, stopping)).await;
            }
            Some(stream) => Either::Right(Box::new(stream)),
        },
    };
    let mut connection = std::pin::pin!(
        http1::Builder::new().max_buf_size(BUFFER).serve_connection(TokioIo::new(stream), service)
    );
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        () = stopping.cancelled() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(%error, "a connection broke");
    }
}

/// Whether the error concerns only one connection, so the next may succeed.
fn is_of_one_connection(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}
