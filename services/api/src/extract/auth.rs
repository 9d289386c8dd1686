//! Authentication and authorisation. A handler takes one of these types; requests without the role never
//! reach it. A request carries a bearer token, or the cookie of a session, which has the role of its token.

use std::convert::Infallible;
use std::net::IpAddr;

use axum::extract::FromRequestParts;
use axum::http::Method;
use axum::http::header::AUTHORIZATION;
use axum::http::request::Parts;
use forelight_protocol::{LeaseId, NodeId, ProblemKind, Role};
use forelight_store::tokens::{self, Principal};

use crate::connections::{Holds, Standing};
use crate::cookies::{check_same_origin, session_secret};
use crate::error::{ApiError, ApiResult, BAD_TOKEN, NO_TOKEN, WRONG_ROLE};
use crate::rights::Held;
use crate::state::App;

macro_rules! caller {
    ($(#[$doc:meta])* $name:ident, $($role:ident)|+) => {
        $(#[$doc])*
        pub(crate) struct $name(#[allow(dead_code, reason = "most handlers need to know only that there is one")] pub Principal);

        impl FromRequestParts<App> for $name {
            type Rejection = ApiError;

            async fn from_request_parts(parts: &mut Parts, app: &App) -> ApiResult<Self> {
                let principal = principal(parts, app).await?;
                take_seat(parts, app, &principal)?;
                match principal.role {
                    $(Role::$role)|+ => Ok(Self(principal)),
                    #[allow(unreachable_patterns, reason = "one of the types admits every role")]
                    other => Err(forbidden(other, &[$(Role::$role),+])),
                }
            }
        }
    };
}

caller!(
    /// A token of any role.
    Anyone, Submitter | Worker | Operator | Viewer
);
caller!(
    /// A token that may view jobs, plans and the farm.
    Reader, Submitter | Operator | Viewer
);
caller!(
    /// A token that may submit and cancel.
    Submitter, Submitter | Operator
);
caller!(
    /// A token that may do tasks.
    WorkerToken, Worker | Operator
);
caller!(
    /// A token that may do everything.
    Operator, Operator
);

impl WorkerToken {
    /// Checks that the token may act for this node. A node's token acts for that node alone.
    pub fn speaks_for(&self, node: NodeId) -> ApiResult<()> {
        match self.0.node {
            Some(own) if own != node => {
                Err(ApiError::new(ProblemKind::Forbidden, "this token is for another node")
                    .authenticate(WRONG_ROLE))
            }
            _ => Ok(()),
        }
    }

    /// The same for a lease: its node must match.
    pub async fn speaks_for_lease(&self, app: &App, lease: LeaseId) -> ApiResult<()> {
        match self.0.node {
            Some(_) => self.speaks_for(app.store.lease_holder(lease).await?),
            None => Ok(()),
        }
    }
}

/// The address of a connection's other end. Each request carries it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PeerAddress(pub IpAddr);

pub(crate) const UNKNOWN_TOKEN: &str = "the service does not know this token, or it has expired";

/// Who sent the request, if that is known.
pub(crate) struct Peer(pub Option<IpAddr>);

impl FromRequestParts<App> for Peer {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &App) -> Result<Self, Infallible> {
        Ok(Self(peer(parts)))
    }
}

fn peer(parts: &Parts) -> Option<IpAddr> {
    parts.extensions.get::<PeerAddress>().map(|address| address.0)
}

/// A bearer token that may be a one-time token. It is checked when it is used up.
pub(crate) struct OneTimeToken(pub String);

impl FromRequestParts<App> for OneTimeToken {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &App) -> ApiResult<Self> {
        bearer(parts).map(|token| Self(token.to_owned()))
    }
}

fn bearer(parts: &Parts) -> ApiResult<&str> {
    let refused = |detail: &str| ApiError::new(ProblemKind::Unauthenticated, detail).authenticate(NO_TOKEN);
    let Some(header) = parts.headers.get(AUTHORIZATION) else {
        return Err(refused("send a token: Authorization: Bearer …"));
    };
    // Without a token, HTTP also drops the space after the scheme.
    let header = header.to_str().unwrap_or_default();
    let (scheme, token) = header.split_once(' ').unwrap_or((header, ""));
    match (scheme.eq_ignore_ascii_case("bearer"), token.trim()) {
        (false, _) => Err(refused("only bearer tokens are accepted: Authorization: Bearer …")),
        (true, "") => Err(refused("there is no token after `Bearer`: Authorization: Bearer …")),
        (true, token) => Ok(token),
    }
}

/// The caller. The request ends with the caller's right, see [`crate::rights`].
async fn principal(parts: &Parts, app: &App) -> ApiResult<Principal> {
    let secret = session_secret(&parts.headers).filter(|_| !parts.headers.contains_key(AUTHORIZATION));
    let now = app.now();
    let (right, found, reason) = match secret {
        Some(secret) => {
            if !matches!(parts.method, Method::GET | Method::HEAD) {
                check_same_origin(&parts.headers, app.public_origin.as_deref())?;
            }
            let right = app.rights.hold(tokens::hash(secret));
            (right, app.store.caller_of_session(secret, now).await?, "the session has ended; sign in again")
        }
        None => {
            let token = bearer(parts)?;
            let right = app.rights.hold(tokens::hash(token));
            (right, tokens::find(&app.store, token, now).await?, UNKNOWN_TOKEN)
        }
    };
    let unknown = || ApiError::new(ProblemKind::Unauthenticated, reason).authenticate(BAD_TOKEN);
    let caller = found.ok_or_else(unknown)?;
    right.until(caller.expires_at);
    app.rights.note_use(caller.token, now);
    if let Some(held) = parts.extensions.get::<Held>() {
        // Only the first of a request's extractors sets it; all hold the same right.
        let _ = held.set(right);
    }
    Ok(Principal { from: peer(parts), ..caller })
}

/// Counts the request among those of its caller, and lets its connection have the caller's standing.
fn take_seat(parts: &Parts, app: &App, caller: &Principal) -> ApiResult<()> {
    let Some(holds) = parts.extensions.get::<Holds>() else { return Ok(()) };
    let quota = app.quotas.request(caller, app.limits.requests_per_token)?;
    holds.show(Standing::from(caller.role), quota);
    Ok(())
}

fn forbidden(role: Role, allowed: &[Role]) -> ApiError {
    let allowed = allowed.iter().map(|role| role.name()).collect::<Vec<_>>().join(" or ");
    let detail = format!("a {role} token does not allow this; the request needs the role {allowed}");
    ApiError::new(ProblemKind::Forbidden, detail).authenticate(WRONG_ROLE)
}
