//! A frame without noise: a denoiser is given the image and what its pixels show. Its error is measured.
//!
//! A denoised image shows no noise by which its error could be told. So a few pixels are traced again with
//! many camera samples, by random numbers that are independent of the image. They say how far the denoised
//! pixels are from the truth, without bias: their own noise is known from several independent means, and
//! taken off.

use crate::answers::{Progress, Step};
use crate::costs::seconds;
use crate::error::RenderError;
use crate::frame::OwnFrame;
use crate::render::Rendered;
use forelight_denoise::{Denoised, Denoiser, Layers};
use forelight_forecast::PixelCurve;
use forelight_kept::TemporaryFolder;
use forelight_protocol::{DenoisedStats, ImageError};
use forelight_random::Random;
use forelight_renderer::door::{Limits, RendererError, Run};
use forelight_tracer::{DenoisedColors, Feature, Image, Pixel};
use std::sync::atomic::AtomicBool;

/// Camera samples by which features are averaged: enough for smooth edges.
const MOST_FEATURE_SAMPLES: u32 = 16;

/// A pixel whose error is measured gets so many independent means.
const MEANS: u32 = 8;

/// Fewest and most camera samples of a mean. In between, it has this multiple of those of the image: a noisy
/// image is compared with a truth that may be noisy too.
const SAMPLES_OF_MEAN: (u32, u32) = (8, 32);
const MULTIPLE: u32 = 2;

/// Share of the image's camera samples that measuring takes, within [`MEASURED`].
const SHARE_OF_MEASURING: f64 = 0.1;

/// Numbers of measured pixels. Fewer say too little, more than the largest hardly more.
const MEASURED: (f64, f64) = (256.0, 4096.0);

/// What removing the noise of an image took, CPU seconds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DenoisingCost {
    /// Of the denoiser.
    pub denoiser: f64,
    /// Of tracing what the pixels show.
    pub features: f64,
}

/// Lets `work` run a program in a folder of its own, on all threads of the current pool.
pub(crate) fn with_folder<T>(
    cancel: &AtomicBool,
    work: impl FnOnce(&Run<'_>) -> Result<T, RenderError>,
) -> Result<T, RenderError> {
    let folder = TemporaryFolder::new().map_err(RendererError::io(std::env::temp_dir()))?;
    work(&Run::silent(cancel, folder.path(), Limits { threads: threads(), ..Limits::default() }))
}

fn threads() -> u32 {
    u32::try_from(rayon::current_num_threads()).unwrap_or(1)
}

/// Removes the noise of a finished frame, measures the error that is left, and adds what that took to its cost.
/// Any cache must be filled. `None` if the run was cancelled.
pub(crate) fn denoise(
    ready: &OwnFrame<'_>,
    rendered: &mut Rendered,
    denoiser: &Denoiser,
    run: &Run<'_>,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Option<()>, RenderError> {
    let step = |done| progress(Progress { step: Step::Denoising, done, all: 2 });
    step(0);
    let Some(cost) = remove_noise(ready, &mut rendered.image, denoiser, run)? else { return Ok(None) };
    step(1);
    let Some(stats) = measured(ready, &rendered.image, cost, run) else { return Ok(None) };
    rendered.stats.cpu_seconds += stats.cpu_seconds();
    rendered.stats.denoised = Some(stats);
    step(2);
    Ok(Some(()))
}

/// Whether to stop. Stands still while the run is paused.
fn stops(run: &Run<'_>) -> bool {
    run.pause.inspect(|pause| pause.wait());
    run.is_cancelled()
}

/// Removes the noise of an image. `None` if the run was cancelled.
pub(crate) fn remove_noise(
    ready: &OwnFrame<'_>,
    image: &mut Image,
    denoiser: &Denoiser,
    run: &Run<'_>,
) -> Result<Option<DenoisingCost>, RenderError> {
    let samples = feature_samples(ready.tracer.settings().spp);
    let Some((features, tracing)) = ready.tracer.features(samples, &|| stops(run)) else { return Ok(None) };
    let size = (image.width, image.height);
    let Some(made) = without_noise(size, &traced_colors(image), &features, denoiser, run)? else {
        return Ok(None);
    };
    image.denoised = Some(DenoisedColors { by: made.by, colors: made.color, features });
    Ok(Some(DenoisingCost { denoiser: seconds(made.usage.cpu_nanos), features: seconds(tracing) }))
}

/// Colours without noise. `None` if the run was cancelled.
pub(crate) fn without_noise(
    size: (u32, u32),
    color: &[[f32; 3]],
    features: &[Feature],
    denoiser: &Denoiser,
    run: &Run<'_>,
) -> Result<Option<Denoised>, RenderError> {
    let albedo: Vec<[f32; 3]> = features.iter().map(|feature| feature.albedo.to_array()).collect();
    let normal: Vec<[f32; 3]> = features.iter().map(|feature| feature.normal.to_array()).collect();
    let layers = Layers { size, color, albedo: &albedo, normal: &normal };
    // What it says of its progress is no news in a log.
    match denoiser.denoise(&layers, &Run { log: &|_| (), progress: &|_| (), ..*run }) {
        Err(_) if run.is_cancelled() => Ok(None),
        made => Ok(Some(made?)),
    }
}

/// Camera samples of each pixel's features in an image of `spp`.
pub(crate) fn feature_samples(spp: u32) -> u32 {
    spp.min(MOST_FEATURE_SAMPLES)
}

/// How many pixels of an image are measured, and by how many camera samples for each mean.
fn measuring(pixels: usize, spp: u32) -> (u32, u32) {
    let of_mean = (MULTIPLE * spp).clamp(SAMPLES_OF_MEAN.0, SAMPLES_OF_MEAN.1);
    let wanted = SHARE_OF_MEASURING * pixels as f64 * f64::from(spp) / f64::from(MEANS * of_mean);
    (wanted.clamp(MEASURED.0, MEASURED.1) as u32, of_mean)
}

/// Camera samples by which an image is measured, as a share of its own.
fn share_of_measuring(pixels: usize, spp: u32) -> f64 {
    let (measured, of_mean) = measuring(pixels, spp);
    f64::from(measured).min(pixels as f64) * f64::from(MEANS * of_mean) / (pixels as f64 * f64::from(spp))
}

/// Forecast of what [`denoise`] adds to a frame, from some of its pixels, and the CPU time of asking, both in
/// nanoseconds. Measuring takes what as many camera samples of the image take, on average. `None` if `stop`
/// returned `true`.
pub(crate) fn forecast_nanos(
    ready: &OwnFrame<'_>,
    some: &[u32],
    nanos_of_all_pixels: f64,
    denoiser_nanos_per_pixel: u64,
    stop: &(dyn Fn() -> bool + Sync),
) -> Option<(u64, u64)> {
    let (pixels, spp) = (ready.frame().camera.pixels(), ready.tracer.settings().spp);
    let (_, asking) = ready.tracer.features_of(some, feature_samples(spp), stop)?;
    let of_pixel = denoiser_nanos_per_pixel as f64 + asking as f64 / some.len().max(1) as f64;
    // The conversion saturates.
    Some((added_nanos((pixels, spp), of_pixel, nanos_of_all_pixels) as u64, asking))
}

/// What [`denoise`] adds to an image of so many pixels and camera samples, from the nanoseconds of removing the noise
/// of a pixel and of tracing all pixels.
pub(crate) fn added_nanos((pixels, spp): (usize, u32), of_pixel: f64, of_all_pixels: f64) -> f64 {
    of_pixel * pixels as f64 + share_of_measuring(pixels, spp) * of_all_pixels
}

/// Measures the error of a denoised image, whose noise was removed at this cost. `None` if the run was
/// cancelled, or the image is not denoised.
fn measured(
    ready: &OwnFrame<'_>,
    image: &Image,
    cost: DenoisingCost,
    run: &Run<'_>,
) -> Option<DenoisedStats> {
    let denoised = image.denoised.as_ref()?;
    let color = traced_colors(image);
    let (count, of_mean) = measuring(color.len(), ready.tracer.settings().spp);
    let places = places(&ready.curve(), [&color, &denoised.colors], count, ready.tracer.settings().seed);
    let pixels: Vec<u32> = places.iter().map(|place| place.pixel).collect();
    let (means, measuring) = ready.tracer.independent_pixels(&pixels, (MEANS, of_mean), &|| stops(run))?;
    let mean = mean_of(&color);
    let error = |colors: &[[f32; 3]]| image_error(&squares(colors, &places, &means), mean);
    Some(DenoisedStats {
        by: denoised.by.clone(),
        error: error(&denoised.colors),
        noisy: error(&color),
        measured_pixels: places.len() as u64,
        measured_samples: MEANS * of_mean,
        denoiser_cpu_seconds: cost.denoiser,
        features_cpu_seconds: cost.features,
        measuring_cpu_seconds: seconds(measuring.cpu_nanos),
    })
}

/// The colours that were traced: with noise.
pub(crate) fn traced_colors(image: &Image) -> Vec<[f32; 3]> {
    image.pixels.iter().map(|pixel| pixel.color).collect()
}

/// Mean over pixels and channels.
pub(crate) fn mean_of(colors: &[[f32; 3]]) -> f64 {
    colors.iter().flatten().map(|&value| f64::from(value)).sum::<f64>() / (3 * colors.len()) as f64
}

/// A pixel whose error is measured, and by how much it counts.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Place {
    pixel: u32,
    weight: f64,
}

/// Pixels to measure, along the curve, each once. Few pixels hold most of the error: bright ones, and those that the
/// denoiser changed much. So these are chosen more often, and count less (Horvitz and Thompson 1952).
fn places(curve: &PixelCurve, [noisy, denoised]: [&[[f32; 3]]; 2], count: u32, seed: u64) -> Vec<Place> {
    let amplitude = |color: [f64; 3]| color.iter().map(|value| value * value).sum::<f64>().sqrt();
    let of = |pixel: usize| {
        let [before, after] = [noisy[pixel], denoised[pixel]].map(|color| color.map(f64::from));
        [amplitude(after), amplitude(std::array::from_fn(|c| after[c] - before[c]))]
    };
    let all: Vec<[f64; 2]> = (0..noisy.len()).map(of).collect();
    let mean = |k: usize| all.iter().map(|of| of[k]).sum::<f64>() / all.len() as f64;
    let means = [mean(0), mean(1)];
    let relative = |value: f64, mean: f64| {
        let share = value / mean;
        // Of black images, and beside infinite values.
        if share.is_finite() { share } else { 1.0 }
    };
    let share = |&[bright, changed]: &[f64; 2]| {
        (1.0 + relative(bright, means[0]) + relative(changed, means[1])) / 3.0
    };
    let shares: Vec<f64> = all.iter().map(share).collect();
    let mean_share = shares.iter().sum::<f64>() / shares.len() as f64;
    // One place in each interval of equal sums of shares.
    let step = mean_share * f64::from(curve.count()) / f64::from(count);
    let mut random = Random::new(seed);
    let mut pixels = curve.pixels(0..curve.count()).into_iter().map(|pixel| (pixel, shares[pixel as usize]));
    let (mut sum, mut here) = (0.0, None);
    let place = |number: u32| {
        let wanted = (f64::from(number) + random.uniform()) * step;
        while sum <= wanted {
            // Rounding may leave the last place behind the last pixel.
            let Some((pixel, share)) = pixels.next() else { break };
            sum += share;
            here = Some(Place { pixel, weight: mean_share / share });
        }
        here
    };
    let drawn: Vec<Place> = (0..count).filter_map(place).collect();
    // A pixel that was drawn several times is measured once, and counts for all of them.
    let runs = drawn.chunk_by(|one, other| one.pixel == other.pixel);
    let merged = runs.map(|same| Place { weight: same.len() as f64 * same[0].weight, ..same[0] });
    let mut places: Vec<Place> = merged.collect();
    let distinct = places.len() as f64 / drawn.len().max(1) as f64;
    places.iter_mut().for_each(|place| place.weight *= distinct);
    places
}

/// Squared errors of an image at some places, whose mean is that of all pixels.
fn squares(colors: &[[f32; 3]], places: &[Place], measured: &[Vec<Pixel>]) -> Vec<f64> {
    let at = places.iter().zip(measured);
    at.map(|(place, means)| place.weight * square(colors[place.pixel as usize], means)).collect()
}

/// Squared difference of a colour from the truth, mean over the channels, by independent means of the pixel.
/// The mean of M means has 1 / (M (M − 1)) of the sum of their squared deviations as its variance.
pub(crate) fn square(color: [f32; 3], means: &[Pixel]) -> f64 {
    let count = means.len() as f64;
    let of_channel = |c: usize| {
        let values = || means.iter().map(|pixel| f64::from(pixel.color[c]));
        let truth = values().sum::<f64>() / count;
        let variance = values().map(|value| (value - truth).powi(2)).sum::<f64>() / (count * (count - 1.0));
        (f64::from(color[c]) - truth).powi(2) - variance
    };
    (0..3).map(of_channel).sum::<f64>() / 3.0
}

/// The error of an image from squared errors of some of its pixels, relative to the image's mean. The mean of
/// many squares is nearly normal. The error of a black image is 0.
fn image_error(squares: &[f64], mean: f64) -> ImageError {
    if mean <= 0.0 {
        return ImageError::default();
    }
    let count = squares.len() as f64;
    let square = squares.iter().sum::<f64>() / count;
    let variance = squares.iter().map(|value| (value - square).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    let scale = 1.0 / (mean * mean);
    normal_error(square * scale, (variance / count).sqrt() * scale)
}

/// The error whose square is normal with this mean and deviation.
pub(crate) fn normal_error(square: f64, deviation: f64) -> ImageError {
    let at = |normal: f64| (square + normal * deviation).max(0.0).sqrt();
    ImageError { p05: at(-1.645), p50: at(0.0), p80: at(0.842), p95: at(1.645) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::{Converged, direct_light};
    use crate::common::{Nobody, kitchen};
    use crate::render::{Given, render_frame};

    /// Means of three neighbours.
    fn blurred(colors: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let at = |i: usize| colors[i.min(colors.len() - 1)];
        let mean = |i: usize| std::array::from_fn(|c| (at(i)[c] + at(i + 1)[c] + at(i + 2)[c]) / 3.0);
        (0..colors.len()).map(mean).collect()
    }

    #[test]
    fn places_are_chosen_by_their_shares_and_weigh_what_makes_up_for_it() {
        let curve = PixelCurve::new(40, 30);
        let noisy: Vec<[f32; 3]> = (0..1200).map(|i| [if i % 50 == 0 { 40.0 } else { 1.0 }; 3]).collect();
        let denoised = vec![[1.0; 3]; 1200];
        let chosen = places(&curve, [&noisy, &denoised], 300, 7);
        let bright = chosen.iter().filter(|place| place.pixel % 50 == 0).count();
        assert_eq!(bright, 24, "all pixels that were changed");
        assert!((150..250).contains(&chosen.len()), "{} pixels", chosen.len());
        assert!(chosen.windows(2).all(|pair| pair[0].pixel != pair[1].pixel), "each once");
        let mean = chosen.iter().map(|place| place.weight).sum::<f64>() / chosen.len() as f64;
        assert!((mean - 1.0).abs() < 0.05, "{mean}");
        // One pixel, and colours without bounds.
        let one = places(&PixelCurve::new(1, 1), [&[[1.0; 3]], &[[2.0; 3]]], 256, 7);
        assert_eq!(one, [Place { pixel: 0, weight: 1.0 }]);
        let mut infinite = denoised.clone();
        infinite[600] = [f32::INFINITY; 3];
        assert!(places(&curve, [&infinite, &denoised], 300, 7).len() > 200);
        // Black images have no bright places.
        let black = vec![[0.0; 3]; 1200];
        let even = places(&curve, [&black, &black], 300, 7);
        assert!(even.len() == 300 && even.iter().all(|place| place.weight == 1.0));
    }

    /// Of a noisy image, whose true error follows from another one with many samples.
    #[test]
    fn the_measured_error_is_that_of_the_image() {
        let (shot, samples, never) = (kitchen(), 16, AtomicBool::new(false));
        let truth = Converged::new(&shot, 0, direct_light(512, 99), &Nobody::default()).unwrap();
        let compared: Vec<(f64, f64)> = (0..4)
            .map(|seed| {
                let settings = direct_light(samples, seed);
                let noisy = render_frame(&shot, 0, &settings, Given::default(), &|_| (), &never);
                let noisy = noisy.unwrap().unwrap().image;
                let error = truth.error(&noisy).0;
                let ready = shot.frame(0, &settings).unwrap();
                let colors = traced_colors(&noisy);
                let values = colors.iter().flatten().map(|&value| f64::from(value));
                let mean = values.sum::<f64>() / (3 * colors.len()) as f64;
                let places = places(&ready.curve(), [&colors, &blurred(&colors)], 1024, seed);
                let pixels: Vec<u32> = places.iter().map(|place| place.pixel).collect();
                let means = (MEANS, samples);
                let (measured, _) = ready.tracer.independent_pixels(&pixels, means, &|| false).unwrap();
                let measured = image_error(&squares(&colors, &places, &measured), mean);
                println!("seed {seed}: {error:.4}, measured {measured:?}");
                assert!(measured.p05 <= measured.p50 && measured.p50 <= measured.p80);
                (error.powi(2), measured.p50.powi(2))
            })
            .collect();
        let sum = |of: fn(&(f64, f64)) -> f64| compared.iter().map(of).sum::<f64>();
        let ratio = (sum(|pair| pair.1) / sum(|pair| pair.0)).sqrt();
        assert!((0.85..1.15).contains(&ratio), "measured over true: {ratio}");
    }

    /// In work, which is the same in every run.
    #[test]
    fn measuring_takes_what_is_forecast() {
        let (shot, never) = (kitchen(), AtomicBool::new(false));
        for samples in [4, 16] {
            let settings = direct_light(samples, 1);
            let made = render_frame(&shot, 0, &settings, Given::default(), &|_| (), &never);
            let image = made.unwrap().unwrap().image;
            let ready = shot.frame(0, &settings).unwrap();
            let colors = traced_colors(&image);
            let (count, of_mean) = measuring(colors.len(), samples);
            let places = places(&ready.curve(), [&colors, &blurred(&colors)], count, 1);
            let pixels: Vec<u32> = places.iter().map(|place| place.pixel).collect();
            let (_, cost) = ready.tracer.independent_pixels(&pixels, (MEANS, of_mean), &|| false).unwrap();
            let expected = share_of_measuring(colors.len(), samples) * image.totals().work as f64;
            let ratio = expected / cost.work as f64;
            println!("{samples} samples: {ratio}");
            assert!((0.8..1.25).contains(&ratio), "{samples} samples: {ratio}");
        }
    }

    #[test]
    fn the_noise_of_the_measurement_is_taken_off() {
        let pixel = |value: f32| Pixel { color: [value; 3], ..Pixel::default() };
        // Means of 0.9 and 1.1: the truth is 1 ± 0.1, and a colour of 1 is on it.
        let means = [pixel(0.9), pixel(1.1)];
        assert!((square([1.0; 3], &means) + 0.01).abs() < 1e-6);
        assert!((square([1.3; 3], &means) - 0.08).abs() < 1e-6);
        let error = image_error(&[0.04, 0.04, 0.04], 2.0);
        assert!((error.p50 - 0.1).abs() < 1e-12 && error.p50 == error.p95);
        assert_eq!(image_error(&[-1.0, -1.0], 2.0).p95, 0.0);
        assert_eq!(image_error(&[4.0], 2.0).p95, 1.0);
        assert_eq!(image_error(&[4.0], 0.0), ImageError::default());
    }
}
