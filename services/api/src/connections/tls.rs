//! TLS: certificates from files that are read again when they change.
//!
//! Certificates are renewed every few weeks, by a program that writes new files. A service that had to be
//! restarted for that would break all its connections, so it looks at the files every few seconds. Files that
//! do not fit together, as in the middle of a renewal, change nothing: the old certificate is served until
//! they do.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use hyper::server::conn::http2;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use parking_lot::RwLock;
use rustls::ServerConfig;
use rustls::crypto::CryptoProvider;
use rustls::crypto::aws_lc_rs::default_provider;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::{ClientHello, ResolvesServerCert};
use rustls::sign::CertifiedKey;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use tokio_util::sync::CancellationToken;

use super::Ends;
use crate::config::TlsFiles;

/// Longest time of a handshake.
const HANDSHAKE: Duration = Duration::from_secs(10);

/// Interval between looks at the files.
const LOOKED_AT: Duration = Duration::from_secs(5);

/// Most requests of a connection at the same time.
const STREAMS: u32 = 200;

/// Protocols that are offered, the best first.
const PROTOCOLS: [&[u8]; 2] = [b"h2", b"http/1.1"];

/// Why the service cannot serve TLS.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file cannot be read, or holds no certificate or no key.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: String,
        /// What is wrong.
        reason: String,
    },
    /// The key is not that of the certificate.
    #[error("{certificate} and {key} do not fit together: {source}")]
    Pair {
        /// File of the certificate.
        certificate: String,
        /// File of the key.
        key: String,
        /// What is wrong.
        source: rustls::Error,
    },
    /// This program's TLS cannot be set up.
    #[error("TLS cannot be set up: {0}")]
    Setup(#[from] rustls::Error),
}

/// Answers with TLS.
#[derive(Clone)]
pub(crate) struct Tls {
    acceptor: TlsAcceptor,
    certificate: Arc<Certificate>,
}

/// The certificate in force.
#[derive(Debug)]
struct Certificate {
    files: TlsFiles,
    key: RwLock<Arc<CertifiedKey>>,
    provider: Arc<CryptoProvider>,
}

impl ResolvesServerCert for Certificate {
    fn resolve(&self, _: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        Some(self.key.read().clone())
    }
}

impl Tls {
    pub fn new(files: TlsFiles) -> Result<Self, TlsError> {
        let provider = Arc::new(default_provider());
        let key = RwLock::new(Arc::new(read(&files, &provider)?));
        let certificate = Arc::new(Certificate { files, key, provider: provider.clone() });
        let config = ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions()?;
        let mut config = config.with_no_client_auth().with_cert_resolver(certificate.clone());
        config.alpn_protocols = PROTOCOLS.map(<[u8]>::to_vec).to_vec();
        Ok(Self { acceptor: TlsAcceptor::from(Arc::new(config)), certificate })
    }

    /// The connection after its handshake; `None` if that failed or took too long.
    pub async fn accept<S: AsyncRead + AsyncWrite + Unpin>(&self, stream: S) -> Option<TlsStream<S>> {
        match tokio::time::timeout(HANDSHAKE, self.acceptor.accept(stream)).await {
            Ok(Ok(stream)) => Some(stream),
            Ok(Err(error)) => {
                tracing::debug!(%error, "a TLS handshake failed");
                None
            }
            Err(_) => {
                tracing::debug!("a TLS handshake took too long");
                None
            }
        }
    }

    /// Reads the files again whenever they change, until `stopping` is cancelled.
    pub async fn follow_files(self, stopping: CancellationToken) {
        let certificate = self.certificate;
        let mut seen = certificate.files.versions();
        loop {
            tokio::select! {
                () = stopping.cancelled() => return,
                () = tokio::time::sleep(LOOKED_AT) => {}
            }
            let now = certificate.files.versions();
            if now == seen {
                continue;
            }
            match read(&certificate.files, &certificate.provider) {
                Ok(key) => {
                    *certificate.key.write() = Arc::new(key);
                    seen = now;
                    tracing::info!("the certificate was read again");
                }
                Err(error) => {
                    tracing::warn!(%error, "the new certificate cannot be used; the old one is served on");
                }
            }
        }
    }
}

impl TlsFiles {
    /// What changes with the files: when they were written, and how long they are.
    fn versions(&self) -> [Option<(SystemTime, u64)>; 2] {
        [&self.certificate, &self.key].map(|path| {
            let about = std::fs::metadata(path).ok()?;
            Some((about.modified().ok()?, about.len()))
        })
    }
}

fn read(files: &TlsFiles, provider: &CryptoProvider) -> Result<CertifiedKey, TlsError> {
    let wrong = |path: &PathBuf, reason: String| TlsError::File { path: path.display().to_string(), reason };
    let chain = CertificateDer::pem_file_iter(&files.certificate)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|error| wrong(&files.certificate, error.to_string()))?;
    if chain.is_empty() {
        return Err(wrong(&files.certificate, "the file holds no certificate in PEM form".to_owned()));
    }
    let key =
        PrivateKeyDer::from_pem_file(&files.key).map_err(|error| wrong(&files.key, error.to_string()))?;
    CertifiedKey::from_der(chain, key, provider).map_err(|source| TlsError::Pair {
        certificate: files.certificate.display().to_string(),
        key: files.key.display().to_string(),
        source,
    })
}

/// Whether the client has chosen HTTP/2.
pub(crate) fn speaks_http_2<S>(stream: &TlsStream<S>) -> bool {
    stream.get_ref().1.alpn_protocol() == Some(PROTOCOLS[0])
}

/// Answers an HTTP/2 connection, which browsers use. Workers have one request at a time and stay with
/// HTTP/1.1.
pub(crate) async fn answer_http_2<I, S>(stream: TlsStream<I>, service: S, ends: Ends)
where
    I: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    S: hyper::service::Service<
            hyper::Request<hyper::body::Incoming>,
            Response = axum::response::Response,
            Error = std::convert::Infallible,
        > + Send
        + Clone
        + 'static,
    S::Future: Send + 'static,
{
    let mut builder = http2::Builder::new(TokioExecutor::new());
    builder.timer(TokioTimer::new()).max_concurrent_streams(STREAMS);
    ends.wait(std::pin::pin!(builder.serve_connection(TokioIo::new(stream), service))).await;
}
