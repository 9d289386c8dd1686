//! Responses that several handlers share.

use axum::Json;
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_store::{Answered, RecordedAnswer};
use serde::Serialize;

use crate::document::Document;
use crate::error::ApiResult;

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

/// A JSON document with a tag of its content, or 304 if the client has it already.
pub(crate) fn tagged<T: Serialize>(headers: &HeaderMap, document: &T) -> ApiResult<Response> {
    Ok(Document::json(document)?.respond(headers))
}
