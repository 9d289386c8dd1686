//! Scene bundles.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use forelight_protocol::{Bundle, BundleId, ProblemKind, SceneDigest};
use forelight_store::{NewBundle, QuotaOf, StoreError};

use super::responses::{created, repeated};
use crate::bundle_inspection;
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{
    Anyone, KeyHeader, Segment, Submitter, announced_length, media_type, within_announced_length,
};
use crate::schema::{FileContent, IdempotencyKeyHeader};
use crate::state::App;

/// Media type of Blender files.
const BLEND: &str = "application/x-blender";

/// Uploads of people leave this many times the disk space below which no task is handed out.
const LEFT_FREE: u64 = 4;

/// Uploads a bundle as a zip file. If it is not a valid scene, it is not kept, and the answer is the scene's
/// error. Also uploads a Blender file, as `application/x-blender`: the service does not open it, so its jobs
/// find out what is in it. Files that it refers to must be packed, or lie on storage that all workers share.
#[utoipa::path(post, path = "/v1/bundles", operation_id = "bundle_upload", tag = "bundles",
    request_body(content((inline(FileContent) = "application/zip"), (inline(FileContent) = "application/x-blender")),
        description = "The zip or Blender file; by default at most 256 MiB"),
    params(IdempotencyKeyHeader),
    responses((status = 201, description = "The bundle", body = Bundle), Problems))]
pub(crate) async fn upload(
    State(app): State<App>,
    Submitter(principal): Submitter,
    key: KeyHeader,
    headers: HeaderMap,
    body: Body,
) -> ApiResult<Response> {
    let media_type = media_type(&headers);
    let is_blend = media_type == BLEND;
    if !is_blend
        && !["application/zip", "application/x-zip-compressed", "application/octet-stream"]
            .contains(&media_type.as_str())
    {
        return Err(ApiError::new(
            ProblemKind::UnsupportedMediaType,
            format!("send a zip file with Content-Type: application/zip, or a Blender file with {BLEND}"),
        ));
    }
    let most = app.limits.bundle_bytes;
    let body = within_announced_length(&headers, body, most).await?;
    let announced = announced_length(&headers).unwrap_or(most);
    let _quota = app.quotas.upload(&principal, announced, app.limits.uploads.bytes_per_token)?;
    app.store.check_storage(QuotaOf::Token(&principal.name), announced_length(&headers).unwrap_or(0)).await?;
    let leave = app.limits.least_disk_space.saturating_mul(LEFT_FREE);
    let room = app.reserved.begin(&app.store, &headers, most, leave)?;
    let staged = app.store.artifacts().stage(room.fill(body.into_data_stream()), most).await?;
    // Who sends in chunks announces nothing. It is checked once more when the bundle is stored.
    app.store.check_storage(QuotaOf::Token(&principal.name), staged.size).await?;
    let hash = staged.hash;
    let key = key.of(&principal, &hash.0);
    let _guard = app.in_flight.enter(key.as_ref())?;
    if let Some(key) = &key
        && let Some(answer) = app.store.recorded_answer(key).await?
    {
        return Ok(repeated(answer));
    }
    let scene = if is_blend {
        bundle_inspection::blend(staged.path().to_owned(), SceneDigest(hash.0)).await?
    } else {
        bundle_inspection::inspect(&app, staged.path().to_owned(), "bundle.zip").await?
    };
    let stored = app.store.artifacts().keep(staged, app.now()).await?;
    app.metrics.bytes_received.add(stored.size);
    let answered =
        app.by(&principal).create_bundle(NewBundle { hash, scene }, key.as_ref(), app.now()).await?;
    Ok(created(StatusCode::CREATED, answered))
}

/// One bundle.
#[utoipa::path(get, path = "/v1/bundles/{id}", operation_id = "bundle_get",
    tag = "bundles", params(("id" = BundleId, Path)),
    responses((status = 200, description = "The bundle", body = Bundle), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    Anyone(caller): Anyone,
    Segment(bundle): Segment<BundleId>,
) -> ApiResult<Json<Bundle>> {
    if !app.store.sees_bundle(&caller, bundle).await? {
        return Err(StoreError::NotFound("bundle").into());
    }
    Ok(Json(app.store.bundle(bundle).await?))
}
