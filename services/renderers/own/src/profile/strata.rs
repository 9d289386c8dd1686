//! Strata of a shot, and prior costs, for the forecast.

use crate::answers::StratumInfo;
use forelight_forecast::Stratum;
use forelight_protocol::{CacheMode, MaterialMode, RenderSettings};
use forelight_scene::MaterialClass;

/// The shot's strata for the forecast, the background last.
///
/// Prior costs only steer the first samples. Glass sends out several times the rays of a wall.
pub fn forecast_strata(strata: &[StratumInfo], settings: &RenderSettings) -> Vec<Stratum> {
    const TRANSPARENT: f64 = 3.0;
    const SPECULAR: f64 = 2.0;
    const DIFFUSE: f64 = 1.0;
    const BACKGROUND: f64 = 0.1;
    let prior = |class| match (settings.materials, class) {
        (MaterialMode::Lambert, _) | (_, MaterialClass::Diffuse) => DIFFUSE,
        (_, MaterialClass::Specular) => SPECULAR,
        (_, MaterialClass::Transparent) => TRANSPARENT,
    };
    let known = strata.iter().map(|s| Stratum {
        object: s.object,
        material: s.material,
        prior_cost: prior(s.class),
        apart: false,
    });
    known.chain([Stratum::background(BACKGROUND)]).collect()
}

/// Prior cost of gathering a record, relative to a plain diffuse pixel. `None` without a cache.
pub fn record_prior_cost(settings: &RenderSettings) -> Option<f64> {
    let cost = f64::from(settings.cache_rays) / f64::from(settings.spp);
    (settings.cache == CacheMode::On).then_some(cost)
}
