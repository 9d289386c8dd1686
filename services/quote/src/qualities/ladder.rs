//! Defines the settings on each ladder, and marks those worth taking.

use forelight_forecast::accuracy::front_of_known;
use forelight_protocol::{
    AccuracyDoc, AccuracyRung, CacheMode, Integrator, LadderKind, MissingLadder, NextRung, Profiled,
    RenderSettings, SpentOnForecast,
};

/// Cache accuracy on a ladder of a job without a cache, in thousandths.
const USUAL_ACCURACY: u32 = 200;

/// True if a profile with the settings `asked` also prices the rungs of this ladder
/// ([`forelight_protocol::Ladders::Own`]).
pub fn is_own(kind: LadderKind, asked: &RenderSettings) -> bool {
    let cached = asked.cache == CacheMode::On;
    match (kind, asked.integrator) {
        (LadderKind::Path, Integrator::Path) => true,
        (LadderKind::Ambient, Integrator::Ambient) | (LadderKind::Resolution, _) => !cached,
        (LadderKind::CachedSamples, Integrator::Ambient) => cached,
        _ => false,
    }
}

/// Qualities of a ladder, cheapest first. They include `asked` if it is of the ladder's kind.
///
/// # Errors
/// The reason, if these settings have no such ladder.
pub fn ladder(kind: LadderKind, asked: &RenderSettings) -> Result<Vec<RenderSettings>, String> {
    let gathered = RenderSettings { integrator: Integrator::Ambient, cache: CacheMode::Off, ..asked.clone() };
    let spp = |like: RenderSettings| {
        let with = move |spp| RenderSettings { spp, ..like.clone() };
        along(&[1, 4, 16, 64, 256], asked.spp).map(with).collect()
    };
    let own_accuracy = if asked.cache == CacheMode::On { asked.cache_accuracy } else { USUAL_ACCURACY };
    let cached = |cache_accuracy| RenderSettings { cache: CacheMode::On, cache_accuracy, ..gathered.clone() };
    let needs_gathers = || {
        let none = "there is no indirect light: ambient_bounces is 0".to_owned();
        if asked.ambient_bounces == 0 { Err(none) } else { Ok(()) }
    };
    let rungs: Vec<RenderSettings> = match kind {
        LadderKind::Ambient => spp(gathered.clone()),
        LadderKind::Path => spp(RenderSettings { integrator: Integrator::Path, ..gathered.clone() }),
        LadderKind::CachedSamples => {
            needs_gathers()?;
            spp(cached(own_accuracy))
        }
        LadderKind::Cache => {
            needs_gathers()?;
            // The smaller error costs more.
            along(&[100, 150, 200, 300, 400], own_accuracy).rev().map(cached).collect()
        }
        LadderKind::Divisions => {
            needs_gathers()?;
            let with = |ambient_divisions| RenderSettings { ambient_divisions, ..gathered.clone() };
            along(&[4, 16, 64, 256], asked.ambient_divisions).map(with).collect()
        }
        LadderKind::Resolution => {
            let scaled = |pixels: f64| {
                let side = |side: u32| ((f64::from(side) * pixels.sqrt()).round() as u32).max(1);
                RenderSettings { width: side(asked.width), height: side(asked.height), ..asked.clone() }
            };
            let mut rungs: Vec<RenderSettings> = [0.25, 0.5, 1.0, 2.0, 4.0].map(scaled).into();
            rungs.dedup();
            rungs
        }
    };
    let fits = |rung: &RenderSettings| rung.check().map_err(|wrong| wrong.to_string());
    match kind {
        // Leave out resolutions that are too large.
        LadderKind::Resolution => Ok(rungs.into_iter().filter(|rung| fits(rung).is_ok()).collect()),
        _ => rungs.iter().try_for_each(fits).map(|()| rungs),
    }
}

/// The usual values and the present one, ascending, each once.
fn along(usual: &[u32], own: u32) -> impl DoubleEndedIterator<Item = u32> + use<> {
    let all: std::collections::BTreeSet<u32> = usual.iter().copied().chain([own]).collect();
    all.into_iter()
}

/// The document of a frame without ladders, with the reason.
pub fn without_ladders(frame: u32, settings: &RenderSettings, reason: &str) -> AccuracyDoc {
    let missing = LadderKind::ALL.map(|ladder| MissingLadder { ladder, reason: reason.to_owned() });
    AccuracyDoc {
        frames: 1,
        settings: settings.clone(),
        rungs: Vec::new(),
        missing: missing.into(),
        profiled: Profiled { frames: vec![frame], pixels: 0 },
        spent: SpentOnForecast::default(),
        calibrated: false,
    }
}

/// Median CPU seconds and median error of each rung, as it is delivered. `None` for rungs without an error,
/// and for other resolutions.
pub fn points(document: &AccuracyDoc) -> Vec<Option<(f64, f64)>> {
    let point = |rung: &AccuracyRung| {
        let error = rung.delivered_error().filter(|_| rung.ladder != LadderKind::Resolution)?;
        Some((rung.cpu_seconds.p50, error.p50))
    };
    document.rungs.iter().map(point).collect()
}

/// Marks the rungs worth taking, on all their ladders: no other rung is both cheaper and better. Each gets
/// the index of the next better one.
pub fn mark(document: &mut AccuracyDoc) {
    let points = points(document);
    for (own, next) in front_of_known(&points) {
        let Some((cost, error)) = points.get(own).copied().flatten() else { continue };
        let next = next.and_then(|rung| Some((rung, points.get(rung).copied().flatten()?)));
        let next = next.map(|(rung, (next_cost, next_error))| NextRung {
            rung: rung as u32,
            more_cpu_seconds: next_cost - cost,
            times_cpu_seconds: next_cost / cost,
            times_error: next_error / error,
        });
        // The settings asked for are on several ladders.
        let settings = document.rungs[own].settings.clone();
        let same = document.rungs.iter_mut().zip(&points);
        for (rung, _) in same.filter(|(rung, point)| point.is_some() && rung.settings == settings) {
            (rung.worth_taking, rung.next) = (true, next);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::RenderSettingsRequest;

    fn asked() -> RenderSettings {
        let request = RenderSettingsRequest { spp: Some(8), ..RenderSettingsRequest::default() };
        request.complete((640, 360))
    }

    #[test]
    fn every_ladder_rises_and_holds_what_was_asked_for_where_it_can() {
        let asked = asked();
        for kind in LadderKind::ALL {
            let rungs = ladder(kind, &asked).unwrap();
            assert!(rungs.len() >= 4 && rungs.iter().all(|rung| rung.check().is_ok()), "{kind:?}");
            let own = rungs.iter().filter(|rung| **rung == asked).count();
            let expected = !matches!(kind, LadderKind::Path | LadderKind::Cache | LadderKind::CachedSamples);
            assert_eq!(own, usize::from(expected), "{kind:?}");
        }
        let spp: Vec<u32> = ladder(LadderKind::Path, &asked).unwrap().iter().map(|rung| rung.spp).collect();
        assert_eq!(spp, [1, 4, 8, 16, 64, 256]);
        let cached = RenderSettings { cache: CacheMode::On, cache_accuracy: 250, ..asked };
        let accuracies: Vec<u32> =
            ladder(LadderKind::Cache, &cached).unwrap().iter().map(|rung| rung.cache_accuracy).collect();
        assert_eq!(accuracies, [400, 300, 250, 200, 150, 100]);
        assert!(
            ladder(LadderKind::Ambient, &cached).unwrap().iter().all(|rung| rung.cache == CacheMode::Off)
        );
        let sampled: Vec<u32> =
            ladder(LadderKind::CachedSamples, &cached).unwrap().iter().map(|rung| rung.spp).collect();
        assert_eq!(sampled, [1, 4, 8, 16, 64, 256]);
        assert!(ladder(LadderKind::CachedSamples, &cached).unwrap().contains(&cached));
    }

    #[test]
    fn a_ladder_that_cannot_be_is_missing_with_a_reason() {
        let direct = RenderSettings { ambient_bounces: 0, ..asked() };
        assert!(ladder(LadderKind::Cache, &direct).unwrap_err().contains("ambient_bounces is 0"));
        assert!(ladder(LadderKind::Divisions, &direct).is_err() && ladder(LadderKind::Path, &direct).is_ok());
        let deep = RenderSettings { integrator: Integrator::Path, ambient_bounces: 100, ..asked() };
        assert!(ladder(LadderKind::Ambient, &deep).unwrap_err().contains("ambient_bounces"));
        assert!(ladder(LadderKind::Path, &deep).is_ok());
        let huge = RenderSettings { width: 1 << 14, height: 1 << 14, ..asked() };
        assert_eq!(ladder(LadderKind::Resolution, &huge).unwrap().len(), 3);
        let speck = RenderSettings { width: 1, height: 1, ..asked() };
        assert_eq!(ladder(LadderKind::Resolution, &speck).unwrap().len(), 2);
    }
}
