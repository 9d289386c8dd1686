//! The quote of a shot, made on this machine alone.

use crate::render::seconds;
use crate::renderer::Renderer;
use crate::shot::{
    CountedFrames, Observer, ProfiledFrame, ShotError, cost_of_record, count_frames, forecast_strata,
    profile_frame, record_prior_cost,
};
use forelight_forecast::{
    Calibration, Corrections, Cost, Costs, FIRST_FRAMES, FramePopulation, Observation, Quantity,
    RecordStrata, ShotForecast, Strategy, Stratum, with_times,
};
use forelight_protocol::{
    ByClass, FixedCosts, ForecastDoc, ForecastTotals, FrameForecast, LeftOut, ProcessCosts, Profiled,
    Quantiles, QuotedShot, RayQuantiles, RenderSettings, Spent, SpentOnForecast,
};
use std::collections::BTreeSet;

/// How a quote is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuoteOptions {
    /// Pixels to profile per profiled frame.
    pub samples: u32,
    /// Frames to profile at most, at least 1; `None`: as many as pay, see [`forelight_forecast::choose_more_frames`].
    pub profile_frames: Option<usize>,
    /// Seed of the choice of pixels.
    pub seed: u64,
    /// How the pixels are chosen and expanded.
    pub strategy: Strategy,
    /// What past jobs of the same renderer and class of features teach of the quantiles.
    pub corrections: Option<Corrections>,
}

impl Default for QuoteOptions {
    fn default() -> Self {
        Self { samples: 256, profile_frames: None, seed: 0, strategy: Strategy::Snapshot, corrections: None }
    }
}

/// A quote, and what it was made from.
#[derive(Debug, Clone)]
pub struct Quote {
    /// The quote.
    pub document: ForecastDoc,
    /// The same with everything that the statistics know.
    pub forecast: ShotForecast,
    /// What every frame shows.
    pub counted: CountedFrames,
    /// The profiled frames, ascending; their pixels can be taken over by renders.
    pub profiled: Vec<ProfiledFrame>,
}

impl Quote {
    /// What the quote took, all of it.
    pub fn spent(&self) -> Spent {
        self.profiled.iter().map(ProfiledFrame::spent).fold(self.counted.spent, Spent::plus)
    }

    /// The part of what the quote took that renders after it do not get back: previews, with the plans of irradiance caches, and
    /// setting up the profiled frames; see [`ProfiledFrame::spent_for_good`].
    pub fn spent_for_good(&self) -> Spent {
        self.profiled.iter().map(ProfiledFrame::spent_for_good).fold(self.counted.spent, Spent::plus)
    }
}

/// Makes the quote of these frames (ascending): previews all of them, profiles a few, estimates all.
pub fn quote(
    renderer: &dyn Renderer,
    frames: &[u32],
    settings: &RenderSettings,
    options: &QuoteOptions,
    observer: &dyn Observer,
) -> Result<Quote, ShotError> {
    let strategy = options.strategy;
    let shown = forecast_strata(&renderer.info().strata, settings);
    let mut strata = strategy.strata(&shown);
    let counted = count_frames(renderer, frames, settings, observer)?;
    let mut populations: Vec<FramePopulation> = frames
        .iter()
        .enumerate()
        .map(|(at, &frame)| FramePopulation {
            number: i64::from(frame),
            counts: strategy.counts(&shown, &counted.counts[at]),
            lights: counted.lights[at],
            shining: counted.shining[at],
            triangles: counted.triangles[at],
        })
        .collect();
    let records: Vec<&[u32]> = counted.cache_records.iter().map(Vec::as_slice).collect();
    let prior_cost = record_prior_cost(settings).unwrap_or(1.0);
    let apart = RecordStrata::add(&mut strata, &mut populations, &records, prior_cost);
    let first = options.profile_frames.unwrap_or(FIRST_FRAMES).max(1);
    let mut chosen = forelight_forecast::choose_frames(&strata, &populations, first)?;
    let mut profiled: Vec<ProfiledFrame> = Vec::with_capacity(chosen.len());
    let forecast = loop {
        for &index in &chosen[profiled.len()..] {
            profiled.push(profile_frame(renderer, frames[index], settings, options, observer)?);
            observer.profiled(profiled.len(), chosen.len());
        }
        let forecast = estimated(&strata, &populations, &apart, &counted, &chosen, &profiled)?;
        if options.profile_frames.is_some() {
            break forecast;
        }
        let spent = profiled.iter().map(ProfiledFrame::work_on_pixels).sum();
        let more = forelight_forecast::choose_more_frames(&strata, &populations, &forecast, spent)?;
        if more.is_empty() {
            break forecast;
        }
        chosen.extend(more);
    };
    profiled.sort_by_key(|profile| profile.frame);
    let forecast = match &options.corrections {
        Some(corrections) => forecast.corrected(corrections),
        None => forecast,
    };
    let of = QuotedShot { scene: renderer.info().summary.digest, settings: settings.clone() };
    let document = document(of, frames, &counted, &profiled, &forecast);
    let mut quote = Quote { document, forecast, counted, profiled };
    let spent = quote.spent();
    let mean = quote.document.total.work.mean;
    quote.document.spent = SpentOnForecast {
        work: spent.work,
        cpu_seconds: seconds(spent.cpu_nanos),
        fraction_of_forecast: if mean > 0.0 { spent.work as f64 / mean } else { 0.0 },
    };
    Ok(quote)
}

/// What the profiled frames, of these places, say of all.
fn estimated(
    strata: &[Stratum],
    populations: &[FramePopulation],
    apart: &RecordStrata,
    counted: &CountedFrames,
    chosen: &[usize],
    profiled: &[ProfiledFrame],
) -> Result<ShotForecast, ShotError> {
    let observed: Vec<Vec<Observation>> = profiled
        .iter()
        .map(|profile: &ProfiledFrame| {
            let records =
                profile.records.iter().map(|record| apart.observation(record.level, cost_of_record(record)));
            profile.observations.iter().copied().chain(records).collect()
        })
        .collect();
    let measured: Vec<forelight_forecast::ProfiledFrame<'_>> = chosen
        .iter()
        .zip(profiled)
        .zip(&observed)
        .map(|((&frame, profile), observations)| forelight_forecast::ProfiledFrame {
            frame,
            observations,
            expansion: &profile.expansion,
            fixed: cost(profile.fixed.without_plan().without_build(), [0; 7]),
            build: cost(profile.fixed.build, [0; 7]),
        })
        .collect();
    // Each frame's cache was planned to be counted: what that takes is known.
    let plans = with_times(
        counted.cache_plans.iter().flatten().map(|plan| Cost {
            work: plan.work,
            rays: plan.rays,
            ..Cost::default()
        }),
        profiled.iter().map(|profile| (profile.fixed.plan.work, profile.fixed.plan.cpu_nanos)),
    );
    Ok(forelight_forecast::forecast_shot(strata, populations, &measured, Calibration::NONE)?
        .with_known(&plans, Calibration::NONE))
}

fn cost(spent: Spent, rays: [u64; 7]) -> Cost {
    Cost { work: spent.work, cpu_nanos: spent.cpu_nanos, rays }
}

fn document(
    of: QuotedShot,
    frames: &[u32],
    counted: &CountedFrames,
    profiled: &[ProfiledFrame],
    forecast: &ShotForecast,
) -> ForecastDoc {
    let frame = |((&frame, records), forecast): ((&u32, &Vec<u32>), &forelight_forecast::FrameForecast)| {
        FrameForecast {
            frame,
            rays: rays(&forecast.total),
            cache_records: FrameForecast::known_records(records),
            work: quantiles(&forecast.total.work, 1.0),
            cpu_seconds: quantiles(&forecast.total.cpu_nanos, 1e-9),
        }
    };
    let effects: BTreeSet<&String> = profiled.iter().flat_map(|profile| &profile.effects).collect();
    ForecastDoc {
        of: Some(of),
        frames: frames.iter().zip(&counted.cache_records).zip(&forecast.frames).map(frame).collect(),
        total: ForecastTotals {
            rays: rays(&forecast.total),
            cache_records: ForecastTotals::known_records(counted.cache_records.iter().map(Vec::as_slice)),
            work: quantiles(&forecast.total.work, 1.0),
            cpu_seconds: quantiles(&forecast.total.cpu_nanos, 1e-9),
        },
        profiled: Profiled {
            frames: profiled.iter().map(|p| p.frame).collect(),
            pixels: profiled.iter().map(|p| p.observations.len() as u64).sum(),
        },
        spent: SpentOnForecast::default(),
        calibrated: forecast.calibrated,
        effects: effects.into_iter().cloned().collect(),
        left_out: LeftOut::of_all(profiled.iter().map(|profile| &profile.left_out[..])),
        chosen_spp: None,
        fixed: FixedCosts::mean(&profiled.iter().map(|profile| profile.fixed).collect::<Vec<_>>()),
        once: ProcessCosts::mean(&profiled.iter().map(|profile| profile.once).collect::<Vec<_>>()),
        work_by_class: profiled.iter().filter_map(|profile| profile.work_by_class).reduce(ByClass::plus),
        cpu_seconds_on: Vec::new(),
        cache: None,
        cost: None,
    }
}

fn rays(costs: &Costs<Quantity>) -> RayQuantiles {
    RayQuantiles::from_array(costs.rays.map(|category| quantiles(&category, 1.0)))
}

pub(crate) fn quantiles(quantity: &Quantity, unit: f64) -> Quantiles {
    Quantiles {
        mean: quantity.mean * unit,
        p50: quantity.p50 * unit,
        p80: quantity.p80 * unit,
        p95: quantity.p95 * unit,
    }
}
