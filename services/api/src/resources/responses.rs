//! Responses that several handlers share.

use axum::Json;
use axum::body::Body;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_LENGTH, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, IF_NONE_MATCH,
};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_protocol::ProblemKind;
use forelight_store::{Answered, ArtifactReader, RecordedAnswer};
use serde::Serialize;

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

/// An artefact as a response body. Its content never changes under its name, so it may be cached forever.
pub(crate) fn file(reader: ArtifactReader, media_type: &'static str, headers: HeaderMap) -> Response {
    let mut response = Response::new(Body::from_stream(reader.stream));
    *response.headers_mut() = headers;
    response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(media_type));
    response.headers_mut().insert(CONTENT_LENGTH, HeaderValue::from(reader.size));
    response
}

/// A picture that may hold names which people chose. Opened by itself, it runs nothing.
pub(crate) fn svg(picture: String) -> Response {
    let headers = [
        (CONTENT_TYPE, "image/svg+xml"),
        (CACHE_CONTROL, "private, no-cache"),
        (CONTENT_SECURITY_POLICY, "default-src 'none'; style-src 'unsafe-inline'; sandbox"),
    ];
    (headers, picture).into_response()
}

/// Whether the client has this version already, by `If-None-Match` (RFC 9110, section 13.1.2). Tags are
/// compared weakly, because compression changes the bytes and not the content.
pub(crate) fn is_known(headers: &HeaderMap, etag: &HeaderValue) -> bool {
    fn opaque(tag: &str) -> &str {
        tag.trim().trim_start_matches("W/")
    }
    let Ok(etag) = etag.to_str() else { return false };
    let asked = headers.get_all(IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    asked.flat_map(|value| value.split(',')).any(|tag| tag.trim() == "*" || opaque(tag) == opaque(etag))
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
