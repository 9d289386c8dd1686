//! Responses that several handlers share.

use axum::Json;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_protocol::ProblemKind;
use forelight_store::{Answered, RecordedAnswer};
use serde::Serialize;

use crate::delivery::is_known;
use crate::error::{ApiError, ApiResult};

/// Answers with secrets are not kept by browsers and proxies.
pub(crate) const NOT_KEPT: HeaderValue = HeaderValue::from_static("no-store");

pub(crate) fn repeated(answer: RecordedAnswer) -> Response {
    let status = StatusCode::from_u16(answer.status).unwrap_or(StatusCode::OK);
    (status, [(CONTENT_TYPE, "application/json"), (REPLAYED, "true")], answer.body).into_response()
}

/// Marks an answer as a recorded one.
const REPLAYED: axum::http::HeaderName = axum::http::HeaderName::from_static("idempotency-replayed");

pub(crate) fn created<T: Serialize>(status: StatusCode, answered: Answered<T>) -> Response {
    match answered {
        Answered::Fresh(value) => (status, Json(value)).into_response(),
        Answered::Repeated(answer) => repeated(answer),
    }
}

/// Headers of a picture that may hold names which people chose. Opened by itself, it runs nothing.
pub(crate) fn svg_headers() -> [(HeaderName, &'static str); 2] {
    [
        (CONTENT_TYPE, "image/svg+xml"),
        (CONTENT_SECURITY_POLICY, "default-src 'none'; style-src 'unsafe-inline'; sandbox"),
    ]
}

/// A JSON document with a tag of its content, or 304 if the client has it already.
pub(crate) fn tagged<T: Serialize>(headers: &HeaderMap, document: &T) -> ApiResult<Response> {
    tagged_by(headers, document, document)
}

/// A JSON document with a tag of `content`, which is what counts of it.
pub(crate) fn tagged_by<C: Serialize, T: Serialize>(
    headers: &HeaderMap,
    content: &C,
    document: &T,
) -> ApiResult<Response> {
    let failed = |error: &dyn std::fmt::Display| {
        tracing::error!(%error, "a document could not be written");
        ApiError::new(ProblemKind::Internal, "the service failed; its log says more")
    };
    let counts = serde_json::to_vec(content).map_err(|error| failed(&error))?;
    let tag = blake3::hash(&counts).to_hex();
    let etag = HeaderValue::from_str(&format!("W/\"{}\"", &tag[..32])).map_err(|error| failed(&error))?;
    let own = [(ETAG, etag.clone()), (CACHE_CONTROL, HeaderValue::from_static("private, no-cache"))];
    if is_known(headers, &etag) {
        return Ok((StatusCode::NOT_MODIFIED, own).into_response());
    }
    let json = serde_json::to_vec(document).map_err(|error| failed(&error))?;
    let mut answer = ([(CONTENT_TYPE, "application/json")], json).into_response();
    answer.headers_mut().extend(own);
    Ok(answer)
}
