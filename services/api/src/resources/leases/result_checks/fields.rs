//! Checks of fields that several kinds of results share. Each takes the JSON pointer of its field.

use std::collections::BTreeSet;

use forelight_protocol::{
    CACHE_BYTES, CacheMode, ImageError, LeftOut, ProcessCosts, RenderSettings, Spent, Stratum,
};

use crate::error::{ApiError, ApiResult};

/// Largest number that the database and all JSON readers involved can hold.
const LARGEST: u64 = i64::MAX as u64;

pub(super) fn wrong(pointer: impl Into<String>, reason: impl Into<String>) -> ApiResult<()> {
    Err(ApiError::invalid(pointer, reason))
}

pub(super) fn storable(pointer: &str, numbers: impl IntoIterator<Item = u64>) -> ApiResult<()> {
    match numbers.into_iter().find(|&number| number > LARGEST) {
        Some(number) => wrong(pointer, format!("{number} is larger than 2⁶³ − 1")),
        None => Ok(()),
    }
}

pub(super) fn spent(pointer: &str, spent: Spent) -> ApiResult<()> {
    storable(pointer, [spent.work, spent.cpu_nanos])
}

pub(super) fn once(pointer: &str, costs: Option<ProcessCosts>) -> ApiResult<()> {
    let ProcessCosts { load, build } = costs.unwrap_or_default();
    spent(&format!("{pointer}/load"), load)?;
    spent(&format!("{pointer}/build"), build)
}

pub(super) fn frame(pointer: &str, found: u32, expected: u32) -> ApiResult<()> {
    if found == expected {
        return Ok(());
    }
    wrong(pointer, format!("this is frame {found}; the task is about frame {expected}"))
}

pub(super) fn frame_count(pointer: &str, found: usize, expected: usize) -> ApiResult<()> {
    if found == expected {
        return Ok(());
    }
    wrong(pointer, format!("there are {found} frames; the task has {expected}"))
}

pub(super) fn levels(settings: &RenderSettings) -> usize {
    match settings.cache {
        CacheMode::On => settings.ambient_bounces as usize,
        CacheMode::Off => 0,
    }
}

pub(super) fn record_levels(pointer: &str, settings: &RenderSettings, found: usize) -> ApiResult<()> {
    let expected = levels(settings);
    if found == expected {
        return Ok(());
    }
    wrong(pointer, format!("there are records of {found} cache levels; the settings call for {expected}"))
}

pub(super) fn cache_bytes(pointer: &str, bytes: u64) -> ApiResult<()> {
    if bytes <= CACHE_BYTES {
        return Ok(());
    }
    wrong(pointer, format!("{bytes} bytes; an irradiance cache has at most {CACHE_BYTES}"))
}

pub(super) fn strata(pointer: &str, strata: &[Stratum]) -> ApiResult<()> {
    let mut seen = BTreeSet::new();
    for (i, stratum) in strata.iter().enumerate() {
        let (object, material) = stratum.identity();
        // The largest number stands for the background.
        for (name, number) in [("object", object), ("material", material)] {
            if number == u32::MAX {
                return wrong(format!("{pointer}/{i}/{name}"), format!("a scene has no {name} {number}"));
            }
        }
        if !seen.insert(stratum.identity()) {
            let reason = format!("material {material} of object {object} is in the list twice");
            return wrong(format!("{pointer}/{i}"), reason);
        }
        prior_cost(&format!("{pointer}/{i}/prior_cost"), stratum.prior_cost)?;
    }
    Ok(())
}

pub(super) fn prior_cost(pointer: &str, cost: f64) -> ApiResult<()> {
    // This form also refuses a NaN.
    if cost > 0.0 && cost <= Stratum::HIGHEST_PRIOR_COST {
        return Ok(());
    }
    wrong(pointer, format!("a prior cost is above 0 and at most {}", Stratum::HIGHEST_PRIOR_COST))
}

/// Checks an image's error: 0 to 10¹².
pub(super) fn image_error(pointer: &str, error: ImageError) -> ApiResult<()> {
    let ImageError { p05, p50, p80, p95 } = error;
    if [p05, p50, p80, p95].iter().all(|error| (0.0..=1e12).contains(error)) {
        return Ok(());
    }
    wrong(pointer, "each quantile of an image's error is 0 to 1e12")
}

pub(super) fn effects(pointer: &str, effects: &[String]) -> ApiResult<()> {
    if effects.len() <= 100 && effects.iter().all(|name| name.len() <= 100) {
        return Ok(());
    }
    wrong(pointer, "there are at most 100 names, each of at most 100 bytes")
}

pub(super) fn left_out(pointer: &str, left_out: &[LeftOut]) -> ApiResult<()> {
    const LONGEST: usize = 4096;
    let fits = |left: &LeftOut| left.what.len() <= LONGEST && left.reason.len() <= LONGEST;
    if left_out.len() <= LeftOut::MOST && left_out.iter().all(fits) {
        return Ok(());
    }
    wrong(pointer, format!("there are at most {} entries, each of at most {LONGEST} bytes", LeftOut::MOST))
}
