//! Signing in and out with a browser.

use std::net::IpAddr;

use axum::Json;
use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, SET_COOKIE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_protocol::{
    ProblemKind, Role, Session, SessionCode, SessionId, SessionPage, SessionRequest, Timestamp,
};
use forelight_store::NewSession;
use forelight_store::tokens::{self, Principal};

use super::responses::NOT_KEPT;
use crate::cookies::{check_not_cross_site, forget_session, set_session};
use crate::error::{ApiError, ApiResult, BAD_TOKEN, Problems};
use crate::extract::{
    JsonBody, OfStrangers, Operator, Peer, QueryParameters, Reader, Segment, UNKNOWN_TOKEN,
};
use crate::page::{PageQuery, cut};
use crate::state::App;

/// Makes a one-time code, which begins one session with the caller's rights. It is valid for five minutes.
#[utoipa::path(post, path = "/v1/sessions/codes", operation_id = "session_code_create", tag = "sessions",
    responses((status = 201, description = "The code", body = SessionCode), Problems))]
pub(crate) async fn create_code(State(app): State<App>, Reader(caller): Reader) -> ApiResult<Response> {
    let code = app.store.create_session_code(&caller, app.now()).await?;
    Ok((StatusCode::CREATED, [(CACHE_CONTROL, NOT_KEPT)], Json(code)).into_response())
}

/// Signs in with a one-time code or a bearer token. The answer sets the cookie `forelight_session`.
///
/// The session has the rights of the token and ends with it. A code is used up. Workers' tokens are refused.
/// After ten wrong secrets in a minute, more are refused with 429.
#[utoipa::path(post, path = "/v1/sessions", operation_id = "session_begin", tag = "sessions",
    request_body = SessionRequest, security(()),
    responses((status = 201, description = "The session", body = Session,
               headers(("Set-Cookie" = String, description = "The session's secret"))), Problems))]
pub(crate) async fn begin(
    State(app): State<App>,
    Peer(from): Peer,
    headers: HeaderMap,
    JsonBody { value: request, .. }: JsonBody<SessionRequest, OfStrangers>,
) -> ApiResult<Response> {
    check_not_cross_site(&headers)?;
    let now = app.now();
    app.sign_ins.check(from, now)?;
    let begun = match (&request.code, &request.token) {
        (Some(code), None) => with_code(&app, code, from, now).await,
        (None, Some(token)) => with_token(&app, token, from, now).await,
        _ => return Err(ApiError::invalid("", "give exactly one of `code` and `token`")),
    };
    let NewSession { secret, session } = begun.inspect_err(|error| {
        if error.kind() == Some(ProblemKind::Unauthenticated) {
            app.sign_ins.failed(from, now);
        }
    })?;
    tracing::info!(session = ?session.id, role = %session.role, name = session.name, "signed in");
    let cookie = set_session(&secret, app.session_lifetime.as_secs(), app.is_over_tls)?;
    let own = [(SET_COOKIE, cookie), (CACHE_CONTROL, NOT_KEPT)];
    Ok((StatusCode::CREATED, own, Json(session)).into_response())
}

async fn with_code(app: &App, code: &str, from: Option<IpAddr>, now: Timestamp) -> ApiResult<NewSession> {
    let begun = app.store.begin_session_with_code(code, from, app.session_lifetime, now).await?;
    begun.ok_or_else(|| {
        let reason = "the code is unknown, used or expired; ask for a new one with `forelight dashboard`";
        ApiError::new(ProblemKind::Unauthenticated, reason).authenticate(BAD_TOKEN).at("/code")
    })
}

async fn with_token(app: &App, token: &str, from: Option<IpAddr>, now: Timestamp) -> ApiResult<NewSession> {
    let Some(caller) = tokens::find(&app.store, token.trim(), now).await? else {
        let refused = ApiError::new(ProblemKind::Unauthenticated, UNKNOWN_TOKEN);
        return Err(refused.authenticate(BAD_TOKEN).at("/token"));
    };
    if caller.role == Role::Worker {
        let reason = "a worker's token cannot sign in; use a viewer's, submitter's or operator's";
        return Err(ApiError::new(ProblemKind::Forbidden, reason).at("/token"));
    }
    let caller = Principal { from, ..caller };
    Ok(app.by(&caller).begin_session(&caller, app.session_lifetime, now).await?)
}

/// Who is signed in: by the session's cookie, or by a bearer token.
#[utoipa::path(get, path = "/v1/sessions/current", operation_id = "session_current", tag = "sessions",
    responses((status = 200, description = "The session", body = Session), Problems))]
pub(crate) async fn current(State(app): State<App>, Reader(caller): Reader) -> ApiResult<Response> {
    let session = match caller.session {
        Some(session) => app.store.session(session, app.now()).await?,
        None => Session {
            id: None,
            role: caller.role,
            projects: caller.projects,
            name: caller.name,
            created_at: None,
            expires_at: None,
            last_used_at: None,
        },
    };
    Ok(([(CACHE_CONTROL, NOT_KEPT)], Json(session)).into_response())
}

/// Signs out: ends the session of the cookie. 409 with a bearer token, which has none.
#[utoipa::path(delete, path = "/v1/sessions/current", operation_id = "session_end_current", tag = "sessions",
    responses((status = 204, description = "Signed out"), Problems))]
pub(crate) async fn end_current(State(app): State<App>, Reader(caller): Reader) -> ApiResult<Response> {
    let Some(session) = caller.session else {
        let reason = "a bearer token has no session to end";
        return Err(ApiError::new(ProblemKind::Conflict, reason));
    };
    app.by(&caller).end_session(session, app.now()).await?;
    app.end_rights().await;
    Ok((StatusCode::NO_CONTENT, [(SET_COOKIE, forget_session(app.is_over_tls)?)]).into_response())
}

/// Everybody who is signed in, newest first.
#[utoipa::path(get, path = "/v1/sessions", operation_id = "session_list", tag = "sessions", params(PageQuery),
    responses((status = 200, description = "A page of sessions", body = SessionPage), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    _: Operator,
    QueryParameters(query): QueryParameters<PageQuery>,
) -> ApiResult<Json<SessionPage>> {
    let size = query.size();
    let mut items = app.store.sessions(query.key("sessions")?, size + 1, app.now()).await?;
    let next_page_token = cut(&mut items, size, "sessions", |session| session.id);
    Ok(Json(SessionPage { items, next_page_token }))
}

/// Ends somebody's session at once.
#[utoipa::path(delete, path = "/v1/sessions/{id}", operation_id = "session_end", tag = "sessions",
    params(("id" = SessionId, Path)), responses((status = 204, description = "It has ended"), Problems))]
pub(crate) async fn end(
    State(app): State<App>,
    Operator(caller): Operator,
    Segment(session): Segment<SessionId>,
) -> ApiResult<StatusCode> {
    app.by(&caller).end_session(session, app.now()).await?;
    app.end_rights().await;
    Ok(StatusCode::NO_CONTENT)
}
