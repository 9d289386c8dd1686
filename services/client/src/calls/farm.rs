//! The farm: plans, projects, budgets.

use crate::client::Client;
use crate::error::ClientError;
use crate::transport::Request;
use forelight_protocol::{
    Budget, BudgetForecast, BudgetForecastRequest, BudgetList, BudgetRequest, PlanDifference, PlanId,
    PlanPage, PlanSummary, ProjectList, ProjectRequest, ProjectShare,
};
use reqwest::Method;

impl Client {
    /// The newest plans.
    pub async fn newest_plans(&self) -> Result<Vec<PlanSummary>, ClientError> {
        let page: PlanPage = self.get("/v1/plans").await?;
        Ok(page.items)
    }

    /// What a plan changed.
    pub async fn plan_difference(&self, plan: PlanId) -> Result<PlanDifference, ClientError> {
        self.get(format!("/v1/plans/{plan}/difference")).await
    }

    /// The shares of all projects.
    pub async fn projects(&self) -> Result<ProjectList, ClientError> {
        self.get("/v1/projects").await
    }

    /// Sets a project's share.
    pub async fn set_share(&self, request: &ProjectRequest) -> Result<ProjectShare, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/projects", request)).await
    }

    /// All budgets and how much of each is spent.
    pub async fn budgets(&self) -> Result<BudgetList, ClientError> {
        self.get("/v1/budgets").await
    }

    /// Sets a project's budget.
    pub async fn set_budget(&self, budget: &BudgetRequest) -> Result<Budget, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/budgets", budget)).await
    }

    /// The forecast cost of tonight and the following nights.
    pub async fn budget_forecast(
        &self,
        request: &BudgetForecastRequest,
    ) -> Result<BudgetForecast, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/budget-forecasts", request)).await
    }
}
