//! The version of the messages that a worker speaks.

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use forelight_protocol::{OLDEST_WORKER_PROTOCOL, ProblemKind, WORKER_PROTOCOL, WORKER_PROTOCOL_HEADER};

use crate::error::{ApiError, ApiResult};
use crate::state::App;

/// A worker whose version this service understands. It is looked at before the body, which may have fields that
/// this service does not know.
pub(crate) struct WorkerVersion;

impl FromRequestParts<App> for WorkerVersion {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &App) -> ApiResult<Self> {
        let Some(stated) = parts.headers.get(WORKER_PROTOCOL_HEADER) else { return agreed(1) };
        match stated.to_str().ok().and_then(|text| text.parse().ok()) {
            Some(version) => agreed(version),
            None => {
                let reason = "the version of a worker's messages is a number, 1 or more";
                Err(ApiError::new(ProblemKind::Malformed, reason).in_parameter(WORKER_PROTOCOL_HEADER))
            }
        }
    }
}

fn agreed(version: u32) -> ApiResult<WorkerVersion> {
    let own = env!("CARGO_PKG_VERSION");
    let (kind, what_to_do) = match version {
        ..OLDEST_WORKER_PROTOCOL => (
            ProblemKind::WorkerTooOld,
            format!(
                "install forelight {own}, or another version that the service understands, on its machine"
            ),
        ),
        OLDEST_WORKER_PROTOCOL..=WORKER_PROTOCOL => return Ok(WorkerVersion),
        _ => (
            ProblemKind::WorkerTooNew,
            format!("upgrade the service, or start the worker with forelight {own} as the service has"),
        ),
    };
    let detail = format!(
        "this worker speaks version {version} of the worker protocol, and this service, forelight {own}, \
         understands {OLDEST_WORKER_PROTOCOL} to {WORKER_PROTOCOL}: {what_to_do}"
    );
    Err(ApiError::new(kind, detail).in_parameter(WORKER_PROTOCOL_HEADER))
}
