//! Quotes and their track record.

use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use forelight_forecast::Correction;
use forelight_plots::PlotError;
use forelight_protocol::{
    AccuracyDoc, CalibratedQuantiles, CalibrationDoc, CalibrationKind, Corrections, Explanation, ForecastDoc,
    ForecastHistory, Job, JobId, ProblemKind, Timestamp, TrackRecord,
};

use serde::Deserialize;
use utoipa::IntoParams;

use crate::conductor::AdvanceError;
use crate::conductor::job_profile::{JobProfile, explanation};
use crate::costly::key;
use crate::document::Document;
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{QueryParameters, Reader, SeenJob, number_if_any};
use crate::page::{PageQuery, cut};
use crate::plot;
use crate::resources::responses;
use crate::schema::FileContent;
use crate::state::App;

/// A job's quote. 409 until it exists.
#[utoipa::path(get, path = "/v1/jobs/{id}/forecast", operation_id = "job_forecast",
    tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The quote", body = ForecastDoc),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn of_job(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    headers: HeaderMap,
) -> ApiResult<Response> {
    match app.store.forecast(job).await? {
        Some(forecast) => responses::tagged(&headers, &forecast),
        None => {
            let state = app.store.job(job).await?.state;
            Err(ApiError::new(ProblemKind::Conflict, format!("the job is {state} and has no quote")))
        }
    }
}

/// Cost and error of the job at other qualities, from its own profile. 409 until that exists.
///
/// Request the job with `ladders: all` for the ladders of integrator, cache accuracy and divisions. A shared
/// irradiance cache is in no rung; the quote lists it separately.
#[utoipa::path(get, path = "/v1/jobs/{id}/accuracy", operation_id = "job_accuracy",
    tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The ladders", body = AccuracyDoc),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn accuracy_of_job(
    State(app): State<App>,
    SeenJob(id): SeenJob,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let job = app.store.job(id).await?;
    let key = key(&("accuracy", id, app.store.profile_version(id).await?));
    let costly = app.costly.clone();
    let make = async move {
        let measured = profile(&app, &job).await?;
        Document::json(&measured.qualities().await.map_err(uncovered)?)
    };
    Ok(costly.answer(key, make).await?.respond(&headers))
}

fn uncovered(reason: AdvanceError) -> ApiError {
    ApiError::new(ProblemKind::Conflict, format!("the profile does not cover this: {reason}"))
}

/// Which part of the job to explain.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExplanationQuery {
    /// Only this frame. If absent, the whole job.
    #[serde(default, deserialize_with = "number_if_any::<_, _, 0, { u32::MAX as i64 }>")]
    pub frame: Option<u32>,
}

/// Where the work of a job, or of one of its frames, goes, and what would halve it. 409 until the profile
/// exists.
///
/// Work is given by parts, by what the pixels show and by kinds of rays, with the number of profiled pixels.
/// It adds up to the quote without a shared irradiance cache, which has its own line there. Nothing is
/// traced. With another renderer, work is CPU time in microseconds on a node of speed 1, and objects are
/// listed if the renderer says where in the image time goes.
#[utoipa::path(get, path = "/v1/jobs/{id}/explanation", operation_id = "job_explanation",
    tag = "jobs", params(("id" = JobId, Path), ExplanationQuery),
    responses((status = 200, description = "The explanation", body = Explanation),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn explanation_of_job(
    State(app): State<App>,
    SeenJob(id): SeenJob,
    QueryParameters(ExplanationQuery { frame }): QueryParameters<ExplanationQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let job = app.store.job(id).await?;
    if let Some(frame) = frame.filter(|&frame| !job.frames.iter().any(|known| known == frame)) {
        return Err(ApiError::new(ProblemKind::NotFound, format!("the job has no frame {frame}")));
    }
    let key = key(&("explanation", id, frame, app.store.profile_version(id).await?));
    let costly = app.costly.clone();
    let make = async move {
        let explained = explanation(&app.store, &job, frame).await.map_err(uncovered)?;
        Document::json(&explained.ok_or_else(|| not_profiled(&job))?)
    };
    Ok(costly.answer(key, make).await?.respond(&headers))
}

async fn profile(app: &App, job: &Job) -> ApiResult<JobProfile> {
    JobProfile::read(&app.store, job).await?.ok_or_else(|| {
        let reason = match &job.renderer {
            Some(renderer) => format!("{renderer} profiles samples of frames; this needs profiled pixels"),
            None => return not_profiled(job),
        };
        ApiError::new(ProblemKind::Conflict, reason)
    })
}

fn not_profiled(job: &Job) -> ApiError {
    ApiError::new(ProblemKind::Conflict, format!("the job is {} and not profiled yet", job.state))
}

/// The job's estimate over time, from the quote to the actual cost, with the booking. 409 until it is booked.
#[utoipa::path(get, path = "/v1/jobs/{id}/forecast/history", operation_id = "job_forecast_history",
    tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The history", body = ForecastHistory),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn history_of_job(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let key = key(&("history", job, app.store.last_event_id().await?));
    let costly = app.costly.clone();
    let make = async move { Document::json(&history(&app, job).await?) };
    Ok(costly.answer(key, make).await?.respond(&headers))
}

/// The job's estimate over time as a picture: expected cost and end, next to the booking.
#[utoipa::path(get, path = "/v1/jobs/{id}/forecast/history.svg", operation_id = "job_forecast_history_svg",
    tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The picture", body = inline(FileContent), content_type = "image/svg+xml"),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn history_of_job_svg(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let key = key(&("picture of history", job, app.store.last_event_id().await?));
    let costly = app.costly.clone();
    let make = async move { svg(plot::forecast_history(&history(&app, job).await?)) };
    Ok(costly.answer(key, make).await?.respond(&headers))
}

async fn history(app: &App, job: JobId) -> ApiResult<ForecastHistory> {
    match app.store.forecast_history(job).await? {
        Some(history) => Ok(history),
        None => {
            let state = app.store.job(job).await?.state;
            Err(ApiError::new(ProblemKind::Conflict, format!("the job is {state} and has no quote")))
        }
    }
}

pub(super) fn svg(drawn: Result<String, PlotError>) -> ApiResult<Document> {
    let svg = drawn.map_err(|error| ApiError::new(ProblemKind::Internal, error.to_string()))?;
    Document::svg(svg)
}

/// Forecasts against actual costs of all finished frames that the caller sees, also by kind of quote. Newest
/// frames first.
#[utoipa::path(get, path = "/v1/forecasts/track-record", operation_id = "track_record_get",
    tag = "farm", params(PageQuery),
    responses((status = 200, description = "The record", body = TrackRecord),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn track_record(
    State(app): State<App>,
    Reader(caller): Reader,
    QueryParameters(query): QueryParameters<PageQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let size = query.size();
    let before: Option<(Timestamp, JobId, u32)> = query.key("track-record")?;
    let projects = caller.project_names();
    let key = key(&("track record", before, size, &projects, app.store.last_event_id().await?));
    let costly = app.costly.clone();
    let make = async move {
        let mut record = app.store.track_record(before, size + 1, projects.as_deref()).await?;
        record.next_page_token =
            cut(&mut record.items, size, "track-record", |row| (row.finished, row.job_id, row.frame));
        Document::json(&record)
    };
    Ok(costly.answer(key, make).await?.respond(&headers))
}

const SHOWN_JOBS: u32 = 500;

/// The track record as a picture: how often quantiles held, with and without calibration, and the errors of
/// the newest 500 jobs.
#[utoipa::path(get, path = "/v1/forecasts/track-record.svg", operation_id = "track_record_svg", tag = "farm",
    responses((status = 200, description = "The picture", body = inline(FileContent), content_type = "image/svg+xml"),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn track_record_svg(
    State(app): State<App>,
    Reader(caller): Reader,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let projects = caller.project_names();
    let key = key(&("picture of the track record", &projects, app.store.last_event_id().await?));
    let costly = app.costly.clone();
    let make = async move {
        let record = app.store.track_record(None, 0, projects.as_deref()).await?;
        let jobs = app.store.finished_jobs(SHOWN_JOBS, projects.as_deref()).await?;
        svg(plot::track_record(&record, &jobs))
    };
    Ok(costly.answer(key, make).await?.respond(&headers))
}

/// Calibration learned from finished jobs, by renderer and class of features. `forelight forecast
/// --calibration` takes it.
#[utoipa::path(get, path = "/v1/forecasts/calibration", operation_id = "calibration_get", tag = "farm",
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
