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
}

impl Basis {
    pub(super) fn horizon(&self, until: Timestamp) -> Timestamp {
        self.nights.last().map_or(until, |last| last.until.min(until))
    }
}
