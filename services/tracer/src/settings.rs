//! Settings: the quality and size of an image.

use forelight_protocol::{BadSetting, CacheMode, Integrator, MaterialMode, RenderSettings};
use serde::{Deserialize, Serialize};

/// Quality and size of an image. Two renders of one frame with equal settings have equal bits.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Camera samples per pixel.
    pub spp: u32,
    /// The light transport algorithm.
    pub integrator: Integrator,
    /// Number of indirect diffuse bounces; 0 for direct light, mirrors and glass only. For
    /// [`Integrator::Path`], it limits how often light is spread (diffuse, glossy, rough glass) after the
    /// first time; its largest value means no limit.
    pub ambient_bounces: u32,
    /// Rays of a gather at the first diffuse hit with full weight, proportionally fewer with less. Each
    /// further bounce gets an eighth.
    pub ambient_divisions: u32,
    /// Longest chain of mirror, glass and glossy hits.
    pub max_depth: u32,
    /// Irradiance cache. `None` gathers indirect light at every hit.
    pub cache: Option<CacheSettings>,
    /// Replacement of all materials.
    pub materials: MaterialMode,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Quality of an irradiance cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct CacheSettings {
    /// Allowed interpolation error in thousandths, by the split-sphere bound of Ward, Rubinstein and Clear
    /// 1988: a record is used up to this fraction of the harmonic mean distance to its surroundings. Above
    /// 0.3, the densest records also lie farther apart. Above 0.4, only they do.
    pub accuracy: u32,
    /// Rays per record: nearest of 48, 192, 432, 768, 1200, … Each further bounce uses a quarter, at least
    /// 48. Directions of bright places get more, up to five times as many in all.
    pub rays: u32,
}

/// Number of rays of the gathers at points that no cache record covers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UncoveredGathers {
    /// In the first camera sample of a pixel. The n-th sample uses an n-th of it.
    pub first: u32,
    /// Minimum in every sample, at least 1.
    pub least: u32,
}

impl UncoveredGathers {
    /// Rays of a gather in the n-th camera sample of a pixel, counted from 1.
    pub fn of_sample(self, n: u32) -> u32 {
        (self.first / n.max(1)).max(self.least)
    }
}

impl CacheSettings {
    /// Number of rays at uncovered points. The first sample uses a quarter of a record's rays at accuracy
    /// 200, and proportionally more at finer accuracies, up to the rays of a record. With few samples, these
    /// points would otherwise cause most of the error. Images with 16 to 64 samples have the smallest error
    /// for their work with 2 to 8 rays.
    pub fn uncovered(self) -> UncoveredGathers {
        let part = u64::from(self.rays) * 50 / u64::from(self.accuracy.max(1));
        UncoveredGathers { first: (part.min(u64::from(self.rays)) as u32).max(24), least: 4 }
    }
}

impl Default for CacheSettings {
    fn default() -> Self {
        Self { accuracy: 200, rays: 768 }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            width: 640,
            height: 360,
            spp: 4,
            integrator: Integrator::Ambient,
            ambient_bounces: 1,
            ambient_divisions: 32,
            max_depth: 12,
            cache: None,
            materials: MaterialMode::Full,
            seed: 0,
        }
    }
}

impl From<&RenderSettings> for Settings {
    fn from(settings: &RenderSettings) -> Self {
        let &RenderSettings { cache_accuracy: accuracy, cache_rays: rays, .. } = settings;
        Self {
            width: settings.width,
            height: settings.height,
            spp: settings.spp,
            integrator: settings.integrator,
            ambient_bounces: settings.ambient_bounces,
            ambient_divisions: settings.ambient_divisions,
            max_depth: settings.max_depth,
            cache: (settings.cache == CacheMode::On).then_some(CacheSettings { accuracy, rays }),
            materials: settings.materials,
            seed: settings.seed,
        }
    }
}

impl From<&Settings> for RenderSettings {
    fn from(settings: &Settings) -> Self {
        let CacheSettings { accuracy, rays } = settings.cache.unwrap_or_default();
        Self {
            width: settings.width,
            height: settings.height,
            spp: settings.spp,
            integrator: settings.integrator,
            ambient_bounces: settings.ambient_bounces,
            ambient_divisions: settings.ambient_divisions,
            max_depth: settings.max_depth,
            cache: if settings.cache.is_some() { CacheMode::On } else { CacheMode::Off },
            cache_accuracy: accuracy,
            cache_rays: rays,
            materials: settings.materials,
            seed: settings.seed,
        }
    }
}

impl Settings {
    /// Checks every setting (see [`RenderSettings::check`]) and returns the first wrong one.
    pub fn validate(&self) -> Result<(), BadSetting> {
        RenderSettings::from(self).check()
    }
}
