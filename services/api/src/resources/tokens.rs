//! Bearer tokens.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::State;
use axum::http::header::CACHE_CONTROL;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_protocol::{
    NewToken, Role, RotateRequest, Timestamp, Token, TokenChange, TokenId, TokenPage, TokenRequest,
};
use forelight_store::StoreError;

use super::checks::{check_name, within};
use super::responses::{NOT_KEPT, tagged};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{JsonBody, Operator, QueryParameters, Segment};
use crate::page::{PageQuery, cut};
use crate::state::App;

/// Most projects of a token.
const MOST_PROJECTS: usize = 200;

/// Longest time for which a replaced token is still valid: a week, in seconds.
const LONGEST_GRACE: i64 = 7 * 86_400;

/// Makes a token. The answer has its secret, which is shown only once. Repeating the request makes another
/// one.
#[utoipa::path(post, path = "/v1/tokens", operation_id = "token_create", tag = "people",
    request_body = TokenRequest,
    responses((status = 201, description = "The token with its secret", body = NewToken), Problems))]
pub(crate) async fn create(
    State(app): State<App>,
    Operator(caller): Operator,
    JsonBody { value: request, .. }: JsonBody<TokenRequest>,
) -> ApiResult<Response> {
    check_name("/name", &request.name, 200)?;
    check_end(&app, request.expires_at)?;
    if request.role.is_some() == request.projects.is_some() {
        return Err(ApiError::invalid("", "give exactly one of `role` and `projects`"));
    }
    check_projects(request.projects.as_ref())?;
    Ok(with_secret(app.by(&caller).create_token(&request, app.now()).await.map_err(at_projects)?))
}

/// The tokens, oldest first. A token that expired is listed for thirty days more.
#[utoipa::path(get, path = "/v1/tokens", operation_id = "token_list", tag = "people", params(PageQuery),
    responses((status = 200, description = "A page of tokens", body = TokenPage),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    _: Operator,
    QueryParameters(query): QueryParameters<PageQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let size = query.size();
    app.rights.store_uses(&app.store, true, app.now()).await?;
    let mut items = app.store.tokens(query.key("tokens")?, size + 1).await?;
    let next_page_token = cut(&mut items, size, "tokens", |token| (token.created_at, token.id));
    tagged(&headers, &TokenPage { items, next_page_token })
}

/// One token.
#[utoipa::path(get, path = "/v1/tokens/{id}", operation_id = "token_get", tag = "people",
    params(("id" = TokenId, Path)),
    responses((status = 200, description = "The token", body = Token),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    _: Operator,
    Segment(token): Segment<TokenId>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    app.rights.store_uses(&app.store, true, app.now()).await?;
    tagged(&headers, &app.store.token(token).await?)
}

/// Changes a token's name, when it expires, or which projects it reaches.
#[utoipa::path(patch, path = "/v1/tokens/{id}", operation_id = "token_change", tag = "people",
    params(("id" = TokenId, Path)), request_body = TokenChange,
    responses((status = 200, description = "The token", body = Token), Problems))]
pub(crate) async fn change(
    State(app): State<App>,
    Operator(caller): Operator,
    Segment(token): Segment<TokenId>,
    JsonBody { value: change, .. }: JsonBody<TokenChange>,
) -> ApiResult<Json<Token>> {
    if let Some(name) = &change.name {
        check_name("/name", name, 200)?;
    }
    check_end(&app, change.expires_at.flatten())?;
    check_projects(change.projects.as_ref())?;
    let changed = app.by(&caller).change_token(token, &change, app.now()).await.map_err(at_projects)?;
    app.end_rights().await;
    Ok(Json(changed))
}

/// Replaces a token by a new one with the same rights. The answer has its secret, which is shown only once.
///
/// The replaced token, and the sessions that began with it, end at once, or after the grace. Repeating the
/// request without a grace gives 404.
#[utoipa::path(post, path = "/v1/tokens/{id}/rotate", operation_id = "token_rotate", tag = "people",
    params(("id" = TokenId, Path)), request_body = RotateRequest,
    responses((status = 201, description = "The new token with its secret", body = NewToken), Problems))]
pub(crate) async fn rotate(
    State(app): State<App>,
    Operator(caller): Operator,
    Segment(token): Segment<TokenId>,
    JsonBody { value: request, .. }: JsonBody<RotateRequest>,
) -> ApiResult<Response> {
    let grace = i64::from(request.grace_seconds);
    within("/grace_seconds", grace, 0..=LONGEST_GRACE)?;
    let new = app.by(&caller).rotate_token(token, grace * 1_000_000, app.now()).await?;
    app.end_rights().await;
    Ok(with_secret(new))
}

/// Revokes a token at once. Its requests that are under way, its streams of events and its sessions end.
#[utoipa::path(delete, path = "/v1/tokens/{id}", operation_id = "token_revoke", tag = "people",
    params(("id" = TokenId, Path)), responses((status = 204, description = "It is revoked"), Problems))]
pub(crate) async fn revoke(
    State(app): State<App>,
    Operator(caller): Operator,
    Segment(token): Segment<TokenId>,
) -> ApiResult<StatusCode> {
    app.by(&caller).revoke_token(token, app.now()).await?;
    app.end_rights().await;
    Ok(StatusCode::NO_CONTENT)
}

/// Roles of workers and operators are for the whole farm.
fn check_projects(projects: Option<&BTreeMap<String, Role>>) -> ApiResult<()> {
    let Some(projects) = projects else { return Ok(()) };
    if !(1..=MOST_PROJECTS).contains(&projects.len()) {
        let reason = format!("a token reaches 1 to {MOST_PROJECTS} projects, or all: then give `role`");
        return Err(ApiError::invalid("/projects", reason));
    }
    match projects.iter().find(|(_, role)| !matches!(role, Role::Viewer | Role::Submitter)) {
        Some((project, role)) => {
            let place = format!("/projects/{}", project.replace('~', "~0").replace('/', "~1"));
            let reason =
                format!("`{role}` is a role for the whole farm; in a project, write viewer or submitter");
            Err(ApiError::invalid(place, reason))
        }
        None => Ok(()),
    }
}

fn at_projects(error: StoreError) -> ApiError {
    let is_about_projects = matches!(error, StoreError::NoProject(_));
    let error = ApiError::from(error);
    if is_about_projects { error.at("/projects") } else { error }
}

fn with_secret(new: NewToken) -> Response {
    (StatusCode::CREATED, [(CACHE_CONTROL, NOT_KEPT)], Json(new)).into_response()
}

fn check_end(app: &App, end: Option<Timestamp>) -> ApiResult<()> {
    match end {
        Some(end) if end <= app.now() => Err(ApiError::invalid("/expires_at", format!("{end} has passed"))),
        _ => Ok(()),
    }
}
