//! Jobs.

pub(crate) mod changes;
mod request_checks;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use forelight_protocol::{Job, JobCheck, JobId, JobPage, JobRequest, JobState};
use forelight_store::tokens::Principal;
use forelight_store::{JobFilter, JobOrder};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::checks::check_search;
use super::responses::{created, repeated, tagged};
use crate::error::{ApiResult, Problems};
use crate::extract::{
    JsonBody, KeyHeader, OwnJob, QueryParameters, Reader, SeenJob, Submitter, check_may_change, number_if_any,
};
use crate::page::{LARGEST_PAGE, PageQuery, cut};
use crate::schema::IdempotencyKeyHeader;
use crate::seen::mentioned_by;
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
    check_may_change(&principal, &request.project)?;
    let new = request_checks::checked(&app, &principal, request).await?;
    Ok(created(StatusCode::CREATED, app.by(&principal).create_job(&new, key.as_ref(), app.now()).await?))
}

/// Checks a job as submitting it would. Nothing is stored.
#[utoipa::path(post, path = "/v1/jobs/check", operation_id = "job_check",
    tag = "jobs", request_body = JobRequest,
    responses((status = 200, description = "The job would be accepted", body = JobCheck), Problems))]
pub(crate) async fn check(
    State(app): State<App>,
    Submitter(caller): Submitter,
    JsonBody { value: request, .. }: JsonBody<JobRequest>,
) -> ApiResult<Json<JobCheck>> {
    check_may_change(&caller, &request.project)?;
    let new = request_checks::checked(&app, &caller, request).await?;
    app.store.check_new_job(&new, &caller.name, caller.role).await?;
    let frames_total = u32::try_from(new.request.frames.count()).unwrap_or(u32::MAX);
    Ok(Json(JobCheck { scene: new.scene, frames: new.request.frames, frames_total, settings: new.settings }))
}

/// The order of a list of jobs.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum JobSort {
    /// Newest first.
    #[default]
    #[serde(rename = "-created")]
    Newest,
    /// Those at risk first, then by deadline.
    Risk,
    /// By deadline; jobs without one last.
    Deadline,
    /// By name.
    Name,
    /// Dearest first, by the cost of their bookings.
    Cost,
}

impl JobSort {
    /// The order, and the name of such a list in page tokens.
    fn order(self) -> (JobOrder, &'static str) {
        match self {
            JobSort::Newest => (JobOrder::Newest, "jobs"),
            JobSort::Risk => (JobOrder::Risk, "jobs by risk"),
            JobSort::Deadline => (JobOrder::Deadline, "jobs by deadline"),
            JobSort::Name => (JobOrder::Name, "jobs by name"),
            JobSort::Cost => (JobOrder::Cost, "jobs by cost"),
        }
    }
}

/// Filter of the list of jobs.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct JobQuery {
    /// Only jobs that are not over.
    #[serde(default)]
    pub open: bool,
    /// Only jobs in this state.
    pub state: Option<JobState>,
    /// Only jobs of this project.
    pub project: Option<String>,
    /// Only jobs with exactly this name.
    pub name: Option<String>,
    /// Only jobs with this text in the name of job or project.
    #[param(max_length = 200)]
    pub search: Option<String>,
    /// The order. Default: newest first.
    #[param(inline)]
    pub sort: Option<JobSort>,
    /// `next_page_token` of the previous page.
    pub page_token: Option<String>,
    /// Number of items on a page: 1 to 200, default 50.
    #[param(minimum = 1, maximum = 200, default = 50)]
    #[serde(default, deserialize_with = "number_if_any::<_, _, 1, LARGEST_PAGE>")]
    pub page_size: Option<u32>,
}

/// The jobs, newest first unless another order is asked for.
#[utoipa::path(get, path = "/v1/jobs", operation_id = "job_list", tag = "jobs", params(JobQuery),
    responses((status = 200, description = "A page of jobs", body = JobPage),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    Reader(caller): Reader,
    QueryParameters(query): QueryParameters<JobQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let JobQuery { open, state, project, name, search, sort, page_token, page_size } = query;
    check_search(search.as_deref())?;
    let page = PageQuery { page_token, page_size };
    let size = page.size();
    let filter = JobFilter { open, state, project, name, search, projects: caller.project_names() };
    let (order, list) = sort.unwrap_or_default().order();
    let after = page.key(list)?;
    let mut items = app.store.jobs(&filter, (order, after.as_ref()), size + 1).await?;
    let next_page_token = cut(&mut items, size, list, |job| order.place(job));
    expect(&app, &caller, &mut items).await?;
    tagged(&headers, &JobPage { items, next_page_token })
}

/// One job.
#[utoipa::path(get, path = "/v1/jobs/{id}", operation_id = "job_get",
    tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The job", body = Job),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    Reader(caller): Reader,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let mut job = app.store.job(job).await?;
    expect(&app, &caller, std::slice::from_mut(&mut job)).await?;
    let spent = app.store.spent_on(job.id, app.now()).await?;
    job.spent = Some(spent).filter(|spent| spent.0 > 0);
    job.failing = app.store.failing(job.id, app.now()).await?;
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
pub(crate) async fn cancel(State(app): State<App>, OwnJob(caller, job): OwnJob) -> ApiResult<Json<Job>> {
    Ok(Json(app.by(&caller).cancel_job(job, app.now()).await?))
}

/// Fills in the expected ends, leaves out what the caller does not see, and fills in reasons to wait that no
/// plan gives: no quote yet, or no disk space.
async fn expect(app: &App, caller: &Principal, jobs: &mut [Job]) -> ApiResult<()> {
    if jobs.iter().any(|job| matches!(job.state, JobState::Previewing | JobState::Profiling)) {
        app.store.unattended(app.lease_ttl, app.now()).await?.tell(&mut *jobs);
    }
    if jobs.iter().any(|job| !job.state.is_final()) {
        let ends = app.projection().await?.ends();
        app.store.tell_ends(jobs, &ends, app.now()).await?;
    }
    // The expected end depends on the plan's reason to wait.
    app.tell_disk_full(jobs.iter_mut().map(|job| (job.state, &mut job.waits)));
    let seen = app.seen(caller, jobs.iter().flat_map(mentioned_by)).await?;
    jobs.iter_mut().for_each(|job| seen.show_job(job));
    Ok(())
}
