//! The farm: plans, projects, budgets.

use crate::client::Client;
use crate::error::ClientError;
use crate::transport::{Request, parameters};
use forelight_protocol::{
    Budget, BudgetForecast, BudgetForecastRequest, BudgetList, BudgetPeriod, BudgetRequest, PlanDifference,
    PlanId, PlanPage, PlanSummary, ProjectList, ProjectRequest, ProjectShare, PruneRequest, Pruned,
    Retention, RetentionRule,
};
use reqwest::Method;
use std::time::Duration;

/// Limit of one attempt to delete what is past its time. After years there is much of it.
const PRUNING: Duration = Duration::from_secs(1800);

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

    /// Removes a project's budget.
    pub async fn remove_budget(&self, project: &str, period: BudgetPeriod) -> Result<(), ClientError> {
        let path = format!("/v1/budgets?period={}{}", period.name(), parameters(&[("project", project)]));
        self.transport.send(&Request::new(Method::DELETE, path)).await.map(drop)
    }

    /// How long things are kept.
    pub async fn retention(&self) -> Result<Retention, ClientError> {
        self.get("/v1/retention").await
    }

    /// Sets how long something is kept.
    pub async fn set_retention(&self, rule: &RetentionRule) -> Result<Retention, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/retention", rule)).await
    }

    /// Deletes what is past its time, or only asks what that is.
    pub async fn prune(&self, request: &PruneRequest) -> Result<Pruned, ClientError> {
        let request = Request::json(Method::POST, "/v1/prune", request).timeout(Some(PRUNING));
        self.transport.json(&request).await
    }

    /// The forecast cost of tonight and the following nights.
    pub async fn budget_forecast(
        &self,
        request: &BudgetForecastRequest,
    ) -> Result<BudgetForecast, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/budget-forecasts", request)).await
    }
}
