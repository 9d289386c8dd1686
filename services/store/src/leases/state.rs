//! How far a lease is.

/// A lease's state.
#[derive(Clone, Copy, PartialEq, Eq, Debug, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum LeaseState {
    Active,
    Committed,
    Failed,
    Expired,
    Released,
    Revoked,
}
