//! Quotes, and how often they were right.

use axum::Json;
use axum::extract::State;
use forelight_protocol::{ForecastDoc, JobId, ProblemKind, Timestamp, TrackRecord};

use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{QueryParameters, Reader, Segment};
use crate::page::{PageQuery, cut};
use crate::state::App;

/// A job's quote. 409 until it is there.
#[utoipa::path(get, path = "/v1/jobs/{id}/forecast", tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The quote", body = ForecastDoc), Problems))]
pub(crate) async fn of_job(
    State(app): State<App>,
    _: Reader,
    Segment(job): Segment<JobId>,
) -> ApiResult<Json<ForecastDoc>> {
    match app.store.forecast(job).await? {
        Some(forecast) => Ok(Json(forecast)),
        None => {
            let state = app.store.job(job).await?.state;
            Err(ApiError::new(ProblemKind::Conflict, format!("the job is {state} and has no forecast")))
        }
    }
}

/// Forecast against actual over all finished frames, and the frames themselves, newest first.
#[utoipa::path(get, path = "/v1/forecasts/track-record", tag = "farm", params(PageQuery),
    responses((status = 200, description = "The record", body = TrackRecord), Problems))]
pub(crate) async fn track_record(
    State(app): State<App>,
    _: Reader,
    QueryParameters(query): QueryParameters<PageQuery>,
) -> ApiResult<Json<TrackRecord>> {
    let size = query.size()?;
    let before: Option<(Timestamp, JobId, u32)> = query.key("track-record")?;
    let mut record = app.store.track_record(before, size + 1).await?;
    record.next_page_token =
        cut(&mut record.items, size, "track-record", |row| (row.finished, row.job_id, row.frame));
    Ok(Json(record))
}
