//! Quotes: the cost of frames and jobs, as distributions.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ByClass, CacheQuote, FixedCosts, JobSettings, LeftOut, MoneyQuantiles, NodeCalibration, ProcessCosts,
    Quantiles, RendererRequest, SceneDigest,
};

/// Forecast numbers of rays, by category.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct RayQuantiles {
    /// Camera rays.
    pub primary: Quantiles,
    /// Rays towards lights.
    pub shadow: Quantiles,
    /// Rays that continue straight through thin glass and cut-outs.
    pub transparent: Quantiles,
    /// Rays reflected by perfect mirrors.
    pub reflected: Quantiles,
    /// Rays into and out of solid glass.
    pub refracted: Quantiles,
    /// Rays that gather indirect light.
    pub ambient: Quantiles,
    /// Rays reflected by glossy surfaces.
    pub specular: Quantiles,
}

impl RayQuantiles {
    /// The forecasts in the order of [`crate::Rays::NAMES`].
    pub const fn to_array(&self) -> [Quantiles; 7] {
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

    /// The forecasts from an array in the order of [`crate::Rays::NAMES`].
    pub const fn from_array(rays: [Quantiles; 7]) -> Self {
        let [primary, shadow, transparent, reflected, refracted, ambient, specular] = rays;
        Self { primary, shadow, transparent, reflected, refracted, ambient, specular }
    }
}

/// Forecast of one frame.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameForecast {
    /// Frame number.
    pub frame: u32,
    /// Rays by category.
    pub rays: RayQuantiles,
    /// Number of irradiance cache records, by level. Known once the cache is planned. Empty without a cache.
    pub cache_records: Vec<Quantiles>,
    /// Deterministic count of operations.
    pub work: Quantiles,
    /// CPU seconds over all threads, on a node of speed 1.
    pub cpu_seconds: Quantiles,
}

impl FrameForecast {
    /// The numbers of records of a frame's irradiance cache, as a forecast of known values.
    pub fn known_records(records: &[u32]) -> Vec<Quantiles> {
        records.iter().map(|&count| Quantiles::known(count.into())).collect()
    }
}

/// Forecast of all frames together. These are quantiles of sums, not sums of quantiles.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct ForecastTotals {
    /// Rays by category.
    pub rays: RayQuantiles,
    /// Number of irradiance cache records, by level.
    pub cache_records: Vec<Quantiles>,
    /// Deterministic count of operations.
    pub work: Quantiles,
    /// CPU seconds over all threads, on a node of speed 1.
    pub cpu_seconds: Quantiles,
}

impl ForecastTotals {
    /// The sums of the numbers of records of all frames' irradiance caches, as a forecast of known values.
    pub fn known_records<'a>(frames: impl IntoIterator<Item = &'a [u32]>) -> Vec<Quantiles> {
        let mut levels: Vec<u64> = Vec::new();
        for records in frames {
            levels.resize(levels.len().max(records.len()), 0);
            levels.iter_mut().zip(records).for_each(|(sum, &count)| *sum += u64::from(count));
        }
        levels.into_iter().map(|count| Quantiles::known(count as f64)).collect()
    }
}

/// The frames and pixels that were profiled.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct Profiled {
    /// The profiled frames, ascending.
    pub frames: Vec<u32>,
    /// Number of profiled pixels, over all profiled frames.
    pub pixels: u64,
}

/// What a job takes of the farm's storage until it is deleted. See `GET /v1/retention`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct StorageForecast {
    /// Bytes of images, cost maps and previews of all frames: measured on the profiled frames. An image that is
    /// written elsewhere takes its bytes there once more.
    pub file_bytes: u64,
    /// Bytes of rows in the database, for all frames.
    pub database_bytes: u64,
}

/// Cost of making the quote: previews and profiling.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct SpentOnForecast {
    /// Deterministic count of operations.
    pub work: u64,
    /// CPU seconds.
    pub cpu_seconds: f64,
    /// `work` divided by the forecast's mean total work.
    pub fraction_of_forecast: f64,
}

/// The quote of a job: the output of `forelight forecast --json` and of `GET /v1/jobs/{id}/forecast`.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ForecastDoc {
    /// The scene and settings that are quoted. Absent in quotes of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<QuotedShot>,
    /// One forecast per frame, ascending.
    pub frames: Vec<FrameForecast>,
    /// Forecast of all frames together.
    pub total: ForecastTotals,
    /// The profiled frames and pixels behind the quote.
    pub profiled: Profiled,
    /// Cost of making the quote.
    pub spent: SpentOnForecast,
    /// Whether the quantiles were calibrated on past jobs. If not, only sampling statistics support them.
    pub calibrated: bool,
    /// Names of the effects that any profiled frame needs, sorted. Only these are simulated and paid for.
    #[serde(default)]
    pub effects: Vec<String>,
    /// Lights and objects that provably do not affect the profiled frames. They are not simulated.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Camera samples per pixel chosen for the job's limit (`within`) or its `error_target`; of the latter, the
    /// mean of the profiled frames. Absent without either. A frame uses about the work of this many, and puts
    /// them where they reduce the image's error most.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chosen_spp: Option<u32>,
    /// Mean cost per frame that does not depend on its pixels, at speed 1. Included in the forecasts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixed: Option<FixedCosts>,
    /// Cost that every process pays once per shot, at speed 1. Not included in the frames or the total.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub once: Option<ProcessCosts>,
    /// Work of the profiled frames by class. With a node's calibration, it gives the time on that node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work_by_class: Option<ByClass>,
    /// CPU seconds of all frames on at most 20 particular nodes: calibrated ones of the farm, or the
    /// requested one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cpu_seconds_on: Vec<NodeSeconds>,
    /// How the irradiance caches are made: shared or per frame. Absent without caches, and with a limit
    /// or an error target, where each frame makes its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<CacheQuote>,
    /// Total cost at the mean price of the farm's nodes, with a shared cache. Absent without nodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<MoneyQuantiles>,
    /// What the job takes of the farm's storage. Absent with renderers whose files are not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub storage: Option<StorageForecast>,
}

/// The scene and settings of a quote.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct QuotedShot {
    /// Hash of the scene's files.
    pub scene: SceneDigest,
    /// The renderer. Absent for forelight's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub renderer: Option<RendererRequest>,
    /// Settings of all frames.
    pub settings: JobSettings,
}

/// CPU time of a job on one node.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeSeconds {
    /// Name of the node.
    pub node: String,
    /// Speed of one of its cores for this job's mix of work, relative to the reference core.
    pub speed: f64,
    /// CPU seconds over all threads.
    pub cpu_seconds: Quantiles,
}

impl NodeSeconds {
    /// Largest number of nodes in a quote.
    pub const MOST: usize = 20;

    /// The CPU time on a node of speed `speed`, given that on a node of speed 1.
    pub fn new(node: String, speed: f64, at_one: &Quantiles) -> Self {
        let Quantiles { mean, p50, p80, p95 } = *at_one;
        let cpu_seconds =
            Quantiles { mean: mean / speed, p50: p50 / speed, p80: p80 / speed, p95: p95 / speed };
        Self { node, speed, cpu_seconds }
    }

    /// The quote on another machine, from the calibrations of the quote's machine (`here`) and of that one
    /// (`there`). `None` if the quote has no work by class.
    pub fn carried(
        quote: &ForecastDoc,
        node: String,
        here: &NodeCalibration,
        there: &NodeCalibration,
    ) -> Option<Self> {
        let work = quote.work_by_class?;
        let (here, there) = (here.speed(&work)?, there.speed(&work)?);
        let Quantiles { mean, p50, p80, p95 } = quote.total.cpu_seconds;
        let at_one = Quantiles { mean: mean * here, p50: p50 * here, p80: p80 * here, p95: p95 * here };
        Some(Self::new(node, there, &at_one))
    }
}
