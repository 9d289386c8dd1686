//! A quote as it is stored with the job and shown to people.

use std::collections::BTreeSet;

use forelight_forecast::{Corrections, Costs, Measure, Quantity, shot_times};
use forelight_protocol::{
    ArtifactHash, ByClass, CacheQuote, FixedCosts, ForecastDoc, ForecastTotals, FrameForecast, LeftOut,
    MoneyQuantiles, NodeSeconds, ProcessCosts, Profiled, Quantiles, QuotedShot, RayQuantiles, RenderSettings,
    Spent, SpentOnForecast,
};
use serde::{Deserialize, Serialize};

use crate::error::QuoteError;
use crate::estimate::Estimate;
use crate::measured::{Measured, MeasuredProfile};
use crate::populations::Populations;

/// A quote without its frames, as the store keeps it with the job.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct JobForecast {
    /// All frames together.
    pub total: ForecastTotals,
    /// The frames and pixels that the quote rests on.
    pub profiled: Profiled,
    /// What the quote itself cost.
    pub spent: SpentOnForecast,
    /// Whether the quantiles have been calibrated on past jobs.
    pub calibrated: bool,
    /// The effects that any of the profiled frames calls for.
    #[serde(default)]
    pub effects: Vec<String>,
    /// Lights and objects that are left out of all frames.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Camera samples that were chosen to fit a time or a sum of money.
    #[serde(default)]
    pub chosen_spp: Option<u32>,
    /// What a frame costs whatever its pixels show: the mean of the profiled frames.
    #[serde(default)]
    pub fixed: Option<FixedCosts>,
    /// What every process pays once that renders frames of the shot.
    #[serde(default)]
    pub once: Option<ProcessCosts>,
    /// Work of the profiled frames by class.
    #[serde(default)]
    pub work_by_class: Option<ByClass>,
    /// CPU seconds of all frames on calibrated nodes.
    #[serde(default)]
    pub cpu_seconds_on: Vec<NodeSeconds>,
    /// How the irradiance caches are built. `None` without caches.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<CacheQuote>,
    /// The total in money, with the shared irradiance cache if there is one.
    pub cost: Option<MoneyQuantiles>,
    /// For each frame, a number for the set of lights that shine in it. Empty if all frames have the same lights.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lights: Vec<u32>,
    /// For each frame, its time on the shot's own clock. The store keeps it with the frames, so it is empty when it is
    /// read back.
    #[serde(skip)]
    pub clock: Vec<f64>,
}

impl JobForecast {
    /// CPU seconds for the irradiance cache that the frames share; zero if they do not.
    pub fn shared_cache_seconds(&self) -> Quantiles {
        self.cache.as_ref().map(CacheQuote::shared_cache_seconds).unwrap_or_default()
    }

    /// The document for people and programs, with the shot that it is of and the forecasts of its frames.
    pub fn document(self, of: QuotedShot, frames: Vec<FrameForecast>) -> ForecastDoc {
        ForecastDoc {
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

/// The jobs that a quote is compared with: those of the same renderer version and class of features.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct QuoteKind {
    /// The renderer that measured the profiles, with its version.
    pub renderer: String,
    /// [`RenderSettings::feature_class`].
    pub feature_class: String,
}

impl QuoteKind {
    /// The kind of a quote that rests on these profiles. `None` if they do not say which renderer measured them, or if
    /// several did.
    pub fn of(profiles: &[MeasuredProfile], settings: &RenderSettings) -> Option<Self> {
        let mut renderers = profiles.iter().map(|profile| profile.result.renderer.as_ref());
        let renderer = renderers.next()??;
        renderers
            .all(|other| other == Some(renderer))
            .then(|| Self { renderer: renderer.clone(), feature_class: settings.feature_class().to_owned() })
    }
}

/// How uncertain a quote says that it is: standard deviations of the logarithm, before past jobs correct the quantiles.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Spreads {
    /// Of work.
    pub work: f64,
    /// Of CPU time.
    pub cpu: f64,
}

/// What is remembered of a quote so that later quotes can learn from it.
#[derive(Clone, PartialEq, Debug)]
pub struct QuoteBasis {
    /// The jobs that it is compared with.
    pub kind: QuoteKind,
    /// Of all frames together.
    pub total: Spreads,
    /// Of each frame, in their order.
    pub frames: Vec<Spreads>,
}

/// A shared irradiance cache that will be built before the frames.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SharedCacheToBuild {
    /// The cache as planned: an artefact.
    pub cache: ArtifactHash,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// Records of all levels.
    pub records: u64,
}

impl SharedCacheToBuild {
    /// Fewest records of a part. Below this, opening the scene and sending the cache costs more than filling it.
    const PART_RECORDS: u64 = 256;
    /// Most parts.
    const MOST_PARTS: u32 = 64;
    /// Most bytes of all parts together: the worker that merges them holds all of them.
    const PARTS_BYTES: u64 = 4 << 30;

    /// Into how many parts the cache is split on a farm of `nodes` nodes: one a node, as long as that pays.
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
    /// How uncertain the formulas are: of all frames together, and of each frame.
    pub spreads: (Spreads, Vec<Spreads>),
    /// The irradiance cache that is built before the frames. `None` if they do not share one.
    pub shared_cache: Option<SharedCacheToBuild>,
}

impl Quote {
    /// What is remembered so that later quotes of the kind learn from this one.
    pub fn basis(&self, kind: QuoteKind) -> QuoteBasis {
        let (total, frames) = self.spreads.clone();
        QuoteBasis { kind, total, frames }
    }
}

impl Measured<'_> {
    /// The quote of all frames, with the caches as [`Measured::shared`] says. If past jobs taught corrections, they put
    /// the quantiles where they belong.
    ///
    /// # Errors
    /// As of [`Measured::estimate`].
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
        let lights: Vec<u32> = populations.iter().map(|frame| frame.lights).collect();
        let same_lights = lights.windows(2).all(|pair| pair[0] == pair[1]);
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
            fixed: self.fixed_costs(None),
            once: ProcessCosts::mean(&self.profiles.iter().filter_map(once).collect::<Vec<_>>()),
            work_by_class: by_class.reduce(ByClass::plus),
            cpu_seconds_on: Vec::new(),
            cache: None,
            cost: None,
            lights: if same_lights { Vec::new() } else { lights },
            clock,
        };
        Ok(Quote { job, frames, spreads, shared_cache: None })
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
        let spent = profiles.fold(self.preview.spent, Spent::plus);
        SpentOnForecast {
            work: spent.work,
            cpu_seconds: spent.cpu_nanos as f64 * 1e-9,
            fraction_of_forecast: if forecast > 0.0 { spent.work as f64 / forecast } else { 0.0 },
        }
    }
}

fn spreads(costs: &Costs<Quantity>) -> Spreads {
    Spreads { work: costs.work.spread(Measure::Work), cpu: costs.cpu_nanos.spread(Measure::CpuTime) }
}

fn rays(costs: &Costs<Quantity>) -> RayQuantiles {
    RayQuantiles::from_array(costs.rays.map(|category| quantiles(&category, 1.0)))
}

/// A quantity of the statistics in the terms of the wire, times `unit`.
pub fn quantiles(quantity: &Quantity, unit: f64) -> Quantiles {
    let Quantity { mean, p50, p80, p95, .. } = *quantity;
    Quantiles { mean: mean * unit, p50: p50 * unit, p80: p80 * unit, p95: p95 * unit }
}
