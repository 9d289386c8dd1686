//! Quality settings of a render.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

use crate::ShotSettings;

/// Which materials the renderer uses.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum MaterialMode {
    /// The scene's materials.
    #[default]
    Full,
    /// Every surface diffuse with its own colour.
    Lambert,
}

/// How light is simulated.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    /// Distribution ray tracing with gathered indirect light, without caustics.
    #[default]
    Ambient,
    /// Unbiased path tracing, caustics included.
    Path,
}

impl MaterialMode {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            MaterialMode::Full => "full",
            MaterialMode::Lambert => "lambert",
        }
    }
}

impl Integrator {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Integrator::Ambient => "ambient",
            Integrator::Path => "path",
        }
    }
}

/// Whether indirect light is interpolated from an irradiance cache.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, Serialize, Deserialize, ToSchema)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum CacheMode {
    /// Every point gathers its own light.
    #[default]
    Off,
    /// Light is gathered at few places and interpolated.
    On,
}

/// Complete quality settings of a job. The same settings, bundle and frame give the same bits anywhere.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderSettings {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Camera paths per pixel.
    pub spp: u32,
    /// How light is simulated.
    #[serde(default)]
    pub integrator: Integrator,
    /// Diffuse interreflections, 0 for direct light only. With `path`: scattering events (diffuse, glossy,
    /// rough glass) after the first.
    pub ambient_bounces: u32,
    /// Hemisphere rays per gather, without a cache.
    pub ambient_divisions: u32,
    /// Longest path through mirrors and glass, in surfaces.
    pub max_depth: u32,
    /// Whether indirect light is interpolated.
    #[serde(default)]
    pub cache: CacheMode,
    /// Allowed error of interpolation in thousandths: a record serves up to this share of the mean distance
    /// to its surroundings.
    #[serde(default = "default_cache_accuracy")]
    pub cache_accuracy: u32,
    /// Hemisphere rays per cache record. Each further bounce has a quarter of them, at least 48. Directions
    /// of bright places get more.
    #[serde(default = "default_cache_rays")]
    pub cache_rays: u32,
    /// Which materials the renderer uses.
    pub materials: MaterialMode,
    /// Seed of all random numbers.
    pub seed: u64,
}

const fn default_cache_accuracy() -> u32 {
    200
}

const fn default_cache_rays() -> u32 {
    768
}

/// An invalid setting.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct BadSetting {
    /// Name of the setting, as in JSON.
    pub name: &'static str,
    /// The reason, without the name.
    pub reason: String,
}

impl std::fmt::Display for BadSetting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.name, self.reason)
    }
}

impl std::error::Error for BadSetting {}

impl RenderSettings {
    /// Most diffuse bounces.
    pub const MOST_BOUNCES: u32 = 8;
    /// Most bounces with the integrator `path`: in effect no limit.
    pub const MOST_BOUNCES_OF_A_PATH: u32 = 65_536;

    /// Number of pixels of the image.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    /// Class of jobs whose quotes are comparable: how light is simulated. One word.
    pub fn feature_class(&self) -> &'static str {
        match (self.integrator, self.cache, self.ambient_bounces) {
            (Integrator::Path, ..) => "path",
            (Integrator::Ambient, _, 0) => "direct",
            (Integrator::Ambient, CacheMode::On, _) => "cached",
            (Integrator::Ambient, CacheMode::Off, _) => "gathered",
        }
    }

    /// Checks every range and combination. The error is the first wrong setting.
    pub fn check(&self) -> Result<(), BadSetting> {
        let wrong = |name: &'static str, reason: String| Err(BadSetting { name, reason });
        let cached = self.cache == CacheMode::On;
        if cached && self.integrator == Integrator::Path {
            return wrong(
                "cache",
                "the integrator `path` uses no cache; set `ambient` or no cache".to_owned(),
            );
        }
        let bounces = match self.integrator {
            Integrator::Ambient => Self::MOST_BOUNCES,
            Integrator::Path => Self::MOST_BOUNCES_OF_A_PATH,
        };
        let ranges: [(&str, u32, RangeInclusive<u32>); 8] = [
            ("width", self.width, 1..=65_536),
            ("height", self.height, 1..=65_536),
            ("spp", self.spp, 1..=65_536),
            ("ambient_bounces", self.ambient_bounces, 0..=bounces),
            ("ambient_divisions", self.ambient_divisions, 1..=65_536),
            ("max_depth", self.max_depth, 1..=64),
            ("cache_accuracy", self.cache_accuracy, 10..=1000),
            ("cache_rays", self.cache_rays, 48..=65_536),
        ];
        for (name, value, range) in ranges {
            if !range.contains(&value) {
                return wrong(name, format!("{value} is not within {} to {}", range.start(), range.end()));
            }
        }
        if self.pixels() > 1 << 28 {
            let reason = format!("{} × {} pixels; an image has at most 2²⁸", self.width, self.height);
            return wrong("width", reason);
        }
        Ok(())
    }
}

/// Quality settings of a request. Absent ones take their defaults.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RenderSettingsRequest {
    /// Image width in pixels, 1 to 65536. Default: the scene's camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 65536)]
    pub width: Option<u32>,
    /// Image height in pixels, 1 to 65536. Default: the scene's camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 65536)]
    pub height: Option<u32>,
    /// Camera paths per pixel, 1 to 65536. Default: 16.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 65536)]
    pub spp: Option<u32>,
    /// How light is simulated. Default: `ambient`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub integrator: Option<Integrator>,
    /// Diffuse interreflections: 0 to 8, with `path` 0 to 65536 (in effect no limit).
    /// Default: 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 65536)]
    pub ambient_bounces: Option<u32>,
    /// Hemisphere rays per gather, without a cache, 1 to 65536. Default: 16.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 65536)]
    pub ambient_divisions: Option<u32>,
    /// Longest path through mirrors and glass, 1 to 64. Default: 12.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 64)]
    pub max_depth: Option<u32>,
    /// Whether indirect light is interpolated from an irradiance cache. Needs `ambient`. Default: `off`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cache: Option<CacheMode>,
    /// Allowed error of interpolation in thousandths, 10 to 1000: a record serves up to this share of the
    /// mean distance to its surroundings. Lower values take more records. Default: 200.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 10, maximum = 1000)]
    pub cache_accuracy: Option<u32>,
    /// Hemisphere rays per cache record, 48 to 65536, rounded to 48, 192, 432, 768, 1200, … Default: 768.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 48, maximum = 65536)]
    pub cache_rays: Option<u32>,
    /// Which materials the renderer uses. Default: `full`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub materials: Option<MaterialMode>,
    /// Seed of all random numbers. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Settings of another renderer, by its schema. Only for a job that names a `renderer`; such a job has,
    /// besides these, only `width`, `height`, `spp` and `seed`, and the defaults are those of its scene.
    #[serde(skip_serializing_if = "Map::is_empty")]
    #[schema(value_type = Object)]
    pub own: Map<String, Value>,
}

impl RenderSettingsRequest {
    /// The settings for a renderer other than our own. The error is the first setting that it cannot have.
    pub fn of_shot(&self) -> Result<ShotSettings, BadSetting> {
        let ours = [
            ("integrator", self.integrator.is_some()),
            ("ambient_bounces", self.ambient_bounces.is_some()),
            ("ambient_divisions", self.ambient_divisions.is_some()),
            ("max_depth", self.max_depth.is_some()),
            ("cache", self.cache.is_some()),
            ("cache_accuracy", self.cache_accuracy.is_some()),
            ("cache_rays", self.cache_rays.is_some()),
            ("materials", self.materials.is_some()),
        ];
        if let Some((name, _)) = ours.into_iter().find(|(_, is_given)| *is_given) {
            let reason = "only forelight's own renderer has this setting".to_owned();
            return Err(BadSetting { name, reason });
        }
        for (name, value) in [("width", self.width), ("height", self.height), ("spp", self.spp)] {
            if value.is_some_and(|value| !(1..=65_536).contains(&value)) {
                return Err(BadSetting { name, reason: "it is not within 1 to 65536".to_owned() });
            }
        }
        let seed = match self.seed.map(u32::try_from) {
            Some(Err(_)) => {
                return Err(BadSetting { name: "seed", reason: format!("it is at most {}", u32::MAX) });
            }
            seed => seed.and_then(Result::ok),
        };
        let Self { width, height, spp: samples, .. } = *self;
        Ok(ShotSettings { width, height, samples, seed, own: self.own.clone() })
    }

    /// Fills in the defaults. `camera` is the scene's image size (width, height) in pixels.
    pub fn complete(&self, camera: (u32, u32)) -> RenderSettings {
        RenderSettings {
            width: self.width.unwrap_or(camera.0),
            height: self.height.unwrap_or(camera.1),
            spp: self.spp.unwrap_or(16),
            integrator: self.integrator.unwrap_or_default(),
            ambient_bounces: self.ambient_bounces.unwrap_or(2),
            ambient_divisions: self.ambient_divisions.unwrap_or(16),
            max_depth: self.max_depth.unwrap_or(12),
            cache: self.cache.unwrap_or_default(),
            cache_accuracy: self.cache_accuracy.unwrap_or_else(default_cache_accuracy),
            cache_rays: self.cache_rays.unwrap_or_else(default_cache_rays),
            materials: self.materials.unwrap_or_default(),
            seed: self.seed.unwrap_or(0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_were_stored_before_there_was_a_cache_still_read() {
        let stored = r#"{"width":8,"height":6,"spp":4,"ambient_bounces":2,"ambient_divisions":16,"max_depth":12,"materials":"full","seed":3}"#;
        let expected = RenderSettingsRequest { spp: Some(4), seed: Some(3), ..Default::default() };
        assert_eq!(serde_json::from_str::<RenderSettings>(stored).unwrap(), expected.complete((8, 6)));
    }

    #[test]
    fn the_defaults_are_right_whatever_they_are_combined_with() {
        for (integrator, cache) in [
            (Integrator::Ambient, CacheMode::Off),
            (Integrator::Ambient, CacheMode::On),
            (Integrator::Path, CacheMode::Off),
        ] {
            let request = RenderSettingsRequest {
                integrator: Some(integrator),
                cache: Some(cache),
                ..Default::default()
            };
            assert_eq!(request.complete((1, 1)).check(), Ok(()));
        }
    }

    #[test]
    fn what_does_not_go_together_is_said_of_the_setting_that_has_to_change() {
        let mut request = RenderSettingsRequest {
            cache: Some(CacheMode::On),
            ambient_bounces: Some(RenderSettings::MOST_BOUNCES),
            ..Default::default()
        };
        assert_eq!(request.complete((1, 1)).check(), Ok(()));
        request.integrator = Some(Integrator::Path);
        assert_eq!(request.complete((1, 1)).check().unwrap_err().name, "cache");
    }
}
