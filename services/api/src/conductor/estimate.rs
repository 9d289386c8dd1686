//! From profiles to a forecast of every frame.

use std::collections::{BTreeMap, BTreeSet};

use forelight_forecast::{
    Calibration, Corrections, Cost, Costs, Expansion, ForecastError, Measure, Observation, ProfiledFrame,
    Quantity, ShotForecast, forecast_shot, shot_times, with_times,
};
use forelight_protocol::{
    ByClass, CacheFrame, CacheSample, FixedCosts, ForecastTotals, FrameForecast, LeftOut, PlanCount,
    PreviewResult, ProcessCosts, Profiled, Quantiles, RayQuantiles, RenderSettings, Spent, SpentOnForecast,
    at_speed_one,
};
use forelight_store::{JobForecast, MeasuredProfile, QuoteBasis, QuoteKind, Spreads};

use super::AdvanceError;
use super::choose::Populations;
use super::sharing::{SeedPlan, SharedWay, surplus};

/// A job's forecast, and that of each of its frames.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Forecast {
    pub job: JobForecast,
    pub frames: Vec<FrameForecast>,
    /// How sure the formulas are, of all frames together and of each; before past jobs corrected the quantiles.
    pub spreads: (Spreads, Vec<Spreads>),
    /// The irradiance cache that is made before the frames, if they share one.
    pub seed: Option<SeedPlan>,
}

impl Forecast {
    /// What is remembered so that later quotes of the kind learn from this one.
    pub fn basis(&self, kind: QuoteKind) -> QuoteBasis {
        let (total, frames) = self.spreads.clone();
        QuoteBasis { kind, total, frames }
    }
}

/// The kind of a quote that rests on these profiles; none if they do not say which renderer measured them, or came from several.
pub(super) fn kind(profiles: &[MeasuredProfile], settings: &RenderSettings) -> Option<QuoteKind> {
    let mut renderers = profiles.iter().map(|profile| profile.result.renderer.as_ref());
    let renderer = renderers.next()??;
    renderers
        .all(|other| other == Some(renderer))
        .then(|| QuoteKind { renderer: renderer.clone(), feature_class: settings.feature_class().to_owned() })
}

/// What the statistics know of a shot.
pub(super) struct Estimated {
    pub shot: ShotForecast,
    pub populations: Populations,
}

/// Which lights shine in each frame; nothing if it is the same ones in all.
fn lights_of(Populations { frames, .. }: &Populations) -> Vec<u32> {
    let lights: Vec<u32> = frames.iter().map(|frame| frame.lights).collect();
    if lights.windows(2).all(|pair| pair[0] == pair[1]) { Vec::new() } else { lights }
}

/// The records of each frame's irradiance cache: those that it reads, and those of them that it gathers itself.
fn records_of<'a>(preview: &'a PreviewResult, shared: Option<&SharedWay<'a>>) -> Vec<(&'a [u32], &'a [u32])> {
    match shared {
        Some(way) => way.plan.frames.iter().map(|frame| (&frame.records[..], &frame.own[..])).collect(),
        None => preview.frames.iter().map(|frame| &frame.cache_records[..]).map(|all| (all, all)).collect(),
    }
}

/// What planning each frame's own cache takes, as counted with the preview; nothing if it was not. A plan's operations take as long as in the
/// profiled frames, on a node of speed 1.
fn plans(preview: &PreviewResult, profiles: &[MeasuredProfile]) -> Vec<Costs<f64>> {
    let counted: Option<Vec<PlanCount>> = preview.frames.iter().map(|frame| frame.cache_plan).collect();
    let counted = counted.unwrap_or_default().into_iter();
    let taken = profiles.iter().map(|profile| profile.result.fixed.at_speed_one(profile.node_speed).plan);
    with_times(
        counted.map(|PlanCount { work, rays }| Cost { work, rays, ..Cost::default() }),
        taken.map(|plan| (plan.work, plan.cpu_nanos)),
    )
}

/// Which of the sampled records stand for those that frames gather themselves beside a shared cache.
struct OwnRecords {
    /// By level, how many of these were sampled.
    sampled: BTreeMap<u32, usize>,
}

impl OwnRecords {
    /// Fewer say less than all records do.
    const LEAST: usize = 4;

    fn of(profiles: &[MeasuredProfile]) -> Self {
        let mut sampled = BTreeMap::new();
        let samples = profiles.iter().flat_map(|profile| &profile.result.shared_cache_samples);
        samples.filter(|sample| sample.own).for_each(|sample| *sampled.entry(sample.level).or_default() += 1);
        Self { sampled }
    }

    fn counts(&self, sample: &CacheSample) -> bool {
        sample.own || self.sampled.get(&sample.level).is_none_or(|&own| own < Self::LEAST)
    }
}

/// The statistics' part, with quantiles as the formulas have them; of frames that are given a `shared` irradiance cache, without what that
/// takes, or that make their own.
pub(super) fn estimated(
    preview: &PreviewResult,
    profiles: &[MeasuredProfile],
    shared: Option<&SharedWay<'_>>,
) -> Result<Estimated, AdvanceError> {
    let strata = profiles.iter().flat_map(|profile| &profile.result.strata);
    let gathered: Vec<&[u32]> = records_of(preview, shared).into_iter().map(|(_, own)| own).collect();
    let mut populations = Populations::with_records(preview, strata, &gathered);
    // Beside a shared cache, planning was done for every frame, and is known.
    let mut known: Vec<Costs<f64>> = match shared {
        Some(way) => {
            way.plan.frames.iter().map(|frame| Costs::from(planning(frame, way.node_speed))).collect()
        }
        None => plans(preview, profiles),
    };
    // Of old previews it is not, and what the profiled frames took is carried to the others.
    let plans_are_known = !known.is_empty();
    let own = OwnRecords::of(profiles);
    let mut gathered_by: Vec<(usize, Vec<u32>)> = Vec::new();
    let mut observations: Vec<(usize, Vec<Observation>, Cost, Cost)> = Vec::with_capacity(profiles.len());
    for MeasuredProfile { result, node_speed, .. } in profiles {
        let at = preview.frames.iter().position(|frame| frame.frame == result.frame).ok_or_else(|| {
            AdvanceError::Hopeless(format!("frame {} was profiled, but not previewed", result.frame))
        })?;
        let pixels = result.samples.iter().zip(0..).map(|(sample, place)| {
            let beside = result.shared_samples.get::<usize>(place).filter(|_| shared.is_some());
            let (work, cpu_nanos, rays) = match beside {
                Some(sample) => (sample.work, sample.cpu_nanos, sample.rays),
                None => (sample.work, sample.cpu_nanos, sample.rays),
            };
            let stratum = populations.shown_by(sample, result);
            let cost = Cost { work, cpu_nanos: at_speed_one(cpu_nanos, *node_speed), rays };
            Observation { stratum: stratum as u32, cost }
        });
        let records = match shared {
            Some(_) => &result.shared_cache_samples,
            None => &result.cache_samples,
        };
        let gathered_here = |sample: &&CacheSample| shared.is_none() || own.counts(sample);
        let records = records.iter().filter(gathered_here).map(|sample| {
            let cpu_nanos = at_speed_one(sample.cpu_nanos, *node_speed);
            let cost = Cost { work: sample.work, cpu_nanos, rays: sample.rays };
            populations.records.observation(sample.level, cost)
        });
        let observed: Vec<Observation> = pixels.chain(records).collect();
        if shared.is_some()
            && let Some(known) = known.get_mut(at)
        {
            let counts = &populations.frames[at].counts;
            *known = known.plus(&surplus(counts, &observed, &populations.strata).times(-1.0));
        }
        gathered_by.push((at, populations.frames[at].counts.clone()));
        make_room(&mut populations.frames[at].counts, &observed);
        let fixed = if plans_are_known { result.fixed.without_plan() } else { result.fixed };
        let cost = |Spent { work, cpu_nanos }: Spent, rays: [u64; 7]| {
            let cpu_nanos = at_speed_one(cpu_nanos, *node_speed);
            Cost { work, cpu_nanos, rays }
        };
        let (others, build) = (cost(fixed.without_build(), fixed.plan_rays), cost(fixed.build, [0; 7]));
        observations.push((at, observed, others, build));
    }
    let profiled: Vec<ProfiledFrame<'_>> = observations
        .iter()
        .map(|(frame, observations, fixed, build)| ProfiledFrame {
            frame: *frame,
            observations,
            expansion: &Expansion::Groups,
            fixed: *fixed,
            build: *build,
        })
        .collect();
    let mut shot = forecast_shot(&populations.strata, &populations.frames, &profiled, Calibration::NONE)
        .map_err(no_forecast)?
        .with_known(&known, Calibration::NONE);
    // The records that a frame gathers, and not those that were measured in a cache of its own.
    for (at, counts) in gathered_by.iter().filter(|_| shared.is_some()) {
        let strata = shot.frames[*at].strata.iter_mut().zip(&populations.strata).zip(counts);
        strata.filter(|((_, stratum), _)| stratum.apart).for_each(|((own, _), &count)| own.pixels = count);
    }
    Ok(Estimated { shot, populations })
}

fn no_forecast(error: ForecastError) -> AdvanceError {
    AdvanceError::Hopeless(format!("no forecast: {error}"))
}

/// Forecasts every frame from the preview's counts of pixels and records and from those that were profiled, with quantiles as past jobs teach them, if there
/// are enough. CPU time is brought to a node of speed 1 first: a second measured on a node of speed 2 is two.
pub(super) fn calibrated(
    preview: &PreviewResult,
    profiles: &[MeasuredProfile],
    shared: Option<&SharedWay<'_>>,
    corrections: Option<&Corrections>,
) -> Result<Forecast, AdvanceError> {
    let of_frames = records_of(preview, shared);
    let Estimated { shot, populations } = estimated(preview, profiles, shared)?;
    let clock = shot_times(&populations.strata, &populations.frames).map_err(no_forecast)?;
    let shot = match corrections {
        Some(corrections) => shot.corrected(corrections),
        None => shot,
    };
    let spreads = |costs: &Costs<Quantity>| Spreads {
        work: costs.work.spread(Measure::Work),
        cpu: costs.cpu_nanos.spread(Measure::CpuTime),
    };
    let spreads = (spreads(&shot.total), shot.frames.iter().map(|frame| spreads(&frame.total)).collect());

    let frames = preview
        .frames
        .iter()
        .zip(&shot.frames)
        .zip(&of_frames)
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
        cache_records: ForecastTotals::known_records(of_frames.iter().map(|(records, _)| *records)),
        work: quantiles(&shot.total.work, 1.0),
        cpu_seconds: quantiles(&shot.total.cpu_nanos, 1e-9),
    };
    let spent = profiles.iter().map(|profile| profile.result.spent).fold(preview.spent, Spent::plus);
    let effects: BTreeSet<&String> = profiles.iter().flat_map(|profile| &profile.result.effects).collect();
    let once = |profile: &MeasuredProfile| Some(profile.result.once?.at_speed_one(profile.node_speed));
    let mut profiled_frames: Vec<u32> = profiles.iter().map(|profile| profile.result.frame).collect();
    profiled_frames.sort_unstable();
    let job = JobForecast {
        profiled: Profiled {
            frames: profiled_frames,
            pixels: profiles.iter().map(|profile| profile.result.samples.len() as u64).sum(),
        },
        spent: SpentOnForecast {
            work: spent.work,
            cpu_seconds: spent.cpu_nanos as f64 * 1e-9,
            fraction_of_forecast: if total.work.mean > 0.0 {
                spent.work as f64 / total.work.mean
            } else {
                0.0
            },
        },
        total,
        calibrated: shot.calibrated,
        effects: effects.into_iter().cloned().collect(),
        left_out: LeftOut::of_all(profiles.iter().map(|profile| &profile.result.left_out[..])),
        chosen_spp: None,
        fixed: fixed_costs(profiles, shared, None),
        once: ProcessCosts::mean(&profiles.iter().filter_map(once).collect::<Vec<_>>()),
        work_by_class: profiles
            .iter()
            .filter_map(|profile| profile.result.work_by_class)
            .reduce(ByClass::plus),
        cpu_seconds_on: Vec::new(),
        cache: None,
        cost: None,
        lights: lights_of(&populations),
        clock,
    };
    Ok(Forecast { job, frames, spreads, seed: None })
}

/// What a frame costs whatever its pixels show, the mean of the profiled ones; what planning takes beyond a shared cache, which is known of every frame, that of
/// this one or the mean of all.
pub(super) fn fixed_costs(
    profiles: &[MeasuredProfile],
    shared: Option<&SharedWay<'_>>,
    frame: Option<u32>,
) -> Option<FixedCosts> {
    let fixed = |profile: &MeasuredProfile| profile.result.fixed.at_speed_one(profile.node_speed);
    let own = FixedCosts::mean(&profiles.iter().map(fixed).collect::<Vec<_>>())?;
    let Some(way) = shared else { return Some(own) };
    let frames = way.plan.frames.iter().filter(|planned| frame.is_none_or(|number| planned.frame == number));
    let beside = frames.map(|planned| {
        let plans = FixedCosts { plan: planned.plan, plan_rays: planned.plan_rays, ..FixedCosts::default() };
        plans.at_speed_one(way.node_speed)
    });
    let FixedCosts { plan, plan_rays, .. } =
        FixedCosts::mean(&beside.collect::<Vec<_>>()).unwrap_or_default();
    Some(FixedCosts { plan, plan_rays, ..own })
}

/// The hazard: the frame was previewed on a graphics processor and profiled where there is none, and a pixel on an edge
/// shows another object there. More pixels of a stratum are then profiled than were counted, which the forecast
/// rightly refuses. What was traced is true, so the count gives way: a few pixels of a whole image.
pub(super) fn make_room(counts: &mut [u32], observations: &[Observation]) {
    let mut samples = vec![0u32; counts.len()];
    for observation in observations {
        // What belongs to no stratum is for the forecast to refuse.
        if let Some(samples) = samples.get_mut(observation.stratum as usize) {
            *samples += 1;
        }
    }
    for (count, samples) in counts.iter_mut().zip(samples) {
        *count = (*count).max(samples);
    }
}

/// What planning a frame's records beyond the shared cache takes, with its time on a node of speed 1.
fn planning(frame: &CacheFrame, node_speed: f64) -> Cost {
    let Spent { work, cpu_nanos } = frame.plan;
    Cost { work, cpu_nanos: at_speed_one(cpu_nanos, node_speed), rays: frame.plan_rays }
}

fn rays(costs: &Costs<Quantity>) -> RayQuantiles {
    RayQuantiles::from_array(costs.rays.map(|category| quantiles(&category, 1.0)))
}

pub(super) fn quantiles(quantity: &Quantity, unit: f64) -> Quantiles {
    let Quantity { mean, p50, p80, p95, .. } = *quantity;
    Quantiles { mean: mean * unit, p50: p50 * unit, p80: p80 * unit, p95: p95 * unit }
}

#[cfg(test)]
mod tests;
