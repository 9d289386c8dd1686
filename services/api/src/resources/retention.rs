//! What is kept for how long, and what is deleted.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use forelight_protocol::{
    JobId, JobState, ProblemKind, PruneRequest, Pruned, Retention, RetentionKind, RetentionRule, Role,
};

use super::checks::check_name;
use super::responses::tagged;
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{JsonBody, Operator, OwnJob, Reader};
use crate::state::App;

/// Most days of a rule: a century.
const MOST_DAYS: u32 = 36_500;

/// How long things are kept, and what was deleted last.
#[utoipa::path(get, path = "/v1/retention", operation_id = "retention_get", tag = "farm",
    responses((status = 200, description = "The rules", body = Retention),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn get(State(app): State<App>, _: Reader, headers: HeaderMap) -> ApiResult<Response> {
    tagged(&headers, &app.store.retention().await?)
}

/// Sets how long something is kept. The next night deletes by it. Setting it again replaces the rule, so
/// repeating is harmless.
#[utoipa::path(post, path = "/v1/retention", operation_id = "retention_set", tag = "farm",
    request_body = RetentionRule,
    responses((status = 200, description = "The rules", body = Retention), Problems))]
pub(crate) async fn set(
    State(app): State<App>,
    Operator(caller): Operator,
    JsonBody { value: rule, .. }: JsonBody<RetentionRule>,
) -> ApiResult<Json<Retention>> {
    if let Some(project) = &rule.project {
        check_name("/project", project, 200)?;
        if !rule.kind.is_by_project() {
            let by_project = RetentionKind::ALL.into_iter().filter(|kind| kind.is_by_project());
            let kinds: Vec<&str> = by_project.map(RetentionKind::name).collect();
            let reason = format!(
                "{} have one rule for the whole farm; projects can have rules for {}",
                rule.kind.name(),
                kinds.join(", ")
            );
            return Err(ApiError::invalid("/project", reason));
        }
    }
    if rule.days.is_some_and(|days| days > MOST_DAYS) {
        return Err(ApiError::invalid("/days", format!("0 to {MOST_DAYS} days; leave it out for ever")));
    }
    app.by(&caller).set_retention(&rule, app.now()).await?;
    Ok(Json(app.store.retention().await?))
}

/// Deletes now what is past its time, or only says what that is. The farm does this by itself every night.
#[utoipa::path(post, path = "/v1/prune", operation_id = "prune", tag = "farm", request_body = PruneRequest,
    responses((status = 200, description = "What was deleted, or would be", body = Pruned), Problems))]
pub(crate) async fn prune(
    State(app): State<App>,
    _: Operator,
    JsonBody { value: request, .. }: JsonBody<PruneRequest>,
) -> ApiResult<Json<Pruned>> {
    let _alone = app.pruning.try_lock().map_err(|_| {
        ApiError::new(ProblemKind::Busy, "the farm is deleting already; ask again when it is done")
    })?;
    Ok(Json(app.store.prune(request.dry_run, app.now()).await?))
}

/// Deletes a job that has ended, with its images, logs and events. What it cost stays in the books of its
/// project. A job that is done is part of the track record, so only an operator may delete it.
#[utoipa::path(delete, path = "/v1/jobs/{id}", operation_id = "job_delete", tag = "jobs",
    params(("id" = JobId, Path)),
    responses((status = 204, description = "It is deleted"), Problems))]
pub(crate) async fn delete_job(State(app): State<App>, OwnJob(caller, job): OwnJob) -> ApiResult<StatusCode> {
    if caller.role != Role::Operator && app.store.job(job).await?.state == JobState::Done {
        return Err(ApiError::new(
            ProblemKind::Forbidden,
            "a job that is done counts in the track record; only an operator may delete it",
        ));
    }
    app.by(&caller).delete_job(job, app.now()).await?;
    Ok(StatusCode::NO_CONTENT)
}
