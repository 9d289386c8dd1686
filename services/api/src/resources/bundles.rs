//! Scene bundles.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::header::{CONTENT_LENGTH, CONTENT_TYPE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use forelight_protocol::{Bundle, BundleId, ProblemKind};
use forelight_store::NewBundle;
use futures::StreamExt;
use std::time::Duration;

use super::{created, repeated};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{Anyone, KeyHeader, Segment, Submitter};
use crate::openapi::FileContent;
use crate::scenes;
use crate::state::App;

/// Uploads a bundle as a zip file. It is kept only if it is a scene; if not, the answer is the scene error.
#[utoipa::path(post, path = "/v1/bundles", tag = "bundles",
    request_body(content = inline(FileContent), content_type = "application/zip", description = "The zip file; by default at most 256 MiB"),
    params(("Idempotency-Key" = Option<String>, Header, description = "Makes repeating the request harmless", min_length = 1, max_length = 255, pattern = "^[ -~]+$")),
    responses((status = 201, description = "The bundle", body = Bundle), Problems))]
pub(crate) async fn upload(
    State(app): State<App>,
    Submitter(principal): Submitter,
    key: KeyHeader,
    headers: HeaderMap,
    body: Body,
) -> ApiResult<Response> {
    let media_type = headers.get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or("");
    if !["application/zip", "application/x-zip-compressed", "application/octet-stream"].contains(&media_type)
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
    let scene = scenes::inspect(&app, staged.path().to_owned(), "bundle.zip").await?;
    let stored = app.store.artifacts().keep(staged, app.now()).await?;
    app.metrics.bytes_received.add(stored.size);
    let answered = app.store.create_bundle(NewBundle { hash, scene }, key.as_ref(), app.now()).await?;
    Ok(created(StatusCode::CREATED, answered))
}

/// One bundle.
#[utoipa::path(get, path = "/v1/bundles/{id}", tag = "bundles", params(("id" = BundleId, Path)),
    responses((status = 200, description = "The bundle", body = Bundle), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    _: Anyone,
    Segment(bundle): Segment<BundleId>,
) -> ApiResult<Json<Bundle>> {
    Ok(Json(app.store.bundle(bundle).await?))
}

/// How much of a body that is refused for its length is read, bytes.
const DRAINED: usize = 1 << 20;

/// The body, unless it says of itself that it is too long. Then nothing of it is kept, but its beginning is read: a client that
/// is still sending when the connection closes may never see the answer that says why.
pub(crate) async fn within_announced_length(headers: &HeaderMap, body: Body, limit: u64) -> ApiResult<Body> {
    let announced = headers.get(CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse::<u64>().ok());
    if announced.is_none_or(|length| length <= limit) {
        return Ok(body);
    }
    let mut stream = body.into_data_stream();
    let drain = async {
        let mut read = 0;
        while read < DRAINED
            && let Some(Ok(chunk)) = stream.next().await
        {
            read += chunk.len();
        }
    };
    // Whether it ended in time or not, the answer is the same.
    let _ = tokio::time::timeout(Duration::from_secs(2), drain).await;
    Err(ApiError::new(ProblemKind::TooLarge, format!("at most {limit} bytes are taken here")))
}
