//! Jobs in addresses, with the check that the caller reaches their projects. A handler takes one of these, so
//! none can forget it. A job of another project is answered like one that does not exist.

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use forelight_protocol::{JobId, ProblemKind};
use forelight_store::StoreError;
use forelight_store::tokens::Principal;

use super::{Reader, Segment, Segments, Submitter};
use crate::error::{ApiError, ApiResult, WRONG_ROLE};
use crate::state::App;

/// A job that the caller sees.
pub(crate) struct SeenJob(pub JobId);

/// A frame of a job that the caller sees.
pub(crate) struct SeenFrame(pub JobId, pub u32);

/// A job that the caller may change, and the caller.
pub(crate) struct OwnJob(pub Principal, pub JobId);

/// A caller who reaches all projects, for what concerns all of them.
pub(crate) struct FarmReader;

impl FromRequestParts<App> for SeenJob {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> ApiResult<Self> {
        let Reader(caller) = Reader::from_request_parts(parts, app).await?;
        let Segment(job) = Segment::from_request_parts(parts, app).await?;
        check_seen(app, &caller, job).await?;
        Ok(Self(job))
    }
}

impl FromRequestParts<App> for SeenFrame {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> ApiResult<Self> {
        let Reader(caller) = Reader::from_request_parts(parts, app).await?;
        let Segments(job, frame) = Segments::from_request_parts(parts, app).await?;
        check_seen(app, &caller, job).await?;
        Ok(Self(job, frame))
    }
}

impl FromRequestParts<App> for OwnJob {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> ApiResult<Self> {
        let Submitter(caller) = Submitter::from_request_parts(parts, app).await?;
        let Segment(job) = Segment::from_request_parts(parts, app).await?;
        if caller.projects.is_some() {
            let project = app.store.project_of_job(job).await?;
            if !caller.sees(&project) {
                return Err(StoreError::NotFound("job").into());
            }
            check_may_change(&caller, &project)?;
        }
        Ok(Self(caller, job))
    }
}

impl FromRequestParts<App> for FarmReader {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> ApiResult<Self> {
        let Reader(caller) = Reader::from_request_parts(parts, app).await?;
        if caller.reaches_all() {
            return Ok(Self);
        }
        let reason = "this concerns all projects; a token for some projects does not allow it";
        Err(ApiError::new(ProblemKind::Forbidden, reason).authenticate(WRONG_ROLE))
    }
}

/// Refuses a job that the caller does not see, as one that does not exist.
async fn check_seen(app: &App, caller: &Principal, job: JobId) -> ApiResult<()> {
    if caller.reaches_all() || caller.sees(&app.store.project_of_job(job).await?) {
        return Ok(());
    }
    Err(StoreError::NotFound("job").into())
}

/// Refuses a project in which the caller may not submit.
pub(crate) fn check_may_change(caller: &Principal, project: &str) -> ApiResult<()> {
    if caller.may_change(project) {
        return Ok(());
    }
    let reason = format!("this token does not allow to submit to the project {project:?}");
    Err(ApiError::new(ProblemKind::Forbidden, reason).authenticate(WRONG_ROLE))
}
