//! Actual cost of rendered frames.

use crate::{ByClass, ImageError, LeftOut, Money, ProcessCosts, Quantiles};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One number per category of rays: how many there are, or what they cost.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Rays {
    /// Camera rays.
    pub primary: u64,
    /// Rays towards lights.
    pub shadow: u64,
    /// Rays that continue straight through thin glass and cut-outs.
    pub transparent: u64,
    /// Rays reflected by perfect mirrors.
    pub reflected: u64,
    /// Rays into and out of solid glass.
    pub refracted: u64,
    /// Rays that gather indirect light.
    pub ambient: u64,
    /// Rays reflected by glossy surfaces.
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

    /// Sum over all categories. Saturating.
    pub fn total(self) -> u64 {
        self.to_array().into_iter().fold(0, u64::saturating_add)
    }
}

/// Cost and contents of an irradiance cache.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheStats {
    /// Work of planning: finding where records are needed, and how far each is valid.
    pub plan_work: u64,
    /// Work of gathering all records.
    pub fill_work: u64,
    /// Number of records with values that are not finite. They are never used.
    pub rejected: u64,
    /// Number of points without a usable record. They gathered their own light.
    pub uncovered: u64,
    /// Number of records taken over from profiling.
    pub reused_records: u64,
    /// Number of records of the shared cache that are valid here. Their cost is not part of the frame.
    #[serde(default)]
    pub shared_records: u64,
    /// Number of records of the shared cache that were dropped, because something moved.
    #[serde(default)]
    pub dropped_records: u64,
    /// Number of records that the frame made itself: those missing in the shared cache, or all without one.
    #[serde(default)]
    pub own_records: u64,
    /// Number of secondary lights: small bright places that every point samples, because they cast shadows with
    /// edges.
    #[serde(default, skip_serializing_if = "crate::is_zero")]
    pub secondary_lights: u64,
}

/// Settings of an irradiance cache that were chosen for an error, by `--cache-error`.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CacheChoice {
    /// Allowed error of interpolation, in thousandths.
    pub cache_accuracy: u32,
    /// Rays of a record.
    pub cache_rays: u32,
    /// Forecast of the error that the cache leaves: a root mean square over blocks of 4 × 4 pixels, as a share of
    /// the image's mean.
    pub error: f64,
    /// CPU seconds of the choice. Not included in those of any frame.
    pub cpu_seconds: f64,
}

/// Actual cost of a rendered frame, as written by `forelight render --stats`. Totals do not depend on reuse
/// of profiled pixels; `reused_…` is the part that this run did not trace. Totals include an irradiance
/// cache.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderStats {
    /// Frame number.
    pub frame: u32,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Camera samples per pixel. If they differ by pixel, the rounded mean.
    pub spp: u32,
    /// How camera samples were distributed over the pixels. Absent if all pixels have the same number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub allotted: Option<Box<AllottedStats>>,
    /// How the noise of the image was removed. Absent if it was not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub denoised: Option<DenoisedStats>,
    /// Names of the effects that the frame needed, sorted.
    pub effects: Vec<String>,
    /// Lights and objects that provably do not affect the image. No rays were traced for them.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Rays by category.
    pub rays: Rays,
    /// Number of irradiance cache records by level. Empty without a cache.
    #[serde(default)]
    pub cache_records: Vec<u64>,
    /// Cost of the irradiance cache. Absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<CacheStats>,
    /// How the settings of the cache were chosen. Absent if they were given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache_choice: Option<CacheChoice>,
    /// Deterministic count of operations.
    pub work: u64,
    /// `work` by class. Reused work is divided in the proportions of this run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work_by_class: Option<ByClass>,
    /// `work` by the category of the ray that caused it. Gathered rays and the irradiance cache count as
    /// ambient. Loading and building are not included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work_by_ray: Option<Rays>,
    /// CPU time over all threads, in seconds. It includes removing the noise and measuring what is left of it. On
    /// the farm it also includes encoding the pictures and the preview.
    pub cpu_seconds: f64,
    /// Costs that the process paid once for the shot. Not included in the work and CPU time of any frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub once: Option<ProcessCosts>,
    /// Wall time of this run in seconds.
    pub wall_seconds: f64,
    /// Peak resident memory of the process in bytes. 0 if the system does not report it.
    pub peak_rss_bytes: u64,
    /// Number of pixels taken over from profiling.
    #[serde(default)]
    pub reused_pixels: u64,
    /// Rays of everything taken over: these pixels, and records of the irradiance cache.
    #[serde(default)]
    pub reused_rays: u64,
    /// Work of everything taken over.
    #[serde(default)]
    pub reused_work: u64,
    /// CPU seconds of everything taken over, measured when it was profiled.
    #[serde(default)]
    pub reused_cpu_seconds: f64,
}

/// A frame whose noise was removed, and the error that is left. It is measured: some pixels are traced again
/// with many camera samples. Errors of an irradiance cache are not in it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DenoisedStats {
    /// The denoiser and its version.
    pub by: String,
    /// Error of the denoised image. Its interval is that of the measurement.
    pub error: ImageError,
    /// Error of the image before, at the same pixels.
    pub noisy: ImageError,
    /// Number of pixels that were measured.
    pub measured_pixels: u64,
    /// Camera samples by which each of them was measured.
    pub measured_samples: u32,
    /// CPU seconds of the denoiser. They are part of the frame's CPU time, as the next two.
    pub denoiser_cpu_seconds: f64,
    /// CPU seconds of tracing what the pixels show, for the denoiser.
    pub features_cpu_seconds: f64,
    /// CPU seconds of measuring the error.
    pub measuring_cpu_seconds: f64,
}

impl DenoisedStats {
    /// CPU seconds of all of it.
    pub fn cpu_seconds(&self) -> f64 {
        self.denoiser_cpu_seconds + self.features_cpu_seconds + self.measuring_cpu_seconds
    }
}

/// Camera samples that differ by pixel, to meet a requested time, amount of work or error.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AllottedStats {
    /// Fewest camera samples of a pixel.
    pub least: u32,
    /// Most camera samples of a pixel.
    pub most: u32,
    /// Mean camera samples per pixel.
    pub mean: f64,
    /// Error of the image, estimated from its own pixels, without that of an irradiance cache.
    pub error: ImageError,
    /// Forecast for these camera samples. Absent if no pixels were profiled for them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub forecast: Option<AllottedForecast>,
    /// How the render kept to its time limit. Absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within: Option<WithinStats>,
}

/// Forecast of a frame with camera samples that differ by pixel.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AllottedForecast {
    /// Work of the frame.
    pub work: Quantiles,
    /// CPU seconds of the frame, without profiling.
    pub cpu_seconds: Quantiles,
    /// Work of profiling and previews for the forecast. Not part of the frame's work.
    pub profiling_work: u64,
    /// CPU seconds of profiling and previews.
    pub profiling_cpu_seconds: f64,
}

/// The clock of a time limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BudgetClock {
    /// Wall time.
    Wall,
    /// CPU time over all threads.
    Cpu,
}

/// How a render kept to its time limit.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WithinStats {
    /// The clock of the limit.
    pub clock: BudgetClock,
    /// The limit in seconds.
    pub given_seconds: f64,
    /// Seconds used, from the start to the written image.
    pub spent_seconds: f64,
    /// Number of passes over the image.
    pub passes: u32,
    /// Cost of that time in micro-units. Absent without a price.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<Money>,
}
