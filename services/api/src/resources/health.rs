//! Health, readiness and metrics. All but the metrics are open to everyone.

use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use forelight_protocol::ProblemKind;

use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::Reader;
use crate::state::App;

/// The process is running.
#[utoipa::path(get, path = "/healthz", tag = "service", security(()), responses((status = 200, description = "It is running", body = String, content_type = "text/plain"), Problems))]
pub(crate) async fn healthz() -> &'static str {
    "ok\n"
}

/// The service can work: its database answers, there is enough disk space, and it is not stopping.
#[utoipa::path(get, path = "/readyz", tag = "service", security(()), responses((status = 200, description = "It is ready", body = String, content_type = "text/plain"), Problems))]
pub(crate) async fn readyz(State(app): State<App>) -> ApiResult<&'static str> {
    if app.stopping.is_cancelled() {
        return Err(ApiError::new(ProblemKind::Busy, "the service is stopping"));
    }
    app.store.ping().await.map_err(|error| {
        tracing::error!(%error, "the database does not answer");
        ApiError::new(ProblemKind::Busy, "the database does not answer")
    })?;
    app.check_disk_space()?;
    Ok("ready\n")
}

/// Metrics in Prometheus text format. Who reaches some projects only, gets the numbers of jobs and tasks of
/// these; all others are about the service and its nodes.
#[utoipa::path(get, path = "/metrics", tag = "service", responses((status = 200, description = "The metrics", body = String, content_type = "text/plain"), Problems))]
pub(crate) async fn metrics(State(app): State<App>, Reader(caller): Reader) -> ApiResult<Response> {
    let projects = caller.project_names();
    let counts = app.store.counts(projects.as_deref(), app.lease_ttl, app.now()).await?;
    let text = app.metrics.render(&counts, app.store.free_disk_space()?);
    Ok(([(CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text).into_response())
}

/// This document.
#[utoipa::path(get, path = "/openapi.yaml", tag = "service", security(()), responses((status = 200, description = "The OpenAPI document", body = String, content_type = "application/yaml"), Problems))]
pub(crate) async fn openapi(State(app): State<App>) -> Response {
    ([(CONTENT_TYPE, "application/yaml")], (app.openapi)()).into_response()
}
