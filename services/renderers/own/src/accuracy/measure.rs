//! Measured errors: every rung is rendered and compared to converged images.
//!
//! The converged image is rendered in two independent halves, a and b. For an image x that is independent of
//! both, E[(x − a)(x − b)] = E[(x − t)²], with t what both converge to. Their own noise drops out.

use super::AccuracyObserver;
use crate::profile::ShotError;
use crate::render::{Given, render_frame};
use crate::shot::OwnShot;
use forelight_protocol::{AccuracyDoc, CacheMode, MeasuredRung, RenderSettings, RenderSettingsRequest};
use forelight_tracer::Image;

/// How rungs are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeasureOptions {
    /// Camera samples per pixel of a converged image, both halves together, at least 2.
    pub reference_spp: u32,
}

/// The image's seed with these bits flipped is the seed of each half.
const HALVES: [u64; 2] = [0x6861_6c66, 0x6f74_6865];

/// Two independent images of what a rung converges to.
pub(crate) struct Converged {
    settings: RenderSettings,
    halves: [Image; 2],
    mean: f64,
}

/// Renders every distinct rung of a one-frame document, and records its cost and error.
pub fn measure(
    shot: &OwnShot,
    frame: u32,
    document: &mut AccuracyDoc,
    options: &MeasureOptions,
    observer: &dyn AccuracyObserver,
) -> Result<(), ShotError> {
    let mut converged: Vec<Converged> = Vec::new();
    let mut known: Vec<(RenderSettings, MeasuredRung)> = Vec::new();
    let all = document.rungs.len();
    for index in 0..all {
        let settings = document.rungs[index].settings.clone();
        let measured = match known.iter().find(|(known, _)| *known == settings) {
            Some((_, measured)) => *measured,
            None => {
                let truth = truth(&settings, &document.settings, options);
                let at = match converged.iter().position(|one| one.settings == truth) {
                    Some(at) => at,
                    None => {
                        converged.push(Converged::new(shot, frame, truth, observer)?);
                        converged.len() - 1
                    }
                };
                let (image, work, cpu_seconds) = image(shot, frame, &settings, observer)?;
                let (error, error_deviation) = converged[at].error(&image);
                MeasuredRung { work, cpu_seconds, error, error_deviation }
            }
        };
        known.push((settings, measured));
        document.rungs[index].measured = Some(measured);
        observer.predicted(index + 1, all);
    }
    Ok(())
}

/// Gathers of a converged image have few rays: each of its many camera samples gathers.
const DIVISIONS: u32 = 4;

/// Most camera samples of a half that serves a single rung, as a multiple of the rung's.
const TIMES_SAMPLES: u32 = 4;

/// Settings of a converged half for a rung. Settings that do not change what a rung converges to are
/// normalised, so that one image serves many rungs.
fn truth(settings: &RenderSettings, asked: &RenderSettings, options: &MeasureOptions) -> RenderSettings {
    let plain = RenderSettingsRequest::default().complete((1, 1));
    let mut spp = (options.reference_spp / 2).max(1);
    if settings.pixels() != asked.pixels() {
        spp = spp.min(settings.spp.saturating_mul(TIMES_SAMPLES));
    }
    RenderSettings {
        spp,
        cache: CacheMode::Off,
        ambient_divisions: DIVISIONS,
        cache_accuracy: plain.cache_accuracy,
        cache_rays: plain.cache_rays,
        ..settings.clone()
    }
}

fn image(
    shot: &OwnShot,
    frame: u32,
    settings: &RenderSettings,
    observer: &dyn AccuracyObserver,
) -> Result<(Image, u64, f64), ShotError> {
    let rendered = render_frame(shot, frame, settings, Given::default(), &|_| (), observer.cancel())?;
    let rendered = rendered.ok_or(ShotError::Cancelled)?;
    Ok((rendered.image, rendered.stats.work, rendered.stats.cpu_seconds))
}

impl Converged {
    pub(crate) fn new(
        shot: &OwnShot,
        frame: u32,
        settings: RenderSettings,
        observer: &dyn AccuracyObserver,
    ) -> Result<Self, ShotError> {
        let half = |seed: u64| {
            let settings = RenderSettings { seed: settings.seed ^ seed, ..settings.clone() };
            image(shot, frame, &settings, observer).map(|(image, ..)| image)
        };
        let halves = [half(HALVES[0])?, half(HALVES[1])?];
        let values = halves.iter().flat_map(|half| &half.pixels).flat_map(|pixel| pixel.color);
        let (sum, count) =
            values.fold((0.0, 0u64), |(sum, count), value| (sum + f64::from(value), count + 1));
        Ok(Self { settings, halves, mean: sum / count.max(1) as f64 })
    }

    /// Root mean square error of an image, relative to the mean, and its standard deviation.
    pub(crate) fn error(&self, image: &Image) -> (f64, f64) {
        let [one, other] = &self.halves;
        let products: Vec<f64> = (0..image.pixels.len())
            .map(|i| {
                let channel = |c: usize| {
                    let [x, a, b] = [image, one, other].map(|image| f64::from(image.pixels[i].color[c]));
                    (x - a) * (x - b)
                };
                (0..3).map(channel).sum::<f64>() / 3.0
            })
            .collect();
        let count = products.len() as f64;
        let mean = products.iter().sum::<f64>() / count;
        let spread = products.iter().map(|product| (product - mean) * (product - mean)).sum::<f64>();
        let deviation = (spread / count).sqrt() / count.sqrt();
        if self.mean <= 0.0 {
            return (0.0, 0.0);
        }
        let scale = 1.0 / (self.mean * self.mean);
        let square = (mean * scale).max(0.0);
        // First-order propagation if the error is significant, else the smallest error that would show.
        let square_deviation = deviation * scale;
        let error = square.sqrt();
        let error_deviation = if square > square_deviation {
            square_deviation / (2.0 * error)
        } else {
            square_deviation.sqrt()
        };
        (error, error_deviation)
    }
}
