//! Quotes, and how often they were right.

use axum::Json;
use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use forelight_forecast::Correction;
use forelight_protocol::{
    AccuracyDoc, CalibratedQuantiles, CalibrationDoc, CalibrationKind, Corrections, ForecastDoc, JobId,
    ProblemKind, Timestamp, TrackRecord,
};

use crate::conductor::accuracy::accuracy;
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{QueryParameters, Reader, Segment};
use crate::openapi::FileContent;
use crate::page::{PageQuery, cut};
use crate::plot;
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

/// What accuracy costs in time: other qualities of the job, with what all its frames would take and how far their images would be from
/// their converged selves. It rests on the job's own profile, and nothing is traced for it: so of the other integrator, of a cache's
/// accuracy and of the rays of a gather it says nothing. 409 until the profile is there.
#[utoipa::path(get, path = "/v1/jobs/{id}/accuracy", tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The ladders", body = AccuracyDoc), Problems))]
pub(crate) async fn accuracy_of_job(
    State(app): State<App>,
    _: Reader,
    Segment(id): Segment<JobId>,
) -> ApiResult<Json<AccuracyDoc>> {
    let job = app.store.job(id).await?;
    let preview = app.store.preview_result(id).await?;
    let profiles = app.store.profile_results(id).await?.filter(|profiles| !profiles.is_empty());
    let (Some(preview), Some(profiles)) = (preview, profiles) else {
        let reason =
            format!("the job is {} and not profiled, so nothing is known of other qualities", job.state);
        return Err(ApiError::new(ProblemKind::Conflict, reason));
    };
    match accuracy(job.settings, preview, profiles).await {
        Ok(document) => Ok(Json(document)),
        Err(reason) => {
            Err(ApiError::new(ProblemKind::Conflict, format!("the profile says nothing: {reason}")))
        }
    }
}

/// Forecast against actual over all finished frames, also by kind of quote, and the frames themselves, newest first.
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

/// Finished jobs whose errors the picture of the record shows.
const SHOWN_JOBS: u32 = 500;

/// The same as a picture: how often truths stayed at or below the quantiles that were promised, of quotes that were calibrated on past jobs
/// and of those that were not, and the errors of the newest 500 finished jobs in their order.
#[utoipa::path(get, path = "/v1/forecasts/track-record.svg", tag = "farm",
    responses((status = 200, description = "The picture", body = inline(FileContent), content_type = "image/svg+xml"), Problems))]
pub(crate) async fn track_record_svg(State(app): State<App>, _: Reader) -> ApiResult<Response> {
    let record = app.store.track_record(None, 0).await?;
    let jobs = app.store.finished_jobs(SHOWN_JOBS).await?;
    let svg = plot::track_record(&record, &jobs).map_err(|reason| {
        ApiError::new(ProblemKind::Internal, format!("the picture cannot be drawn: {reason}"))
    })?;
    Ok(([(CONTENT_TYPE, "image/svg+xml"), (CACHE_CONTROL, "private, no-cache")], svg).into_response())
}

/// What the finished jobs teach of the next quote's quantiles, by renderer and class of features: what a quote that is made now would be
/// calibrated with. `forelight forecast --calibration` takes it for quotes that are made offline.
#[utoipa::path(get, path = "/v1/forecasts/calibration", tag = "farm",
    responses((status = 200, description = "The calibration", body = CalibrationDoc), Problems))]
pub(crate) async fn calibration(State(app): State<App>, _: Reader) -> ApiResult<Json<CalibrationDoc>> {
    let quantiles = |Correction { p50, p80, p95 }| CalibratedQuantiles { p50, p80, p95 };
    let mut kinds = Vec::new();
    for (kind, jobs) in app.store.learnt_kinds().await? {
        let corrections = app.store.experience(&kind).await?.corrections();
        kinds.push(CalibrationKind {
            renderer: kind.renderer,
            feature_class: kind.feature_class,
            jobs,
            corrections: corrections.map(|found| Corrections {
                frame_work: quantiles(found.frame_work),
                frame_cpu: quantiles(found.frame_cpu),
                job_work: quantiles(found.job_work),
                job_cpu: quantiles(found.job_cpu),
            }),
        });
    }
    Ok(Json(CalibrationDoc { kinds }))
}
