//! Jobs.

pub(crate) mod changes;
mod request_checks;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use forelight_protocol::{Job, JobCheck, JobId, JobPage, JobRequest, JobState};
use forelight_store::{JobFilter, project};
use serde::Deserialize;
use utoipa::IntoParams;

use super::responses::{created, repeated, tagged};
use crate::error::{ApiResult, Problems};
use crate::extract::{JsonBody, KeyHeader, QueryParameters, Reader, Segment, Submitter, number_if_any};
use crate::page::{LARGEST_PAGE, PageQuery, cut};
use crate::schema::IdempotencyKeyHeader;
use crate::state::App;

/// Submits a job. The farm then previews, forecasts, books and renders it.
#[utoipa::path(post, path = "/v1/jobs", operation_id = "job_submit", tag = "jobs", request_body = JobRequest,
    params(IdempotencyKeyHeader),
    responses((status = 201, description = "The job", body = Job), Problems))]
pub(crate) async fn submit(
    State(app): State<App>,
    Submitter(principal): Submitter,
    key: KeyHeader,
    JsonBody { value: request, hash, .. }: JsonBody<JobRequest>,
) -> ApiResult<Response> {
    let key = key.of(&principal, &hash);
    let _guard = app.in_flight.enter(key.as_ref())?;
    if let Some(key) = &key
        && let Some(answer) = app.store.recorded_answer(key).await?
    {
        return Ok(repeated(answer));
    }
    let new = request_checks::checked(&app, request).await?;
    Ok(created(StatusCode::CREATED, app.store.create_job(&new, key.as_ref(), app.now()).await?))
}

/// Checks a job as submitting it would. Nothing is stored.
#[utoipa::path(post, path = "/v1/jobs/check", operation_id = "job_check",
    tag = "jobs", request_body = JobRequest,
    responses((status = 200, description = "The job would be accepted", body = JobCheck), Problems))]
pub(crate) async fn check(
    State(app): State<App>,
    _: Submitter,
    JsonBody { value: request, .. }: JsonBody<JobRequest>,
) -> ApiResult<Json<JobCheck>> {
    let new = request_checks::checked(&app, request).await?;
    let frames_total = u32::try_from(new.request.frames.count()).unwrap_or(u32::MAX);
    Ok(Json(JobCheck { scene: new.scene, frames: new.request.frames, frames_total, settings: new.settings }))
}

/// Filter of the list of jobs.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct JobQuery {
    /// Only jobs in this state.
    pub state: Option<JobState>,
    /// Only jobs of this project.
    pub project: Option<String>,
    /// Only jobs with exactly this name.
    pub name: Option<String>,
    /// `next_page_token` of the previous page.
    pub page_token: Option<String>,
    /// Number of items on a page: 1 to 200, default 50.
    #[param(minimum = 1, maximum = 200, default = 50)]
    #[serde(default, deserialize_with = "number_if_any::<_, _, 1, LARGEST_PAGE>")]
    pub page_size: Option<u32>,
}

/// The jobs, newest first.
#[utoipa::path(get, path = "/v1/jobs", operation_id = "job_list", tag = "jobs", params(JobQuery),
    responses((status = 200, description = "A page of jobs", body = JobPage), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    _: Reader,
    QueryParameters(query): QueryParameters<JobQuery>,
) -> ApiResult<Json<JobPage>> {
    let JobQuery { state, project, name, page_token, page_size } = query;
    let page = PageQuery { page_token, page_size };
    let size = page.size();
    let filter = JobFilter { state, project, name };
    let mut items = app.store.jobs(&filter, page.key("jobs")?, size + 1).await?;
    let next_page_token = cut(&mut items, size, "jobs", |job| job.id);
    expect(&app, &mut items).await?;
    Ok(Json(JobPage { items, next_page_token }))
}

/// One job.
#[utoipa::path(get, path = "/v1/jobs/{id}", operation_id = "job_get",
    tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The job", body = Job),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    _: Reader,
    Segment(job): Segment<JobId>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let mut job = app.store.job(job).await?;
    expect(&app, std::slice::from_mut(&mut job)).await?;
    let spent = app.store.spent_on(job.id, app.now()).await?;
    job.spent = Some(spent).filter(|spent| spent.0 > 0);
    // The estimate dates from the last finished piece of the job; its nodes have been paid since.
    if let Some(live) = &mut job.live {
        live.cost = live.cost.map(|cost| cost.at_least(spent));
    }
    tagged(&headers, &job)
}

/// Cancels a job. Its workers stop at their next renewal. Repeating the request changes nothing.
#[utoipa::path(post, path = "/v1/jobs/{id}/cancel", operation_id = "job_cancel",
    tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The job", body = Job), Problems))]
pub(crate) async fn cancel(
    State(app): State<App>,
    _: Submitter,
    Segment(job): Segment<JobId>,
) -> ApiResult<Json<Job>> {
    Ok(Json(app.store.cancel_job(job, app.now()).await?))
}

/// Fills in the expected end, and reasons to wait that no plan gives: no quote yet, or no disk space.
async fn expect(app: &App, jobs: &mut [Job]) -> ApiResult<()> {
    if jobs.iter().any(|job| matches!(job.state, JobState::Previewing | JobState::Profiling)) {
        app.store.unattended(app.lease_ttl, app.now()).await?.tell(&mut *jobs);
    }
    if jobs.iter().any(|job| !job.state.is_final() && job.plan_id.is_some()) {
        let (bookings, parts) = (app.store.open_bookings().await?, app.store.open_cache_parts().await?);
        let projected = project(&bookings, &parts, app.now());
        jobs.iter_mut().for_each(|job| job.eta = projected.eta(job));
    }
    // The expected end depends on the plan's reason to wait.
    app.tell_disk_full(jobs.iter_mut().map(|job| (job.state, &mut job.waits)));
    Ok(())
}
