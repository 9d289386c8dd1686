//! What accuracy costs in time, for one frame, on this machine alone.
//!
//! | file | subject |
//! | --- | --- |
//! | `pilot` | profiled pixels of one kind of setting: their cost and their error |
//! | `gathers` | how other gathers change the error of the same pixels |
//! | `interpolation` | the error that an irradiance cache adds |
//! | `cache_error`, `blocks` | settings of a cache for an error; images in blocks of pixels |
//! | `denoising`, `tiles` | the error that a denoiser leaves; the tiles in which it is tried out |
//! | `measure` | measured errors: rungs rendered and compared to converged images |
//!
//! Every kind of setting (an integrator, a number of divisions, an accuracy of the cache) is profiled once,
//! by a *pilot*, with a few camera samples per pixel. A rung's cost follows as in a quote. Its error follows
//! from the spectrum of its variance (`forelight_forecast::accuracy`) and, with a cache, from the
//! interpolation error, which does not fall with samples. Other resolutions share the pilot of the settings
//! that were asked for.

mod blocks;
mod cache_error;
mod denoising;
mod gathers;
mod interpolation;
mod measure;
mod observer;
mod pilot;
mod tiles;

pub use blocks::Blocks;
pub use cache_error::{ChosenCache, choose_cache};
pub use denoising::DenoiseBy;
#[cfg(test)]
pub(crate) use measure::Converged;
#[cfg(test)]
pub(crate) use measure::direct_light;
pub use measure::{MeasureOptions, measure};
use observer::is_cancelled;
pub use observer::{AccuracyObserver, AccuracyOptions};
pub(crate) use pilot::Pilot;

use crate::error::ShotError;
use crate::frame::OwnFrame;
use crate::quote_options::QuoteOptions;
use crate::shot::OwnShot;
use denoising::{Chosen, Left};
use forelight_forecast::Calibration;
use forelight_protocol::{
    AccuracyDoc, AccuracyRung, CacheMode, Integrator, LadderKind, MissingLadder, Profiled, Quantiles,
    RenderSettings, Spent,
};
use forelight_quote::{ladder, mark};
use gathers::{affordable, is_too_dear, relate};
use interpolation::Truth;
use pilot::View;

/// Camera samples of a profiled pixel: enough for four doublings.
const PILOT_SPP: u32 = 16;

/// Gather rays of a profiled pixel, over all its camera samples. May be more, see [`LEAST_SPP`].
const PILOT_RAYS: u32 = 256;

/// Least pixels to profile where gathers have many rays, instead of the usual number.
const LEAST_SAMPLES: u32 = 48;

/// Least camera samples of a profiled pixel: two doublings.
const LEAST_SPP: u32 = 4;

/// Larger images are left out, unless a larger one was asked for: a preview needs 32 bytes per pixel.
const MOST_PIXELS: u64 = 1 << 26;

/// Predicts these ladders. Of the other ladders, only the rung that was asked for.
pub fn predict(
    shot: &OwnShot,
    frame: u32,
    asked: &RenderSettings,
    ladders: &[LadderKind],
    options: &AccuracyOptions<'_>,
    observer: &dyn AccuracyObserver,
) -> Result<AccuracyDoc, ShotError> {
    let mut missing = Vec::new();
    let mut wanted = Vec::new();
    for kind in LadderKind::ALL {
        match (ladder(kind, asked), ladders.contains(&kind)) {
            (Ok(rungs), true) => wanted.push((kind, rungs)),
            (Err(reason), true) => missing.push(MissingLadder { ladder: kind, reason }),
            // The rung that the others are compared to.
            (Ok(rungs), false) if rungs.contains(asked) => wanted.push((kind, vec![asked.clone()])),
            (_, false) => {}
        }
    }
    let rungs = || wanted.iter().flat_map(|(_, rungs)| rungs);
    let mut kinds: Vec<_> = rungs().map(kind_of_noise).collect();
    kinds.sort_unstable_by_key(|&(integrator, cache)| (integrator as u8, cache as u8));
    kinds.dedup();
    // Tiles to denoise are chosen once, and tried for each kind of noise.
    let all = rungs().count() + options.denoise.map_or(0, |_| 1 + kinds.len());
    let mut prediction =
        Prediction { missing, all, ..Prediction::new(shot, frame, asked, options, observer) };
    for (kind, rungs) in wanted {
        prediction.ladder(kind, &rungs)?;
    }
    Ok(prediction.document())
}

struct Prediction<'a> {
    shot: &'a OwnShot,
    frame: u32,
    asked: &'a RenderSettings,
    options: &'a AccuracyOptions<'a>,
    observer: &'a dyn AccuracyObserver,
    pilots: Vec<Pilot>,
    truth: Option<Truth>,
    tiles: Option<Chosen>,
    /// What a denoiser leaves, for an integrator with or without a cache.
    left: Vec<((Integrator, CacheMode), Left)>,
    rungs: Vec<AccuracyRung>,
    missing: Vec<MissingLadder>,
    /// Cost beside the pilots.
    spent: Spent,
    done: usize,
    all: usize,
}

impl<'a> Prediction<'a> {
    fn new(
        shot: &'a OwnShot,
        frame: u32,
        asked: &'a RenderSettings,
        options: &'a AccuracyOptions<'a>,
        observer: &'a dyn AccuracyObserver,
    ) -> Self {
        Self {
            shot,
            frame,
            asked,
            options,
            observer,
            pilots: Vec::new(),
            truth: None,
            tiles: None,
            left: Vec::new(),
            rungs: Vec::new(),
            missing: Vec::new(),
            spent: Spent::default(),
            done: 0,
            all: 0,
        }
    }

    fn ladder(&mut self, kind: LadderKind, rungs: &[RenderSettings]) -> Result<(), ShotError> {
        for settings in rungs {
            if is_cancelled(self.observer) {
                return Err(ShotError::Cancelled);
            }
            let is_dear = || {
                let (first, other) = (self.gathers_asked_for(), piloted(settings));
                is_too_dear(self.options.samples, LEAST_SAMPLES, &first, &other)
            };
            let left_out = match kind {
                LadderKind::Divisions if is_dear() => Some(format!(
                    "{} rays with {} bounces: profiling a few pixels would take longer than everything else",
                    settings.ambient_divisions, settings.ambient_bounces
                )),
                LadderKind::Resolution => too_large(settings, self.asked),
                _ => None,
            };
            if let Some(reason) = left_out {
                self.missing.push(MissingLadder { ladder: kind, reason });
                self.step();
                continue;
            }
            let like = match kind {
                LadderKind::Resolution => self.asked,
                _ => settings,
            };
            let pilot = self.pilot(like)?;
            let view = match kind {
                LadderKind::Resolution => self.view(settings, pilot)?,
                _ => self.pilots[pilot].view.clone(),
            };
            let left = self.options.denoise.map(|by| self.left(pilot, by)).transpose()?;
            let pilot = &self.pilots[pilot];
            let (work, mut cpu_seconds) = pilot.cost(&view, settings.spp)?;
            let mut denoised_error = None;
            if let Some(left) = left.map(|left| &self.left[left].1) {
                denoised_error = Some(left.error(pilot.noisy(&view, settings.spp)?));
                let more = left.cpu_seconds(settings, pilot.traced_seconds(&view, settings.spp)?);
                cpu_seconds = cpu_seconds.plus(&Quantiles::known(more));
            }
            self.rungs.push(AccuracyRung {
                ladder: kind,
                settings: settings.clone(),
                asked_for: settings == self.asked,
                work,
                cpu_seconds,
                error: Some(pilot.error(&view, settings.spp)?),
                denoised_error,
                worth_taking: false,
                next: None,
                measured: None,
            });
            self.step();
        }
        Ok(())
    }

    fn step(&mut self) {
        self.done += 1;
        self.observer.predicted(self.done, self.all);
    }

    fn pilot(&mut self, settings: &RenderSettings) -> Result<usize, ShotError> {
        let settings = piloted(settings);
        if let Some(known) = self.pilots.iter().position(|pilot| pilot.settings == settings) {
            return Ok(known);
        }
        // Settings close to the gathers that were asked for are compared to these on the same pixels.
        let first = self.gathers_asked_for();
        let known = match settings.integrator {
            Integrator::Ambient if settings != first => Some(self.pilot(&first)?),
            _ => None,
        };
        let ready = self.shot.frame(self.frame, &settings)?;
        let samples = match settings.cache {
            CacheMode::Off if settings.integrator == Integrator::Ambient => {
                affordable(self.options.samples, LEAST_SAMPLES, &first, &settings)
            }
            _ => self.options.samples,
        };
        // The noise of a pilot that is compared to another follows from that one's.
        let (seed, scans) = (self.options.seed, known.is_none());
        let options = QuoteOptions { samples, seed, scans, ..QuoteOptions::default() };
        let mut pilot = Pilot::new(self.shot, &ready, settings, &options, self.observer)?;
        if let Some(first) = known.map(|known| &self.pilots[known]) {
            if pilot.settings.cache == CacheMode::Off {
                relate(self.shot, &ready, first, &mut pilot, self.observer)?;
            } else {
                let truth = match self.truth.take() {
                    Some(truth) => truth,
                    None => {
                        let truth = Truth::new(self.shot, self.frame, first, self.observer)?;
                        self.spent = self.spent.plus(truth.spent);
                        truth
                    }
                };
                self.truth.insert(truth).interpolated(&ready, &first.noise, &mut pilot, self.observer)?;
            }
        }
        self.pilots.push(pilot);
        Ok(self.pilots.len() - 1)
    }

    /// What a denoiser leaves of the noise of settings like a pilot's: the place in [`Self::left`].
    fn left(&mut self, pilot: usize, by: DenoiseBy<'_>) -> Result<usize, ShotError> {
        let asked = self.pilot(self.asked)?;
        let kind = kind_of_noise(&self.pilots[pilot].settings);
        if let Some(known) = self.left.iter().position(|(known, _)| *known == kind) {
            return Ok(known);
        }
        let chosen = match self.tiles.take() {
            Some(chosen) => chosen,
            None => {
                let (shot, seed) = (self.shot, self.options.seed);
                let (chosen, spent) =
                    denoising::choose(shot, self.frame, self.asked, seed, by, self.observer)?;
                self.spent = self.spent.plus(spent);
                self.step();
                chosen
            }
        };
        let pilot = &self.pilots[pilot];
        let ready = self.shot.frame(self.frame, &pilot.settings)?;
        let noise = |spp: u32| Ok(pilot.noisy(&pilot.view, spp)?.noise.p50);
        // The mean of few pixels is less sure than its ratio for two kinds of settings on the same pixels.
        let ratio = pilot.mean()? / self.pilots[asked].mean()?;
        let (tiles, mean) = &chosen;
        let mean = mean.map(|mean| mean * ratio);
        let (left, spent) = Left::measure(&ready, tiles, mean, noise, by, self.observer)?;
        self.spent = self.spent.plus(ready.spent_on_setup()).plus(ready.fixed().plan).plus(spent);
        self.tiles = Some(chosen);
        self.left.push((kind, left));
        self.step();
        Ok(self.left.len() - 1)
    }

    /// The pilot's settings for gathers as they were asked for, without a cache.
    fn gathers_asked_for(&self) -> RenderSettings {
        let gathered =
            RenderSettings { integrator: Integrator::Ambient, cache: CacheMode::Off, ..self.asked.clone() };
        piloted(&gathered)
    }

    /// What the frame shows at another resolution than the pilot's.
    fn view(&mut self, settings: &RenderSettings, pilot: usize) -> Result<View, ShotError> {
        let pilot = &self.pilots[pilot];
        let own = &pilot.settings;
        if (settings.width, settings.height) == (own.width, own.height) {
            return Ok(pilot.view.clone());
        }
        let ready: OwnFrame<'_> = self.shot.frame(self.frame, settings)?;
        let (view, spent) = View::of(&ready)?;
        self.spent = self.spent.plus(spent);
        Ok(view)
    }

    fn document(self) -> AccuracyDoc {
        let spent = self.pilots.iter().map(|pilot| pilot.spent).fold(self.spent, Spent::plus);
        let asked = self.rungs.iter().find(|rung| rung.asked_for).map_or(0.0, |rung| rung.work.mean);
        let mut document = AccuracyDoc {
            frames: 1,
            settings: self.asked.clone(),
            rungs: self.rungs,
            missing: self.missing,
            profiled: Profiled {
                frames: vec![self.frame],
                pixels: self.pilots.iter().map(|pilot| pilot.profiled()).sum(),
            },
            spent: spent.on_forecast(asked),
            calibrated: Calibration::NONE.calibrated,
        };
        mark(&mut document);
        document
    }
}

/// Settings of a kind keep about the same share of their noise when it is removed.
fn kind_of_noise(settings: &RenderSettings) -> (Integrator, CacheMode) {
    (settings.integrator, settings.cache)
}

fn too_large(settings: &RenderSettings, asked: &RenderSettings) -> Option<String> {
    let RenderSettings { width, height, .. } = settings;
    let why = || format!("{width} × {height}: a preview of this many pixels takes too much memory");
    (settings.pixels() > MOST_PIXELS.max(asked.pixels())).then(why)
}

/// The settings of the pilot for these settings. Those that it does not depend on are normalised.
pub(crate) fn piloted(settings: &RenderSettings) -> RenderSettings {
    let plain = forelight_protocol::RenderSettingsRequest::default().complete((1, 1));
    let mut piloted = settings.clone();
    if settings.cache == CacheMode::Off {
        piloted.cache_accuracy = plain.cache_accuracy;
        piloted.cache_rays = plain.cache_rays;
    }
    if settings.integrator == Integrator::Path {
        piloted.ambient_divisions = plain.ambient_divisions;
    }
    piloted.spp = (PILOT_RAYS / piloted.ambient_divisions.max(1)).clamp(LEAST_SPP, PILOT_SPP);
    piloted
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::RenderSettingsRequest;

    #[test]
    fn only_images_much_larger_than_usual_are_not_looked_at() {
        let of = |width, height| RenderSettingsRequest::default().complete((width, height));
        let left_out = |asked: &RenderSettings| {
            let rungs = ladder(LadderKind::Resolution, asked).unwrap();
            rungs.iter().filter_map(|rung| too_large(rung, asked)).collect::<Vec<String>>()
        };
        assert!(left_out(&of(4096, 2160)).is_empty());
        let dear = left_out(&of(8192, 8192));
        assert_eq!(dear.len(), 2, "{dear:?}");
        assert!(dear[1].starts_with("16384 × 16384: "), "{dear:?}");
    }
}
