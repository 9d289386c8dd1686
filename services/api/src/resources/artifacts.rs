//! Artefacts: files named by their hash.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE, ETAG};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_protocol::{ArtifactHash, ArtifactStored};
use forelight_store::StoreError;
use forelight_store::tokens::Principal;

use super::responses::file;
use crate::error::{ApiResult, Problems};
use crate::extract::{Anyone, Segment, WorkerToken, within_announced_length};
use crate::schema::FileContent;
use crate::state::App;

const MEDIA_TYPE: &str = "application/octet-stream";

/// Stores bytes under their hash. Repeating the request changes nothing; bytes with another hash are refused.
#[utoipa::path(put, path = "/v1/artifacts/{blake3}", operation_id = "artifact_put",
    tag = "work", params(("blake3" = ArtifactHash, Path)),
    request_body(content = inline(FileContent), content_type = "application/octet-stream", description = "By default at most 1 GiB"),
    responses((status = 201, description = "Stored", body = ArtifactStored), (status = 200, description = "It already existed", body = ArtifactStored), Problems))]
pub(crate) async fn put(
    State(app): State<App>,
    _: WorkerToken,
    Segment(hash): Segment<ArtifactHash>,
    headers: HeaderMap,
    body: Body,
) -> ApiResult<Response> {
    let limit = app.limits.artifact_bytes;
    let body = within_announced_length(&headers, body, limit).await?;
    let stored = app.store.artifacts().put(hash, body.into_data_stream(), limit, app.now()).await?;
    let status = if stored.existed { StatusCode::OK } else { StatusCode::CREATED };
    if !stored.existed {
        app.metrics.bytes_received.add(stored.size);
    }
    Ok((status, Json(stored)).into_response())
}

/// An artefact's bytes.
#[utoipa::path(get, path = "/v1/artifacts/{blake3}", operation_id = "artifact_get",
    tag = "work", params(("blake3" = ArtifactHash, Path)),
    responses((status = 200, description = "The bytes", body = inline(FileContent), content_type = "application/octet-stream"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    Anyone(caller): Anyone,
    Segment(hash): Segment<ArtifactHash>,
) -> ApiResult<Response> {
    check_seen(&app, &caller, hash).await?;
    Ok(file(app.store.artifacts().get(hash).await?, MEDIA_TYPE, headers_of(hash)))
}

/// Checks that an artefact exists, and gives its length.
#[utoipa::path(head, path = "/v1/artifacts/{blake3}", operation_id = "artifact_head",
    tag = "work", params(("blake3" = ArtifactHash, Path)),
    responses((status = 200, description = "It exists"), Problems))]
pub(crate) async fn head(
    State(app): State<App>,
    Anyone(caller): Anyone,
    Segment(hash): Segment<ArtifactHash>,
) -> ApiResult<Response> {
    check_seen(&app, &caller, hash).await?;
    let size = app.store.artifacts().size(hash).await?;
    let mut headers = headers_of(hash);
    headers.insert(CONTENT_LENGTH, HeaderValue::from(size));
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(MEDIA_TYPE));
    Ok((StatusCode::OK, headers).into_response())
}

/// Refuses an artefact that belongs to other projects only, as one that does not exist.
async fn check_seen(app: &App, caller: &Principal, hash: ArtifactHash) -> ApiResult<()> {
    if app.store.sees_artifact(caller, hash).await? {
        Ok(())
    } else {
        Err(StoreError::NotFound("artefact").into())
    }
}

fn headers_of(hash: ArtifactHash) -> HeaderMap {
    let mut headers = HeaderMap::new();
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("private, immutable, max-age=31536000"));
    if let Ok(tag) = HeaderValue::from_str(&format!("\"{hash}\"")) {
        headers.insert(ETAG, tag);
    }
    headers
}
