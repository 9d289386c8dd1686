//! All frames of a job in a row.

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use forelight_protocol::{FrameStrip, JobId, StripQuantity};
use serde::Deserialize;
use utoipa::IntoParams;

use super::responses::tagged;
use crate::error::{ApiResult, Problems};
use crate::extract::{QueryParameters, SeenJob};
use crate::state::App;

/// What the numbers of a strip are.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct StripQuery {
    /// What the numbers are. Default: CPU seconds.
    pub quantity: Option<StripQuantity>,
}

/// States, forecasts and true costs of all frames of a job, in a few lists.
#[utoipa::path(get, path = "/v1/jobs/{id}/strip", operation_id = "job_strip", tag = "jobs",
    params(("id" = JobId, Path), StripQuery),
    responses((status = 200, description = "The strip", body = FrameStrip),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    QueryParameters(query): QueryParameters<StripQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    tagged(&headers, &app.store.strip(job, query.quantity.unwrap_or_default()).await?)
}
