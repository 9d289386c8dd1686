//! What the user asks of a render.

use serde::{Deserialize, Serialize};

/// Replacement of all materials, for comparisons with other renderers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaterialOverride {
    /// The bundle's materials.
    #[default]
    Full,
    /// Every material as two-sided Lambert with its diffuse colour or texture; metals and glass as 0.5 grey.
    Lambert,
}

/// Quality and size of an image. Two renders of one frame with equal settings have equal bits.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Camera samples a pixel.
    pub spp: u32,
    /// Indirect diffuse bounces; 0 is direct light (and mirrors and glass) alone.
    pub ambient_bounces: u32,
    /// Rays of a hemisphere gather at the first diffuse hit of full weight. Hits of lower weight get fewer, in
    /// proportion; each further bounce gets an eighth.
    pub ambient_divisions: u32,
    /// Longest chain of mirror, glass and glossy hits.
    pub max_depth: u32,
    /// Replacement of all materials.
    pub materials: MaterialOverride,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            width: 640,
            height: 360,
            spp: 4,
            ambient_bounces: 1,
            ambient_divisions: 32,
            max_depth: 12,
            materials: MaterialOverride::Full,
            seed: 0,
        }
    }
}

/// A setting outside its range.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name} is {value}, but must lie in {lowest} … {highest}")]
pub struct SettingsError {
    /// Name of the setting.
    pub name: &'static str,
    /// What was asked.
    pub value: u64,
    /// Smallest value allowed.
    pub lowest: u64,
    /// Largest value allowed.
    pub highest: u64,
}

impl Settings {
    /// Checks every range, in the order of the fields.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let ranges = [
            ("width", self.width, 1, 65_536),
            ("height", self.height, 1, 65_536),
            ("spp", self.spp, 1, 65_536),
            ("ambient_bounces", self.ambient_bounces, 0, 8),
            ("ambient_divisions", self.ambient_divisions, 1, 65_536),
            ("max_depth", self.max_depth, 1, 64),
        ];
        let pixels = ("width × height", u64::from(self.width) * u64::from(self.height), 1, 1 << 28);
        let check = |(name, value, lowest, highest): (&'static str, u64, u64, u64)| {
            if (lowest..=highest).contains(&value) {
                Ok(())
            } else {
                Err(SettingsError { name, value, lowest, highest })
            }
        };
        ranges.into_iter().map(|(n, v, l, h)| (n, v.into(), l, h)).chain([pixels]).try_for_each(check)
    }
}
