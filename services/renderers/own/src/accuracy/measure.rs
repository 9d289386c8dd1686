//! Measured errors: every rung is rendered and compared to converged images.
//!
//! The converged image is rendered in two independent halves, a and b. For an image x that is independent of
//! both, E[(x − a)(x − b)] = E[(x − t)²], with t what both converge to. Their own noise drops out.

use crate::accuracy::observer::AccuracyObserver;
use crate::error::ShotError;
use crate::frame::OwnFrame;
use crate::render::denoised::{denoise, traced_colors, with_folder};
use crate::render::{Rendered, render_ready};
use crate::shot::OwnShot;
use forelight_denoise::Denoiser;
use forelight_protocol::{
    AccuracyDoc, CacheMode, DenoisedRung, MeasuredRung, RenderSettings, RenderSettingsRequest,
};
use forelight_renderer::door::Run;
use forelight_tracer::Image;

/// How rungs are measured.
#[derive(Debug, Clone, Copy)]
pub struct MeasureOptions<'a> {
    /// Camera samples per pixel of a converged image, both halves together, at least 2.
    pub reference_spp: u32,
    /// Measures every image after its noise was removed, too.
    pub denoiser: Option<&'a Denoiser>,
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
    options: &MeasureOptions<'_>,
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
                measured(shot, (frame, &settings), &converged[at], options, observer)?
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
fn truth(settings: &RenderSettings, asked: &RenderSettings, options: &MeasureOptions<'_>) -> RenderSettings {
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

pub(super) fn rendered(
    ready: &OwnFrame<'_>,
    settings: &RenderSettings,
    observer: &dyn AccuracyObserver,
) -> Result<Rendered, ShotError> {
    let rendered = render_ready(ready, settings, None, &|_| (), &|_| (), observer.cancel())?;
    rendered.ok_or(ShotError::Cancelled)
}

fn measured(
    shot: &OwnShot,
    (frame, settings): (u32, &RenderSettings),
    converged: &Converged,
    options: &MeasureOptions<'_>,
    observer: &dyn AccuracyObserver,
) -> Result<MeasuredRung, ShotError> {
    let ready = shot.frame(frame, settings)?;
    let mut rendered = rendered(&ready, settings, observer)?;
    let (error, error_deviation) = converged.error(&rendered.image);
    let (work, cpu_seconds) = (rendered.stats.work, rendered.stats.cpu_seconds);
    if let Some(denoiser) = options.denoiser {
        let remove = |run: &Run<'_>| denoise(&ready, &mut rendered, denoiser, run, &|_| ());
        with_folder(observer.cancel(), remove)?.ok_or(ShotError::Cancelled)?;
    }
    let denoised = rendered.image.denoised.as_ref().map(|denoised| {
        let (error, error_deviation) = converged.error_of(&denoised.colors);
        DenoisedRung { cpu_seconds: rendered.stats.cpu_seconds - cpu_seconds, error, error_deviation }
    });
    Ok(MeasuredRung { work, cpu_seconds, error, error_deviation, denoised })
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
            rendered(&shot.frame(frame, &settings)?, &settings, observer).map(|rendered| rendered.image)
        };
        let halves = [half(HALVES[0])?, half(HALVES[1])?];
        let values = halves.iter().flat_map(|half| &half.pixels).flat_map(|pixel| pixel.color);
        let (sum, count) =
            values.fold((0.0, 0u64), |(sum, count), value| (sum + f64::from(value), count + 1));
        Ok(Self { settings, halves, mean: sum / count.max(1) as f64 })
    }

    /// Root mean square error of an image, relative to the mean, and its standard deviation.
    pub(crate) fn error(&self, image: &Image) -> (f64, f64) {
        self.error_of(&traced_colors(image))
    }

    /// The same for the colours of an image.
    fn error_of(&self, colors: &[[f32; 3]]) -> (f64, f64) {
        let [one, other] = &self.halves;
        let products: Vec<f64> = colors
            .iter()
            .enumerate()
            .map(|(i, color)| {
                let channel = |c: usize| {
                    let [x, a, b] =
                        [color[c], one.pixels[i].color[c], other.pixels[i].color[c]].map(f64::from);
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

/// Settings of small images in direct light, for tests against [`Converged`].
#[cfg(test)]
pub(crate) fn direct_light(spp: u32, seed: u64) -> RenderSettings {
    let request = RenderSettingsRequest {
        spp: Some(spp),
        seed: Some(seed),
        ambient_bounces: Some(0),
        ..RenderSettingsRequest::default()
    };
    request.complete((128, 72))
}
