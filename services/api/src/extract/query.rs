//! Query parameters. Unknown ones are refused: a misspelt filter would show everything.

use axum::extract::{FromRequestParts, Query};
use axum::http::request::Parts;
use forelight_protocol::ProblemKind;
use serde::de::{DeserializeOwned, Error};
use serde::{Deserialize, Deserializer};

use crate::error::{ApiError, ApiResult};
use crate::state::App;

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
                // axum puts the parameter's name before the reason.
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

/// A whole number in this range, for a field's `deserialize_with`.
pub(crate) fn number<'de, D, T, const LEAST: i64, const MOST: i64>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: TryFrom<i64>,
{
    let text = String::deserialize(deserializer)?;
    let number = text.parse().ok().filter(|number| (LEAST..=MOST).contains(number));
    number
        .and_then(|number| T::try_from(number).ok())
        .ok_or_else(|| D::Error::custom(format!("`{text}` is not a whole number from {LEAST} to {MOST}")))
}

/// The same for an optional field.
pub(crate) fn number_if_any<'de, D, T, const LEAST: i64, const MOST: i64>(
    deserializer: D,
) -> Result<Option<T>, D::Error>
where
    D: Deserializer<'de>,
    T: TryFrom<i64>,
{
    number::<D, T, LEAST, MOST>(deserializer).map(Some)
}
