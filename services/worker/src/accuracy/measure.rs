//! The truth: every rung rendered, and held against converged images.
//!
//! The converged image is rendered in two independent halves, a and b. For an image x that has nothing to do with either,
//! E[(x − a)(x − b)] = E[(x − t)²] with t what both converge to: the halves' own noise drops out, and need not be small.

use super::AccuracyObserver;
use crate::profile::ShotError;
use crate::render::{Given, render_frame};
use crate::renderer::Renderer;
use forelight_protocol::{AccuracyDoc, CacheMode, MeasuredRung, RenderSettings, RenderSettingsRequest};
use forelight_tracer::Image;

/// How rungs are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeasureOptions {
    /// Camera samples a pixel of a converged image, both halves together, at least 2.
    pub reference_spp: u32,
}

/// Seeds of the two halves are the image's with these bits flipped.
const HALVES: [u64; 2] = [0x6861_6c66, 0x6f74_6865];

/// Two independent images of what a rung converges to.
pub(crate) struct Converged {
    settings: RenderSettings,
    halves: [Image; 2],
    mean: f64,
}

/// Renders every rung of a document of one frame, once for each different setting, and writes what it took and came to into it.
/// `observer` is told of rungs.
pub fn measure(
    renderer: &dyn Renderer,
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
                        converged.push(Converged::new(renderer, frame, truth, observer)?);
                        converged.len() - 1
                    }
                };
                let (image, work, cpu_seconds) = image(renderer, frame, &settings, observer)?;
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

/// Gathers of a converged image have few rays: it is the camera samples that are many, and each of them gathers.
const DIVISIONS: u32 = 4;

/// A half of a converged image that serves a single rung has this many times the rung's camera samples at most.
const TIMES_SAMPLES: u32 = 4;

/// Settings of a half of what a rung converges to. What makes no difference to that is brought to one value, so that one image
/// serves many rungs.
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
    renderer: &dyn Renderer,
    frame: u32,
    settings: &RenderSettings,
    observer: &dyn AccuracyObserver,
) -> Result<(Image, u64, f64), ShotError> {
    let rendered = render_frame(renderer, frame, settings, Given::default(), &|_| (), observer.cancel())?;
    let rendered = rendered.ok_or(ShotError::Cancelled)?;
    Ok((rendered.image, rendered.stats.work, rendered.stats.cpu_seconds))
}

impl Converged {
    /// Renders both.
    pub(crate) fn new(
        renderer: &dyn Renderer,
        frame: u32,
        settings: RenderSettings,
        observer: &dyn AccuracyObserver,
    ) -> Result<Self, ShotError> {
        let half = |seed: u64| {
            let settings = RenderSettings { seed: settings.seed ^ seed, ..settings.clone() };
            image(renderer, frame, &settings, observer).map(|(image, ..)| image)
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
        // To first order where there is an error to speak of; where there is none, as much as would show.
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
