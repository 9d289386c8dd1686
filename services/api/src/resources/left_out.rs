//! Jobs that are taken out of the track record, and put back.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use forelight_protocol::{JobId, LeaveOutRequest, LeftOutJob};

use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{JsonBody, Operator, Segment};
use crate::state::App;

/// Takes a job out of the track record, for example because a node lied about it.
///
/// Neither the record nor calibration counts it any more, and nodes forget what it taught about their speed.
/// The record lists it with the reason. Repeating the request replaces the reason.
#[utoipa::path(put, path = "/v1/jobs/{id}/left-out", operation_id = "job_leave_out", tag = "jobs",
    params(("id" = JobId, Path)), request_body = LeaveOutRequest,
    responses((status = 200, description = "It is out of the record", body = LeftOutJob), Problems))]
pub(crate) async fn leave_out(
    State(app): State<App>,
    Operator(caller): Operator,
    Segment(job): Segment<JobId>,
    JsonBody { value: request, .. }: JsonBody<LeaveOutRequest>,
) -> ApiResult<Json<LeftOutJob>> {
    let LeaveOutRequest { reason } = request;
    if !(1..=500).contains(&reason.chars().count()) || reason.trim().is_empty() {
        return Err(ApiError::invalid("/reason", "a reason has 1 to 500 characters"));
    }
    Ok(Json(app.by(&caller).leave_out(job, &reason, app.now()).await?))
}

/// Puts a job back into the track record.
#[utoipa::path(delete, path = "/v1/jobs/{id}/left-out", operation_id = "job_put_back", tag = "jobs",
    params(("id" = JobId, Path)), responses((status = 204, description = "It is in the record"), Problems))]
pub(crate) async fn put_back(
    State(app): State<App>,
    Operator(caller): Operator,
    Segment(job): Segment<JobId>,
) -> ApiResult<StatusCode> {
    app.by(&caller).put_back(job, app.now()).await?;
    Ok(StatusCode::NO_CONTENT)
}
