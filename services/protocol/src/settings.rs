//! How good a frame is to look.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Which materials the renderer honours.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum MaterialMode {
    /// The scene's materials.
    #[default]
    Full,
    /// Every surface diffuse with its own colour.
    Lambert,
}

/// The quality settings of a job, complete. The same settings, bundle and frame give the same bits anywhere.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderSettings {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Camera paths per pixel.
    pub spp: u32,
    /// Diffuse interreflections followed: 0 is direct light only.
    pub ambient_bounces: u32,
    /// Hemisphere rays of one ambient gather.
    pub ambient_divisions: u32,
    /// Longest path through mirrors and glass, in surfaces.
    pub max_depth: u32,
    /// Which materials are honoured.
    pub materials: MaterialMode,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl RenderSettings {
    /// Pixels of the image.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

/// The quality settings as a client gives them; what is left out takes the default named at each field.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RenderSettingsRequest {
    /// Image width in pixels, 1 to 65536; default: the scene's camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 65536)]
    pub width: Option<u32>,
    /// Image height in pixels, 1 to 65536; default: the scene's camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 65536)]
    pub height: Option<u32>,
    /// Camera paths per pixel, 1 to 65536; default 16.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 65536)]
    pub spp: Option<u32>,
    /// Diffuse interreflections, 0 to 64; default 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 64)]
    pub ambient_bounces: Option<u32>,
    /// Hemisphere rays of one ambient gather, 1 to 65536; default 16.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 65536)]
    pub ambient_divisions: Option<u32>,
    /// Longest path through mirrors and glass, 1 to 256; default 12.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 256)]
    pub max_depth: Option<u32>,
    /// Which materials are honoured; default `full`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub materials: Option<MaterialMode>,
    /// Seed of all random numbers; default 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
}

impl RenderSettingsRequest {
    /// The complete settings; `camera` is the scene's image size (width, height), in pixels.
    pub fn complete(&self, camera: (u32, u32)) -> RenderSettings {
        RenderSettings {
            width: self.width.unwrap_or(camera.0),
            height: self.height.unwrap_or(camera.1),
            spp: self.spp.unwrap_or(16),
            ambient_bounces: self.ambient_bounces.unwrap_or(2),
            ambient_divisions: self.ambient_divisions.unwrap_or(16),
            max_depth: self.max_depth.unwrap_or(12),
            materials: self.materials.unwrap_or_default(),
            seed: self.seed.unwrap_or(0),
        }
    }
}
