//! JSON bodies. Errors give the place as a JSON pointer.

use std::marker::PhantomData;

use axum::extract::{FromRequest, Request};
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use forelight_protocol::ProblemKind;
use serde::de::DeserializeOwned;
use serde_json::Value;
use serde_path_to_error::{Path, Segment};

use super::body::whole;
use super::objects::Objects;
use crate::error::{ApiError, ApiResult};
use crate::state::App;

pub(crate) trait BodyLimit {
    fn bytes(app: &App) -> usize;
}

/// Requests by people.
pub(crate) struct Small;

/// Requests by callers of whom nothing is known yet. Many of them must not take much memory.
pub(crate) struct OfStrangers;

/// Results of tasks.
pub(crate) struct Large;

impl BodyLimit for Small {
    fn bytes(app: &App) -> usize {
        app.limits.request_bytes
    }
}

impl BodyLimit for OfStrangers {
    fn bytes(app: &App) -> usize {
        app.limits.request_bytes.min(64 << 10)
    }
}

impl BodyLimit for Large {
    fn bytes(app: &App) -> usize {
        app.limits.result_bytes
    }
}

pub(crate) struct JsonBody<T, L = Small> {
    pub value: T,
    /// BLAKE3 of the bytes. It distinguishes a repeated request from a different one.
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

/// Media type of a request's body in lower case, without parameters. Empty if not given.
pub fn media_type(headers: &HeaderMap) -> String {
    let sent = headers.get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    sent.split(';').next().unwrap_or_default().trim().to_ascii_lowercase()
}

/// Parses a body. Invalid JSON is malformed (400); JSON of the wrong shape is invalid (422).
fn parse<T: DeserializeOwned>(bytes: &[u8]) -> ApiResult<T> {
    if bytes.iter().find(|byte| !byte.is_ascii_whitespace()) != Some(&b'{') {
        return Err(match serde_json::from_slice::<serde::de::IgnoredAny>(bytes) {
            Ok(_) => ApiError::invalid("", "a JSON object is expected here"),
            Err(error) => ApiError::new(ProblemKind::Malformed, format!("the body is not JSON: {error}")),
        });
    }
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    let parsed = serde_path_to_error::deserialize(Objects(&mut deserializer));
    if parsed.is_err()
        && let Some(value) = with_integers(bytes)
    {
        return Ok(value);
    }
    let value = parsed.map_err(|error| {
        let pointer = pointer(error.path());
        let error = error.into_inner();
        let is_json = || serde_json::from_slice::<serde::de::IgnoredAny>(bytes).is_ok();
        match error.classify() {
            serde_json::error::Category::Data => ApiError::invalid(pointer, error.to_string()),
            // serde reads a name letter by letter and reports any other value there as bad JSON.
            _ if is_json() => ApiError::invalid(pointer, "this is none of the values allowed here"),
            _ => ApiError::new(ProblemKind::Malformed, format!("the body is not JSON: {error}")),
        }
    })?;
    deserializer.end().map_err(|error| {
        ApiError::new(ProblemKind::Malformed, format!("the body goes on after its end: {error}"))
    })?;
    Ok(value)
}

/// The body, read so that 7.0 is an integer, as JSON Schema has it (2020-12, section 4.2.3 of the core). `None` if
/// that does not make it readable.
fn with_integers<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    let mut value: Value = serde_json::from_slice(bytes).ok()?;
    make_integers(&mut value).then_some(())?;
    T::deserialize(Objects(value)).ok()
}

/// Makes integers of fractions that are whole numbers. Returns whether there were any.
fn make_integers(value: &mut Value) -> bool {
    /// Beyond this, not every integer has a fraction of its own: 2⁵³.
    const EXACT: f64 = 9_007_199_254_740_992.0;
    match value {
        Value::Array(list) => list.iter_mut().fold(false, |found, inner| make_integers(inner) | found),
        Value::Object(map) => map.values_mut().fold(false, |found, inner| make_integers(inner) | found),
        Value::Number(number) => match number.as_f64().filter(|_| number.is_f64()) {
            Some(whole) if whole.fract() == 0.0 && whole.abs() <= EXACT => {
                *number = (whole as i64).into();
                true
            }
            _ => false,
        },
        Value::Null | Value::Bool(_) | Value::String(_) => false,
    }
}

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
