//! Result of a profile: pixels that were traced completely, with the cost of each.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    AccuracyDoc, ArtifactHash, ByClass, FixedCosts, LeftOut, ProcessCosts, SamplesForError, Spent, Stratum,
};

/// One profiled pixel.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileSample {
    /// Index of the pixel in row order from the top left: row × width + column.
    pub pixel: u32,
    /// Index into `strata` of the profile's result. The number of strata stands for the background.
    pub stratum: u32,
    /// Work of all its camera paths: deterministic count of operations.
    pub work: u64,
    /// The part of `work` that is not proportional to the camera samples, see `UncoveredGathers`.
    #[serde(default, skip_serializing_if = "crate::is_zero")]
    pub extra_work: u64,
    /// `work` by category of ray, as in `RenderStats`: primary, shadow, transparent, reflected, refracted,
    /// ambient, specular. All 0 if unknown.
    #[serde(default)]
    #[schema(min_items = 7, max_items = 7)]
    pub work_by_ray: [u64; 7],
    /// CPU time of all its camera paths, in nanoseconds.
    pub cpu_nanos: u64,
    /// Rays by category: primary, shadow, transparent, reflected, refracted, ambient, specular.
    #[schema(min_items = 7, max_items = 7)]
    pub rays: [u64; 7],
}

fn is_false(value: &bool) -> bool {
    !value
}

/// Number of rays gathered at a point without an irradiance cache record. The n-th camera sample of a pixel
/// gathers `first` / n rays, at least `least`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct UncoveredGathers {
    /// Rays in the first camera sample.
    pub first: u32,
    /// Least number of rays in any camera sample.
    #[schema(minimum = 1)]
    pub least: u32,
}

impl UncoveredGathers {
    /// Number of rays above the least with `to` camera samples, over that with `from`. 1 if there are none.
    pub fn growth(self, from: u32, to: u32) -> f64 {
        let [from, to] = [from, to].map(|samples| self.above_the_least(samples) as f64);
        if from > 0.0 { to / from } else { 1.0 }
    }

    fn above_the_least(self, samples: u32) -> u64 {
        let least = self.least.max(1);
        // Later samples have none.
        let last = samples.min(self.first / least);
        (1..=last).map(|n| u64::from((self.first / n).saturating_sub(least))).sum()
    }
}

/// Cost of a profiled pixel with a shared irradiance cache, which has more records to look up.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SharedSample {
    /// Work of all its camera paths: deterministic count of operations.
    pub work: u64,
    /// The part of `work` that is not proportional to the camera samples, see `UncoveredGathers`.
    #[serde(default, skip_serializing_if = "crate::is_zero")]
    pub extra_work: u64,
    /// CPU time of all its camera paths, in nanoseconds.
    pub cpu_nanos: u64,
    /// Rays by category: primary, shadow, transparent, reflected, refracted, ambient, specular.
    #[schema(min_items = 7, max_items = 7)]
    pub rays: [u64; 7],
}

/// Measured cost of one irradiance cache record: gathering it and averaging it with others.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheSample {
    /// Level of the record. The image reads level 0; the gathers of each level read the next one.
    pub level: u32,
    /// Whether the frame gathers it in addition to the shared cache. Such records are near moving things.
    #[serde(default, skip_serializing_if = "is_false")]
    pub own: bool,
    /// Deterministic count of operations.
    pub work: u64,
    /// CPU time in nanoseconds.
    pub cpu_nanos: u64,
    /// Rays by category: primary, shadow, transparent, reflected, refracted, ambient, specular.
    #[schema(min_items = 7, max_items = 7)]
    pub rays: [u64; 7],
}

/// Noise of one pixel, from its camera samples. Weighted, where a set of pixels has two cells.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NoiseSample {
    /// Mean of the samples, over the three linear channels.
    pub brightness: f32,
    /// Estimates of V(1) − V(2), V(2) − V(4), … V(n) is the variance of the mean of n camera samples,
    /// averaged over the channels. None is negative.
    #[schema(max_items = 32)]
    pub drops: Vec<f32>,
}

/// A set of similar pixels of a frame, and the noise of some of them. Where some pixels were profiled and others
/// scanned with fewer samples, the set is two cells of half its size. The weights of their samples are such
/// that the mean over both cells is the estimate for the set.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NoiseCell {
    /// Number of pixels in the set, or in half of it.
    pub pixels: u32,
    /// Some of them, each chosen with the same probability.
    pub samples: Vec<NoiseSample>,
}

/// The artefacts of a profile.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileArtifacts {
    /// Finished pixels with radiance and counters, or the gathered irradiance cache. The render takes it
    /// over.
    pub profile: ArtifactHash,
    /// The frame's preview as an image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preview_png: Option<ArtifactHash>,
}

/// The result of a profile.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileResult {
    /// The frame.
    pub frame: u32,
    /// Strata of the samples, each once. They match the preview's by object and material, in any order.
    pub strata: Vec<Stratum>,
    /// The profiled pixels, each once.
    pub samples: Vec<ProfileSample>,
    /// Rays of gathers at points that the irradiance cache does not cover. Absent without a cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncovered: Option<UncoveredGathers>,
    /// Costs of these pixels with the task's shared cache, in the same order. Empty without one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shared_samples: Vec<SharedSample>,
    /// Irradiance cache records that were gathered, some of every level. Empty without a cache.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cache_samples: Vec<CacheSample>,
    /// The same for the task's shared cache, whose gathers look up more records.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shared_cache_samples: Vec<CacheSample>,
    /// Noise of the profiled pixels, by what they show; the cells cover the frame. Empty with an irradiance
    /// cache, and with too few camera samples.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub noise: Vec<NoiseCell>,
    /// Camera samples that reach the job's error target. Absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub samples_for_error: Option<SamplesForError>,
    /// Names of the effects that the frame needs, sorted.
    #[serde(default)]
    pub effects: Vec<String>,
    /// Lights and objects that provably do not affect the frame's image.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Renderer and version: at most 200 characters. Jobs are compared only within a renderer. If absent,
    /// nothing is learnt.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(max_length = 200)]
    pub renderer: Option<String>,
    /// Estimated work of the whole frame by class, expanded from the profiled pixels and records.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work_by_class: Option<ByClass>,
    /// Costs that do not depend on the pixels.
    pub fixed: FixedCosts,
    /// Costs that the process paid once for the shot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub once: Option<ProcessCosts>,
    /// Bytes of a frame's files, measured on an image of its size that is made of the profiled pixels. Absent if
    /// they were not measured. At most 2⁴⁰.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 1_099_511_627_776_u64)]
    pub file_bytes: Option<u64>,
    /// Ladders of other qualities in this frame, with the requested quality as one rung. Absent unless the
    /// task asks for them. If they could not be made, only the reason.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ladders: Option<Box<AccuracyDoc>>,
    /// Cost of the whole task.
    pub spent: Spent,
    /// Its artefacts.
    pub artifacts: ProfileArtifacts,
}

impl ProfileResult {
    /// Work of setting up the frame and tracing its pixels, also those for the error of its image alone. Without
    /// other qualities and the irradiance cache.
    pub fn work_on_pixels(&self) -> u64 {
        let gathered = self.cache_samples.iter().chain(&self.shared_cache_samples).map(|sample| sample.work);
        let on_ladders = self.ladders.as_ref().map_or(0, |ladders| ladders.spent.work);
        gathered
            .chain([self.fixed.plan.work, on_ladders])
            .fold(self.spent.work, |spent, part| spent.saturating_sub(part))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_above_the_least_come_to_an_end_with_the_samples() {
        let gathers = UncoveredGathers { first: 48, least: 4 };
        // 44 in the first sample, then 20, 12, 8, 5, 4, 2, 2, 1, 0, 0, 0.
        assert_eq!(gathers.growth(1, 2), 64.0 / 44.0);
        assert_eq!(gathers.growth(4, 1), 44.0 / 84.0);
        assert_eq!(gathers.growth(1, 12), gathers.growth(1, 65_536));
        assert_eq!(gathers.growth(1, 12), 98.0 / 44.0);
        assert_eq!(UncoveredGathers { first: 3, least: 4 }.growth(1, 9), 1.0);
        assert_eq!(UncoveredGathers { first: 0, least: 0 }.growth(0, 9), 1.0);
    }
}
