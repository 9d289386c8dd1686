//! Quotes: what a frame and a job will cost, as distributions.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    ByClass, CacheQuote, FixedCosts, LeftOut, Money, NodeCalibration, ProcessCosts, RenderSettings,
    SceneDigest,
};

/// A forecast of one number: its mean and the values that it stays below with probability 50, 80 and 95 %.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct Quantiles {
    /// Expected value.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 80 % quantile.
    pub p80: f64,
    /// 95 % quantile.
    pub p95: f64,
}

impl Quantiles {
    /// A number that is known: all four values alike.
    pub const fn known(value: f64) -> Self {
        Self { mean: value, p50: value, p80: value, p95: value }
    }

    /// The value at a confidence.
    pub const fn at(&self, confidence: Confidence) -> f64 {
        match confidence {
            Confidence::P50 => self.p50,
            Confidence::P80 => self.p80,
            Confidence::P95 => self.p95,
        }
    }

    /// Both together, where the same measurements are behind both: what one is off, the other is.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        let [a, b] = [self, other];
        Self { mean: a.mean + b.mean, p50: a.p50 + b.p50, p80: a.p80 + b.p80, p95: a.p95 + b.p95 }
    }

    /// What is left of it once so much is spent, never negative.
    #[must_use]
    pub fn less(&self, spent: f64) -> Self {
        let left = |amount: f64| (amount - spent).max(0.0);
        let Self { mean, p50, p80, p95 } = *self;
        Self { mean: left(mean), p50: left(p50), p80: left(p80), p95: left(p95) }
    }

    /// In money, at so many micro-units for one of what this counts.
    pub fn in_money(&self, price: f64) -> MoneyQuantiles {
        let money = |amount: f64| Money((amount * price).round() as i64);
        let Self { mean, p50, p80, p95 } = *self;
        MoneyQuantiles { mean: money(mean), p50: money(p50), p80: money(p80), p95: money(p95) }
    }
}

/// As [`Quantiles`], for money.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct MoneyQuantiles {
    /// Expected value.
    pub mean: Money,
    /// Median.
    pub p50: Money,
    /// 80 % quantile.
    pub p80: Money,
    /// 95 % quantile.
    pub p95: Money,
}

impl MoneyQuantiles {
    /// Where so much is known to be spent.
    #[must_use]
    pub fn at_least(&self, spent: Money) -> Self {
        let Self { mean, p50, p80, p95 } = *self;
        Self { mean: mean.max(spent), p50: p50.max(spent), p80: p80.max(spent), p95: p95.max(spent) }
    }

    /// With so much that is known.
    #[must_use]
    pub fn plus(&self, known: Money) -> Self {
        let sum = |amount: Money| Money(amount.0.saturating_add(known.0));
        let Self { mean, p50, p80, p95 } = *self;
        Self { mean: sum(mean), p50: sum(p50), p80: sum(p80), p95: sum(p95) }
    }
}

/// How sure the planner has to be.
#[derive(
    Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default, Serialize, Deserialize, ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Confidence {
    /// As likely as not.
    P50,
    /// Four times out of five.
    #[default]
    P80,
    /// Nineteen times out of twenty.
    P95,
}

impl Confidence {
    /// The probability, between 0 and 1.
    pub const fn probability(self) -> f64 {
        match self {
            Confidence::P50 => 0.50,
            Confidence::P80 => 0.80,
            Confidence::P95 => 0.95,
        }
    }

    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Confidence::P50 => "p50",
            Confidence::P80 => "p80",
            Confidence::P95 => "p95",
        }
    }
}

/// Forecast numbers of rays, by category as in [`crate::Rays`].
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct RayQuantiles {
    /// From the camera.
    pub primary: Quantiles,
    /// Towards lights.
    pub shadow: Quantiles,
    /// Straight on through thin glass and cut-outs.
    pub transparent: Quantiles,
    /// Off perfect mirrors.
    pub reflected: Quantiles,
    /// Into and out of solid glass.
    pub refracted: Quantiles,
    /// Ambient gathers.
    pub ambient: Quantiles,
    /// Off glossy surfaces.
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

/// The forecast of one frame.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameForecast {
    /// Frame number.
    pub frame: u32,
    /// Rays by category.
    pub rays: RayQuantiles,
    /// Irradiance cache records, one number a level, known since the cache was planned; empty without a cache.
    pub cache_records: Vec<Quantiles>,
    /// Deterministic count of operations.
    pub work: Quantiles,
    /// CPU seconds over all threads, on a node of speed 1.
    pub cpu_seconds: Quantiles,
}

impl FrameForecast {
    /// The records of a frame's irradiance cache as a forecast.
    pub fn known_records(records: &[u32]) -> Vec<Quantiles> {
        records.iter().map(|&count| Quantiles::known(count.into())).collect()
    }
}

/// The forecast of all frames together. Quantiles of sums: not the sums of the frames' quantiles.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct ForecastTotals {
    /// Rays by category.
    pub rays: RayQuantiles,
    /// Irradiance cache records, one number a level.
    pub cache_records: Vec<Quantiles>,
    /// Deterministic count of operations.
    pub work: Quantiles,
    /// CPU seconds over all threads, on a node of speed 1.
    pub cpu_seconds: Quantiles,
}

impl ForecastTotals {
    /// The records of all frames' irradiance caches as a forecast.
    pub fn known_records<'a>(frames: impl IntoIterator<Item = &'a [u32]>) -> Vec<Quantiles> {
        let mut levels: Vec<u64> = Vec::new();
        for records in frames {
            levels.resize(levels.len().max(records.len()), 0);
            levels.iter_mut().zip(records).for_each(|(sum, &count)| *sum += u64::from(count));
        }
        levels.into_iter().map(|count| Quantiles::known(count as f64)).collect()
    }
}

/// What was profiled.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct Profiled {
    /// The profiled frames, ascending.
    pub frames: Vec<u32>,
    /// Profiled pixels, over all of these frames.
    pub pixels: u64,
}

/// What the forecast itself took: previews and profiling.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct SpentOnForecast {
    /// Deterministic count of operations.
    pub work: u64,
    /// CPU seconds.
    pub cpu_seconds: f64,
    /// `work` over the forecast's mean total work.
    pub fraction_of_forecast: f64,
}

/// A job's quote, as `forelight forecast --json` and `GET /v1/jobs/{id}/forecast` give it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ForecastDoc {
    /// What is quoted; absent in quotes of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<QuotedShot>,
    /// One forecast a frame, ascending.
    pub frames: Vec<FrameForecast>,
    /// All frames together.
    pub total: ForecastTotals,
    /// What the quote rests on.
    pub profiled: Profiled,
    /// What the quote took.
    pub spent: SpentOnForecast,
    /// Whether the quantiles have been calibrated on past jobs; if not, they rest on the statistics alone.
    pub calibrated: bool,
    /// The effects that any of the profiled frames calls for, by name, sorted: what is simulated, and so paid for.
    #[serde(default)]
    pub effects: Vec<String>,
    /// Lights and objects that cannot matter to any of the profiled frames: what is not simulated, and costs nothing.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Camera samples per pixel that were chosen for a time or an amount of money; absent where they were asked for. Frames take as much work as
    /// so many of every pixel, and spend it where their images show that it pays.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chosen_spp: Option<u32>,
    /// What a frame costs whatever its pixels show, on a node of speed 1: the mean of the profiled frames. It is part of the forecasts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixed: Option<FixedCosts>,
    /// What every process pays once that renders frames of the shot, on a node of speed 1: in no frame's cost, and not in the total.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub once: Option<ProcessCosts>,
    /// The work of the profiled frames by class: what it takes on other nodes follows from their calibrations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work_by_class: Option<ByClass>,
    /// CPU seconds of all frames on calibrated nodes of the farm as it was when the quote was made, or on the node that was asked for; of
    /// twenty nodes at most.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cpu_seconds_on: Vec<NodeSeconds>,
    /// How the irradiance caches are made: one for all frames, which is a line of its own beside them, or one by each. Absent without
    /// caches, and where camera samples were chosen for a limit: each frame makes its own then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<CacheQuote>,
    /// The total in money, with the shared irradiance cache if there is one, at the mean price of the farm's nodes; absent without nodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<MoneyQuantiles>,
}

/// The scene and the quality that a quote is of.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct QuotedShot {
    /// Hash of the scene's files.
    pub scene: SceneDigest,
    /// How its frames are rendered.
    pub settings: RenderSettings,
}

/// What a job takes on one node.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeSeconds {
    /// Name of the node.
    pub node: String,
    /// Speed of one of its cores for this work against the reference.
    pub speed: f64,
    /// CPU seconds over all threads.
    pub cpu_seconds: Quantiles,
}

impl NodeSeconds {
    /// Nodes of a quote at most.
    pub const MOST: usize = 20;

    /// Of a node of this speed, for what takes `at_one` on a node of speed 1.
    pub fn new(node: String, speed: f64, at_one: &Quantiles) -> Self {
        let Quantiles { mean, p50, p80, p95 } = *at_one;
        let cpu_seconds =
            Quantiles { mean: mean / speed, p50: p50 / speed, p80: p80 / speed, p95: p95 / speed };
        Self { node, speed, cpu_seconds }
    }

    /// What a quote comes to on another machine, from the calibrations of the machine that made the quote (`here`) and of the other
    /// one (`there`). `None` if the quote does not say of which classes its work is.
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
