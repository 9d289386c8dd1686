//! Artefacts: files that are addressed by the hash of their content.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::ArtifactHash;

/// The answer to an upload of an artefact.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ArtifactStored {
    /// Hash of the content received. The same as in the address.
    pub hash: ArtifactHash,
    /// Length in bytes.
    pub size: u64,
    /// Whether the farm already had this artefact.
    pub existed: bool,
}
