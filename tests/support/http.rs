//! Raw HTTP for tests, without the retries and checks of `forelight-client`.

use forelight_protocol::{Problem, ProblemKind};
use reqwest::{Method, RequestBuilder, Response, StatusCode};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::time::Duration;

/// A client with an address and a token.
#[derive(Clone)]
pub struct Http {
    client: reqwest::Client,
    base: String,
    token: Option<String>,
}

impl Http {
    /// A client of the service at `base` (`http://host:port`). It keeps no connection open, because the
    /// service may be killed between requests.
    pub fn new(base: &str, token: Option<String>) -> Self {
        let client = reqwest::Client::builder()
            .no_proxy()
            // Reading the certificates of the system takes longer than most tests.
            .tls_certs_only([])
            .pool_max_idle_per_host(0)
            .connect_timeout(Duration::from_secs(10))
            // Longer silence is a hang: streams of events send a comment every 15 seconds.
            .read_timeout(Duration::from_secs(60))
            .build()
            .expect("these options make a client");
        Self { client, base: base.to_owned(), token }
    }

    /// The same client for another address.
    pub fn at(&self, base: &str) -> Self {
        Self { base: base.to_owned(), ..self.clone() }
    }

    /// A request to this path, with the token if there is one.
    pub fn request(&self, method: Method, path: &str) -> RequestBuilder {
        let request = self.client.request(method, format!("{}{path}", self.base));
        match &self.token {
            Some(token) => request.bearer_auth(token),
            None => request,
        }
    }

    /// Response to a GET, whatever its status.
    pub async fn get(&self, path: &str) -> Response {
        self.request(Method::GET, path).send().await.unwrap_or_else(|error| panic!("GET {path}: {error}"))
    }

    /// JSON of a GET that must return status 200.
    pub async fn json<T: DeserializeOwned>(&self, path: &str) -> T {
        self.get(path).await.parsed(StatusCode::OK).await
    }

    /// Body of a GET that must return status 200 and this media type.
    pub async fn bytes(&self, path: &str, media_type: &str) -> Vec<u8> {
        let response = self.get(path).await;
        assert_eq!(response.status(), StatusCode::OK, "{path}");
        assert_eq!(response.headers()["content-type"], media_type, "{path}");
        response.bytes().await.unwrap_or_else(|error| panic!("{path}: {error}")).into()
    }

    /// Response to a POST of JSON.
    pub async fn post(&self, path: &str, body: &impl Serialize) -> Response {
        let request = self.request(Method::POST, path).json(body);
        request.send().await.unwrap_or_else(|error| panic!("POST {path}: {error}"))
    }

    /// Response to the upload of a bundle.
    pub async fn upload(&self, zip: Vec<u8>, key: Option<&str>) -> Response {
        let mut request = self.request(Method::POST, "/v1/bundles").header("content-type", "application/zip");
        if let Some(key) = key {
            request = request.header("idempotency-key", key);
        }
        request.body(zip).send().await.unwrap_or_else(|error| panic!("upload: {error}"))
    }

    /// Value of a metric without labels.
    pub async fn metric(&self, name: &str) -> u64 {
        let text = self.get("/metrics").await.text().await.unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
        let value = line.and_then(|value| value.parse().ok());
        value.unwrap_or_else(|| panic!("there is no number {name} in:\n{text}"))
    }
}

/// Checks of a response.
pub trait Answer {
    /// The body as JSON. Panics if the status differs.
    #[allow(async_fn_in_trait, reason = "used in these tests alone")]
    async fn parsed<T: DeserializeOwned>(self, status: StatusCode) -> T;

    /// The body as a problem document of this kind. Panics if any part of it is wrong.
    #[allow(async_fn_in_trait, reason = "used in these tests alone")]
    async fn problem(self, kind: ProblemKind) -> Problem;
}

impl Answer for Response {
    async fn parsed<T: DeserializeOwned>(self, status: StatusCode) -> T {
        let (url, got) = (self.url().clone(), self.status());
        let text = self.text().await.unwrap_or_else(|error| panic!("{url}: {error}"));
        assert_eq!(got, status, "{url}: {text}");
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{url}: {error}: {text}"))
    }

    async fn problem(self, kind: ProblemKind) -> Problem {
        let (url, status) = (self.url().clone(), self.status());
        let media_type = self.headers().get("content-type").cloned();
        let text = self.text().await.unwrap_or_else(|error| panic!("{url}: {error}"));
        assert_eq!(
            media_type.as_ref().and_then(|value| value.to_str().ok()),
            Some("application/problem+json"),
            "{url}: {status} {text}"
        );
        let problem: Problem =
            serde_json::from_str(&text).unwrap_or_else(|error| panic!("{url}: {error}: {text}"));
        assert_eq!(problem.known_kind(), Some(kind), "{url}: {text}");
        assert_eq!((problem.status, status.as_u16()), (kind.status(), kind.status()), "{url}: {text}");
        assert_eq!(problem.instance.as_deref(), Some(url.path()), "{url}: {text}");
        assert!(!problem.detail.is_empty() && !problem.detail.contains('\n'), "{url}: {text}");
        problem
    }
}
