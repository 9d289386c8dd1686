//! Artefacts: files named by their hash.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, Method, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_protocol::{ArtifactHash, ArtifactStored};
use forelight_store::StoreError;
use forelight_store::tokens::Principal;

use crate::delivery::{Asked, Keep, deliver};
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
    // A result of work that was done is taken as long as it fits. What is left lets the database write, so that
    // people can make room.
    let leave = app.limits.least_disk_space / 2;
    let room = app.reserved.begin(&app.store, &headers, limit, leave)?;
    let content = room.fill(body.into_data_stream());
    let stored = app.store.artifacts().put(hash, content, limit, app.now()).await?;
    let status = if stored.existed { StatusCode::OK } else { StatusCode::CREATED };
    if !stored.existed {
        app.metrics.bytes_received.add(stored.size);
    }
    Ok((status, Json(stored)).into_response())
}

/// An artefact's bytes, or a range of them. They are verified first: 500 if they are not what was stored.
#[utoipa::path(get, path = "/v1/artifacts/{blake3}", operation_id = "artifact_get",
    tag = "work", params(("blake3" = ArtifactHash, Path), ("Range" = Option<String>, Header, description = "Ranges of bytes, at most 16"), ("If-Match" = Option<String>, Header, description = "Tags of which the file must have one")),
    responses((status = 200, description = "The bytes", body = inline(FileContent), content_type = "application/octet-stream"),
              (status = 206, description = "The ranges of them; of several, each with its place", content((inline(FileContent) = "application/octet-stream"), (inline(FileContent) = "multipart/byteranges"))),
              (status = 304, description = "The client has them"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    Anyone(caller): Anyone,
    Segment(hash): Segment<ArtifactHash>,
    method: Method,
    headers: HeaderMap,
) -> ApiResult<Response> {
    check_seen(&app, &caller, hash).await?;
    deliver(&app, &Asked { method, headers }, hash, MEDIA_TYPE, Keep::ForEver).await
}

/// Checks that an artefact exists and is whole, and gives its length.
#[utoipa::path(head, path = "/v1/artifacts/{blake3}", operation_id = "artifact_head",
    tag = "work", params(("blake3" = ArtifactHash, Path)),
    responses((status = 200, description = "It exists"), (status = 304, description = "The client has it"), Problems))]
pub(crate) async fn head(
    app: State<App>,
    caller: Anyone,
    hash: Segment<ArtifactHash>,
    method: Method,
    headers: HeaderMap,
) -> ApiResult<Response> {
    app.store.artifacts().announce(hash.0).await?;
    get(app, caller, hash, method, headers).await
}

/// Refuses an artefact that belongs to other projects only, as one that does not exist.
async fn check_seen(app: &App, caller: &Principal, hash: ArtifactHash) -> ApiResult<()> {
    if app.store.sees_artifact(caller, hash).await? {
        Ok(())
    } else {
        Err(StoreError::NotFound("artefact").into())
    }
}
