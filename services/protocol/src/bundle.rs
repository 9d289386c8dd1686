//! Scene bundles.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{ArtifactHash, BundleId, FrameRate, SceneDigest, Timestamp};

/// The bundle that a job renders. Exactly one of the two fields must be given.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BundleRef {
    /// Id of an uploaded bundle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<BundleId>,
    /// A folder or zip file on shared storage, below one of the service's bundle roots. It must not change
    /// while the job is active, else the job fails.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<String>,
}

/// Where a worker gets the bundle of a task.
#[derive(Clone, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum BundleSource {
    /// A zip file at `/v1/artifacts/{hash}`.
    Artifact(ArtifactHash),
    /// An absolute path on shared storage.
    Path(String),
}

/// Summary of the scene in a bundle.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct SceneSummary {
    /// The scene's name.
    pub name: String,
    /// Hash of all files of the scene. It tells the scene from its other versions.
    pub digest: SceneDigest,
    /// Number of frames of the animation. 1 for a still.
    pub frames: u32,
    /// The camera's image width in pixels.
    pub width: u32,
    /// The camera's image height in pixels.
    pub height: u32,
    /// Number of objects.
    pub objects: u64,
    /// Number of materials on surfaces. The material libraries may define more.
    pub materials: u64,
    /// Number of triangles.
    pub triangles: u64,
    /// Frames per second of its animation. Absent if it states none, or none that a video can have.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames_per_second: Option<FrameRate>,
}

/// An uploaded bundle.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Bundle {
    /// Its id.
    pub id: BundleId,
    /// BLAKE3 hash of the zip file. The file is also an artefact with this hash.
    pub hash: ArtifactHash,
    /// Length of the zip file in bytes.
    pub size: u64,
    /// Summary of the scene.
    pub scene: SceneSummary,
    /// When it was uploaded.
    pub created_at: Timestamp,
}
