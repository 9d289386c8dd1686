//! What accuracy costs in time: ladders of qualities, with what each takes and how far its image will be from the converged one.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{CacheMode, Confidence, Integrator, Profiled, Quantiles, RenderSettings, SpentOnForecast};

/// What is changed along a ladder; all else is as it was asked for.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LadderKind {
    /// Camera samples a pixel, with the integrator `ambient` and without an irradiance cache.
    Ambient,
    /// Camera samples a pixel, with the integrator `path`.
    Path,
    /// Camera samples a pixel, with the integrator `ambient` and an irradiance cache: of the accuracy that was asked for, or the usual one.
    CachedSamples,
    /// The error that an irradiance cache may make, with the integrator `ambient`.
    Cache,
    /// Hemisphere rays of a gather, with the integrator `ambient` and without a cache.
    Divisions,
    /// Pixels, with all else as it was asked for. The error is that of the pixels that are delivered, each against its own
    /// converged self: an image of more pixels is as far from its own converged self, and shows more. So these rungs are not held
    /// against the others.
    Resolution,
}

/// Which ladders of qualities are part of a job's quote.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Ladders {
    /// Those that the job's own profile speaks of: camera samples and, without a cache, resolutions.
    #[default]
    Own,
    /// All of them: one frame is profiled with the other settings too, before the job is quoted. That takes about as much as half a million camera
    /// samples of it, whatever its size and the length of the shot: a few percent of a large frame, several times a small one. What it took is part
    /// of what the quote did.
    All,
}

impl Ladders {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Ladders::Own => "own",
            Ladders::All => "all",
        }
    }

    /// Whether they are the usual ones.
    pub fn are_own(&self) -> bool {
        *self == Ladders::Own
    }
}

/// Accuracy of an irradiance cache that nobody asked for, in thousandths.
const USUAL_ACCURACY: u32 = 200;

impl LadderKind {
    /// All of them, in the order in which they are listed.
    pub const ALL: [LadderKind; 6] = [
        LadderKind::Ambient,
        LadderKind::Path,
        LadderKind::CachedSamples,
        LadderKind::Cache,
        LadderKind::Divisions,
        LadderKind::Resolution,
    ];

    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            LadderKind::Ambient => "ambient",
            LadderKind::Path => "path",
            LadderKind::CachedSamples => "cached_samples",
            LadderKind::Cache => "cache",
            LadderKind::Divisions => "divisions",
            LadderKind::Resolution => "resolution",
        }
    }

    /// Whether pixels that were profiled with these settings tell what its rungs take: it is one of [`Ladders::Own`].
    pub fn is_own(self, asked: &RenderSettings) -> bool {
        let cached = asked.cache == CacheMode::On;
        match (self, asked.integrator) {
            (LadderKind::Path, Integrator::Path) => true,
            (LadderKind::Ambient, Integrator::Ambient) | (LadderKind::Resolution, _) => !cached,
            (LadderKind::CachedSamples, Integrator::Ambient) => cached,
            _ => false,
        }
    }

    /// The qualities of the ladder, from the cheapest to the dearest. That of `asked` is among them if it is one of the ladder's kind.
    ///
    /// # Errors
    /// In words, why there is no such ladder of these settings.
    pub fn rungs(self, asked: &RenderSettings) -> Result<Vec<RenderSettings>, String> {
        let gathered =
            RenderSettings { integrator: Integrator::Ambient, cache: CacheMode::Off, ..asked.clone() };
        let spp = |like: RenderSettings| {
            let with = move |spp| RenderSettings { spp, ..like.clone() };
            along(&[1, 4, 16, 64, 256], asked.spp).map(with).collect()
        };
        let own_accuracy = if asked.cache == CacheMode::On { asked.cache_accuracy } else { USUAL_ACCURACY };
        let cached =
            |cache_accuracy| RenderSettings { cache: CacheMode::On, cache_accuracy, ..gathered.clone() };
        let needs_gathers = || {
            let none = "there is no indirect light: ambient_bounces is 0".to_owned();
            if asked.ambient_bounces == 0 { Err(none) } else { Ok(()) }
        };
        let rungs: Vec<RenderSettings> = match self {
            LadderKind::Ambient => spp(gathered.clone()),
            LadderKind::Path => spp(RenderSettings { integrator: Integrator::Path, ..gathered.clone() }),
            LadderKind::CachedSamples => {
                needs_gathers()?;
                spp(cached(own_accuracy))
            }
            LadderKind::Cache => {
                needs_gathers()?;
                // A smaller error is the dearer one.
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
        match self {
            // One that is too large is left out; the others are what they are.
            LadderKind::Resolution => Ok(rungs.into_iter().filter(|rung| fits(rung).is_ok()).collect()),
            _ => rungs.iter().try_for_each(fits).map(|()| rungs),
        }
    }
}

/// Usual values and one more, ascending, each once.
fn along(usual: &[u32], own: u32) -> impl DoubleEndedIterator<Item = u32> + use<> {
    let all: std::collections::BTreeSet<u32> = usual.iter().copied().chain([own]).collect();
    all.into_iter()
}

/// The error of an image that is forecast: the values that it stays below with these probabilities. The error is the root mean
/// square of (pixel − converged pixel) over all pixels and channels, as a share of the mean of the converged image. Converged is
/// the image of the same integrator with endless camera samples, and nothing interpolated.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
pub struct ImageError {
    /// 5 % quantile.
    pub p05: f64,
    /// Median.
    pub p50: f64,
    /// 80 % quantile.
    pub p80: f64,
    /// 95 % quantile.
    pub p95: f64,
}

impl ImageError {
    /// The value at a confidence.
    pub const fn at(&self, confidence: Confidence) -> f64 {
        match confidence {
            Confidence::P50 => self.p50,
            Confidence::P80 => self.p80,
            Confidence::P95 => self.p95,
        }
    }
}

/// The way from a rung that is worth taking to the next better one.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct NextRung {
    /// Its index in the list of rungs.
    pub rung: u32,
    /// CPU seconds that it takes more, by the medians.
    pub more_cpu_seconds: f64,
    /// Its CPU time over that of this rung.
    pub times_cpu_seconds: f64,
    /// Its error over that of this rung.
    pub times_error: f64,
}

/// What a rung took and came to when it was rendered.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct MeasuredRung {
    /// Deterministic count of operations.
    pub work: u64,
    /// CPU seconds.
    pub cpu_seconds: f64,
    /// Error as in [`ImageError`], without that of the image that it was held against. 0 where it is too small to be told from it.
    pub error: f64,
    /// Standard deviation of that number, for want of pixels.
    pub error_deviation: f64,
}

/// A quality, what it takes and how good it is.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct AccuracyRung {
    /// The ladder that it is of. A quality that is on several ladders is listed once on each.
    pub ladder: LadderKind,
    /// All settings.
    pub settings: RenderSettings,
    /// Whether these are the settings that were asked for.
    pub asked_for: bool,
    /// Deterministic count of operations.
    pub work: Quantiles,
    /// CPU seconds over all threads, on a node of speed 1.
    pub cpu_seconds: Quantiles,
    /// How far the image will be from its converged self; absent where the profiled pixels do not tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<ImageError>,
    /// Whether it is worth taking: no other rung is both cheaper and better, by the medians. Never of a ladder of resolutions.
    pub worth_taking: bool,
    /// The next better rung that is worth taking; absent for the best, and for those that are not worth taking.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next: Option<NextRung>,
    /// What it took and came to, if it was rendered to find out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<MeasuredRung>,
}

/// A ladder that is missing, or has no errors, or a rung of it that is left out.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct MissingLadder {
    /// The ladder.
    pub ladder: LadderKind,
    /// Why.
    pub reason: String,
}

/// What accuracy costs in time, as `forelight accuracy --json` (of one frame) and `GET /v1/jobs/{id}/accuracy` (of all frames of a
/// job) give it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct AccuracyDoc {
    /// Number of frames that `work` and `cpu_seconds` are of, all together.
    pub frames: u32,
    /// The settings that were asked for.
    pub settings: RenderSettings,
    /// The rungs, ladder by ladder, from the cheapest settings to the dearest.
    pub rungs: Vec<AccuracyRung>,
    /// Ladders that are missing or have no errors, rungs that are left out, and why.
    pub missing: Vec<MissingLadder>,
    /// Frames and pixels that the predictions rest on. Errors are those of the profiled frames: root mean square over them.
    pub profiled: Profiled,
    /// What the predictions took; its fraction is that of one frame of the settings that were asked for, or of the job.
    pub spent: SpentOnForecast,
    /// Whether the quantiles have been calibrated; if not, they rest on the statistics alone.
    pub calibrated: bool,
}

impl AccuracyDoc {
    /// Of one frame whose ladders are all missing, for this reason.
    pub fn missing(frame: u32, settings: &RenderSettings, reason: &str) -> Self {
        let missing = LadderKind::ALL.map(|ladder| MissingLadder { ladder, reason: reason.to_owned() });
        Self {
            frames: 1,
            settings: settings.clone(),
            rungs: Vec::new(),
            missing: missing.into(),
            profiled: Profiled { frames: vec![frame], pixels: 0 },
            spent: SpentOnForecast::default(),
            calibrated: false,
        }
    }

    /// What the rungs that can be held against each other cost in CPU seconds, and their errors, by the medians; none of the others.
    pub fn points(&self) -> Vec<Option<(f64, f64)>> {
        let point = |rung: &AccuracyRung| {
            let error = rung.error.filter(|_| rung.ladder != LadderKind::Resolution)?;
            Some((rung.cpu_seconds.p50, error.p50))
        };
        self.rungs.iter().map(point).collect()
    }

    /// Marks the rungs that are worth taking: these and those of the same settings, each with the index of the next better one.
    pub fn mark(&mut self, front: impl IntoIterator<Item = (usize, Option<usize>)>) {
        let points = self.points();
        for (own, next) in front {
            let Some((cost, error)) = points.get(own).copied().flatten() else { continue };
            let next = next.and_then(|rung| Some((rung, points.get(rung).copied().flatten()?)));
            let next = next.map(|(rung, (next_cost, next_error))| NextRung {
                rung: rung as u32,
                more_cpu_seconds: next_cost - cost,
                times_cpu_seconds: next_cost / cost,
                times_error: next_error / error,
            });
            // What was asked for stands in several ladders.
            let settings = self.rungs[own].settings.clone();
            let same = self.rungs.iter_mut().zip(&points);
            for (rung, _) in same.filter(|(rung, point)| point.is_some() && rung.settings == settings) {
                (rung.worth_taking, rung.next) = (true, next);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RenderSettingsRequest;

    fn asked() -> RenderSettings {
        let request = RenderSettingsRequest { spp: Some(8), ..RenderSettingsRequest::default() };
        request.complete((640, 360))
    }

    #[test]
    fn every_ladder_rises_and_holds_what_was_asked_for_where_it_can() {
        let asked = asked();
        for kind in LadderKind::ALL {
            let rungs = kind.rungs(&asked).unwrap();
            assert!(rungs.len() >= 4 && rungs.iter().all(|rung| rung.check().is_ok()), "{kind:?}");
            let own = rungs.iter().filter(|rung| **rung == asked).count();
            let expected = !matches!(kind, LadderKind::Path | LadderKind::Cache | LadderKind::CachedSamples);
            assert_eq!(own, usize::from(expected), "{kind:?}");
        }
        let spp: Vec<u32> = LadderKind::Path.rungs(&asked).unwrap().iter().map(|rung| rung.spp).collect();
        assert_eq!(spp, [1, 4, 8, 16, 64, 256]);
        let cached = RenderSettings { cache: CacheMode::On, cache_accuracy: 250, ..asked };
        let accuracies: Vec<u32> =
            LadderKind::Cache.rungs(&cached).unwrap().iter().map(|rung| rung.cache_accuracy).collect();
        assert_eq!(accuracies, [400, 300, 250, 200, 150, 100]);
        assert!(LadderKind::Ambient.rungs(&cached).unwrap().iter().all(|rung| rung.cache == CacheMode::Off));
        let sampled: Vec<u32> =
            LadderKind::CachedSamples.rungs(&cached).unwrap().iter().map(|rung| rung.spp).collect();
        assert_eq!(sampled, [1, 4, 8, 16, 64, 256]);
        assert!(LadderKind::CachedSamples.rungs(&cached).unwrap().contains(&cached));
    }

    #[test]
    fn a_ladder_that_cannot_be_is_missing_with_a_reason() {
        let direct = RenderSettings { ambient_bounces: 0, ..asked() };
        assert!(LadderKind::Cache.rungs(&direct).unwrap_err().contains("ambient_bounces is 0"));
        assert!(LadderKind::Divisions.rungs(&direct).is_err() && LadderKind::Path.rungs(&direct).is_ok());
        let deep = RenderSettings { integrator: Integrator::Path, ambient_bounces: 100, ..asked() };
        assert!(LadderKind::Ambient.rungs(&deep).unwrap_err().contains("ambient_bounces"));
        assert!(LadderKind::Path.rungs(&deep).is_ok());
        let huge = RenderSettings { width: 1 << 14, height: 1 << 14, ..asked() };
        assert_eq!(LadderKind::Resolution.rungs(&huge).unwrap().len(), 3);
        let speck = RenderSettings { width: 1, height: 1, ..asked() };
        assert_eq!(LadderKind::Resolution.rungs(&speck).unwrap().len(), 2);
    }
}
