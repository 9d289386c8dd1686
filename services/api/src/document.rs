//! Documents with a tag of their content: a client that has one already is told so.

use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use forelight_protocol::ProblemKind;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::delivery::is_known;
use crate::error::{ApiError, ApiResult};

/// A finished document. It is cheap to clone, and written once for all who ask for it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Document {
    bytes: Bytes,
    etag: HeaderValue,
    form: Form,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Json,
    Svg,
}

impl Document {
    pub fn json(value: &impl Serialize) -> ApiResult<Self> {
        let bytes = written(value)?;
        Ok(Self { etag: tag(&bytes)?, bytes: bytes.into(), form: Form::Json })
    }

    /// JSON with the tag of `content`, which is what counts of it.
    pub fn json_tagged_by(content: &impl Serialize, value: &impl Serialize) -> ApiResult<Self> {
        Ok(Self { etag: tag(&written(content)?)?, ..Self::json(value)? })
    }

    pub fn svg(picture: String) -> ApiResult<Self> {
        Ok(Self { etag: tag(picture.as_bytes())?, bytes: picture.into(), form: Form::Svg })
    }

    /// The value that was written as JSON.
    pub fn parsed<T: DeserializeOwned>(&self) -> ApiResult<T> {
        serde_json::from_slice(&self.bytes).map_err(failed)
    }

    /// Number of bytes.
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// The document, or 304 if the client has it already.
    pub fn respond(&self, headers: &HeaderMap) -> Response {
        let own = [(ETAG, self.etag.clone()), (CACHE_CONTROL, HeaderValue::from_static("private, no-cache"))];
        if is_known(headers, &self.etag) {
            return (StatusCode::NOT_MODIFIED, own).into_response();
        }
        match self.form {
            Form::Json => (own, [(CONTENT_TYPE, "application/json")], self.bytes.clone()).into_response(),
            Form::Svg => (own, SVG_HEADERS, self.bytes.clone()).into_response(),
        }
    }
}

/// Headers of a picture that may hold names which people chose. Opened by itself, it runs nothing.
const SVG_HEADERS: [(HeaderName, &str); 2] = [
    (CONTENT_TYPE, "image/svg+xml"),
    (CONTENT_SECURITY_POLICY, "default-src 'none'; style-src 'unsafe-inline'; sandbox"),
];

fn written(value: &impl Serialize) -> ApiResult<Vec<u8>> {
    serde_json::to_vec(value).map_err(failed)
}

fn tag(content: &[u8]) -> ApiResult<HeaderValue> {
    let hash = blake3::hash(content).to_hex();
    HeaderValue::from_str(&format!("W/\"{}\"", &hash[..32])).map_err(failed)
}

fn failed(error: impl std::fmt::Display) -> ApiError {
    tracing::error!(%error, "a document could not be written or read");
    ApiError::new(ProblemKind::Internal, "the service failed; its log says more")
}
