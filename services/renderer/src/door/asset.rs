//! Files that a scene refers to.

use serde::{Deserialize, Serialize};

/// Where an asset is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AssetState {
    /// A file, or files, that exist.
    Present,
    /// Inside the scene.
    Packed,
    /// A file that does not exist.
    Missing,
}

/// A file that the scene refers to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Asset {
    /// Such as `image`, `library`, `cache`, `font` or `volume`.
    pub kind: String,
    /// Its name in the scene.
    pub name: String,
    /// Absolute path. Patterns such as `<UDIM>` are left as they are.
    pub path: String,
    /// Where it is.
    pub state: AssetState,
}
