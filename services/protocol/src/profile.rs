//! What a profile says: pixels that were traced to the end, each with what it took.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{AccuracyDoc, ArtifactHash, ByClass, LeftOut, Spent, Stratum};

/// One profiled pixel.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileSample {
    /// The pixel: row × width + column, from the top left.
    pub pixel: u32,
    /// Index into [`ProfileResult::strata`]; the number of strata stands for the background.
    pub stratum: u32,
    /// Deterministic count of operations of all its camera paths.
    pub work: u64,
    /// The part of `work` that is not in proportion to the camera samples, see [`UncoveredGathers`].
    #[serde(default, skip_serializing_if = "is_zero")]
    pub extra_work: u64,
    /// `work` by the ray that brought it about, as in [`crate::RenderStats::work_by_ray`], in the order of [`crate::Rays::NAMES`]; all 0 if that is
    /// not known.
    #[serde(default)]
    #[schema(min_items = 7, max_items = 7)]
    pub work_by_ray: [u64; 7],
    /// CPU time of all its camera paths, in nanoseconds.
    pub cpu_nanos: u64,
    /// Rays by category, in the order of [`crate::Rays::NAMES`].
    #[schema(min_items = 7, max_items = 7)]
    pub rays: [u64; 7],
}

fn is_zero(work: &u64) -> bool {
    *work == 0
}

fn is_false(value: &bool) -> bool {
    !value
}

/// Rays of a gather where the irradiance cache has no record: an n-th of `first` in the n-th camera sample of a pixel, but at least
/// `least`. What they take above the least is what a pixel's cost has that is not in proportion to its samples.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct UncoveredGathers {
    /// In the first camera sample.
    pub first: u32,
    /// In any.
    #[schema(minimum = 1)]
    pub least: u32,
}

impl UncoveredGathers {
    /// How many times as many rays above the least there are in `to` samples as in `from`; 1 where there are none.
    pub fn growth(self, from: u32, to: u32) -> f64 {
        let [from, to] = [from, to].map(|samples| self.above_the_least(samples) as f64);
        if from > 0.0 { to / from } else { 1.0 }
    }

    fn above_the_least(self, samples: u32) -> u64 {
        let least = self.least.max(1);
        // No later sample has any.
        let last = samples.min(self.first / least);
        (1..=last).map(|n| u64::from((self.first / n).saturating_sub(least))).sum()
    }
}

/// What a profiled pixel costs if the frame shares its irradiance cache with others: there are more records to look at.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SharedSample {
    /// Deterministic count of operations of all its camera paths.
    pub work: u64,
    /// The part of `work` that is not in proportion to the camera samples, see [`UncoveredGathers`].
    #[serde(default, skip_serializing_if = "is_zero")]
    pub extra_work: u64,
    /// CPU time of all its camera paths, in nanoseconds.
    pub cpu_nanos: u64,
    /// Rays by category, in the order of [`crate::Rays::NAMES`].
    #[schema(min_items = 7, max_items = 7)]
    pub rays: [u64; 7],
}

/// One record of the irradiance cache, gathered and averaged with others to see what that takes.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheSample {
    /// Level of the record: 0 is read by the image, each further one by the gathers of the one before.
    pub level: u32,
    /// Whether it is one that the frame gathers itself beside the cache that it shares: such records lie around what moves, and cost otherwise.
    #[serde(default, skip_serializing_if = "is_false")]
    pub own: bool,
    /// Deterministic count of operations.
    pub work: u64,
    /// CPU time, in nanoseconds.
    pub cpu_nanos: u64,
    /// Rays by category, in the order of [`crate::Rays::NAMES`].
    #[schema(min_items = 7, max_items = 7)]
    pub rays: [u64; 7],
}

/// What the camera samples of one profiled pixel say of its error.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NoiseSample {
    /// Mean of the samples and of their three linear channels.
    pub brightness: f32,
    /// Estimates of V(1) − V(2), V(2) − V(4), V(4) − V(8), …, where V(n) is the variance of the mean of n camera samples, mean over
    /// channels: as many as the number of samples can be halved. None is negative.
    #[schema(max_items = 32)]
    pub drops: Vec<f32>,
}

/// Pixels of a frame that are alike, and some of them with what their samples say.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NoiseCell {
    /// How many pixels there are.
    pub pixels: u32,
    /// Some of them, all alike likely.
    pub samples: Vec<NoiseSample>,
}

/// Costs that a frame has whatever its pixels show.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FixedCosts {
    /// Setting up the frame: moving what moves in it.
    pub load: Spent,
    /// Building the acceleration structure.
    pub build: Spent,
    /// Planning the irradiance cache, and reading the one that is shared, if there is one; 0 without.
    #[serde(default)]
    pub plan: Spent,
    /// Rays of the plan by category, in the order of [`crate::Rays::NAMES`].
    #[serde(default)]
    #[schema(min_items = 7, max_items = 7)]
    pub plan_rays: [u64; 7],
    /// Making the files of a finished frame: encoding its pictures, and the preview among them. In time alone: work counts
    /// tracing. All 0 where no such files are made.
    pub write: Spent,
}

impl FixedCosts {
    /// All but building the acceleration structure, which depends on how many triangles a frame has.
    pub const fn without_build(self) -> Spent {
        let Self { load, build: _, plan, plan_rays: _, write } = self;
        load.plus(plan).plus(write)
    }

    /// All but planning the irradiance cache.
    #[must_use]
    pub fn without_plan(self) -> Self {
        Self { plan: Spent::default(), plan_rays: [0; 7], ..self }
    }

    /// All of them together.
    pub const fn total(self) -> Spent {
        let Self { load, build, plan, plan_rays: _, write } = self;
        load.plus(build).plus(plan).plus(write)
    }

    /// The mean of some; none of none.
    pub fn mean(all: &[Self]) -> Option<Self> {
        let mean = |of: fn(&Self) -> Spent| Spent::mean(all.iter().map(of));
        Some(Self {
            load: mean(|fixed| fixed.load)?,
            build: mean(|fixed| fixed.build)?,
            plan: mean(|fixed| fixed.plan)?,
            plan_rays: std::array::from_fn(|kind| {
                all.iter().map(|fixed| fixed.plan_rays[kind]).sum::<u64>() / all.len() as u64
            }),
            write: mean(|fixed| fixed.write)?,
        })
    }

    /// The same on a node of speed 1, of what a node of this speed measured.
    #[must_use]
    pub fn at_speed_one(self, speed: f64) -> Self {
        let on = |spent: Spent| spent.at_speed_one(speed);
        let Self { load, build, plan, plan_rays, write } = self;
        Self { load: on(load), build: on(build), plan: on(plan), plan_rays, write: on(write) }
    }
}

/// What each process pays once that renders frames of a shot: in no frame's cost, and in no total.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProcessCosts {
    /// Reading the bundle. In time alone: work counts tracing.
    pub load: Spent,
    /// Building the acceleration structure, if nothing moves in the shot and so its frames share one (or several, one after the other, where the camera
    /// goes from one closed room to the next); 0 if each frame is charged for its own.
    pub build: Spent,
}

impl ProcessCosts {
    /// The mean of some; none of none.
    pub fn mean(all: &[Self]) -> Option<Self> {
        let mean = |of: fn(&Self) -> Spent| Spent::mean(all.iter().map(of));
        Some(Self { load: mean(|once| once.load)?, build: mean(|once| once.build)? })
    }

    /// The same on a node of speed 1, if a node of this speed measured it.
    #[must_use]
    pub fn at_speed_one(self, speed: f64) -> Self {
        Self { load: self.load.at_speed_one(speed), build: self.build.at_speed_one(speed) }
    }
}

/// CPU time on a node of speed 1, of what a node of this speed measured; nanoseconds.
pub fn at_speed_one(cpu_nanos: u64, speed: f64) -> u64 {
    // Saturates at the ends of the range, as float to integer does.
    (cpu_nanos as f64 * speed).round() as u64
}

/// The artefacts of a profile.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileArtifacts {
    /// The finished pixels with their radiance and counters, or the irradiance cache as far as it was gathered, for the render to
    /// take over.
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
    /// The strata that the samples refer to, each once. Matched with the preview's by identity: the order may differ.
    pub strata: Vec<Stratum>,
    /// The profiled pixels, each once.
    pub samples: Vec<ProfileSample>,
    /// Gathers at points that the frame's irradiance cache does not cover; none without a cache.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncovered: Option<UncoveredGathers>,
    /// What each of these pixels costs with the cache that the task names, in their order; empty if it names none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shared_samples: Vec<SharedSample>,
    /// Records of the irradiance cache that were gathered, some of every level; empty without a cache.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cache_samples: Vec<CacheSample>,
    /// The same of the cache that the task names: the gathers of one level look at the records of the next, of which there are more.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shared_cache_samples: Vec<CacheSample>,
    /// What the profiled pixels say of the image's error, by what they show: all pixels of the frame are in one of the cells. Empty
    /// with an irradiance cache, for it is not filled yet, and where too few camera samples were taken to tell.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub noise: Vec<NoiseCell>,
    /// The effects that the frame calls for, by name, sorted.
    #[serde(default)]
    pub effects: Vec<String>,
    /// Lights and objects that cannot matter to the frame's image.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// The renderer that measured all this, with its version: what it took is compared with that of the same alone. At most 200 characters;
    /// if it is left out, nothing is learnt from the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(max_length = 200)]
    pub renderer: Option<String>,
    /// What the frame's work is thought to be, by class: that of the profiled pixels and records, brought to all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work_by_class: Option<ByClass>,
    /// Costs beside the pixels.
    pub fixed: FixedCosts,
    /// What the process had paid once for the shot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub once: Option<ProcessCosts>,
    /// The ladders of this frame that its samples do not tell by themselves, and of those the rung that was asked for, if the task asks for them. None
    /// but the reason, if they could not be laid out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ladders: Option<Box<AccuracyDoc>>,
    /// What the whole task took.
    pub spent: Spent,
    /// Its artefacts.
    pub artifacts: ProfileArtifacts,
}

impl ProfileResult {
    /// Work of setting the frame up and tracing its pixels: all but what is done for other qualities, and for its irradiance cache, whose plan was
    /// needed to count its records, and which its render takes over.
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
