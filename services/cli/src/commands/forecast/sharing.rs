//! Compares one irradiance cache for all frames with one for each frame.

use crate::commands::cache_error::Asker;
use anyhow::{Context, Result};
use forelight_forecast::Strategy;
use forelight_protocol::{CacheMode, CacheSharing, ForecastDoc, RenderSettings};
use forelight_quote::is_shared_cache_worth_planning;
use forelight_renderer_own::{Quote, SharedPlan, plan_shared};
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::options::QualityOptions;

/// Fails if this quote has no cache, or uses another strategy than snapshot.
pub fn check(sharing: CacheSharing, strategy: Strategy, quality: &QualityOptions) -> Result<(), BadInput> {
    if sharing == CacheSharing::Private {
        return Ok(());
    }
    if quality.cache != Some(CacheMode::On) {
        let reason = "--cache-sharing: there is no irradiance cache to share";
        return Err(BadInput::new(reason).hint("add --cache on"));
    }
    if strategy == Strategy::Snapshot {
        return Ok(());
    }
    let reason = format!(
        "--cache-sharing: caches are compared with the strategy snapshot, not by {}",
        strategy.name()
    );
    Err(BadInput::new(reason).hint("leave out --strategy, or use --cache-sharing private"))
}

/// The quote with the caches as chosen. `None` for private caches, which the given quote has already.
pub fn quote(
    asker: &Asker<'_>,
    settings: &RenderSettings,
    sharing: CacheSharing,
    frames: &[u32],
    quoted: &Quote,
) -> Result<Option<ForecastDoc>> {
    if sharing == CacheSharing::Private {
        return Ok(None);
    }
    let planned = match is_shared_cache_worth_planning(sharing, quoted.preview()) {
        true => Some(plan(asker, settings, frames)?),
        false => None,
    };
    let quote = || quoted.with_sharing(&asker.local.shot, settings, sharing, planned);
    let document = asker.local.pool.install(quote);
    document.map(Some).with_context(|| format!("bundle {}", asker.bundle.display()))
}

fn plan(asker: &Asker<'_>, settings: &RenderSettings, frames: &[u32]) -> Result<SharedPlan> {
    const STEPS: f64 = 1000.0;
    let bar = asker.bars.bar("planning a cache for all", STEPS as u64);
    let progress = |done: f64| bar.set_position((done * STEPS) as u64);
    let plan = || plan_shared(&asker.local.shot, frames, settings, &progress, asker.interrupt.flag());
    let planned = asker.local.pool.install(plan);
    bar.finish_and_clear();
    let planned = planned.with_context(|| format!("bundle {}", asker.bundle.display()))?;
    planned.ok_or_else(|| Interrupted.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::forecast::{Args, run};
    use forelight_renderer_own::QuoteOptions;
    use forelight_terminal::interrupt::Interrupt;
    use forelight_terminal::local::Local;
    use forelight_terminal::options::parsed;
    use forelight_terminal::output::Bars;
    use forelight_terminal::watching::QuoteWatcher;
    use std::path::Path;

    #[test]
    fn both_ways_are_priced_as_a_farm_would_and_the_cheaper_one_is_quoted() {
        let bundle = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/scenes/corridor");
        let fixed =
            ["forecast", bundle, "--frames", "0,8,16", "--width", "32", "--spp", "1", "--preview", "cpu"];
        let cached = ["--ambient-bounces", "1", "--cache", "on", "--cache-rays", "48", "--samples", "64"];
        let args = |more: &[&str]| parsed::<Args>(fixed.iter().chain(&cached).chain(more));
        let wanted = args(&["--cache-sharing", "auto"]);
        let bars = Bars::new(true);
        let interrupt = Interrupt::default();
        let local = Local::open(Path::new(bundle), &wanted.machine, &bars).unwrap();
        let settings = local.settings(&wanted.quality).unwrap();
        let options = QuoteOptions { samples: 64, profile_frames: Some(2), ..QuoteOptions::default() };
        let frames = [0, 8, 16];
        let watcher = QuoteWatcher::new(&bars, frames.len(), &interrupt);
        let quoted = watcher.quote(&local, Path::new(bundle), &frames, &settings, &options).unwrap();
        let asker = Asker { local: &local, bundle: Path::new(bundle), bars: &bars, interrupt: &interrupt };
        let ask = |sharing| quote(&asker, &settings, sharing, &frames, &quoted);
        assert!(ask(CacheSharing::Private).unwrap().is_none());
        let document = ask(CacheSharing::Auto).unwrap().unwrap();
        let cache = document.cache.as_ref().unwrap();
        let shared = cache.shared_price.unwrap();
        assert_eq!(cache.shared, shared.work < cache.private_price.work, "{}", cache.reason);
        assert_eq!(cache.shared, cache.shared_cache.is_some());
        assert!((cache.private_price.work / quoted.document.total.work.mean - 1.0).abs() < 1e-9);
        assert!(document.spent.work > quoted.document.spent.work, "planning for all took something");
        let forced = ask(CacheSharing::Shared).unwrap().unwrap().cache.unwrap();
        assert_eq!((forced.shared, forced.shared_price.unwrap().work), (true, shared.work));

        let refused = run(&args(&["--cache-sharing", "auto", "--strategy", "jittered"]), &interrupt);
        let reason = refused.unwrap_err().to_string();
        assert!(reason.contains("snapshot, not by jittered"), "{reason}");
        run(&wanted, &interrupt).unwrap();
    }
}
