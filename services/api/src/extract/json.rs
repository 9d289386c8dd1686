//! JSON bodies, with the place of an error as a JSON pointer.

use std::marker::PhantomData;

use axum::extract::{FromRequest, Request};
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use forelight_protocol::ProblemKind;
use serde::de::DeserializeOwned;
use serde_path_to_error::{Path, Segment};

use super::body::whole;
use crate::error::{ApiError, ApiResult};
use crate::state::App;

/// How long a body may be.
pub(crate) trait BodyLimit {
    fn bytes(app: &App) -> usize;
}

/// Requests of people.
pub(crate) struct Small;

/// Results of tasks.
pub(crate) struct Large;

impl BodyLimit for Small {
    fn bytes(app: &App) -> usize {
        app.limits.request_bytes
    }
}

impl BodyLimit for Large {
    fn bytes(app: &App) -> usize {
        app.limits.result_bytes
    }
}

/// A JSON body and its hash.
pub(crate) struct JsonBody<T, L = Small> {
    pub value: T,
    /// BLAKE3 of the bytes, to tell a repeated request from another one.
    pub hash: [u8; 32],
    limit: PhantomData<L>,
}

impl<T: DeserializeOwned, L: BodyLimit> FromRequest<App> for JsonBody<T, L> {
    type Rejection = ApiError;

    async fn from_request(request: Request, app: &App) -> ApiResult<Self> {
        let sent = media_type(request.headers());
        if sent != "application/json" && !(sent.starts_with("application/") && sent.ends_with("+json")) {
            return Err(ApiError::new(
                ProblemKind::UnsupportedMediaType,
                "send Content-Type: application/json",
            ));
        }
        let (head, body) = request.into_parts();
        let bytes = whole(&head.headers, body, L::bytes(app)).await?;
        Ok(Self { value: parse(&bytes)?, hash: *blake3::hash(&bytes).as_bytes(), limit: PhantomData })
    }
}

/// What a request says that its body is, in small letters and without parameters; empty if it says nothing.
pub fn media_type(headers: &HeaderMap) -> String {
    let sent = headers.get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    sent.split(';').next().unwrap_or_default().trim().to_ascii_lowercase()
}

/// Parses a body. What is no JSON at all is malformed (400); JSON that is not what was asked for is invalid (422).
///
/// Every body here is an object. That is said first, because serde would take a list for the fields in their order.
fn parse<T: DeserializeOwned>(bytes: &[u8]) -> ApiResult<T> {
    if bytes.iter().find(|byte| !byte.is_ascii_whitespace()) != Some(&b'{') {
        return Err(match serde_json::from_slice::<serde::de::IgnoredAny>(bytes) {
            Ok(_) => ApiError::invalid("", "a JSON object is expected here"),
            Err(error) => ApiError::new(ProblemKind::Malformed, format!("the body is not JSON: {error}")),
        });
    }
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let pointer = pointer(error.path());
        let error = error.into_inner();
        let is_json = || serde_json::from_slice::<serde::de::IgnoredAny>(bytes).is_ok();
        match error.classify() {
            serde_json::error::Category::Data => ApiError::invalid(pointer, error.to_string()),
            // A name is read letter by letter, so that anything else in its place is taken for bad JSON.
            _ if is_json() => ApiError::invalid(pointer, "this is none of the values that are possible here"),
            _ => ApiError::new(ProblemKind::Malformed, format!("the body is not JSON: {error}")),
        }
    })?;
    deserializer.end().map_err(|error| {
        ApiError::new(ProblemKind::Malformed, format!("the body goes on after its end: {error}"))
    })?;
    Ok(value)
}

/// The JSON pointer (RFC 6901) of a place.
fn pointer(path: &Path) -> String {
    path.iter()
        .map(|segment| match segment {
            Segment::Seq { index } => format!("/{index}"),
            Segment::Map { key } => format!("/{}", key.replace('~', "~0").replace('/', "~1")),
            Segment::Enum { variant } => format!("/{variant}"),
            Segment::Unknown => String::new(),
        })
        .collect()
}
