//! Tasks and their logs.

use axum::Json;
use axum::extract::State;
use forelight_protocol::{TaskId, TaskLog};
use forelight_store::StoreError;

use crate::error::{ApiResult, Problems};
use crate::extract::{Reader, Segment};
use crate::state::App;

/// The log of a task: lines of all attempts, oldest first. Kept for thirty days, at most 400 lines per
/// attempt.
#[utoipa::path(get, path = "/v1/tasks/{id}/log", operation_id = "task_log",
    tag = "work", params(("id" = TaskId, Path)),
    responses((status = 200, description = "The log", body = TaskLog), Problems))]
pub(crate) async fn log(
    State(app): State<App>,
    Reader(caller): Reader,
    Segment(task): Segment<TaskId>,
) -> ApiResult<Json<TaskLog>> {
    if !caller.reaches_all() && !caller.sees(&app.store.project_of_task(task).await?) {
        return Err(StoreError::NotFound("task").into());
    }
    Ok(Json(app.store.task_log(task).await?))
}
