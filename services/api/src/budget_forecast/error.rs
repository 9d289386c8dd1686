//! Errors of a forecast of nights.

use forelight_planner as planner;
use forelight_store::StoreError;

/// Why a forecast cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum BudgetForecastError {
    /// A field of the request is invalid.
    #[error("{reason}")]
    Invalid {
        /// JSON pointer to it.
        pointer: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The planner rejected its input.
    #[error("the bookings cannot be carried out: {0}")]
    Bookings(#[from] planner::InputError),
    /// The computation panicked, or the service is stopping.
    #[error("the computation was not finished: {0}")]
    Unfinished(#[from] tokio::task::JoinError),
}
