//! Every error that a client can see, as problem details (RFC 9457).
//!
//! A handler's [`ApiError`] becomes a response without a body and with the problem as an extension. The
//! outermost layer, [`render_problems`], knows the path and writes the body, also for axum's own errors.

use std::collections::BTreeMap;

use axum::extract::Request;
use axum::http::header::{CONTENT_TYPE, RETRY_AFTER, WWW_AUTHENTICATE};
use axum::http::{HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use forelight_protocol::{Problem, ProblemKind};
use forelight_store::StoreError;

use utoipa::openapi::{ContentBuilder, Ref, RefOr, Response as DocumentedResponse, ResponseBuilder};

pub(crate) const PROBLEM_JSON: &str = "application/problem+json";

/// Seconds until a client may retry when the artefact store, retried already, is unavailable.
const ARTIFACTS_AWAY: u32 = 2;

/// Challenges to authenticate (RFC 6750).
pub(crate) const NO_TOKEN: &str = "Bearer realm=\"forelight\"";
pub(crate) const BAD_TOKEN: &str = "Bearer realm=\"forelight\", error=\"invalid_token\"";
pub(crate) const WRONG_ROLE: &str = "Bearer realm=\"forelight\", error=\"insufficient_scope\"";

#[derive(Clone, Debug)]
pub(crate) struct ApiError {
    problem: Box<Problem>,
    retry_after: Option<u32>,
    authenticate: Option<&'static str>,
}

pub(crate) type ApiResult<T> = Result<T, ApiError>;

impl ApiError {
    pub fn new(kind: ProblemKind, detail: impl Into<String>) -> Self {
        let retry_after = (kind == ProblemKind::Busy).then_some(1);
        Self { problem: Box::new(Problem::new(kind, detail)), retry_after, authenticate: None }
    }

    pub fn invalid(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::new(ProblemKind::Invalid, detail).at(pointer)
    }

    pub fn kind(&self) -> Option<ProblemKind> {
        self.problem.known_kind()
    }

    /// Sets the place in the request's body (RFC 6901).
    pub fn at(mut self, pointer: impl Into<String>) -> Self {
        self.problem.pointer = Some(pointer.into());
        self
    }

    pub fn in_parameter(mut self, name: impl Into<String>) -> Self {
        self.problem.parameter = Some(name.into());
        self
    }

    pub fn retry_after(mut self, seconds: u32) -> Self {
        self.retry_after = Some(seconds);
        self
    }

    /// Adds a challenge to authenticate (RFC 6750).
    pub fn authenticate(mut self, challenge: &'static str) -> Self {
        self.authenticate = Some(challenge);
        self
    }
}

impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        let kind = match &error {
            StoreError::NotFound(_) => ProblemKind::NotFound,
            StoreError::LeaseLost => ProblemKind::LeaseLost,
            StoreError::Conflict(_) => ProblemKind::Conflict,
            StoreError::JoinRefused(_) => ProblemKind::Unauthenticated,
            StoreError::MissingArtifact(_) => ProblemKind::MissingArtifact,
            StoreError::Implausible { .. } => ProblemKind::ImplausibleResult,
            StoreError::KeyReused => ProblemKind::IdempotencyKeyReused,
            StoreError::HashMismatch { .. } => ProblemKind::HashMismatch,
            StoreError::NoProject(_) => ProblemKind::Invalid,
            StoreError::QuotaExceeded(_) => ProblemKind::QuotaExceeded,
            StoreError::TooLarge { .. } => ProblemKind::TooLarge,
            StoreError::BrokenOff(_) => ProblemKind::Malformed,
            StoreError::Busy | StoreError::ArtifactsAway(_) => ProblemKind::Busy,
            StoreError::Full => ProblemKind::StorageFull,
            StoreError::ArtifactLost { .. } => ProblemKind::ArtifactLost,
            StoreError::ArtifactDamaged { .. } => ProblemKind::ArtifactDamaged,
            _ => ProblemKind::Internal,
        };
        match kind {
            ProblemKind::Internal => {
                // Details are for the operator's log. A client cannot use them and should not see paths.
                tracing::error!(%error, "the store failed");
                Self::new(kind, "the service failed; its log says more")
            }
            ProblemKind::StorageFull => {
                tracing::warn!(%error, "the store could not write");
                Self::new(kind, error.to_string())
            }
            ProblemKind::Busy if matches!(error, StoreError::ArtifactsAway(_)) => {
                // The operator has to act. The client only needs to know that it may retry.
                tracing::warn!(%error, "an artefact could not be moved");
                Self::new(kind, "the artefact store cannot be used just now").retry_after(ARTIFACTS_AWAY)
            }
            ProblemKind::ArtifactLost | ProblemKind::ArtifactDamaged => {
                tracing::error!(%error, "stored content is lost");
                Self::new(kind, format!("{error}; bring it back from a backup, or submit what made it again"))
            }
            ProblemKind::LeaseLost | ProblemKind::NotFound => Self::new(kind, error.to_string()),
            ProblemKind::ImplausibleResult => {
                let detail = error.to_string();
                tracing::warn!(detail, "a result was refused");
                match error {
                    StoreError::Implausible { pointer, .. } => Self::new(kind, detail).at(pointer),
                    _ => Self::new(kind, detail),
                }
            }
            ProblemKind::Invalid => Self::new(kind, error.to_string()).at("/project"),
            ProblemKind::Unauthenticated => Self::new(kind, error.to_string()).authenticate(BAD_TOKEN),
            ProblemKind::IdempotencyKeyReused => {
                Self::new(kind, error.to_string()).in_parameter("Idempotency-Key")
            }
            _ => {
                tracing::debug!(%error, "refused");
                Self::new(kind, error.to_string())
            }
        }
    }
}

/// Problem of a response whose body is not written yet.
#[derive(Clone)]
struct Pending(Box<Problem>);

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.problem.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let mut response = status.into_response();
        if let Some(seconds) = self.retry_after {
            response.headers_mut().insert(RETRY_AFTER, HeaderValue::from(seconds));
        }
        if let Some(challenge) = self.authenticate {
            response.headers_mut().insert(WWW_AUTHENTICATE, HeaderValue::from_static(challenge));
        }
        response.extensions_mut().insert(Pending(self.problem));
        response
    }
}

/// Writes the body of every error response.
pub(crate) async fn render_problems(request: Request, next: Next) -> Response {
    let path = request.uri().path().to_owned();
    let mut response = next.run(request).await;
    if !(response.status().is_client_error() || response.status().is_server_error()) {
        return response;
    }
    let mut problem = match response.extensions_mut().remove::<Pending>() {
        Some(Pending(problem)) => *problem,
        None => of_status(response.status()),
    };
    problem.instance = Some(path);
    let status = response.status();
    let mut headers = std::mem::take(response.headers_mut());
    headers.remove(axum::http::header::CONTENT_LENGTH);
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
    // Strings and numbers always have a JSON form.
    let body = serde_json::to_vec(&problem).unwrap_or_default();
    (status, headers, body).into_response()
}

fn of_status(status: StatusCode) -> Problem {
    let kind = match status {
        StatusCode::NOT_FOUND => ProblemKind::NotFound,
        StatusCode::METHOD_NOT_ALLOWED => ProblemKind::MethodNotAllowed,
        StatusCode::PAYLOAD_TOO_LARGE => ProblemKind::TooLarge,
        StatusCode::UNSUPPORTED_MEDIA_TYPE => ProblemKind::UnsupportedMediaType,
        StatusCode::SERVICE_UNAVAILABLE => ProblemKind::Busy,
        status if status.is_client_error() => ProblemKind::Malformed,
        _ => ProblemKind::Internal,
    };
    let detail = match kind {
        ProblemKind::NotFound => "there is no resource at this address".to_owned(),
        ProblemKind::MethodNotAllowed => "this method is not allowed here; see the Allow header".to_owned(),
        _ => kind.title().to_owned(),
    };
    Problem { status: status.as_u16(), ..Problem::new(kind, detail) }
}

/// Error responses of every operation, for the OpenAPI document.
pub(crate) struct Problems;

impl utoipa::IntoResponses for Problems {
    fn responses() -> BTreeMap<String, RefOr<DocumentedResponse>> {
        let response = |description: &str| {
            let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
            RefOr::T(ResponseBuilder::new().description(description).content(PROBLEM_JSON, content).build())
        };
        BTreeMap::from([
            ("4XX".to_owned(), response("The request is refused; `type` says why")),
            ("5XX".to_owned(), response("The service cannot do it now; 503 has `Retry-After`")),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_busy_database_says_when_to_come_back_and_a_broken_one_tells_nothing_of_its_inside() {
        let busy = ApiError::from(StoreError::Busy).into_response();
        assert_eq!(
            (busy.status(), &busy.headers()[RETRY_AFTER]),
            (StatusCode::SERVICE_UNAVAILABLE, &HeaderValue::from(1))
        );
        let broken = ApiError::from(StoreError::Corrupt("page 7 of /srv/farm".to_owned()));
        assert_eq!(broken.kind(), Some(ProblemKind::Internal));
        assert!(!broken.problem.detail.contains("/srv"), "{}", broken.problem.detail);
    }
}
