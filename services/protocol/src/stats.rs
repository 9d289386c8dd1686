//! What a frame took.

use crate::{ByClass, ImageError, Money, ProcessCosts, Quantiles};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One number for each kind of ray, by what sends it out: how many there are, or what they take.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Rays {
    /// From the camera.
    pub primary: u64,
    /// Towards lights.
    pub shadow: u64,
    /// Straight on through thin glass and cut-outs.
    pub transparent: u64,
    /// Off perfect mirrors.
    pub reflected: u64,
    /// Into and out of solid glass.
    pub refracted: u64,
    /// Ambient gathers.
    pub ambient: u64,
    /// Off glossy surfaces.
    pub specular: u64,
}

impl Rays {
    /// The names of the categories, in the order of [`Rays::to_array`].
    pub const NAMES: [&'static str; 7] =
        ["primary", "shadow", "transparent", "reflected", "refracted", "ambient", "specular"];

    /// The numbers in the order of [`Rays::NAMES`].
    pub const fn to_array(self) -> [u64; 7] {
        [
            self.primary,
            self.shadow,
            self.transparent,
            self.reflected,
            self.refracted,
            self.ambient,
            self.specular,
        ]
    }

    /// The numbers from an array in the order of [`Rays::NAMES`].
    pub const fn from_array(rays: [u64; 7]) -> Self {
        let [primary, shadow, transparent, reflected, refracted, ambient, specular] = rays;
        Self { primary, shadow, transparent, reflected, refracted, ambient, specular }
    }

    /// All rays.
    pub fn total(self) -> u64 {
        self.to_array().into_iter().fold(0, u64::saturating_add)
    }
}

/// A light or an object that cannot matter to an image.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LeftOut {
    /// What it is, by name or number.
    pub what: String,
    /// Why it does not matter.
    pub reason: String,
}

impl LeftOut {
    /// Entries of one frame, at most; the last of so many stands for all that follow.
    pub const MOST: usize = 100;

    /// What is left out of all of several frames: of those that the first one leaves out, in its order.
    pub fn of_all<'a>(frames: impl IntoIterator<Item = &'a [Self]>) -> Vec<Self> {
        let mut frames = frames.into_iter();
        let Some(first) = frames.next() else { return Vec::new() };
        frames.fold(first.to_vec(), |kept, frame| {
            kept.into_iter().filter(|left| frame.contains(left)).collect()
        })
    }
}

/// What an irradiance cache took and came to.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheStats {
    /// Work of planning: finding out where records have to be, and how far each is valid.
    pub plan_work: u64,
    /// Work of gathering all records.
    pub fill_work: u64,
    /// Records whose numbers are not finite, and which are never used.
    pub rejected: u64,
    /// Points at which no record could be used, and which gathered for themselves.
    pub uncovered: u64,
    /// Records that were taken over from profiling.
    pub reused_records: u64,
    /// Records of the shot's cache that hold in this frame; their cost is the shot's, not the frame's.
    #[serde(default)]
    pub shared_records: u64,
    /// Records of the shot's cache whose light has changed by what moved, and which were dropped.
    #[serde(default)]
    pub dropped_records: u64,
    /// Records that the frame has beyond those of the shot's cache: all of them, if it was given none.
    #[serde(default)]
    pub own_records: u64,
}

/// The true cost of one rendered frame, as `forelight render --stats` writes it.
///
/// All totals are those of the whole frame and do not depend on whether profiled pixels were taken over; the
/// `reused_…` fields are the part of them that this run did not have to trace again. The cost of an irradiance cache,
/// planned and filled, is in them.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderStats {
    /// Frame number.
    pub frame: u32,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Camera paths per pixel; where they differ by pixel, their mean, rounded.
    pub spp: u32,
    /// How camera paths were allotted; absent where all pixels have equally many.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub allotted: Option<Box<AllottedStats>>,
    /// The effects that the frame called for, by name, sorted.
    pub effects: Vec<String>,
    /// Lights and objects that cannot matter to the image, and took no rays.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Rays by category.
    pub rays: Rays,
    /// Irradiance cache records, one number a level; empty without a cache.
    #[serde(default)]
    pub cache_records: Vec<u64>,
    /// What the irradiance cache took; absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<CacheStats>,
    /// Deterministic count of operations.
    pub work: u64,
    /// The same by class, as far as it was traced here: what was taken over is thought to be of the same classes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work_by_class: Option<ByClass>,
    /// The same by the ray that brought it about, with what is done where the ray ends. Everything that comes of gathered rays is
    /// ambient, and so is the irradiance cache: what would not be there without indirect light. What belongs to no ray (loading, building the tree)
    /// is missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work_by_ray: Option<Rays>,
    /// CPU time over all threads, in seconds. On the farm also that of encoding the pictures and of the preview among them.
    pub cpu_seconds: f64,
    /// What the process has paid once for the shot: not in the work and the CPU time of any frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub once: Option<ProcessCosts>,
    /// Seconds that this run took, from start to end.
    pub wall_seconds: f64,
    /// Largest resident memory of the process, in bytes; 0 where the system does not say.
    pub peak_rss_bytes: u64,
    /// Pixels taken over from profiling.
    #[serde(default)]
    pub reused_pixels: u64,
    /// Rays of these pixels, and of what was taken over of the irradiance cache.
    #[serde(default)]
    pub reused_rays: u64,
    /// Work of the same.
    #[serde(default)]
    pub reused_work: u64,
    /// CPU seconds of the same when they were profiled.
    #[serde(default)]
    pub reused_cpu_seconds: f64,
}

/// Camera paths that differ by pixel, for a time, an amount of work or an error that was asked for, and what they come to.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AllottedStats {
    /// Fewest camera paths of a pixel.
    pub least: u32,
    /// Most of a pixel.
    pub most: u32,
    /// Mean over the pixels.
    pub mean: f64,
    /// Error of the image, as its own pixels say, without what an irradiance cache adds.
    pub error: ImageError,
    /// What was forecast for these camera paths; absent where no pixels were profiled for them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub forecast: Option<AllottedForecast>,
    /// How it held to its time; absent where none was given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within: Option<WithinStats>,
}

/// What a frame whose camera paths differ by pixel is to take.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AllottedForecast {
    /// Work of the frame.
    pub work: Quantiles,
    /// CPU seconds of the same, without those of profiling.
    pub cpu_seconds: Quantiles,
    /// Work of the pixels that were profiled for it, and of previews; not in the frame's.
    pub profiling_work: u64,
    /// CPU seconds of the same.
    pub profiling_cpu_seconds: f64,
}

/// Which seconds a time counts.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BudgetClock {
    /// Wall time, as whoever waits sees it.
    Wall,
    /// CPU time of all threads.
    Cpu,
}

/// How a render held to the time that it was given.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WithinStats {
    /// Whose seconds these are.
    pub clock: BudgetClock,
    /// Seconds that it was given.
    pub given_seconds: f64,
    /// Seconds that it took: everything from the start to the written image.
    pub spent_seconds: f64,
    /// Passes in which the samples were given.
    pub passes: u32,
    /// What that costs, where a price was given, in micro-units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<Money>,
}
