//! Bodies with a size limit. Part of an oversized body is still read, or the client may never see the answer.

use std::time::Duration;

use axum::body::{Body, BodyDataStream, Bytes};
use axum::http::HeaderMap;
use axum::http::header::CONTENT_LENGTH;
use bytes::BytesMut;
use forelight_protocol::ProblemKind;
use futures::StreamExt;

use crate::error::{ApiError, ApiResult};

/// Bytes of an oversized body that are read before closing.
const DRAINED: usize = 1 << 20;

/// The announced length of a body.
pub(crate) fn announced_length(headers: &HeaderMap) -> Option<u64> {
    headers.get(CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse().ok())
}

/// The body, unless its announced length is too large.
pub(crate) async fn within_announced_length(headers: &HeaderMap, body: Body, limit: u64) -> ApiResult<Body> {
    if announced_length(headers).is_none_or(|length| length <= limit) {
        return Ok(body);
    }
    Err(too_large(body.into_data_stream(), limit).await)
}

/// The whole body. Its announced and its actual length are both checked.
pub(crate) async fn whole(headers: &HeaderMap, body: Body, limit: usize) -> ApiResult<Bytes> {
    let mut stream = within_announced_length(headers, body, limit as u64).await?.into_data_stream();
    let mut bytes = BytesMut::new();
    while let Some(chunk) = stream.next().await {
        let chunk = chunk
            .map_err(|error| ApiError::new(ProblemKind::Malformed, format!("the body broke off: {error}")))?;
        if bytes.len() + chunk.len() > limit {
            return Err(too_large(stream, limit as u64).await);
        }
        bytes.extend_from_slice(&chunk);
    }
    Ok(bytes.freeze())
}

/// Drains the rest of a body and returns the error.
async fn too_large(mut rest: BodyDataStream, limit: u64) -> ApiError {
    let drain = async {
        let mut read = 0;
        while read < DRAINED
            && let Some(Ok(chunk)) = rest.next().await
        {
            read += chunk.len();
        }
    };
    let _ = tokio::time::timeout(Duration::from_secs(2), drain).await;
    ApiError::new(ProblemKind::TooLarge, format!("the body is larger than the limit of {limit} bytes"))
}
