//! Requests that are sent until they are answered.
//!
//! Everything that this program asks of the service may be asked twice: results carry a fencing token, artefacts are
//! named by their hash, and whatever creates something (a claim creates a lease) carries an idempotency key. So a request is sent again whenever no answer came (refused, reset, timed out), or when the answer was
//! "not now" (429, 502, 503, 504, a full disk at the service (507), or an idempotency key whose first request is still being worked on).

use crate::backoff::Backoff;
use bytes::Bytes;
use forelight_protocol::{Problem, ProblemKind};
use reqwest::header::{CONTENT_TYPE, HeaderMap, RETRY_AFTER};
use reqwest::{Method, Response, StatusCode};
use serde::de::DeserializeOwned;
use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

/// Why a request failed in the end.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The address of the service is not one.
    #[error("`{address}` is not the address of a service: {reason}")]
    Address {
        /// What was given.
        address: String,
        /// What is wrong with it.
        reason: String,
    },
    /// No answer, however often it was asked.
    #[error("no answer from {url}")]
    Unreachable {
        /// What was asked, without secrets.
        url: String,
        /// The last failure.
        source: reqwest::Error,
    },
    /// The service said no, and why.
    #[error("{0}")]
    Refused(Box<Problem>),
    /// The answer is not from a service of this kind.
    #[error("{url} answered {status}, which forelight does not understand: {excerpt}")]
    Unexpected {
        /// What was asked.
        url: String,
        /// The HTTP status.
        status: StatusCode,
        /// The beginning of the answer, one line.
        excerpt: String,
    },
    /// A file that was to be sent or received.
    #[error("{}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is longer than anything of its kind.
    #[error("{what} is longer than {most} bytes")]
    TooLarge {
        /// What was asked for.
        what: String,
        /// The most that is taken.
        most: u64,
    },
    /// What arrived is not what was asked for.
    #[error("{what} arrived with the wrong content: its hash is {received}")]
    Corrupt {
        /// What was fetched.
        what: String,
        /// The hash of what arrived.
        received: String,
    },
}

impl ClientError {
    /// The service's own word on the matter, if it gave one.
    pub fn problem(&self) -> Option<&Problem> {
        match self {
            Self::Refused(problem) => Some(problem),
            _ => None,
        }
    }

    /// Whether the same request may succeed when the service, or what stands behind it, is back.
    pub fn is_passing(&self) -> bool {
        matches!(self, Self::Unreachable { .. }) || is_not_now(self)
    }

    /// Whether the service refused for this reason.
    pub fn is(&self, kind: ProblemKind) -> bool {
        self.problem().and_then(Problem::known_kind) == Some(kind)
    }
}

/// A bearer token that shows up in no log.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// The token of this text; white space around it (a file's last line feed) does not count.
    pub fn new(text: &str) -> Self {
        Self(text.trim().to_owned())
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

/// What goes with a request.
#[derive(Debug, Clone)]
pub(crate) enum Payload {
    /// Nothing.
    Empty,
    /// A JSON document.
    Json(Bytes),
    /// Anything else.
    Bytes(Bytes),
    /// A file, streamed anew for each attempt, with its media type.
    File(PathBuf, &'static str),
}

/// One request, ready to be sent as often as needed.
#[derive(Debug, Clone)]
pub(crate) struct Request {
    pub method: Method,
    pub path: String,
    pub payload: Payload,
    pub headers: HeaderMap,
    /// Limit of one attempt, for requests whose length is known to be short.
    pub timeout: Option<Duration>,
}

impl Request {
    pub fn new(method: Method, path: impl Into<String>) -> Self {
        Self {
            method,
            path: path.into(),
            payload: Payload::Empty,
            headers: HeaderMap::new(),
            timeout: Some(SHORT_REQUEST),
        }
    }

    pub fn payload(mut self, payload: Payload) -> Self {
        if matches!(payload, Payload::Bytes(_) | Payload::File(..)) {
            self.timeout = None;
        }
        self.payload = payload;
        self
    }

    pub fn timeout(mut self, timeout: Option<Duration>) -> Self {
        self.timeout = timeout;
        self
    }
}

/// A JSON question is answered within this time, or asked again.
const SHORT_REQUEST: Duration = Duration::from_secs(30);
/// Silence in the middle of a transfer is taken for a lost connection after this time.
const SILENCE: Duration = Duration::from_secs(75);

/// The connection to one service.
#[derive(Debug, Clone)]
pub(crate) struct Transport {
    http: reqwest::Client,
    /// Address without a slash at its end.
    base: String,
    token: Option<Token>,
    backoff: Backoff,
}

impl Transport {
    pub fn new(address: &str, token: Option<Token>, backoff: Backoff) -> Result<Self, ClientError> {
        let wrong = |reason: String| ClientError::Address { address: address.into(), reason };
        let url = reqwest::Url::parse(address).map_err(|e| wrong(e.to_string()))?;
        if url.scheme() != "http" {
            return Err(wrong("it must begin with http://".into()));
        }
        let host = url.host_str().ok_or_else(|| wrong("it names no host".into()))?;
        let mut builder = reqwest::Client::builder()
            .connect_timeout(Duration::from_secs(5))
            .read_timeout(SILENCE)
            // Only http:// is spoken here, so no certificates are needed, and machines without any will do.
            .tls_certs_only([])
            // A redirect could carry the token to another host.
            .redirect(reqwest::redirect::Policy::none())
            .user_agent(concat!("forelight/", env!("CARGO_PKG_VERSION")));
        if host == "localhost"
            || host.trim_matches(['[', ']']).parse().is_ok_and(|ip: std::net::IpAddr| ip.is_loopback())
        {
            builder = builder.no_proxy();
        }
        let http = builder.build().map_err(|e| wrong(e.to_string()))?;
        Ok(Self { http, base: address.trim_end_matches('/').to_owned(), token, backoff })
    }

    pub fn base(&self) -> &str {
        &self.base
    }

    /// The same connection with another patience.
    pub fn with_backoff(&self, backoff: Backoff) -> Self {
        Self { backoff, ..self.clone() }
    }

    /// Sends until there is an answer that is neither "not now" nor silence, and returns it if it is a success.
    pub async fn send(&self, request: &Request) -> Result<Response, ClientError> {
        let mut failures = 0;
        loop {
            let (error, asked) = match self.attempt(request).await? {
                Ok(response) if response.status().is_success() => return Ok(response),
                Ok(response) => {
                    let asked = retry_after(response.headers());
                    let error = refusal(response).await;
                    if !is_not_now(&error) {
                        return Err(error);
                    }
                    (error, asked)
                }
                Err(source) => {
                    let url = format!("{}{}", self.base, request.path);
                    (ClientError::Unreachable { url, source: source.without_url() }, None)
                }
            };
            failures += 1;
            let Some(wait) = self.backoff.jittered(failures, asked) else { return Err(error) };
            tracing::debug!(path = request.path, failures, ?wait, %error, "asking again");
            tokio::time::sleep(wait).await;
        }
    }

    /// Sends, and reads the answer as JSON.
    pub async fn json<T: DeserializeOwned>(&self, request: &Request) -> Result<T, ClientError> {
        let mut failures = 0;
        loop {
            let response = self.send(request).await?;
            let (status, url) = (response.status(), format!("{}{}", self.base, request.path));
            match response.bytes().await {
                Ok(body) => {
                    return serde_json::from_slice(&body).map_err(|error| ClientError::Unexpected {
                        url,
                        status,
                        excerpt: error.to_string(),
                    });
                }
                // The connection broke in the middle of the answer.
                Err(source) => {
                    failures += 1;
                    let Some(wait) = self.backoff.jittered(failures, None) else {
                        return Err(ClientError::Unreachable { url, source: source.without_url() });
                    };
                    tokio::time::sleep(wait).await;
                }
            }
        }
    }

    /// One attempt. The outer error is one that trying again cannot mend.
    async fn attempt(&self, request: &Request) -> Result<Result<Response, reqwest::Error>, ClientError> {
        let mut builder = self.http.request(request.method.clone(), format!("{}{}", self.base, request.path));
        if let Some(token) = &self.token {
            builder = builder.bearer_auth(&token.0);
        }
        if let Some(timeout) = request.timeout {
            builder = builder.timeout(timeout);
        }
        builder = builder.headers(request.headers.clone());
        builder = match &request.payload {
            Payload::Empty => builder,
            Payload::Json(body) => builder.header(CONTENT_TYPE, "application/json").body(body.clone()),
            Payload::Bytes(body) => {
                builder.header(CONTENT_TYPE, "application/octet-stream").body(body.clone())
            }
            Payload::File(path, media_type) => {
                let failed = |source| ClientError::File { path: path.clone(), source };
                let file = tokio::fs::File::open(path).await.map_err(failed)?;
                let length = file.metadata().await.map_err(failed)?.len();
                builder
                    .header(CONTENT_TYPE, *media_type)
                    .header(reqwest::header::CONTENT_LENGTH, length)
                    .body(reqwest::Body::wrap_stream(tokio_util::io::ReaderStream::with_capacity(
                        file,
                        1 << 16,
                    )))
            }
        };
        Ok(builder.send().await)
    }
}

/// The service's refusal as an error.
async fn refusal(response: Response) -> ClientError {
    let (status, url) = (response.status(), response.url().to_string());
    let body = response.bytes().await.unwrap_or_default();
    match serde_json::from_slice::<Problem>(&body) {
        Ok(problem) => ClientError::Refused(Box::new(problem)),
        Err(_) => {
            let text = String::from_utf8_lossy(&body);
            let excerpt = text.split_whitespace().collect::<Vec<_>>().join(" ").chars().take(200).collect();
            ClientError::Unexpected { url, status, excerpt }
        }
    }
}

/// Whether the same request may succeed a little later.
fn is_not_now(error: &ClientError) -> bool {
    let busy = |status: u16| matches!(status, 429 | 502 | 503 | 504 | 507);
    match error {
        ClientError::Refused(problem) => {
            busy(problem.status) || problem.known_kind() == Some(ProblemKind::IdempotencyInFlight)
        }
        ClientError::Unexpected { status, .. } => busy(status.as_u16()),
        _ => false,
    }
}

/// `Retry-After` in its form as seconds; the form as a date is not used by the service.
fn retry_after(headers: &HeaderMap) -> Option<Duration> {
    headers.get(RETRY_AFTER)?.to_str().ok()?.trim().parse().ok().map(Duration::from_secs)
}
