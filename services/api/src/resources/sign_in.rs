//! Signing in through the studio's provider: OpenID Connect.

use axum::Json;
use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, LOCATION, SET_COOKIE};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_protocol::{ProblemKind, SignInWays};
use forelight_store::NewSession;
use serde::Deserialize;
use utoipa::IntoParams;

use super::responses::NOT_KEPT;
use crate::cookies::{set_session, set_sign_in, sign_in_state};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{Peer, QueryParameters};
use crate::oidc::{SignIn, SignInError};
use crate::state::App;

/// How long a browser may be at the provider, in seconds.
const AT_THE_PROVIDER: u64 = 600;

/// How people may sign in, besides codes and tokens.
#[utoipa::path(get, path = "/v1/sign-in", operation_id = "sign_in_ways", tag = "sessions", security(()),
    responses((status = 200, description = "The ways", body = SignInWays), Problems))]
pub(crate) async fn ways(State(app): State<App>) -> Json<SignInWays> {
    Json(SignInWays { provider: app.sign_in.as_ref().map(|provider| provider.name().to_owned()) })
}

/// Sends a browser to the sign-in provider. 404 if there is none.
#[utoipa::path(get, path = "/v1/sign-in/begin", operation_id = "sign_in_begin", tag = "sessions", security(()),
    responses((status = 303, description = "To the provider"), Problems))]
pub(crate) async fn begin(State(app): State<App>) -> ApiResult<Response> {
    let (address, state) = provider(&app)?.begin(app.now()).await.map_err(refused)?;
    let address = HeaderValue::from_str(&address)
        .map_err(|_| ApiError::new(ProblemKind::Internal, "the provider's address cannot be sent"))?;
    let cookie = set_sign_in(&state, AT_THE_PROVIDER, app.is_over_tls)?;
    let own = [(LOCATION, address), (SET_COOKIE, cookie), (CACHE_CONTROL, NOT_KEPT)];
    Ok((StatusCode::SEE_OTHER, own).into_response())
}

/// What the provider sends a browser back with.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct FromProvider {
    /// A code, to be exchanged for the person's identity.
    pub code: Option<String>,
    /// The state with which the browser was sent.
    pub state: Option<String>,
    /// Why there is no code.
    pub error: Option<String>,
    /// The same for people.
    pub error_description: Option<String>,
}

/// Takes a browser that comes back from the sign-in provider, and signs its person in.
///
/// The answer sets the cookie `forelight_session` and leads to the page. Other sessions of the person end.
#[utoipa::path(get, path = "/v1/sign-in/callback", operation_id = "sign_in_finish", tag = "sessions", security(()),
    params(FromProvider), responses((status = 303, description = "To the page"), Problems))]
pub(crate) async fn finish(
    State(app): State<App>,
    Peer(from): Peer,
    headers: HeaderMap,
    QueryParameters(back): QueryParameters<FromProvider>,
) -> ApiResult<Response> {
    let provider = provider(&app)?;
    let now = app.now();
    app.sign_ins.check(from, now)?;
    if let Some(error) = back.error {
        let why: String =
            back.error_description.unwrap_or(error).chars().filter(|it| !it.is_control()).collect();
        return Err(refused(SignInError::Refused(why)));
    }
    let (Some(code), Some(state)) = (back.code, back.state) else {
        return Err(refused(SignInError::Unknown));
    };
    if sign_in_state(&headers) != Some(state.as_str()) {
        app.sign_ins.failed(from, now);
        return Err(refused(SignInError::Unknown));
    }
    let person = provider.finish(&code, &state, now).await.map_err(refused)?;
    let begun = app.store.sign_in_person(&person, from, app.session_lifetime, now).await?;
    app.end_rights().await;
    let NewSession { secret, session } = begun;
    tracing::info!(session = ?session.id, role = %session.role, name = session.name, "signed in");
    let mut answer = (StatusCode::SEE_OTHER, [(LOCATION, HeaderValue::from_static("/"))]).into_response();
    let cookies = answer.headers_mut();
    cookies.append(SET_COOKIE, set_session(&secret, app.session_lifetime.as_secs(), app.is_over_tls)?);
    cookies.append(SET_COOKIE, set_sign_in("", 0, app.is_over_tls)?);
    cookies.insert(CACHE_CONTROL, NOT_KEPT);
    Ok(answer)
}

fn provider(app: &App) -> ApiResult<&SignIn> {
    let reason = "this farm has no sign-in provider; sign in with a token, or with `forelight dashboard`";
    app.sign_in.as_deref().ok_or_else(|| ApiError::new(ProblemKind::NotFound, reason))
}

fn refused(error: SignInError) -> ApiError {
    let kind = match error {
        SignInError::Provider { .. } => ProblemKind::Busy,
        SignInError::Unknown | SignInError::Refused(_) => ProblemKind::Unauthenticated,
        SignInError::NoRole(_) => ProblemKind::Forbidden,
    };
    tracing::info!(%error, "a sign-in was refused");
    ApiError::new(kind, error.to_string().replace('\n', " "))
}
