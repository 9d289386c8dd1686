//! Who is asking, and whether they may. A handler takes one of the types below as an argument; a request whose token
//! does not have the role never reaches it.

use axum::extract::FromRequestParts;
use axum::http::header::AUTHORIZATION;
use axum::http::request::Parts;
use forelight_protocol::{ProblemKind, Role};
use forelight_store::tokens::{self, Principal};

use crate::error::{ApiError, ApiResult};
use crate::state::App;

const NO_TOKEN: &str = "Bearer realm=\"forelight\"";
const BAD_TOKEN: &str = "Bearer realm=\"forelight\", error=\"invalid_token\"";
const WRONG_ROLE: &str = "Bearer realm=\"forelight\", error=\"insufficient_scope\"";

macro_rules! caller {
    ($(#[$doc:meta])* $name:ident, $($role:ident)|+) => {
        $(#[$doc])*
        pub(crate) struct $name(#[allow(dead_code, reason = "most handlers need to know only that there is one")] pub Principal);

        impl FromRequestParts<App> for $name {
            type Rejection = ApiError;

            async fn from_request_parts(parts: &mut Parts, app: &App) -> ApiResult<Self> {
                let principal = principal(parts, app).await?;
                match principal.role {
                    $(Role::$role)|+ => Ok(Self(principal)),
                    #[allow(unreachable_patterns, reason = "one of the types admits every role")]
                    other => Err(forbidden(other)),
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
    /// A token that may look at jobs, plans and the farm.
    Reader, Submitter | Operator | Viewer
);
caller!(
    /// A token that may submit and cancel.
    Submitter, Submitter | Operator
);
caller!(
    /// A token that may do the work.
    WorkerToken, Worker | Operator
);

caller!(
    /// A token that may run the farm.
    Operator, Operator
);

async fn principal(parts: &Parts, app: &App) -> ApiResult<Principal> {
    let refused = |detail: &str, challenge| {
        Err(ApiError::new(ProblemKind::Unauthenticated, detail).authenticate(challenge))
    };
    let Some(header) = parts.headers.get(AUTHORIZATION) else {
        return refused("send a token: Authorization: Bearer …", NO_TOKEN);
    };
    let token = header.to_str().ok().and_then(|header| {
        let (scheme, token) = header.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then_some(token.trim())
    });
    let Some(token) = token else {
        return refused("only bearer tokens are taken: Authorization: Bearer …", NO_TOKEN);
    };
    match tokens::find(&app.store, token).await? {
        Some(principal) => Ok(principal),
        None => refused("this token is not known here", BAD_TOKEN),
    }
}

fn forbidden(role: Role) -> ApiError {
    ApiError::new(ProblemKind::Forbidden, format!("a {role} token does not allow this"))
        .authenticate(WRONG_ROLE)
}
