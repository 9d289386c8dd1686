//! Ids and numbers in addresses.

use std::fmt::Display;
use std::str::FromStr;

use axum::extract::{FromRequestParts, Path};
use axum::http::request::Parts;
use forelight_protocol::ProblemKind;

use crate::error::{ApiError, ApiResult};
use crate::state::App;

/// The only variable part of the address. An invalid id is 404, not 400.
pub(crate) struct Segment<T>(pub T);

pub(crate) struct Segments<A, B>(pub A, pub B);

impl<A> FromRequestParts<App> for Segment<A>
where
    A: FromStr + Send,
{
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> ApiResult<Self> {
        let Path(text) =
            Path::<String>::from_request_parts(parts, app).await.map_err(|error| unreadable(&error))?;
        read(&text).map(Self)
    }
}

impl<A, B> FromRequestParts<App> for Segments<A, B>
where
    A: FromStr + Send,
    B: FromStr + Send,
{
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> ApiResult<Self> {
        let Path((first, second)) = Path::<(String, String)>::from_request_parts(parts, app)
            .await
            .map_err(|error| unreadable(&error))?;
        Ok(Self(read(&first)?, read(&second)?))
    }
}

fn read<T: FromStr>(segment: &str) -> ApiResult<T> {
    let refused = |_| {
        let reason = format!("this address does not exist: `{segment}` is not a valid id or number");
        ApiError::new(ProblemKind::NotFound, reason)
    };
    segment.parse().map_err(refused)
}

fn unreadable(error: &impl Display) -> ApiError {
    ApiError::new(ProblemKind::NotFound, format!("this address does not exist: {error}"))
}
