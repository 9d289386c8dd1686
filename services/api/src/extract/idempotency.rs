//! The `Idempotency-Key` header.

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use forelight_protocol::ProblemKind;
use forelight_store::IdempotencyKey;
use forelight_store::tokens::Principal;

use crate::error::{ApiError, ApiResult};
use crate::state::App;

const NAME: &str = "idempotency-key";

/// The client's idempotency key, if any, and the request's target.
#[derive(Clone, Debug)]
pub(crate) struct KeyHeader {
    key: Option<String>,
    /// Method and path. The same key for another address is another request.
    target: String,
}

impl FromRequestParts<App> for KeyHeader {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &App) -> ApiResult<Self> {
        let target = format!("{} {}", parts.method, parts.uri);
        let Some(header) = parts.headers.get(NAME) else { return Ok(Self { key: None, target }) };
        match header.to_str() {
            Ok(key) if (1..=255).contains(&key.len()) => Ok(Self { key: Some(key.to_owned()), target }),
            _ => Err(ApiError::new(
                ProblemKind::Malformed,
                "an idempotency key is 1 to 255 visible ASCII characters",
            )
            .in_parameter("Idempotency-Key")),
        }
    }
}

impl KeyHeader {
    /// The key in the store's form. `body` is the hash of the request's body.
    pub fn of(self, principal: &Principal, body: &[u8; 32]) -> Option<IdempotencyKey> {
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.target.as_bytes()).update(&[0]).update(body);
        let request_hash = *hasher.finalize().as_bytes();
        self.key.map(|key| IdempotencyKey { principal: principal.hash, key, request_hash })
    }
}
