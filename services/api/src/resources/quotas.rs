//! How much projects and tokens may take.

use axum::Json;
use axum::extract::State;
use forelight_protocol::{QuotaList, QuotaRequest};
use forelight_store::QuotaOf;

use super::checks::{check_name, within};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{JsonBody, Operator, Reader};
use crate::state::App;

/// Most bytes and most open jobs of a quota.
const MOST_BYTES: i64 = 1 << 60;
const MOST_JOBS: i64 = 1_000_000;

/// The quotas of projects and tokens, and how much of each is used. Who reaches some projects only, sees the
/// quotas of these, and that of the own token.
#[utoipa::path(get, path = "/v1/quotas", operation_id = "quota_list", tag = "farm",
    responses((status = 200, description = "The quotas", body = QuotaList), Problems))]
pub(crate) async fn list(State(app): State<App>, Reader(caller): Reader) -> ApiResult<Json<QuotaList>> {
    let is_seen = |of: QuotaOf<'_>| {
        caller.reaches_all()
            || match of {
                QuotaOf::Project(project) => caller.sees(project),
                QuotaOf::Token(token) => token == caller.name,
            }
    };
    let items = app.store.quotas(is_seen).await?;
    Ok(Json(QuotaList { items }))
}

/// Sets how much a project or a token may take, or removes the quota. What is too much already stays, but
/// nothing is added to it. Setting it again replaces it, so repeating is harmless.
#[utoipa::path(post, path = "/v1/quotas", operation_id = "quota_set", tag = "farm",
    request_body = QuotaRequest,
    responses((status = 200, description = "All quotas", body = QuotaList), Problems))]
pub(crate) async fn set(
    State(app): State<App>,
    Operator(caller): Operator,
    JsonBody { value: request, .. }: JsonBody<QuotaRequest>,
) -> ApiResult<Json<QuotaList>> {
    let of = match (&request.project, &request.token) {
        (Some(project), None) => {
            check_name("/project", project, 200)?;
            QuotaOf::Project(project)
        }
        (None, Some(token)) => {
            check_name("/token", token, 200)?;
            QuotaOf::Token(token)
        }
        _ => return Err(ApiError::invalid("", "give exactly one of `project` and `token`")),
    };
    if let Some(bytes) = request.storage_bytes {
        within("/storage_bytes", i64::try_from(bytes).unwrap_or(i64::MAX), 0..=MOST_BYTES)?;
    }
    if let Some(jobs) = request.open_jobs {
        within("/open_jobs", i64::from(jobs), 0..=MOST_JOBS)?;
    }
    app.by(&caller).set_quota(of, &request, app.now()).await?;
    Ok(Json(QuotaList { items: app.store.quotas(|_| true).await? }))
}
