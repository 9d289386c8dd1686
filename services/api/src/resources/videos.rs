//! Videos of a job's frames.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, Method};
use axum::response::Response;
use forelight_protocol::{Job, JobId, ProblemKind, VIDEO_FRAMES, VideoRequest};

use crate::delivery::{Asked, Keep, deliver};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{JsonBody, OwnJob, SeenJob};
use crate::schema::FileContent;
use crate::state::App;

/// Has a video made of a job's frames, when the last of them is finished. If the job is done, it is made now.
///
/// An earlier video is replaced. 409 if the job was cancelled or failed, or its images were deleted.
#[utoipa::path(put, path = "/v1/jobs/{id}/video", operation_id = "video_set", tag = "jobs",
    params(("id" = JobId, Path)), request_body = VideoRequest,
    responses((status = 200, description = "The job", body = Job), Problems))]
pub(crate) async fn set(
    State(app): State<App>,
    OwnJob(caller, job): OwnJob,
    JsonBody { value: request, .. }: JsonBody<VideoRequest>,
) -> ApiResult<Json<Job>> {
    check_length(app.store.job(job).await?.frames.count(), "")?;
    Ok(Json(app.by(&caller).set_video(job, Some(request), app.now()).await?))
}

/// Deletes the video of a job; none is made any more. Repeating the request changes nothing.
#[utoipa::path(delete, path = "/v1/jobs/{id}/video", operation_id = "video_delete", tag = "jobs",
    params(("id" = JobId, Path)),
    responses((status = 200, description = "The job", body = Job), Problems))]
pub(crate) async fn delete(State(app): State<App>, OwnJob(caller, job): OwnJob) -> ApiResult<Json<Job>> {
    Ok(Json(app.by(&caller).set_video(job, None, app.now()).await?))
}

/// The video of a job's frames: MP4 with H.264.
#[utoipa::path(get, path = "/v1/jobs/{id}/video.mp4", operation_id = "video_get", tag = "jobs",
    params(("id" = JobId, Path), ("Range" = Option<String>, Header, description = "Ranges of bytes, at most 16"), ("If-Match" = Option<String>, Header, description = "Tags of which the file must have one")),
    responses((status = 200, description = "The video", body = inline(FileContent), content_type = "video/mp4"), (status = 206, description = "The ranges of it; of several, each with its place", content((inline(FileContent) = "video/mp4"), (inline(FileContent) = "multipart/byteranges"))), (status = 304, description = "The video is still that of `If-None-Match`"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    method: Method,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let missing = |reason: &str| ApiError::new(ProblemKind::NotFound, reason);
    let Some(video) = app.store.job(job).await?.video else {
        return Err(missing("no video is made of the job's frames, or it was deleted"));
    };
    let file = video.file.ok_or_else(|| missing("the job does not have its video yet"))?;
    deliver(&app, &Asked { method, headers }, file.hash, "video/mp4", Keep::WhileItIsThere).await
}

/// Checks that a video of so many frames can be made.
pub(super) fn check_length(frames: u64, pointer: &str) -> ApiResult<()> {
    if frames <= VIDEO_FRAMES {
        return Ok(());
    }
    Err(ApiError::invalid(pointer, format!("{frames} frames; a video has at most {VIDEO_FRAMES}")))
}
