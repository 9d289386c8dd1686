//! Finished tiles of a running frame, for the next worker if this one is lost.

use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use forelight_protocol::{CHECKPOINT_BYTES, LeaseId};
use serde::Deserialize;
use utoipa::IntoParams;

use super::counted;
use crate::error::{ApiResult, Problems};
use crate::extract::{QueryParameters, Segment, WorkerToken, number, whole};
use crate::schema::FileContent;
use crate::state::App;

/// Lease of the checkpoint.
#[derive(Clone, Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct FenceQuery {
    /// The lease's fencing token.
    #[serde(deserialize_with = "number::<_, _, 0, { i64::MAX }>")]
    fence: u64,
}

/// Stores the finished tiles of a frame, replacing those sent before.
#[utoipa::path(put, path = "/v1/leases/{id}/checkpoint", operation_id = "checkpoint_put",
    tag = "work", params(("id" = LeaseId, Path), FenceQuery),
    request_body(content = inline(FileContent), content_type = "application/octet-stream", description = "A profile, at most 64 MiB"),
    responses((status = 204, description = "Kept until the task ends"), Problems))]
pub(crate) async fn put(
    State(app): State<App>,
    worker: WorkerToken,
    Segment(lease): Segment<LeaseId>,
    QueryParameters(FenceQuery { fence }): QueryParameters<FenceQuery>,
    headers: HeaderMap,
    body: axum::body::Body,
) -> ApiResult<StatusCode> {
    worker.speaks_for_lease(&app, lease).await?;
    let bytes = whole(&headers, body, CHECKPOINT_BYTES).await?;
    counted(&app, app.store.put_checkpoint(lease, fence, bytes).await)?;
    Ok(StatusCode::NO_CONTENT)
}

/// Finished tiles of the lease's frame from an earlier worker. 404 if there are none.
#[utoipa::path(get, path = "/v1/leases/{id}/checkpoint", operation_id = "checkpoint_get",
    tag = "work", params(("id" = LeaseId, Path)),
    responses((status = 200, description = "A profile", body = inline(FileContent), content_type = "application/octet-stream"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    worker: WorkerToken,
    Segment(lease): Segment<LeaseId>,
) -> ApiResult<([(axum::http::HeaderName, &'static str); 1], Vec<u8>)> {
    worker.speaks_for_lease(&app, lease).await?;
    Ok(([(CONTENT_TYPE, "application/octet-stream")], app.store.checkpoint(lease).await?))
}
