//! Shares of the farm.

use axum::Json;
use axum::extract::State;
use forelight_planner as planner;
use forelight_protocol::{ProjectList, ProjectRequest, ProjectShare};
use forelight_store::HALF_LIFE;

use super::checks::check_name;
use crate::conductor::farm::planner_project;
use crate::conductor::waits::share_of;
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{JsonBody, Operator, Reader};
use crate::state::App;

const HIGHEST: u32 = 1_000_000;

/// The shares of all projects, and what each has used. Without deadlines, the project with least for its
/// share goes first.
#[utoipa::path(get, path = "/v1/projects", operation_id = "project_list", tag = "farm",
    responses((status = 200, description = "The projects", body = ProjectList), Problems))]
pub(crate) async fn list(State(app): State<App>, Reader(caller): Reader) -> ApiResult<Json<ProjectList>> {
    let mut list = shares(&app).await?;
    list.items.retain(|project| caller.sees(&project.project));
    Ok(Json(list))
}

/// Makes a project, or sets its share, and plans the farm anew. Setting it again replaces it, so repeating is
/// harmless.
#[utoipa::path(post, path = "/v1/projects", operation_id = "project_set",
    tag = "farm", request_body = ProjectRequest,
    responses((status = 200, description = "The project", body = ProjectShare), Problems))]
pub(crate) async fn set(
    State(app): State<App>,
    Operator(caller): Operator,
    JsonBody { value: request, .. }: JsonBody<ProjectRequest>,
) -> ApiResult<Json<ProjectShare>> {
    check_name("/project", &request.project, 200)?;
    if !(1..=HIGHEST).contains(&request.share) {
        return Err(ApiError::invalid("/share", format!("a share is 1 to {HIGHEST}")));
    }
    app.by(&caller).set_share(&request, app.now()).await?;
    let found = shares(&app).await?.items.into_iter().find(|entry| entry.project == request.project);
    let fallback = ProjectShare { project: request.project, share: request.share, used_hours: 0.0 };
    Ok(Json(found.unwrap_or(fallback)))
}

async fn shares(app: &App) -> ApiResult<ProjectList> {
    let now = app.now();
    let projects = app.store.projects(now).await?;
    let entries: Vec<planner::Project> =
        projects.iter().zip(0..).map(|(project, id)| planner_project(project, id)).collect();
    Ok(ProjectList {
        half_life_hours: u32::try_from(HALF_LIFE / 3_600_000_000).unwrap_or(u32::MAX),
        items: entries.iter().map(|project| share_of(project, now.micros())).collect(),
    })
}
