//! The quote as it is stored and shown.

use std::collections::BTreeSet;

use forelight_forecast::{Corrections, Costs, Measure, Quantity, shot_times};
use forelight_protocol::{
    ArtifactHash, ByClass, CacheQuote, FixedCosts, ForecastDoc, ForecastTotals, FrameForecast, LeftOut,
    MOST_PARTS, MoneyQuantiles, NodeSeconds, ProcessCosts, Profiled, Quantiles, QuotedShot, RayQuantiles,
    RenderSettings, RendererId, Spent, SpentOnForecast, StorageForecast,
};
use serde::{Deserialize, Serialize};

use crate::error::QuoteError;
use crate::estimate::Estimate;
use crate::measured::{Measured, MeasuredProfile};
use crate::populations::Populations;

/// A quote without its frames, as stored with the job.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct JobForecast {
    /// Forecast of all frames together.
    pub total: ForecastTotals,
    /// Number of profiled frames and pixels.
    pub profiled: Profiled,
    /// Cost of the quote itself.
    pub spent: SpentOnForecast,
    /// True if past jobs calibrated the quantiles.
    pub calibrated: bool,
    /// Effects that any profiled frame calls for.
    #[serde(default)]
    pub effects: Vec<String>,
    /// Lights and objects that are left out of all frames.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Camera samples that were chosen to fit a limit of time or money, or to reach an error.
    #[serde(default)]
    pub chosen_spp: Option<u32>,
    /// Largest number of parts into which a frame can be divided. 0 or 1: frames are not divided.
    #[serde(default)]
    pub most_parts: u32,
    /// Fixed costs of a frame: the mean of the profiled frames.
    #[serde(default)]
    pub fixed: Option<FixedCosts>,
    /// Costs that each process pays once for the shot.
    #[serde(default)]
    pub once: Option<ProcessCosts>,
    /// Work of the profiled frames by class.
    #[serde(default)]
    pub work_by_class: Option<ByClass>,
    /// CPU seconds of all frames on calibrated nodes.
    #[serde(default)]
    pub cpu_seconds_on: Vec<NodeSeconds>,
    /// How irradiance caches are built. `None` without caches.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<CacheQuote>,
    /// Total in money, including a shared irradiance cache.
    pub cost: Option<MoneyQuantiles>,
    /// Bytes of a frame's files: the mean of the profiled frames. `None` if they were not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_bytes: Option<u64>,
    /// For each frame, a number for the set of lights that shine in it. Empty if all frames have the same
    /// lights.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lights: Vec<u32>,
    /// Time of each frame on the shot's own clock. The store keeps it with the frames, so it is empty when
    /// read back.
    #[serde(skip)]
    pub clock: Vec<f64>,
}

impl JobForecast {
    /// Mean CPU seconds of so many frames at speed 1.
    pub fn mean_of_frames(&self, frames: usize) -> f64 {
        self.total.cpu_seconds.mean / frames.max(1) as f64
    }

    /// CPU seconds of the shared irradiance cache. Zero without one.
    pub fn shared_cache_seconds(&self) -> Quantiles {
        self.cache.as_ref().map(CacheQuote::shared_cache_seconds).unwrap_or_default()
    }

    /// The document for clients, with its shot and the forecasts of its frames.
    pub fn document(self, of: QuotedShot, frames: Vec<FrameForecast>) -> ForecastDoc {
        let count = frames.len() as u64;
        ForecastDoc {
            storage: self.frame_bytes.map(|bytes| StorageForecast {
                file_bytes: bytes.saturating_mul(count),
                database_bytes: DATABASE_BYTES.saturating_mul(count),
            }),
            of: Some(of),
            frames,
            total: self.total,
            profiled: self.profiled,
            spent: self.spent,
            calibrated: self.calibrated,
            effects: self.effects,
            left_out: self.left_out,
            chosen_spp: self.chosen_spp,
            fixed: self.fixed,
            once: self.once,
            work_by_class: self.work_by_class,
            cpu_seconds_on: self.cpu_seconds_on,
            cache: self.cache,
            cost: self.cost,
        }
    }
}

/// Bytes of the database that a frame takes, measured on a year of a simulated studio.
const DATABASE_BYTES: u64 = 31_000;

/// Key of the past jobs that a quote learns from: renderer version and class of features.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct QuoteKind {
    /// Renderer that measured the profiles, with its version.
    pub renderer: String,
    /// [`RenderSettings::feature_class`].
    pub feature_class: String,
}

impl QuoteKind {
    /// The kind of a quote of another renderer.
    pub fn of_renderer(renderer: &RendererId) -> Self {
        Self { renderer: renderer.to_string(), feature_class: "samples".to_owned() }
    }

    /// The kind of a quote from profiled pixels of another renderer.
    pub fn of_pixels(renderer: &str) -> Self {
        Self { renderer: renderer.to_owned(), feature_class: "pixels".to_owned() }
    }

    /// The kind of a quote from these profiles. `None` if they name no renderer, or several.
    pub fn of(profiles: &[MeasuredProfile], settings: &RenderSettings) -> Option<Self> {
        let mut renderers = profiles.iter().map(|profile| profile.result.renderer.as_ref());
        let renderer = renderers.next()??;
        renderers
            .all(|other| other == Some(renderer))
            .then(|| Self { renderer: renderer.clone(), feature_class: settings.feature_class().to_owned() })
    }
}

/// Spreads of a quote: standard deviations of the logarithm, before past jobs correct the quantiles.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Spreads {
    /// Spread of the work.
    pub work: f64,
    /// Spread of the CPU time.
    pub cpu: f64,
}

/// The part of a quote that later quotes learn from.
#[derive(Clone, PartialEq, Debug)]
pub struct QuoteBasis {
    /// Kind of the quote.
    pub kind: QuoteKind,
    /// Spreads of all frames together.
    pub total: Spreads,
    /// Spreads of each frame, in order.
    pub frames: Vec<Spreads>,
}

/// A shared irradiance cache to build before the frames.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SharedCacheToBuild {
    /// The planned cache, an artefact.
    pub cache: ArtifactHash,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// Records of all levels.
    pub records: u64,
}

impl SharedCacheToBuild {
    /// Fewest records in a part. Smaller parts cost more for opening the scene and sending the cache than for
    /// filling.
    const PART_RECORDS: u64 = 256;
    /// Most parts.
    const MOST_PARTS: u32 = 64;
    /// Most bytes of all parts together. The worker that merges them holds all of them.
    const PARTS_BYTES: u64 = 4 << 30;

    /// Number of parts on a farm of `nodes` nodes: one per node within the limits.
    pub fn parts(&self, nodes: usize) -> u32 {
        let nodes = u32::try_from(nodes).unwrap_or(u32::MAX);
        let by_records = u32::try_from(self.records / Self::PART_RECORDS).unwrap_or(u32::MAX);
        let by_bytes = u32::try_from(Self::PARTS_BYTES / self.bytes.max(1)).unwrap_or(u32::MAX);
        nodes.min(by_records).min(by_bytes).clamp(1, Self::MOST_PARTS)
    }
}

/// The quote of a shot.
#[derive(Clone, PartialEq, Debug)]
pub struct Quote {
    /// All frames together.
    pub job: JobForecast,
    /// Each frame, in the order of the preview.
    pub frames: Vec<FrameForecast>,
    /// Spreads of all frames together, and of each frame.
    pub spreads: (Spreads, Vec<Spreads>),
    /// The irradiance cache to build before the frames. `None` if they share none.
    pub shared_cache: Option<SharedCacheToBuild>,
}

impl Quote {
    /// The part of the quote that later quotes of the kind learn from.
    pub fn basis(&self, kind: QuoteKind) -> QuoteBasis {
        let (total, frames) = self.spreads.clone();
        QuoteBasis { kind, total, frames }
    }
}

impl Measured<'_> {
    /// The quote of all frames, with caches as in [`Measured::shared`]. `corrections` from past jobs
    /// calibrate the quantiles.
    pub fn quote(&self, corrections: Option<&Corrections>) -> Result<Quote, QuoteError> {
        let Estimate { shot, populations: Populations { strata, frames: populations, .. }, .. } =
            self.estimate()?;
        let clock = shot_times(&strata, &populations).map_err(QuoteError::Forecast)?;
        let shot = match corrections {
            Some(corrections) => shot.corrected(corrections),
            None => shot,
        };
        let spreads = (spreads(&shot.total), shot.frames.iter().map(|frame| spreads(&frame.total)).collect());
        let records = self.records();
        let frames = self.preview.frames.iter().zip(&shot.frames).zip(&records);
        let frames = frames
            .map(|((previewed, forecast), (records, _))| FrameForecast {
                frame: previewed.frame,
                rays: rays(&forecast.total),
                cache_records: FrameForecast::known_records(records),
                work: quantiles(&forecast.total.work, 1.0),
                cpu_seconds: quantiles(&forecast.total.cpu_nanos, 1e-9),
            })
            .collect();
        let total = ForecastTotals {
            rays: rays(&shot.total),
            cache_records: ForecastTotals::known_records(records.iter().map(|(records, _)| *records)),
            work: quantiles(&shot.total.work, 1.0),
            cpu_seconds: quantiles(&shot.total.cpu_nanos, 1e-9),
        };
        let effects = self.profiles.iter().flat_map(|profile| &profile.result.effects);
        let effects: BTreeSet<&String> = effects.collect();
        let once = |profile: &MeasuredProfile| Some(profile.result.once?.at_speed_one(profile.node_speed));
        let by_class = self.profiles.iter().filter_map(|profile| profile.result.work_by_class);
        let job = JobForecast {
            profiled: self.profiled(),
            spent: self.spent(total.work.mean),
            total,
            calibrated: shot.calibrated,
            effects: effects.into_iter().cloned().collect(),
            left_out: LeftOut::of_all(self.profiles.iter().map(|profile| &profile.result.left_out[..])),
            chosen_spp: None,
            most_parts: MOST_PARTS,
            fixed: self.fixed_costs(None),
            once: ProcessCosts::mean(&self.profiles.iter().filter_map(once).collect::<Vec<_>>()),
            work_by_class: by_class.reduce(ByClass::plus),
            cpu_seconds_on: Vec::new(),
            cache: None,
            cost: None,
            frame_bytes: self.frame_bytes(),
            lights: Populations::lights(&populations),
            clock,
        };
        Ok(Quote { job, frames, spreads, shared_cache: None })
    }

    /// Mean of the bytes of files of the profiled frames.
    fn frame_bytes(&self) -> Option<u64> {
        let bytes: Vec<u64> = self.profiles.iter().filter_map(|profile| profile.result.file_bytes).collect();
        let sum = bytes.iter().fold(0u64, |sum, &bytes| sum.saturating_add(bytes));
        sum.checked_div(bytes.len() as u64)
    }

    fn profiled(&self) -> Profiled {
        let mut frames: Vec<u32> = self.profiles.iter().map(|profile| profile.result.frame).collect();
        frames.sort_unstable();
        Profiled {
            frames,
            pixels: self.profiles.iter().map(|profile| profile.result.samples.len() as u64).sum(),
        }
    }

    fn spent(&self, forecast: f64) -> SpentOnForecast {
        let profiles = self.profiles.iter().map(|profile| profile.result.spent);
        profiles.fold(self.preview.spent, Spent::plus).on_forecast(forecast)
    }
}

fn spreads(costs: &Costs<Quantity>) -> Spreads {
    Spreads { work: costs.work.spread(Measure::Work), cpu: costs.cpu_nanos.spread(Measure::CpuTime) }
}

fn rays(costs: &Costs<Quantity>) -> RayQuantiles {
    RayQuantiles::from_array(costs.rays.map(|category| quantiles(&category, 1.0)))
}

/// Converts a quantity of the statistics, times `unit`, to the wire format.
pub fn quantiles(quantity: &Quantity, unit: f64) -> Quantiles {
    let Quantity { mean, p50, p80, p95, .. } = *quantity;
    Quantiles { mean: mean * unit, p50: p50 * unit, p80: p80 * unit, p95: p95 * unit }
}
