//! Tasks of jobs, and their logs.

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use forelight_protocol::{JobId, TaskId, TaskLog, TaskPage};
use forelight_store::StoreError;
use serde::Deserialize;
use utoipa::IntoParams;

use super::responses::tagged;
use crate::error::{ApiResult, Problems};
use crate::extract::{QueryParameters, Reader, SeenJob, Segment, number_if_any};
use crate::page::{LARGEST_PAGE, PageQuery, cut};
use crate::state::App;

/// Which tasks to list.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct TaskQuery {
    /// Only tasks of this frame.
    #[param(minimum = 0, maximum = 4294967295i64)]
    #[serde(default, deserialize_with = "number_if_any::<_, _, 0, 4_294_967_295>")]
    pub frame: Option<u32>,
    /// `next_page_token` of the previous page.
    pub page_token: Option<String>,
    /// Number of items on a page: 1 to 200, default 50.
    #[param(minimum = 1, maximum = 200, default = 50)]
    #[serde(default, deserialize_with = "number_if_any::<_, _, 1, LARGEST_PAGE>")]
    pub page_size: Option<u32>,
}

/// The tasks of a job, oldest first: what each makes, its state, its node.
#[utoipa::path(get, path = "/v1/jobs/{id}/tasks", operation_id = "task_list",
    tag = "jobs", params(("id" = JobId, Path), TaskQuery),
    responses((status = 200, description = "A page of tasks", body = TaskPage),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    QueryParameters(query): QueryParameters<TaskQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let page = PageQuery { page_token: query.page_token, page_size: query.page_size };
    let (size, after) = (page.size(), page.key("tasks")?);
    let mut items = app.store.tasks(job, query.frame, after, size + 1).await?;
    let next_page_token = cut(&mut items, size, "tasks", |row| row.id);
    tagged(&headers, &TaskPage { items, next_page_token })
}

/// The log of a task: lines of all attempts, oldest first. Kept for thirty days, at most 400 lines per
/// attempt.
#[utoipa::path(get, path = "/v1/tasks/{id}/log", operation_id = "task_log",
    tag = "work", params(("id" = TaskId, Path)),
    responses((status = 200, description = "The log", body = TaskLog),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn log(
    State(app): State<App>,
    Reader(caller): Reader,
    Segment(task): Segment<TaskId>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    if !caller.reaches_all() && !caller.sees(&app.store.project_of_task(task).await?) {
        return Err(StoreError::NotFound("task").into());
    }
    tagged(&headers, &app.store.task_log(task).await?)
}
