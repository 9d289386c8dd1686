//! Tasks: what their workers had to say.

use axum::Json;
use axum::extract::State;
use forelight_protocol::{TaskId, TaskLog};

use crate::error::{ApiResult, Problems};
use crate::extract::{Reader, Segment};
use crate::state::App;

/// The log of a task: what its workers said, all attempts, oldest first. While a task is being done it grows with every renewal of its
/// lease. Kept for thirty days, at most 400 lines an attempt.
#[utoipa::path(get, path = "/v1/tasks/{id}/log", operation_id = "task_log",
    tag = "work", params(("id" = TaskId, Path)),
    responses((status = 200, description = "The log", body = TaskLog), Problems))]
pub(crate) async fn log(
    State(app): State<App>,
    _: Reader,
    Segment(task): Segment<TaskId>,
) -> ApiResult<Json<TaskLog>> {
    Ok(Json(app.store.task_log(task).await?))
}
