//! Query parameters.

use axum::extract::{FromRequestParts, Query};
use axum::http::request::Parts;
use forelight_protocol::ProblemKind;
use serde::de::DeserializeOwned;

use crate::error::{ApiError, ApiResult};
use crate::state::App;

/// The query parameters.
pub(crate) struct QueryParameters<T>(pub T);

impl<T: DeserializeOwned> FromRequestParts<App> for QueryParameters<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &App) -> ApiResult<Self> {
        match Query::try_from_uri(&parts.uri) {
            Ok(Query(value)) => Ok(Self(value)),
            Err(rejection) => {
                let text = rejection.body_text();
                let reason =
                    text.strip_prefix("Failed to deserialize query string: ").unwrap_or(&text).to_owned();
                // axum names the parameter in front of the reason.
                let name = reason.split_once(": ").map(|(name, _)| name.to_owned());
                let error = ApiError::new(ProblemKind::Invalid, reason);
                Err(match name {
                    Some(name) => error.in_parameter(name),
                    None => error,
                })
            }
        }
    }
}
