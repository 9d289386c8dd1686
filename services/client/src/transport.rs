//! Sends a request until it is answered.
//!
//! Any request may be sent twice. Results carry a fencing token, artefacts are named by their hash, and
//! requests that create something carry an idempotency key. So a request is sent again in two cases:
//!
//! - there was no answer: the connection was refused or reset, or the attempt timed out;
//! - the answer was "not now": 429, 502, 503, 504, 507 (the service's disk is full), or an idempotency key
//!   whose first request is still running.

use crate::backoff::Backoff;
use crate::error::ClientError;
use crate::token::Token;
use crate::upload::{self, BoxError, answer, silent};
use bytes::Bytes;
use forelight_protocol::{Problem, WORKER_PROTOCOL, WORKER_PROTOCOL_HEADER};
use parking_lot::Mutex;
use reqwest::header::{CONTENT_TYPE, HeaderMap, HeaderName, HeaderValue, RETRY_AFTER};
use reqwest::{Certificate, Method, Response, StatusCode};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use uuid::Uuid;

/// The body of a request.
#[derive(Debug, Clone)]
pub(crate) enum Payload {
    Empty,
    Json(Bytes),
    Bytes(Bytes),
    /// A file with its media type. Each attempt streams it again.
    File(PathBuf, &'static str),
}

/// A request that can be sent any number of times.
#[derive(Debug, Clone)]
pub(crate) struct Request {
    pub method: Method,
    pub path: String,
    pub payload: Payload,
    pub headers: HeaderMap,
    /// Limit of one attempt. `None` if the length of the transfer is unknown.
    pub timeout: Option<Duration>,
}

impl Payload {
    /// Whether it is as long as a file may be.
    fn is_long(&self) -> bool {
        matches!(self, Payload::Bytes(_) | Payload::File(..))
    }
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

    pub fn get(path: impl Into<String>) -> Self {
        Self::new(Method::GET, path)
    }

    /// A request with this document as its body.
    pub fn json<T: Serialize>(method: Method, path: impl Into<String>, body: &T) -> Self {
        // Wire types have only string keys and finite numbers, so they always have a JSON form.
        let body = serde_json::to_vec(body).unwrap_or_default();
        Self::new(method, path).payload(Payload::Json(body.into()))
    }

    pub fn payload(mut self, payload: Payload) -> Self {
        if payload.is_long() {
            self.timeout = None;
        }
        self.payload = payload;
        self
    }

    pub fn timeout(mut self, timeout: Option<Duration>) -> Self {
        self.timeout = timeout;
        self
    }

    /// The same request of a worker, which states its version.
    pub fn of_worker(mut self) -> Self {
        let name = HeaderName::from_static(WORKER_PROTOCOL_HEADER);
        self.headers.insert(name, HeaderValue::from(WORKER_PROTOCOL));
        self
    }

    /// The same request with an idempotency key. The service carries it out once.
    pub fn with_key(mut self, key: Uuid) -> Self {
        if let Ok(key) = HeaderValue::from_str(&key.to_string()) {
            self.headers.insert(HeaderName::from_static("idempotency-key"), key);
        }
        self
    }
}

/// Limit of one attempt of a short JSON request.
const SHORT_REQUEST: Duration = Duration::from_secs(30);
/// A transfer that is silent for this long has lost its connection.
const SILENCE: Duration = Duration::from_secs(75);

/// An idle connection is closed after this, before the service closes it: a request could meet its end.
const KEPT_IDLE: Duration = Duration::from_secs(45);

/// The connection to one service.
#[derive(Debug, Clone)]
pub(crate) struct Transport {
    http: reqwest::Client,
    /// For requests with long bodies, whose silence [`upload`] measures.
    uploads: reqwest::Client,
    /// The address, without a trailing slash.
    base: String,
    token: Option<Token>,
    backoff: Backoff,
    silence: Arc<Mutex<Silence>>,
}

/// What was said of a service that gives no answer. Clones of a connection share it.
#[derive(Debug, Default)]
struct Silence {
    said: Option<Instant>,
}

impl Silence {
    /// Whether to say now that there is no answer: at once, and then once a minute.
    fn is_to_be_said(&mut self, now: Instant) -> bool {
        const BETWEEN: Duration = Duration::from_secs(60);
        let is_due = self.said.is_none_or(|said| now.duration_since(said) >= BETWEEN);
        if is_due {
            self.said = Some(now);
        }
        is_due
    }

    /// Whether a silence that was reported has ended.
    fn end(&mut self) -> bool {
        self.said.take().is_some()
    }
}

impl Transport {
    /// Over TLS, the service's certificate must lead to one of `roots` (PEM), or else of the system's.
    pub fn new(
        address: &str,
        token: Option<Token>,
        roots: Option<&[u8]>,
        backoff: Backoff,
    ) -> Result<Self, ClientError> {
        let wrong = |reason: String| ClientError::Address { address: address.into(), reason };
        // Of an address without a scheme, the host would be taken for one.
        if !["http://", "https://"].iter().any(|begin| address.to_ascii_lowercase().starts_with(begin)) {
            return Err(wrong("it must begin with http:// or https://".into()));
        }
        let url = reqwest::Url::parse(address).map_err(|e| wrong(e.to_string()))?;
        let roots = match roots {
            Some(pem) => Certificate::from_pem_bundle(pem)
                .ok()
                .filter(|roots| !roots.is_empty())
                .map(Some)
                .ok_or_else(|| wrong("its roots hold no certificate in PEM form".into()))?,
            None => None,
        };
        let host = url.host_str().ok_or_else(|| wrong("it names no host".into()))?;
        let is_local = host == "localhost"
            || host.trim_matches(['[', ']']).parse().is_ok_and(|ip: std::net::IpAddr| ip.is_loopback());
        let builder = || {
            let mut builder = reqwest::Client::builder()
                .connect_timeout(Duration::from_secs(5))
                .pool_idle_timeout(KEPT_IDLE)
                // A worker has one request at a time, and a stream of events is one for hours.
                .http1_only()
                // A redirect could carry the token to another host.
                .redirect(reqwest::redirect::Policy::none())
                .user_agent(concat!("forelight/", env!("CARGO_PKG_VERSION")));
            builder = match &roots {
                Some(roots) => builder.tls_certs_only(roots.clone()),
                None if url.scheme() == "https" => builder,
                // Without TLS, the client loads no certificates, so it also works on machines without any.
                None => builder.tls_certs_only([]),
            };
            if is_local { builder.no_proxy() } else { builder }
        };
        let built = |builder: reqwest::ClientBuilder| builder.build().map_err(|e| wrong(e.to_string()));
        let (http, uploads) = (built(builder().read_timeout(SILENCE))?, built(builder())?);
        let silence = Arc::new(Mutex::new(Silence::default()));
        let base = address.trim_end_matches('/').to_owned();
        Ok(Self { http, uploads, base, token, backoff, silence })
    }

    pub fn base(&self) -> &str {
        &self.base
    }

    /// The same connection with another back-off.
    pub fn with_backoff(&self, backoff: Backoff) -> Self {
        Self { backoff, ..self.clone() }
    }

    /// Sends until an answer is not "not now". Returns the answer if it is a success.
    pub async fn send(&self, request: &Request) -> Result<Response, ClientError> {
        let mut failures = 0;
        loop {
            let sent = self.token.as_ref().map(Token::secret);
            let attempt = self.attempt(request, sent.as_deref()).await?;
            if attempt.is_ok() && self.silence.lock().end() {
                tracing::info!("{} answers again", self.base);
            }
            let (error, asked) = match attempt {
                Ok(response) if response.status().is_success() => return Ok(response),
                Ok(response)
                    if response.status() == StatusCode::UNAUTHORIZED && self.has_another(sent.as_deref()) =>
                {
                    continue;
                }
                Ok(response) => {
                    let asked = retry_after(response.headers());
                    let error = refusal(request, response).await;
                    if !error.is_not_now() {
                        return Err(error);
                    }
                    (error, asked)
                }
                Err(source) => {
                    let error = self.no_answer(request, source);
                    self.tell(&error);
                    (error, None)
                }
            };
            failures += 1;
            let Some(wait) = self.backoff.jittered(failures, asked) else { return Err(error) };
            tracing::debug!(path = request.path, failures, ?wait, %error, "asking again");
            tokio::time::sleep(wait).await;
        }
    }

    /// Sends, and reads the answer as JSON. An answer that breaks off is a failed attempt.
    pub async fn json<T: DeserializeOwned>(&self, request: &Request) -> Result<T, ClientError> {
        let (status, _, body) = self.whole(request).await?;
        self.parse(request, status, &body)
    }

    /// Sends, and reads the whole answer. An answer that breaks off is a failed attempt.
    pub async fn whole(&self, request: &Request) -> Result<(StatusCode, HeaderMap, Bytes), ClientError> {
        let mut failures = 0;
        loop {
            let response = self.send(request).await?;
            let (status, headers) = (response.status(), response.headers().clone());
            match read(request, response).await {
                Ok(body) => return Ok((status, headers, body)),
                Err(source) => {
                    failures += 1;
                    let Some(wait) = self.backoff.jittered(failures, None) else {
                        return Err(self.no_answer(request, source));
                    };
                    tokio::time::sleep(wait).await;
                }
            }
        }
    }

    /// The whole body of an answer.
    pub async fn body(&self, request: &Request, response: Response) -> Result<Bytes, ClientError> {
        response.bytes().await.map_err(|source| self.unreachable(request, source))
    }

    /// The JSON document in an answer's body.
    pub fn parse<T: DeserializeOwned>(
        &self,
        request: &Request,
        status: StatusCode,
        body: &[u8],
    ) -> Result<T, ClientError> {
        serde_json::from_slice(body).map_err(|error| ClientError::Unexpected {
            url: self.url(request),
            status,
            excerpt: error.to_string(),
        })
    }

    /// The error of an answer that did not come or broke off.
    pub fn unreachable(&self, request: &Request, source: reqwest::Error) -> ClientError {
        self.no_answer(request, source.without_url().into())
    }

    fn no_answer(&self, request: &Request, source: BoxError) -> ClientError {
        ClientError::Unreachable { url: self.url(request), source }
    }

    /// Says that there is no answer, if nobody else does: a client that gives up returns its error.
    fn tell(&self, error: &ClientError) {
        let never_gives_up = self.backoff.attempts.is_none();
        if never_gives_up && self.silence.lock().is_to_be_said(Instant::now()) {
            let mut reason: &dyn Error = error;
            while let Some(cause) = reason.source() {
                reason = cause;
            }
            tracing::warn!("no answer from {}: {reason}; trying again", self.base);
        }
    }

    /// Whether the token's file holds another token than the one that was sent: it was rotated.
    fn has_another(&self, sent: Option<&str>) -> bool {
        self.token.as_ref().is_some_and(|token| token.read_again(sent))
    }

    fn url(&self, request: &Request) -> String {
        format!("{}{}", self.base, request.path)
    }

    /// One attempt. Another attempt cannot help after the outer error.
    async fn attempt(
        &self,
        request: &Request,
        token: Option<&str>,
    ) -> Result<Result<Response, BoxError>, ClientError> {
        let http = if request.payload.is_long() { &self.uploads } else { &self.http };
        let mut builder = http.request(request.method.clone(), self.url(request));
        if let Some(token) = token {
            builder = builder.bearer_auth(token);
        }
        if let Some(timeout) = request.timeout {
            builder = builder.timeout(timeout);
        }
        builder = builder.headers(request.headers.clone());
        Ok(match &request.payload {
            Payload::Empty => answer(builder.send()).await,
            Payload::Json(body) => {
                answer(builder.header(CONTENT_TYPE, "application/json").body(body.clone()).send()).await
            }
            Payload::Bytes(body) => {
                let builder = builder.header(CONTENT_TYPE, "application/octet-stream");
                upload::bytes(builder, body.clone(), SILENCE).await
            }
            Payload::File(path, media_type) => {
                let failed = |source| ClientError::File { path: path.clone(), source };
                let file = tokio::fs::File::open(path).await.map_err(failed)?;
                let length = file.metadata().await.map_err(failed)?.len();
                upload::file(builder.header(CONTENT_TYPE, *media_type), (file, length), SILENCE).await
            }
        })
    }
}

/// Parameters for the query of an address, each after a `&`.
pub(crate) fn parameters(named: &[(&str, &str)]) -> String {
    let escaped = |value: &str| value.bytes().map(|byte| format!("%{byte:02X}")).collect::<String>();
    named.iter().map(|(name, value)| format!("&{name}={}", escaped(value))).collect()
}

/// The whole body of a short answer.
async fn read(request: &Request, response: Response) -> Result<Bytes, BoxError> {
    let body = response.bytes();
    // The client of long requests has no limit of its own.
    let body = if request.payload.is_long() {
        tokio::time::timeout(SILENCE, body).await.map_err(|_| silent(SILENCE))?
    } else {
        body.await
    };
    body.map_err(|error| error.without_url().into())
}

/// The error in the service's answer.
async fn refusal(request: &Request, response: Response) -> ClientError {
    let (status, url) = (response.status(), response.url().to_string());
    let body = read(request, response).await.unwrap_or_default();
    match serde_json::from_slice::<Problem>(&body) {
        Ok(problem) => ClientError::Refused(Box::new(problem)),
        Err(_) => {
            let text = String::from_utf8_lossy(&body);
            let excerpt = text.split_whitespace().collect::<Vec<_>>().join(" ").chars().take(200).collect();
            ClientError::Unexpected { url, status, excerpt }
        }
    }
}

/// The wait in `Retry-After`, whole seconds. The service does not use the header's date form.
pub(crate) fn retry_after(headers: &HeaderMap) -> Option<Duration> {
    headers.get(RETRY_AFTER)?.to_str().ok()?.trim().parse().ok().map(Duration::from_secs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn that_there_is_no_answer_is_said_at_once_and_once_a_minute() {
        let mut silence = Silence::default();
        let begin = Instant::now();
        let after = |seconds| begin + Duration::from_secs(seconds);
        let said: Vec<u64> = (0..=130).filter(|&second| silence.is_to_be_said(after(second))).collect();
        assert_eq!(said, [0, 60, 120]);
        assert!(silence.end() && !silence.end());
        assert!(silence.is_to_be_said(after(131)), "it answered in between");
    }

    #[test]
    fn an_address_without_a_scheme_is_refused_with_both() {
        for address in ["127.0.0.1:7878", "farm:7878", "ftp://farm", ""] {
            let error = Transport::new(address, None, None, Backoff::PATIENT).unwrap_err().to_string();
            assert!(error.contains("it must begin with http:// or https://"), "{address}: {error}");
        }
        assert!(Transport::new("HTTP://farm:7878/", None, None, Backoff::PATIENT).is_ok());
    }
}
