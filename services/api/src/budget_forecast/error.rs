//! Why a forecast of nights is not made.

use forelight_planner as planner;
use forelight_store::StoreError;

/// Why a forecast cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum BudgetForecastError {
    /// A field of the request that cannot be.
    #[error("{reason}")]
    Invalid {
        /// JSON pointer to it.
        pointer: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The database.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The planner.
    #[error("what is booked cannot be carried out: {0}")]
    Bookings(#[from] planner::InputError),
    /// The computation panicked, or the service ends.
    #[error("the computation was not finished: {0}")]
    Unfinished(#[from] tokio::task::JoinError),
}
