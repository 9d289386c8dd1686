//! Answers that several handlers give.

use axum::Json;
use axum::body::Body;
use axum::http::header::{CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_store::{Answered, ArtifactReader, RecordedAnswer};
use serde::Serialize;

/// An answer given earlier, given again.
pub(crate) fn repeated(answer: RecordedAnswer) -> Response {
    let status = StatusCode::from_u16(answer.status).unwrap_or(StatusCode::OK);
    (status, [(CONTENT_TYPE, "application/json"), (REPLAYED, "true")], answer.body).into_response()
}

/// Tells a client that the answer is an old one.
const REPLAYED: axum::http::HeaderName = axum::http::HeaderName::from_static("idempotency-replayed");

/// The answer to a request that creates.
pub(crate) fn created<T: Serialize>(status: StatusCode, answered: Answered<T>) -> Response {
    match answered {
        Answered::Fresh(value) => (status, Json(value)).into_response(),
        Answered::Repeated(answer) => repeated(answer),
    }
}

/// An artefact as the body of a response. Its content can never change under its name, so it may be kept for ever.
pub(crate) fn file(reader: ArtifactReader, media_type: &'static str, headers: HeaderMap) -> Response {
    let mut response = Response::new(Body::from_stream(reader.stream));
    *response.headers_mut() = headers;
    response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(media_type));
    response.headers_mut().insert(CONTENT_LENGTH, HeaderValue::from(reader.size));
    response
}

/// A picture that is drawn for each request.
pub(crate) fn svg(picture: String) -> Response {
    ([(CONTENT_TYPE, "image/svg+xml"), (CACHE_CONTROL, "private, no-cache")], picture).into_response()
}
