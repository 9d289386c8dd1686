//! Leases: hands tasks to workers and takes their results.

pub(crate) mod checkpoint;
mod claim;
mod result_checks;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::http::header::RETRY_AFTER;
use axum::response::{IntoResponse, Response};
use forelight_protocol::{
    ClaimRequest, Lease, LeaseId, LogLine, ProblemKind, ReleaseRequest, RenewRequest, Renewal, ResultAnswer,
    ResultRequest, TaskKind,
};
use forelight_store::StoreError;

use self::claim::Claimed;
use super::responses::created;
use crate::config::Evidence;
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{JsonBody, KeyHeader, Large, Segment, WorkerToken, WorkerVersion};
use crate::schema::{IdempotencyKeyHeader, WorkerVersionHeader};
use crate::state::App;

const LONGEST_WAIT: u32 = 60_000;

/// Hands out a task. If there is none, waits up to `wait_ms`, then answers 204.
///
/// A node that is asleep by its calendar gets 204 at once, with `Retry-After` until it wakes up.
#[utoipa::path(post, path = "/v1/leases", operation_id = "lease_claim",
    tag = "work", request_body = ClaimRequest,
    params(IdempotencyKeyHeader, WorkerVersionHeader),
    responses((status = 200, description = "A task", body = Lease), (status = 204, description = "No task; with `Retry-After`, do not ask again before that"), Problems))]
pub(crate) async fn claim(
    State(app): State<App>,
    worker: WorkerToken,
    _: WorkerVersion,
    key: KeyHeader,
    JsonBody { value: request, hash, .. }: JsonBody<ClaimRequest>,
) -> ApiResult<Response> {
    if request.wait_ms > LONGEST_WAIT {
        return Err(ApiError::invalid("/wait_ms", format!("waits last up to {LONGEST_WAIT} ms")));
    }
    worker.speaks_for(request.node_id)?;
    let key = key.of(&worker.0, &hash);
    let _guard = app.in_flight.enter(key.as_ref())?;
    match claim::wait_for_task(&app, &request, key.as_ref()).await? {
        Claimed::Lease(lease) => Ok(created(StatusCode::OK, *lease)),
        Claimed::Nothing => Ok(StatusCode::NO_CONTENT.into_response()),
        Claimed::Asleep(until) => {
            let seconds = until.micros_since(app.now()).max(0).unsigned_abs().div_ceil(1_000_000);
            Ok((StatusCode::NO_CONTENT, [(RETRY_AFTER, seconds.to_string())]).into_response())
        }
    }
}

/// Heartbeat of a node with a task: renews the lease, reports progress and log lines, and brings orders back.
#[utoipa::path(patch, path = "/v1/leases/{id}", operation_id = "lease_renew",
    tag = "work", params(("id" = LeaseId, Path)), request_body = RenewRequest,
    responses((status = 200, description = "The lease was renewed, or the task must be dropped", body = Renewal), Problems))]
pub(crate) async fn renew(
    State(app): State<App>,
    worker: WorkerToken,
    Segment(lease): Segment<LeaseId>,
    JsonBody { value: request, .. }: JsonBody<RenewRequest>,
) -> ApiResult<Json<Renewal>> {
    worker.speaks_for_lease(&app, lease).await?;
    check_log(&request.log)?;
    if !(0.0..=1.0).contains(&request.progress) {
        return Err(ApiError::invalid("/progress", "progress is 0 to 1"));
    }
    if let Some(pixels) = request.pixels {
        if pixels.all == 0 {
            return Err(ApiError::invalid("/pixels/all", "a frame has 1 pixel or more"));
        }
        if pixels.done > pixels.all {
            return Err(ApiError::invalid("/pixels/done", "no more pixels are finished than there are"));
        }
    }
    if let Some(pixels) = &request.pixels
        && app.evidence == Evidence::Checked
    {
        app.store.check_pixels(lease, pixels, app.now()).await?;
    }
    let _no_step = app.clock_steps.read().await;
    let renewal = app.store.renew(lease, &request, app.lease_ttl, app.now()).await;
    Ok(Json(counted(&app, renewal)?))
}

/// Returns an unfinished task.
#[utoipa::path(post, path = "/v1/leases/{id}/release", operation_id = "lease_release",
    tag = "work", params(("id" = LeaseId, Path)), request_body = ReleaseRequest,
    responses((status = 204, description = "The task is ready for another worker"), Problems))]
pub(crate) async fn release(
    State(app): State<App>,
    worker: WorkerToken,
    Segment(lease): Segment<LeaseId>,
    JsonBody { value: request, .. }: JsonBody<ReleaseRequest>,
) -> ApiResult<StatusCode> {
    worker.speaks_for_lease(&app, lease).await?;
    let released = app.store.release(lease, request.fence, app.now()).await;
    counted(&app, released)?;
    Ok(StatusCode::NO_CONTENT)
}

/// Ends a task with its result or an error. It is on disk when this answers. Repeating the request is
/// harmless.
///
/// A result that is not possible is refused as `implausible-result`: CPU time that the lease leaves no room
/// for, work that no machine does in that time, or a file that is not the image that it should be. The lease
/// has failed then, the task is done elsewhere, and the refusal is held against the node.
#[utoipa::path(post, path = "/v1/leases/{id}/result", operation_id = "lease_result",
    tag = "work", params(("id" = LeaseId, Path)), request_body = ResultRequest,
    responses((status = 200, description = "Committed, now or before", body = ResultAnswer), Problems))]
pub(crate) async fn result(
    State(app): State<App>,
    worker: WorkerToken,
    Segment(lease): Segment<LeaseId>,
    JsonBody { value: request, .. }: JsonBody<ResultRequest, Large>,
) -> ApiResult<Json<ResultAnswer>> {
    worker.speaks_for_lease(&app, lease).await?;
    check_log(&request.log)?;
    app.store.keep_log(lease, request.fence, &request.log).await?;
    match (request.result, request.error) {
        (Some(result), None) => {
            let info = app.store.lease(lease).await?;
            result_checks::check(&info.spec, &result)?;
            if app.evidence == Evidence::Checked {
                let checked = app.store.check_evidence(lease, request.fence, &result, app.now()).await;
                counted(&app, checked)?;
            }
            let committed = app.store.commit_result(lease, request.fence, &result, app.now()).await;
            let at_result = |error: ApiError| match error.kind() {
                Some(ProblemKind::MissingArtifact) => error.at("/result"),
                _ => error,
            };
            let committed = counted(&app, committed).map_err(at_result)?;
            if committed.duplicate {
                app.metrics.results_duplicate.add(1);
            } else {
                app.metrics.results_committed.add(1);
            }
            if committed.kind != TaskKind::Render {
                // Sending fails only while the service is stopping. The next start advances all waiting jobs.
                let _ = app.conductor.send(committed.job_id);
            }
            Ok(Json(ResultAnswer { duplicate: committed.duplicate, job_state: committed.job_state }))
        }
        (None, Some(error)) => {
            let length = error.message.chars().count();
            if !(1..=2000).contains(&length) {
                return Err(ApiError::invalid("/error/message", "a message has 1 to 2000 characters"));
            }
            let error = app.store.after_a_look(lease, error, app.now()).await?;
            let failed = app.store.fail_task(lease, request.fence, &error, app.now()).await;
            let (duplicate, job_state) = counted(&app, failed)?;
            app.metrics.task_errors.add(1);
            Ok(Json(ResultAnswer { duplicate, job_state }))
        }
        _ => Err(ApiError::invalid("", "give exactly one of `result` and `error`")),
    }
}

fn check_log(log: &[LogLine]) -> ApiResult<()> {
    const MOST: usize = 100;
    if log.len() > MOST {
        return Err(ApiError::invalid("/log", format!("{} lines; a request has at most {MOST}", log.len())));
    }
    match log.iter().position(|line| line.text.is_empty()) {
        Some(empty) => Err(ApiError::invalid(format!("/log/{empty}/text"), "a log line is empty")),
        None => Ok(()),
    }
}

fn counted<T>(app: &App, outcome: Result<T, StoreError>) -> ApiResult<T> {
    if matches!(outcome, Err(StoreError::LeaseLost)) {
        app.metrics.leases_lost.add(1);
    }
    outcome.map_err(ApiError::from)
}
