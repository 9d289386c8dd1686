//! Artefacts: files by the hash of their content.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::ArtifactHash;

/// The answer to a PUT of an artefact.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ArtifactStored {
    /// The hash of what was received; the same as in the address.
    pub hash: ArtifactHash,
    /// Length in bytes.
    pub size: u64,
    /// Whether it was there already.
    pub existed: bool,
}
