//! Scene bundles.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use forelight_protocol::{Bundle, BundleId, ProblemKind};
use forelight_store::NewBundle;

use super::responses::{created, repeated};
use crate::bundle_inspection;
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{Anyone, KeyHeader, Segment, Submitter, media_type, within_announced_length};
use crate::schema::{FileContent, IdempotencyKeyHeader};
use crate::state::App;

/// Uploads a bundle as a zip file. If it is not a valid scene, it is not kept, and the answer is the scene's
/// error.
#[utoipa::path(post, path = "/v1/bundles", operation_id = "bundle_upload", tag = "bundles",
    request_body(content = inline(FileContent), content_type = "application/zip", description = "The zip file; by default at most 256 MiB"),
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
    if !["application/zip", "application/x-zip-compressed", "application/octet-stream"]
        .contains(&media_type.as_str())
    {
        return Err(ApiError::new(
            ProblemKind::UnsupportedMediaType,
            "send the zip file with Content-Type: application/zip",
        ));
    }
    let body = within_announced_length(&headers, body, app.limits.bundle_bytes).await?;
    let staged = app.store.artifacts().stage(body.into_data_stream(), app.limits.bundle_bytes).await?;
    let hash = staged.hash;
    let key = key.of(&principal, &hash.0);
    let _guard = app.in_flight.enter(key.as_ref())?;
    if let Some(key) = &key
        && let Some(answer) = app.store.recorded_answer(key).await?
    {
        return Ok(repeated(answer));
    }
    let scene = bundle_inspection::inspect(&app, staged.path().to_owned(), "bundle.zip").await?;
    let stored = app.store.artifacts().keep(staged, app.now()).await?;
    app.metrics.bytes_received.add(stored.size);
    let answered = app.store.create_bundle(NewBundle { hash, scene }, key.as_ref(), app.now()).await?;
    Ok(created(StatusCode::CREATED, answered))
}

/// One bundle.
#[utoipa::path(get, path = "/v1/bundles/{id}", operation_id = "bundle_get",
    tag = "bundles", params(("id" = BundleId, Path)),
    responses((status = 200, description = "The bundle", body = Bundle), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    _: Anyone,
    Segment(bundle): Segment<BundleId>,
) -> ApiResult<Json<Bundle>> {
    Ok(Json(app.store.bundle(bundle).await?))
}
