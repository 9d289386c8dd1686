//! Chooses between one irradiance cache for all frames of a shot and one per frame, by price.
//!
//! Both prices use the same measurements. The preview counts the records of each frame's own cache. The plan
//! of the shared cache counts its records, and those that each frame needs beside it. The profiles measured
//! the cost of a record. A shared cache is paid for once, on its own line of the quote, and no frame is
//! charged for it. Planning it counts as cost of the quote, whatever the choice.

use forelight_forecast::{
    Calibration, Corrections, Cost, Expansion, Observation, ProfiledFrame, Quantity, forecast_shot,
};
use forelight_protocol::{
    CACHE_BYTES, CacheMode, CachePrice, CacheQuote, CacheSharing, PreviewResult, RenderSettings,
    SharedCacheForecast, at_speed_one,
};

use crate::error::QuoteError;
use crate::estimate::{make_room, records_alone, surplus};
use crate::job_forecast::{Quote, SharedCacheToBuild, quantiles};
use crate::measured::{Measured, MeasuredProfile, SharedCache};

/// True if a shared cache should be planned, so that [`quote`] can price it.
pub fn is_shared_cache_worth_planning(asked: CacheSharing, preview: &PreviewResult) -> bool {
    let has_records = preview.frames.iter().any(|frame| frame.cache_records.iter().any(|&count| count > 0));
    has_records
        && match asked {
            CacheSharing::Auto => preview.frames.len() > 1,
            CacheSharing::Shared => true,
            CacheSharing::Private => false,
        }
}

/// The quote of a shot, with caches as asked for or the cheaper way. [`Measured::shared`] is the planned
/// shared cache, or `None` if none was planned.
///
/// # Errors
/// Those of [`Measured::estimate`], and if a shared cache is asked for and is too large.
pub fn quote(
    asked: CacheSharing,
    settings: &RenderSettings,
    measured: &Measured<'_>,
    corrections: Option<&Corrections>,
) -> Result<Quote, QuoteError> {
    let mut private = measured.with_cache(None).quote(corrections)?;
    if settings.cache == CacheMode::Off {
        return Ok(private);
    }
    let of_frames = measured.preview.frames.iter().flat_map(|frame| &frame.cache_records);
    let private_price = CachePrice { records: sum(of_frames), ..price(&private) };
    let mut answer = CacheQuote {
        asked,
        shared: false,
        reason: String::new(),
        private_price,
        shared_price: None,
        shared_cache: None,
    };
    let Some(shared) = measured.shared else {
        answer.reason = match asked {
            CacheSharing::Private => "the job asks for it",
            _ if private_price.records == 0 => "no frame needs a record",
            _ => "there is only one frame",
        }
        .to_owned();
        private.job.cache = Some(answer);
        return Ok(private);
    };
    let plan = shared.plan;
    let mut chosen = if let Some(cache) = plan.cache {
        let priced = price_shared(measured, shared, corrections)?;
        let planned = SharedCacheToBuild { cache, bytes: plan.bytes, records: sum(&plan.records) };
        choose(&mut answer, private, priced, planned)
    } else if asked == CacheSharing::Shared {
        return Err(QuoteError::CacheTooLarge(plan.bytes));
    } else {
        answer.reason = format!(
            "a cache for all frames would take {} bytes; the limit of a shared one is {CACHE_BYTES}",
            plan.bytes
        );
        private.job.cache = Some(answer);
        return Ok(private);
    };
    let spent = &mut chosen.job.spent;
    spent.work = spent.work.saturating_add(plan.spent.work);
    spent.cpu_seconds += plan.spent.cpu_nanos as f64 * 1e-9;
    let all = chosen.job.total.work.mean + answer.shared_cache.as_ref().map_or(0.0, |cache| cache.work.mean);
    spent.fraction_of_forecast = if all > 0.0 { spent.work as f64 / all } else { 0.0 };
    chosen.job.cache = Some(answer);
    Ok(chosen)
}

struct SharedQuote {
    frames: Quote,
    cache: SharedCacheForecast,
    price: CachePrice,
}

fn price_shared(
    measured: &Measured<'_>,
    shared: SharedCache<'_>,
    corrections: Option<&Corrections>,
) -> Result<SharedQuote, QuoteError> {
    let plan = shared.plan;
    let frames = measured.with_cache(Some(shared)).quote(corrections)?;
    let cache = forecast_cache(&plan.records, measured, corrections)?;
    let own = sum(plan.frames.iter().flat_map(|frame| &frame.own));
    let of_frames = price(&frames);
    let price = CachePrice {
        records: sum(&plan.records) + own,
        work: of_frames.work + cache.work.mean,
        cpu_seconds: of_frames.cpu_seconds + cache.cpu_seconds.mean,
        cost: None,
    };
    Ok(SharedQuote { frames, cache, price })
}

/// Chooses one of the two ways, and records the reason.
fn choose(
    answer: &mut CacheQuote,
    private: Quote,
    shared: SharedQuote,
    planned: SharedCacheToBuild,
) -> Quote {
    answer.shared_price = Some(shared.price);
    answer.shared = match answer.asked {
        CacheSharing::Shared => true,
        CacheSharing::Private => false,
        CacheSharing::Auto => shared.price.work < answer.private_price.work,
    };
    answer.reason = match answer.asked {
        CacheSharing::Auto => compared(&shared.price, &answer.private_price),
        CacheSharing::Shared | CacheSharing::Private => "the job asks for it".to_owned(),
    };
    if !answer.shared {
        return private;
    }
    answer.shared_cache = Some(shared.cache);
    Quote { shared_cache: Some(planned), ..shared.frames }
}

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
            "a cache for each frame takes {percent:.0} % less work: a shared cache has {records} records, the others have {others}"
        )
    }
}

fn price(quote: &Quote) -> CachePrice {
    let total = &quote.job.total;
    CachePrice { records: 0, work: total.work.mean, cpu_seconds: total.cpu_seconds.mean, cost: None }
}

fn sum<'a>(records: impl IntoIterator<Item = &'a u32>) -> u64 {
    records.into_iter().copied().map(u64::from).sum()
}

/// Cost of gathering the records of the shared cache. The statistics see one frame without pixels that has
/// all of the records. The profiles of all frames gathered a sample of them.
fn forecast_cache(
    records: &[u32],
    measured: &Measured<'_>,
    corrections: Option<&Corrections>,
) -> Result<SharedCacheForecast, QuoteError> {
    let preview = measured.preview;
    let prior_cost = preview.record_prior_cost.unwrap_or(1.0);
    let (strata, mut frames, places) = records_alone(preview.background_prior_cost, prior_cost, records);
    let mut observations: Vec<Observation> = Vec::new();
    for MeasuredProfile { result, node_speed, .. } in measured.profiles {
        let samples = result.shared_cache_samples.iter();
        for sample in samples.filter(|sample| (sample.level as usize) < records.len()) {
            let cpu_nanos = at_speed_one(sample.cpu_nanos, *node_speed);
            let cost = Cost { work: sample.work, cpu_nanos, rays: sample.rays };
            observations.push(places.observation(sample.level, cost));
        }
    }
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
        .map_err(QuoteError::SharedCache)?
        .with_known(&[surplus.times(-1.0)], Calibration::NONE);
    let shot = match corrections {
        Some(corrections) => shot.corrected(corrections),
        None => shot,
    };
    let seconds = |quantity: &Quantity| quantiles(quantity, 1e-9);
    Ok(SharedCacheForecast {
        records: records.to_vec(),
        parts: 1,
        work: quantiles(&shot.total.work, 1.0),
        cpu_seconds: seconds(&shot.total.cpu_nanos),
        cost: None,
    })
}
