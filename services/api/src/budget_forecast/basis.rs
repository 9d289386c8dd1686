//! Everything that a forecast of nights rests on.

use forelight_protocol::{Budget, LedgerLine, Night, Node, Timestamp};
use forelight_store::OpenJob;

/// Everything that the forecast rests on.
pub(super) struct Basis {
    pub now: Timestamp,
    pub zone: String,
    pub nights: Vec<Night>,
    pub nodes: Vec<Node>,
    pub jobs: Vec<OpenJob>,
    pub ledger: Vec<LedgerLine>,
    pub budgets: Vec<Budget>,
}

impl Basis {
    /// Until when a period is looked at.
    pub(super) fn horizon(&self, until: Timestamp) -> Timestamp {
        self.nights.last().map_or(until, |last| last.until.min(until))
    }
}
