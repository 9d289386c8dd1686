//! Changes of jobs: accepting a quote, other terms, frames that are rendered again or cancelled.

use axum::Json;
use axum::extract::State;
use forelight_protocol::{AcceptRequest, FrameSet, FramesRequest, Job, JobChange, JobId, ProblemKind};

use super::request_checks::{check_priority, check_terms};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{JsonBody, OwnJob};
use crate::state::App;

/// Accepts the quote of a job on hold, which is then booked. Cancel the job to drop the quote.
///
/// What is left out stays as it was submitted. Repeating the request without changes changes nothing.
#[utoipa::path(post, path = "/v1/jobs/{id}/accept", operation_id = "job_accept", tag = "jobs",
    params(("id" = JobId, Path)), request_body = AcceptRequest,
    responses((status = 200, description = "The job", body = Job), Problems))]
pub(crate) async fn accept(
    State(app): State<App>,
    OwnJob(caller, job): OwnJob,
    JsonBody { value: request, .. }: JsonBody<AcceptRequest>,
) -> ApiResult<Json<Job>> {
    check_terms(&app, request.deadline, request.budget)?;
    let accepted = app.by(&caller).accept_job(job, &request.into(), app.now()).await?;
    // The conductor ends with the service, and looks for accepted jobs when it starts.
    let _ = app.conductor.send(job);
    Ok(Json(accepted))
}

/// Changes deadline, budget, confidence or priority of a job, or pauses or resumes it. The farm is then planned again.
///
/// Nothing more of a paused job is started: no preview, profile or frame. What is under way goes on. `frames/retry`
/// takes a frame back, which is then rendered from the start.
#[utoipa::path(patch, path = "/v1/jobs/{id}", operation_id = "job_change", tag = "jobs",
    params(("id" = JobId, Path)), request_body = JobChange,
    responses((status = 200, description = "The job", body = Job), Problems))]
pub(crate) async fn change(
    State(app): State<App>,
    OwnJob(caller, job): OwnJob,
    JsonBody { value: change, .. }: JsonBody<JobChange>,
) -> ApiResult<Json<Job>> {
    check_terms(&app, change.deadline.flatten(), change.budget.flatten())?;
    change.priority.map_or(Ok(()), check_priority)?;
    let changed = app.by(&caller).change_job(job, &change, app.now()).await?;
    // The conductor looks again what would become of a quote on hold.
    let _ = app.conductor.send(job);
    Ok(Json(changed))
}

/// Renders frames again, finished ones too, and forgives their failures.
///
/// A job that is done goes on. A job that failed goes on with all frames that it had left; one that failed before it
/// was booked, with its quote. 409 for a cancelled job, and before the frames are booked.
#[utoipa::path(post, path = "/v1/jobs/{id}/frames/retry", operation_id = "frame_retry", tag = "jobs",
    params(("id" = JobId, Path)), request_body = FramesRequest,
    responses((status = 200, description = "The job", body = Job), Problems))]
pub(crate) async fn retry_frames(
    State(app): State<App>,
    OwnJob(caller, job): OwnJob,
    JsonBody { value: request, .. }: JsonBody<FramesRequest>,
) -> ApiResult<Json<Job>> {
    check_frames(&app, job, &request.frames).await?;
    Ok(Json(app.by(&caller).retry_frames(job, &request.frames, app.now()).await?))
}

/// Cancels frames of a job, which is done without them. Finished frames stay.
///
/// If no others are left, the job is done, or cancelled if none is finished. 409 if the job is over, and
/// before its frames are booked.
#[utoipa::path(post, path = "/v1/jobs/{id}/frames/cancel", operation_id = "frame_cancel", tag = "jobs",
    params(("id" = JobId, Path)), request_body = FramesRequest,
    responses((status = 200, description = "The job", body = Job), Problems))]
pub(crate) async fn cancel_frames(
    State(app): State<App>,
    OwnJob(caller, job): OwnJob,
    JsonBody { value: request, .. }: JsonBody<FramesRequest>,
) -> ApiResult<Json<Job>> {
    check_frames(&app, job, &request.frames).await?;
    Ok(Json(app.by(&caller).drop_frames(job, &request.frames, app.now()).await?))
}

async fn check_frames(app: &App, job: JobId, frames: &FrameSet) -> ApiResult<()> {
    let known = app.store.job(job).await?.frames;
    if frames.count() > app.limits.frames {
        let reason = format!("{} frames; a job has at most {}", frames.count(), app.limits.frames);
        return Err(ApiError::invalid("/frames", reason));
    }
    match frames.iter().find(|&frame| !known.contains(frame)) {
        Some(frame) => {
            let reason = format!("the job has no frame {frame}");
            Err(ApiError::new(ProblemKind::NotFound, reason).at("/frames"))
        }
        None => Ok(()),
    }
}
