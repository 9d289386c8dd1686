//! Scene bundles.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{ArtifactHash, BundleId, SceneDigest, Timestamp};

/// Which bundle a job renders: exactly one of the two fields.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BundleRef {
    /// An uploaded bundle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<BundleId>,
    /// A folder or zip file on storage that the service and all workers share, under one of the service's
    /// bundle roots. It must not change while the job lives: a task that finds other files there fails, and
    /// with it the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<String>,
}

/// Where a worker finds the bundle of a task.
#[derive(Clone, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum BundleSource {
    /// A zip file to be fetched from `/v1/artifacts/{hash}`.
    Artifact(ArtifactHash),
    /// An absolute path on shared storage.
    Path(String),
}

/// What the service found in a bundle.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct SceneSummary {
    /// The scene's name.
    pub name: String,
    /// Hash of all its files: what tells it from a later version of itself.
    pub digest: SceneDigest,
    /// Frames of the animation; 1 for a still.
    pub frames: u32,
    /// The camera's image width in pixels.
    pub width: u32,
    /// The camera's image height in pixels.
    pub height: u32,
    /// Objects.
    pub objects: u64,
    /// Materials that surfaces have; libraries may describe more.
    pub materials: u64,
    /// Triangles.
    pub triangles: u64,
}

/// An uploaded bundle.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Bundle {
    /// Its id.
    pub id: BundleId,
    /// BLAKE3 of the zip file, under which it is also an artefact.
    pub hash: ArtifactHash,
    /// Length of the zip file in bytes.
    pub size: u64,
    /// What is in it.
    pub scene: SceneSummary,
    /// When it was uploaded.
    pub created_at: Timestamp,
}
