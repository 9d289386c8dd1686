//! One irradiance cache for all frames of a job, or one for each: both are priced, and the cheaper one is taken.
//!
//! Both prices rest on the same measurements. Records are counted by planning: those of every frame's own cache by the preview, those
//! of the shared one, and those that each frame needs beyond it, by the task that plans it. What a record takes was measured by
//! the profiles. A shared cache is paid for once, as a line of its own in the quote, and the frames without it.
//!
//! What planning the shared cache took is spent when the question is asked, and is part of what the quote took.

use forelight_forecast::{
    Calibration, Corrections, Cost, Costs, Expansion, FramePopulation, Observation, ProfiledFrame, Quantity,
    RecordStrata, Stratum, forecast_shot,
};
use forelight_protocol::{
    ArtifactHash, CACHE_BYTES, CacheMode, CachePlanResult, CachePrice, CacheQuote, CacheSharing,
    PreviewResult, RenderSettings, SeedForecast, SpentOnForecast, at_speed_one,
};
use forelight_store::{MeasuredProfile, PlannedCache};

use super::AdvanceError;
use super::estimate::{self, Forecast, make_room, quantiles};

#[cfg(test)]
mod tests;

/// Fewest records of a part: with fewer, opening the scene and sending the cache around takes more than filling it.
const PART_RECORDS: u64 = 256;
/// Most parts.
const MOST_PARTS: u32 = 64;
/// Most bytes of all parts of a cache together: whoever puts them together holds all of them.
const PARTS_BYTES: u64 = 4 << 30;

/// A cache that all frames share, as it was planned.
#[derive(Clone, Copy, Debug)]
pub(super) struct SharedWay<'a> {
    pub plan: &'a CachePlanResult,
    /// Speed of the node that planned it.
    pub node_speed: f64,
}

impl<'a> SharedWay<'a> {
    /// As it was planned; nothing if there is no plan.
    pub fn of(planned: &'a PlannedCache) -> Option<Self> {
        match planned {
            PlannedCache::There { plan, node_speed } => Some(Self { plan, node_speed: *node_speed }),
            PlannedCache::NotAsked | PlannedCache::Pending => None,
        }
    }
}

/// A shared cache that is to be made.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct SeedPlan {
    /// The cache as planned.
    pub cache: ArtifactHash,
    pub bytes: u64,
    pub records: u64,
}

impl SeedPlan {
    /// Into how many parts it is split on a farm of so many nodes: one for each, as long as that is worth it.
    pub fn parts(&self, nodes: usize) -> u32 {
        let nodes = u32::try_from(nodes).unwrap_or(u32::MAX);
        let by_records = u32::try_from(self.records / PART_RECORDS).unwrap_or(u32::MAX);
        let by_bytes = u32::try_from(PARTS_BYTES / self.bytes.max(1)).unwrap_or(u32::MAX);
        nodes.min(by_records).min(by_bytes).clamp(1, MOST_PARTS)
    }
}

/// Whether a cache that all frames share is to be planned, to see what it would take.
pub(super) fn is_worth_planning(asked: CacheSharing, preview: &PreviewResult) -> bool {
    // Without caches there are none.
    let has_records = preview.frames.iter().any(|frame| frame.cache_records.iter().any(|&count| count > 0));
    has_records
        && match asked {
            CacheSharing::Auto => preview.frames.len() > 1,
            CacheSharing::Shared => true,
            CacheSharing::Private => false,
        }
}

/// The quote of a job, with its caches made in the way that it asks for, or in the one that takes less work.
pub(super) fn quote(
    asked: CacheSharing,
    settings: &RenderSettings,
    preview: &PreviewResult,
    profiles: &[MeasuredProfile],
    planned: &PlannedCache,
    corrections: Option<&Corrections>,
) -> Result<Forecast, AdvanceError> {
    let mut private = estimate::calibrated(preview, profiles, None, corrections)?;
    if settings.cache == CacheMode::Off {
        return Ok(private);
    }
    let of_frames = preview.frames.iter().flat_map(|frame| &frame.cache_records);
    let private_price = CachePrice { records: sum(of_frames), ..price(&private) };
    let mut answer = CacheQuote {
        asked,
        shared: false,
        reason: String::new(),
        private_price,
        shared_price: None,
        seed: None,
    };
    let Some(way) = SharedWay::of(planned) else {
        answer.reason = match asked {
            CacheSharing::Private => "the job asks for it",
            _ if private_price.records == 0 => "no frame needs a record",
            _ => "there is but one frame",
        }
        .to_owned();
        private.job.cache = Some(answer);
        return Ok(private);
    };
    let plan = way.plan;
    let Some(cache) = plan.cache else {
        let reason = format!(
            "a cache for all frames would take {} bytes; one that is shared has at most {CACHE_BYTES}",
            plan.bytes
        );
        if asked == CacheSharing::Shared {
            return Err(AdvanceError::Hopeless(format!(
                "the job asks for a shared irradiance cache: {reason}"
            )));
        }
        answer.reason = reason;
        private.job.cache = Some(answer);
        return Ok(private);
    };
    let mut shared = estimate::calibrated(preview, profiles, Some(&way), corrections)?;
    let seed = seed(&plan.records, preview, profiles, corrections)?;
    let own = sum(plan.frames.iter().flat_map(|frame| &frame.own));
    let frames = price(&shared);
    let shared_price = CachePrice {
        records: sum(&plan.records) + own,
        work: frames.work + seed.work.mean,
        cpu_seconds: frames.cpu_seconds + seed.cpu_seconds.mean,
        cost: None,
    };
    answer.shared_price = Some(shared_price);
    answer.shared = match asked {
        CacheSharing::Shared => true,
        CacheSharing::Private => false,
        CacheSharing::Auto => shared_price.work < private_price.work,
    };
    answer.reason = match asked {
        CacheSharing::Auto => compared(&shared_price, &private_price),
        CacheSharing::Shared | CacheSharing::Private => "the job asks for it".to_owned(),
    };
    let mut chosen = if answer.shared {
        let records = sum(&plan.records);
        shared.seed = Some(SeedPlan { cache, bytes: plan.bytes, records });
        answer.seed = Some(seed);
        shared
    } else {
        private
    };
    // What it took to ask is spent whatever the answer.
    let spent = &mut chosen.job.spent;
    *spent = SpentOnForecast {
        work: spent.work.saturating_add(plan.spent.work),
        cpu_seconds: spent.cpu_seconds + plan.spent.cpu_nanos as f64 * 1e-9,
        fraction_of_forecast: 0.0,
    };
    let all = chosen.job.total.work.mean + answer.seed.as_ref().map_or(0.0, |seed| seed.work.mean);
    if all > 0.0 {
        spent.fraction_of_forecast = spent.work as f64 / all;
    }
    chosen.job.cache = Some(answer);
    Ok(chosen)
}

/// Why the one, in a line.
fn compared(shared: &CachePrice, private: &CachePrice) -> String {
    let less = |less: f64, more: f64| 100.0 * (1.0 - less / more.max(f64::MIN_POSITIVE));
    let (records, others) = (shared.records, private.records);
    if shared.work < private.work {
        let percent = less(shared.work, private.work);
        format!(
            "one cache for all frames takes {percent:.0} % less work: {records} records instead of {others}"
        )
    } else {
        let percent = less(private.work, shared.work);
        format!(
            "caches of the frames' own take {percent:.0} % less work: a shared one makes {records} records of {others}"
        )
    }
}

/// All frames of a forecast.
fn price(forecast: &Forecast) -> CachePrice {
    let total = &forecast.job.total;
    CachePrice { records: 0, work: total.work.mean, cpu_seconds: total.cpu_seconds.mean, cost: None }
}

fn sum<'a>(records: impl IntoIterator<Item = &'a u32>) -> u64 {
    records.into_iter().copied().map(u64::from).sum()
}

/// What gathering these records takes, from those of them that the profiles of all frames gathered: a frame that shows nothing and has them all.
fn seed(
    records: &[u32],
    preview: &PreviewResult,
    profiles: &[MeasuredProfile],
    corrections: Option<&Corrections>,
) -> Result<SeedForecast, AdvanceError> {
    let mut strata = vec![Stratum::background(preview.background_prior_cost)];
    let mut frames =
        vec![FramePopulation { number: 0, counts: vec![0], lights: 0, shining: 0, triangles: 0 }];
    let places =
        RecordStrata::add(&mut strata, &mut frames, &[records], preview.record_prior_cost.unwrap_or(1.0));
    let observations: Vec<Observation> = profiles
        .iter()
        .flat_map(|MeasuredProfile { result, node_speed, .. }| {
            result.shared_cache_samples.iter().filter(|sample| (sample.level as usize) < records.len()).map(
                |sample| {
                    let cpu_nanos = at_speed_one(sample.cpu_nanos, *node_speed);
                    let cost = Cost { work: sample.work, cpu_nanos, rays: sample.rays };
                    places.observation(sample.level, cost)
                },
            )
        })
        .collect();
    let surplus = surplus(&frames[0].counts, &observations, &strata);
    make_room(&mut frames[0].counts, &observations);
    let profiled = ProfiledFrame {
        frame: 0,
        observations: &observations,
        expansion: &Expansion::Groups,
        fixed: Cost::default(),
        build: Cost::default(),
    };
    let shot = forecast_shot(&strata, &frames, &[profiled], Calibration::NONE)
        .map_err(|error| {
            AdvanceError::Hopeless(format!("no forecast of the shared irradiance cache: {error}"))
        })?
        .with_known(&[surplus.times(-1.0)], Calibration::NONE);
    let shot = match corrections {
        Some(corrections) => shot.corrected(corrections),
        None => shot,
    };
    let seconds = |quantity: &Quantity| quantiles(quantity, 1e-9);
    Ok(SeedForecast {
        records: records.to_vec(),
        parts: 1,
        work: quantiles(&shot.total.work, 1.0),
        cpu_seconds: seconds(&shot.total.cpu_nanos),
        cost: None,
    })
}

/// What records that were gathered beyond those that there are took: more were measured than this frame has, in a cache of its own. What stands
/// for more than there is in a forecast ([`make_room`]) is taken off again by this.
pub(super) fn surplus(counts: &[u32], observations: &[Observation], strata: &[Stratum]) -> Costs<f64> {
    let mut all = Costs::<f64>::default();
    for (_, place) in strata.iter().zip(0..).filter(|(stratum, _)| stratum.apart) {
        let of_stratum: Vec<&Observation> =
            observations.iter().filter(|observation| observation.stratum == place).collect();
        let there = counts.get(place as usize).map_or(0, |&count| count as usize);
        if of_stratum.len() > there {
            let measured = of_stratum
                .iter()
                .fold(Costs::<f64>::default(), |sum, observation| sum.plus(&Costs::from(observation.cost)));
            let share = (of_stratum.len() - there) as f64 / of_stratum.len() as f64;
            all = all.plus(&measured.times(share));
        }
    }
    all
}
