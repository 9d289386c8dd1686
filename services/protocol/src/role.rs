//! Who may do what.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What the holder of a token may do.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Submits and cancels jobs, uploads bundles, reads everything.
    Submitter,
    /// Nodes, leases, artefacts; reads bundles. Sees no jobs but by their tasks.
    Worker,
    /// Everything.
    Operator,
    /// Reads everything, changes nothing.
    Viewer,
}

/// A word that names no role.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a role: submitter, worker, operator or viewer")]
pub struct UnknownRole(String);

impl Role {
    /// All roles.
    pub const ALL: [Role; 4] = [Role::Submitter, Role::Worker, Role::Operator, Role::Viewer];

    /// The role's name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Role::Submitter => "submitter",
            Role::Worker => "worker",
            Role::Operator => "operator",
            Role::Viewer => "viewer",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Role {
    type Err = UnknownRole;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Role::ALL
            .into_iter()
            .find(|role| role.name() == text)
            .ok_or_else(|| UnknownRole(text.chars().take(64).collect()))
    }
}
