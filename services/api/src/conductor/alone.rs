//! The quote of a shot as a farm would make it, for who has one machine and no farm.

use forelight_forecast::Corrections;
use forelight_protocol::{
    CachePlanResult, CacheSharing, ForecastDoc, PreviewResult, ProfileResult, QuotedShot,
};
use forelight_store::{MeasuredProfile, PlannedCache};

use super::AdvanceError;
use super::sharing;

/// What one machine found out of a shot.
#[derive(Clone, PartialEq, Debug)]
pub struct Measured {
    /// The preview of its frames.
    pub preview: PreviewResult,
    /// The frames that were profiled, beside the shared cache as well if that was planned.
    pub profiles: Vec<ProfileResult>,
    /// The irradiance cache that all frames could share, if it was planned.
    pub cache: Option<CachePlanResult>,
}

/// Whether a cache that all frames share is to be planned before [`quote_alone`], to see what it would take.
pub fn is_shared_cache_worth_planning(asked: CacheSharing, preview: &PreviewResult) -> bool {
    sharing::is_worth_planning(asked, preview)
}

/// The quote of a shot, with its caches made in the way that is asked for, or in the one that takes less work. CPU time is this machine's.
///
/// # Errors
/// If there is none, with the reason.
pub fn quote_alone(
    asked: CacheSharing,
    of: QuotedShot,
    measured: Measured,
    corrections: Option<&Corrections>,
) -> Result<ForecastDoc, String> {
    let settings = &of.settings;
    let Measured { preview, profiles, cache } = measured;
    let profiles: Vec<MeasuredProfile> = profiles
        .into_iter()
        .map(|result| MeasuredProfile { result, node_speed: 1.0, spp: settings.spp })
        .collect();
    let planned = match cache {
        Some(plan) => PlannedCache::There { plan: Box::new(plan), node_speed: 1.0 },
        None => PlannedCache::NotAsked,
    };
    let quoted = sharing::quote(asked, settings, &preview, &profiles, &planned, corrections);
    let forecast = quoted.map_err(|error: AdvanceError| error.to_string())?;
    Ok(forecast.job.document(of, forecast.frames))
}
