//! Roles of tokens.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What the holder of a token may do.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// May submit and cancel jobs, upload bundles, and read everything.
    Submitter,
    /// May use nodes, leases and artefacts, and read bundles. Sees jobs only through their tasks.
    Worker,
    /// May do everything.
    Operator,
    /// May read everything and change nothing.
    Viewer,
}

/// A word that is not a role.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a role; write submitter, worker, operator or viewer")]
pub struct UnknownRole(String);

impl Role {
    /// All roles.
    pub const ALL: [Role; 4] = [Role::Submitter, Role::Worker, Role::Operator, Role::Viewer];

    /// Name of the role, as in JSON.
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
