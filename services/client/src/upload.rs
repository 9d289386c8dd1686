//! Sends long bodies, and gives up those whose connection falls silent. The HTTP library's own limit would count a
//! whole upload as silence of the service.

use bytes::Bytes;
use futures::{Stream, StreamExt as _, stream};
use reqwest::header::CONTENT_LENGTH;
use reqwest::{RequestBuilder, Response};
use std::time::Duration;
use tokio::sync::watch;
use tokio_util::io::ReaderStream;

pub(crate) type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// After an upload, the service still receives and checks the body: of a large scene, this takes minutes.
const ANSWER_TO_UPLOAD: Duration = Duration::from_secs(900);

/// Bytes of an upload that are handed to the connection at a time.
const PIECE: usize = 1 << 16;

/// Sends a body that is in memory. No piece of it may take longer than `silence`.
pub(crate) async fn bytes(
    request: RequestBuilder,
    body: Bytes,
    silence: Duration,
) -> Result<Response, BoxError> {
    upload(request.header(CONTENT_LENGTH, body.len()), stream::iter(pieces(body)), silence).await
}

/// Sends the content of a file of `length` bytes. No piece of it may take longer than `silence`.
pub(crate) async fn file(
    request: RequestBuilder,
    (file, length): (tokio::fs::File, u64),
    silence: Duration,
) -> Result<Response, BoxError> {
    let pieces = ReaderStream::with_capacity(file, PIECE);
    upload(request.header(CONTENT_LENGTH, length), pieces, silence).await
}

/// The answer to a request.
pub(crate) async fn answer(
    sent: impl Future<Output = Result<Response, reqwest::Error>>,
) -> Result<Response, BoxError> {
    sent.await.map_err(|error| error.without_url().into())
}

/// The error of a connection on which nothing came for so long.
pub(crate) fn silent(limit: Duration) -> BoxError {
    format!("the connection was silent for {} s", limit.as_secs()).into()
}

fn pieces(mut body: Bytes) -> impl Iterator<Item = std::io::Result<Bytes>> {
    std::iter::from_fn(move || {
        let length = body.len().min(PIECE);
        (length > 0).then(|| Ok(body.split_to(length)))
    })
}

/// Sends a long body. It may take as long as it will, but no piece of it longer than `silence`.
async fn upload(
    request: RequestBuilder,
    body: impl Stream<Item = std::io::Result<Bytes>> + Send + 'static,
    silence: Duration,
) -> Result<Response, BoxError> {
    // The sender goes with the body: once all of it is handed over.
    let (progress, mut watched) = watch::channel(());
    let body = body.inspect(move |_| progress.send_replace(()));
    let sent = answer(request.body(reqwest::Body::wrap_stream(body)).send());
    tokio::pin!(sent);
    let mut limit = silence;
    loop {
        tokio::select! {
            answer = &mut sent => return answer,
            changed = watched.changed(), if limit == silence => {
                if changed.is_err() {
                    limit = ANSWER_TO_UPLOAD;
                }
            }
            () = awake(limit) => return Err(silent(limit)),
        }
    }
}

/// Waits. A time in which the whole machine sleeps counts as at most a tenth: the other side may not have been
/// silent in it.
async fn awake(duration: Duration) {
    for _ in 0..10 {
        tokio::time::sleep(duration / 10).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use reqwest::StatusCode;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    use tokio::net::TcpListener;

    /// Much more than a system keeps for a connection that nobody reads: some keep 32 MiB.
    const BODY: usize = 512 << 20;
    const SILENCE: Duration = Duration::from_secs(3);

    /// Uploads to a server that reads a fifteenth of the body in each half second, `times` times. Then it waits,
    /// and answers only if it has read everything.
    async fn uploaded(times: usize) -> Result<Response, BoxError> {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        let server = tokio::spawn(async move {
            let (mut connection, _) = listener.accept().await.unwrap();
            let (mut buffer, mut read) = (vec![0; BODY.div_ceil(15)], 0);
            for _ in 0..times {
                tokio::time::sleep(Duration::from_millis(500)).await;
                let mut filled = 0;
                while filled < buffer.len() && read < BODY {
                    let more = connection.read(&mut buffer[filled..]).await.unwrap();
                    (filled, read) = (filled + more, read + more);
                }
            }
            if read >= BODY {
                connection.write_all(b"HTTP/1.1 204 No Content\r\n\r\n").await.unwrap();
            }
            connection
        });
        let http = reqwest::Client::builder().no_proxy().tls_certs_only([]).build().unwrap();
        let pieces = std::iter::repeat_n(Bytes::from(vec![7; PIECE]), BODY / PIECE);
        let request = http.put(address).header(CONTENT_LENGTH, BODY);
        let sent = upload(request, stream::iter(pieces.map(Ok)), SILENCE).await;
        server.abort();
        sent
    }

    #[tokio::test]
    async fn an_upload_may_take_longer_than_its_connection_may_be_silent() {
        assert_eq!(uploaded(16).await.unwrap().status(), StatusCode::NO_CONTENT);
    }

    #[tokio::test]
    async fn an_upload_that_nobody_reads_is_given_up() {
        let error = uploaded(2).await.unwrap_err().to_string();
        assert_eq!(error, "the connection was silent for 3 s");
    }
}
