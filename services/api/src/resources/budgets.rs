//! Budgets, and the cost of the coming nights.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use forelight_protocol::{
    Budget, BudgetForecast, BudgetForecastRequest, BudgetList, BudgetPeriod, BudgetRequest, Money, Night,
    ProblemKind,
};
use serde::Deserialize;
use utoipa::IntoParams;

use super::checks::{HIGHEST_SUM, check_name};
use super::responses::tagged;
use crate::budget_forecast::{BudgetForecastError, budget_forecast};
use crate::costly::key;
use crate::document::Document;
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{JsonBody, Operator, QueryParameters, Reader};
use crate::state::App;

const MOST_THRESHOLDS: usize = 10;

/// All budgets with their current state.
#[utoipa::path(get, path = "/v1/budgets", operation_id = "budget_list", tag = "farm",
    responses((status = 200, description = "The budgets", body = BudgetList),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    Reader(caller): Reader,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let mut items = app.store.budgets(app.now()).await?;
    items.retain(|budget| caller.sees(&budget.project));
    tagged(&headers, &BudgetList { items })
}

/// Sets a project's budget. Setting it again replaces it and ends the actions in force, so repeating is
/// harmless.
#[utoipa::path(post, path = "/v1/budgets", operation_id = "budget_set",
    tag = "farm", request_body = BudgetRequest,
    responses((status = 200, description = "The budget, as it stands", body = Budget), Problems))]
pub(crate) async fn set(
    State(app): State<App>,
    Operator(caller): Operator,
    JsonBody { value: request, .. }: JsonBody<BudgetRequest>,
) -> ApiResult<Json<Budget>> {
    check_name("/project", &request.project, 200)?;
    if !(Money(0)..=HIGHEST_SUM).contains(&request.amount) {
        return Err(ApiError::invalid("/amount", format!("an amount is 0 to {} micro-units", HIGHEST_SUM.0)));
    }
    if Night::of(&request.zone, app.now()).is_none() {
        return Err(ApiError::invalid("/zone", "unknown time zone; write for example Europe/Berlin"));
    }
    if request.thresholds.len() > MOST_THRESHOLDS {
        return Err(ApiError::invalid(
            "/thresholds",
            format!("a budget has at most {MOST_THRESHOLDS} thresholds"),
        ));
    }
    if let Some(wrong) =
        request.thresholds.iter().position(|threshold| !(1..=1000).contains(&threshold.percent))
    {
        return Err(ApiError::invalid(
            format!("/thresholds/{wrong}/percent"),
            "a threshold is 1 to 1000 per cent",
        ));
    }
    Ok(Json(app.by(&caller).set_budget(&request, app.now()).await?))
}

/// Names a budget.
#[derive(Clone, Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct BudgetQuery {
    /// The project.
    #[param(min_length = 1, max_length = 200)]
    pub project: String,
    /// The period of the budget.
    pub period: BudgetPeriod,
}

/// Removes a project's budget. What it held goes on, unless another budget of the project holds it.
#[utoipa::path(delete, path = "/v1/budgets", operation_id = "budget_remove", tag = "farm", params(BudgetQuery),
    responses((status = 204, description = "It is removed"), Problems))]
pub(crate) async fn remove(
    State(app): State<App>,
    Operator(caller): Operator,
    QueryParameters(BudgetQuery { project, period }): QueryParameters<BudgetQuery>,
) -> ApiResult<StatusCode> {
    app.by(&caller).remove_budget(&project, period, app.now()).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Forecasts the cost of tonight and the following nights, by project, job and class of nodes.
///
/// Also: budgets at risk, jobs that will not be ready, changes since the night before. A repeated request
/// replaces the forecast. Who reaches some projects only, gets the cost of these; that is not kept, and is not
/// compared with the nights before.
#[utoipa::path(post, path = "/v1/budget-forecasts", operation_id = "budget_forecast",
    tag = "farm", request_body = BudgetForecastRequest,
    responses((status = 200, description = "The forecast", body = BudgetForecast), Problems))]
pub(crate) async fn forecast(
    State(app): State<App>,
    Reader(caller): Reader,
    headers: HeaderMap,
    JsonBody { value: request, hash, .. }: JsonBody<BudgetForecastRequest>,
) -> ApiResult<Response> {
    let now = app.now();
    let projects = caller.project_names();
    // It is kept as what was said of the night, so it is computed for each instant that it is asked for, unless an
    // older one will do.
    let instant = now.micros() / (i64::from(request.max_age) * 1_000_000).max(1);
    let key = key(&("nights", hash, &projects, instant));
    let costly = app.costly.clone();
    let make = async move {
        let made = budget_forecast(&app.store, &request, projects, now).await;
        Document::json(&made.map_err(refused)?)
    };
    Ok(costly.answer(key, make).await?.respond(&headers))
}

fn refused(error: BudgetForecastError) -> ApiError {
    match error {
        BudgetForecastError::Invalid { pointer, reason } => ApiError::invalid(pointer, reason),
        BudgetForecastError::Store(error) => error.into(),
        BudgetForecastError::Unfinished(error) => {
            tracing::error!(%error, "a forecast was not finished");
            ApiError::new(ProblemKind::Internal, "the service failed; its log says more")
        }
        error @ BudgetForecastError::Bookings(_) => ApiError::new(ProblemKind::Conflict, error.to_string()),
    }
}
