//! Budgets, and what the nights to come will cost.

use axum::Json;
use axum::extract::State;
use forelight_protocol::{
    Budget, BudgetForecast, BudgetForecastRequest, BudgetList, BudgetRequest, Money, Night, ProblemKind,
};

use super::checks::{HIGHEST_SUM, check_name};
use crate::budget_forecast::{BudgetForecastError, budget_forecast};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{JsonBody, Operator, Reader};
use crate::state::App;

/// Thresholds that a budget may have.
const MOST_THRESHOLDS: usize = 10;

/// All budgets and how they stand.
#[utoipa::path(get, path = "/v1/budgets", operation_id = "budget_list", tag = "farm",
    responses((status = 200, description = "The budgets", body = BudgetList), Problems))]
pub(crate) async fn list(State(app): State<App>, _: Reader) -> ApiResult<Json<BudgetList>> {
    Ok(Json(BudgetList { items: app.store.budgets(app.now()).await? }))
}

/// Sets a project's budget for nights, for months or for good. Setting it again replaces it, and ends what it had in force: so repeating the
/// request is harmless.
#[utoipa::path(post, path = "/v1/budgets", operation_id = "budget_set",
    tag = "farm", request_body = BudgetRequest,
    responses((status = 200, description = "The budget, as it stands", body = Budget), Problems))]
pub(crate) async fn set(
    State(app): State<App>,
    _: Operator,
    JsonBody { value: request, .. }: JsonBody<BudgetRequest>,
) -> ApiResult<Json<Budget>> {
    check_name("/project", &request.project, 200)?;
    if !(Money(0)..=HIGHEST_SUM).contains(&request.amount) {
        return Err(ApiError::invalid("/amount", format!("an amount is 0 to {} micro-units", HIGHEST_SUM.0)));
    }
    if Night::of(&request.zone, app.now()).is_none() {
        return Err(ApiError::invalid(
            "/zone",
            "there is no such time zone; write for instance Europe/Berlin",
        ));
    }
    if request.thresholds.len() > MOST_THRESHOLDS {
        return Err(ApiError::invalid(
            "/thresholds",
            format!("at most {MOST_THRESHOLDS} thresholds are taken"),
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
    Ok(Json(app.store.set_budget(&request, app.now()).await?))
}

/// What tonight and the nights after it will cost, by project, job and class of nodes, against budgets; what will not be ready; what changed since the
/// night before. It is kept as what was said of its first night, in one place however often it is asked for.
#[utoipa::path(post, path = "/v1/budget-forecasts", operation_id = "budget_forecast",
    tag = "farm", request_body = BudgetForecastRequest,
    responses((status = 200, description = "The forecast", body = BudgetForecast), Problems))]
pub(crate) async fn forecast(
    State(app): State<App>,
    _: Reader,
    JsonBody { value: request, .. }: JsonBody<BudgetForecastRequest>,
) -> ApiResult<Json<BudgetForecast>> {
    match budget_forecast(&app.store, &request, app.now()).await {
        Ok(forecast) => Ok(Json(forecast)),
        Err(BudgetForecastError::Invalid { pointer, reason }) => Err(ApiError::invalid(pointer, reason)),
        Err(BudgetForecastError::Store(error)) => Err(error.into()),
        Err(BudgetForecastError::Unfinished(error)) => {
            tracing::error!(%error, "a forecast was not finished");
            Err(ApiError::new(ProblemKind::Internal, "the service failed; its log says more"))
        }
        Err(error @ BudgetForecastError::Bookings(_)) => {
            Err(ApiError::new(ProblemKind::Conflict, error.to_string()))
        }
    }
}
