//! Responses that several handlers share.

use axum::Json;
use axum::body::Body;
use axum::http::header::{CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_store::{Answered, ArtifactReader, RecordedAnswer};
use serde::Serialize;

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

pub(crate) fn svg(picture: String) -> Response {
    ([(CONTENT_TYPE, "image/svg+xml"), (CACHE_CONTROL, "private, no-cache")], picture).into_response()
}
