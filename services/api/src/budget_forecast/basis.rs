//! Input of a forecast of nights.

use forelight_protocol::{Budget, LedgerLine, Night, Node, Timestamp};
use forelight_store::OpenJob;

pub(super) struct Basis {
    pub now: Timestamp,
    pub zone: String,
    pub nights: Vec<Night>,
    pub nodes: Vec<Node>,
    pub jobs: Vec<OpenJob>,
    pub ledger: Vec<LedgerLine>,
    pub budgets: Vec<Budget>,
    /// The projects whose cost is forecast; `None` for all. Jobs of others take nodes all the same.
    pub projects: Option<Vec<String>>,
}

impl Basis {
    /// Whether the forecast is about this project.
    pub(super) fn is_about(&self, project: &str) -> bool {
        self.projects.as_ref().is_none_or(|projects| projects.iter().any(|own| own == project))
    }

    /// The same without money of other projects.
    pub(super) fn of_its_projects(mut self) -> Self {
        let (mut ledger, mut budgets) = (std::mem::take(&mut self.ledger), std::mem::take(&mut self.budgets));
        ledger.retain(|line| self.is_about(&line.project));
        budgets.retain(|budget| self.is_about(&budget.project));
        Self { ledger, budgets, ..self }
    }

    pub(super) fn horizon(&self, until: Timestamp) -> Timestamp {
        self.nights.last().map_or(until, |last| last.until.min(until))
    }
}
