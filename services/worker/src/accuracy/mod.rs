//! What accuracy costs in time, of one frame, on this machine alone.
//!
//! | file | subject |
//! | --- | --- |
//! | `pilot` | profiled pixels of one kind of setting: what they take and how far off they are |
//! | `related` | what other gathers do to the error of the same pixels |
//! | `interpolation` | what an irradiance cache adds to the error |
//! | `measure` | the truth: rungs rendered, and held against converged images |
//!
//! Every kind of setting (an integrator, a number of divisions, an accuracy of the cache) is profiled once, by a *pilot*, with
//! a few camera samples a pixel. What a rung takes follows as in a quote, the pixels' part in proportion to its samples;
//! how far off it will be, from the spectrum of its variance (`forelight_forecast::accuracy`) and, with a cache, from what
//! interpolation adds, which does not fall with samples. Other resolutions share the pilot of the settings that were asked for: the
//! preview counts the pixels of every stratum in each, and the plan the records.

mod gathers;
mod interpolation;
mod measure;
mod pilot;

#[cfg(test)]
pub(crate) use measure::Converged;
pub use measure::{MeasureOptions, measure};
pub(crate) use pilot::Pilot;

use crate::profile::ShotError;
use crate::render::seconds;
use crate::renderer::{FrameRenderer, Renderer};
use forelight_forecast::Calibration;
use forelight_forecast::accuracy::PixelNoise;
use forelight_protocol::{
    AccuracyDoc, AccuracyRung, CacheMode, Integrator, LadderKind, MissingLadder, Profiled, RenderSettings,
    Spent, SpentOnForecast,
};
use forelight_quote::{ladder, mark};
use forelight_tracer::Pixel;
use gathers::{affordable, is_too_dear, relate};
use interpolation::Truth;
use pilot::View;
use std::sync::atomic::{AtomicBool, Ordering};

/// Camera samples of a profiled pixel: four doublings of them can be seen.
const PILOT_SPP: u32 = 16;

/// A profiled pixel gathers with this many rays, over all its camera samples, unless these would be fewer than [`LEAST_SPP`].
const PILOT_RAYS: u32 = 256;

/// Pixels that are profiled at least of gathers with many rays, of which as many as of the others would take longer than all else.
const LEAST_SAMPLES: u32 = 48;

/// Two doublings of camera samples.
const LEAST_SPP: u32 = 4;

/// How accuracy is predicted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AccuracyOptions {
    /// Pixels to profile of every kind of setting.
    pub samples: u32,
    /// Seed of the choice of pixels.
    pub seed: u64,
}

/// Told how far it is; says whether to go on.
pub trait AccuracyObserver: Sync {
    /// So many of all steps of the prediction are done.
    fn predicted(&self, done: usize, all: usize);
    /// The flag that ends it.
    fn cancel(&self) -> &AtomicBool;
}

/// An image of more pixels than this, and than was asked for, is not looked at to see what it would take: its preview alone
/// has 32 bytes a pixel.
const MOST_PIXELS: u64 = 1 << 26;

/// Predicts these ladders around the settings that were asked for; of others the rung that was asked for.
pub fn predict(
    renderer: &dyn Renderer,
    frame: u32,
    asked: &RenderSettings,
    ladders: &[LadderKind],
    options: &AccuracyOptions,
    observer: &dyn AccuracyObserver,
) -> Result<AccuracyDoc, ShotError> {
    let mut missing = Vec::new();
    let mut wanted = Vec::new();
    for kind in LadderKind::ALL {
        match (ladder(kind, asked), ladders.contains(&kind)) {
            (Ok(rungs), true) => wanted.push((kind, rungs)),
            (Err(reason), true) => missing.push(MissingLadder { ladder: kind, reason }),
            // What the others are held against.
            (Ok(rungs), false) if rungs.contains(asked) => wanted.push((kind, vec![asked.clone()])),
            (_, false) => {}
        }
    }
    let all = wanted.iter().map(|(_, rungs)| rungs.len()).sum();
    let mut prediction =
        Prediction { missing, all, ..Prediction::new(renderer, frame, asked, options, observer) };
    for (kind, rungs) in wanted {
        prediction.ladder(kind, &rungs)?;
    }
    Ok(prediction.document())
}

struct Prediction<'a> {
    renderer: &'a dyn Renderer,
    frame: u32,
    asked: &'a RenderSettings,
    options: &'a AccuracyOptions,
    observer: &'a dyn AccuracyObserver,
    /// By the settings that they were made with.
    pilots: Vec<Pilot>,
    truth: Option<Truth>,
    rungs: Vec<AccuracyRung>,
    missing: Vec<MissingLadder>,
    /// Beside the pilots.
    spent: Spent,
    done: usize,
    all: usize,
}

impl<'a> Prediction<'a> {
    fn new(
        renderer: &'a dyn Renderer,
        frame: u32,
        asked: &'a RenderSettings,
        options: &'a AccuracyOptions,
        observer: &'a dyn AccuracyObserver,
    ) -> Self {
        Self {
            renderer,
            frame,
            asked,
            options,
            observer,
            pilots: Vec::new(),
            truth: None,
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
            self.done += 1;
            let is_dear = || {
                let (first, other) = (self.gathers_asked_for(), piloted(settings));
                is_too_dear(self.options.samples, LEAST_SAMPLES, &first, &other)
            };
            let left_out = match kind {
                LadderKind::Divisions if is_dear() => Some(format!(
                    "{} rays with {} bounces: a few pixels of them take longer than all else here",
                    settings.ambient_divisions, settings.ambient_bounces
                )),
                LadderKind::Resolution => too_large(settings, self.asked),
                _ => None,
            };
            if let Some(reason) = left_out {
                self.missing.push(MissingLadder { ladder: kind, reason });
                self.observer.predicted(self.done, self.all);
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
            let pilot = &self.pilots[pilot];
            let (work, cpu_seconds) = pilot.cost(&view, settings.spp)?;
            self.rungs.push(AccuracyRung {
                ladder: kind,
                settings: settings.clone(),
                asked_for: settings == self.asked,
                work,
                cpu_seconds,
                error: Some(pilot.error(&view, settings.spp)?),
                worth_taking: false,
                next: None,
                measured: None,
            });
            self.observer.predicted(self.done, self.all);
        }
        Ok(())
    }

    /// Index of the pilot of a kind of setting, which is made if there is none.
    fn pilot(&mut self, settings: &RenderSettings) -> Result<usize, ShotError> {
        let settings = piloted(settings);
        if let Some(known) = self.pilots.iter().position(|pilot| pilot.settings == settings) {
            return Ok(known);
        }
        // What is close to the gathers that were asked for is held against these on the same pixels.
        let first = self.gathers_asked_for();
        let known = match settings.integrator {
            Integrator::Ambient if settings != first => Some(self.pilot(&first)?),
            _ => None,
        };
        let ready = self.renderer.frame(self.frame, &settings)?;
        let samples = match settings.cache {
            CacheMode::Off if settings.integrator == Integrator::Ambient => {
                affordable(self.options.samples, LEAST_SAMPLES, &first, &settings)
            }
            _ => self.options.samples,
        };
        let options = AccuracyOptions { samples, ..*self.options };
        let mut pilot = Pilot::new(self.renderer, &*ready, settings, &options, self.observer)?;
        if let Some(first) = known.map(|known| &self.pilots[known]) {
            if pilot.settings.cache == CacheMode::Off {
                relate(self.renderer, &*ready, first, &mut pilot, self.observer)?;
            } else {
                let truth = match self.truth.take() {
                    Some(truth) => truth,
                    None => {
                        let truth = Truth::new(self.renderer, self.frame, first, self.observer)?;
                        self.spent = self.spent.plus(truth.spent);
                        truth
                    }
                };
                self.truth.insert(truth).interpolated(&*ready, &first.noise, &mut pilot, self.observer)?;
            }
        }
        self.pilots.push(pilot);
        Ok(self.pilots.len() - 1)
    }

    /// The pilot's settings of gathers as they were asked for, without a cache.
    fn gathers_asked_for(&self) -> RenderSettings {
        let gathered =
            RenderSettings { integrator: Integrator::Ambient, cache: CacheMode::Off, ..self.asked.clone() };
        piloted(&gathered)
    }

    /// What the frame shows in another resolution than the pilot's.
    fn view(&mut self, settings: &RenderSettings, pilot: usize) -> Result<View, ShotError> {
        let pilot = &self.pilots[pilot];
        let own = &pilot.settings;
        if (settings.width, settings.height) == (own.width, own.height) {
            return Ok(pilot.view.clone());
        }
        let ready: Box<dyn FrameRenderer + '_> = self.renderer.frame(self.frame, settings)?;
        let (view, spent) = View::of(&*ready)?;
        self.spent = self.spent.plus(spent);
        Ok(view)
    }

    fn document(self) -> AccuracyDoc {
        let spent = self.pilots.iter().map(|pilot| pilot.spent).fold(self.spent, Spent::plus);
        let asked = self.rungs.iter().find(|rung| rung.asked_for).map_or(0.0, |rung| rung.work.mean);
        let fraction = if asked > 0.0 { spent.work as f64 / asked } else { 0.0 };
        let mut document = AccuracyDoc {
            frames: 1,
            settings: self.asked.clone(),
            rungs: self.rungs,
            missing: self.missing,
            profiled: Profiled {
                frames: vec![self.frame],
                pixels: self.pilots.iter().map(|pilot| pilot.profiled()).sum(),
            },
            spent: SpentOnForecast {
                work: spent.work,
                cpu_seconds: seconds(spent.cpu_nanos),
                fraction_of_forecast: fraction,
            },
            calibrated: Calibration::NONE.calibrated,
        };
        mark(&mut document);
        document
    }
}

/// Why an image is not looked at in passing.
fn too_large(settings: &RenderSettings, asked: &RenderSettings) -> Option<String> {
    let RenderSettings { width, height, .. } = settings;
    let why = || format!("{width} × {height}: looking at so many pixels takes more memory than it is worth");
    (settings.pixels() > MOST_PIXELS.max(asked.pixels())).then(why)
}

fn is_cancelled(observer: &dyn AccuracyObserver) -> bool {
    observer.cancel().load(Ordering::Relaxed)
}

/// These pixels, unless the observer wants it to end on the way.
fn traced(
    ready: &dyn FrameRenderer,
    pixels: &[u32],
    observer: &dyn AccuracyObserver,
) -> Result<Vec<(Pixel, PixelNoise)>, ShotError> {
    ready.trace_unless(pixels, &|| is_cancelled(observer)).ok_or(ShotError::Cancelled)
}

/// The settings of the pilot for these settings. What makes no difference to them is brought to one value, so that one
/// pilot serves many rungs.
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
