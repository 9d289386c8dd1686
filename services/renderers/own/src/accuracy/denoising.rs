//! The error that a denoiser leaves.
//!
//! The error of a denoised image does not follow from the variance of its samples. So some tiles of the image
//! are rendered with 1, 4 and 16 camera samples, denoised, and compared with independent samples of the same
//! pixels. Other images of the same kind are placed by their noise. Between the measured noises, what is left
//! is interpolated on logarithmic axes. With less noise, it falls as between the last two. With more, its
//! share stays the same.
//!
//! The deviation has two parts. That between tiles comes from leaving out one draw at a time (jackknife:
//! Cochran, *Sampling Techniques*, 3rd edition 1977, section 6.17). That within tiles comes from their
//! pixels.

use super::measure::rendered;
use super::observer::{AccuracyObserver, is_cancelled};
use super::tiles::{MARGIN, Rect, Tiles};
use crate::error::{RenderError, ShotError};
use crate::frame::OwnFrame;
use crate::render::denoised::{
    added_nanos, feature_samples, mean_of, remove_noise, square, traced_colors, with_folder, without_noise,
};
use crate::shot::OwnShot;
use forelight_denoise::Denoiser;
use forelight_protocol::{CacheMode, ImageError, RenderSettings, Spent};
use forelight_renderer::door::Run;
use forelight_tracer::Feature;
use std::sync::atomic::AtomicBool;

/// Camera samples of the tiles. Numbers above those of a profiled pixel are left out.
const SAMPLES: [u32; 3] = [1, 4, 16];

/// The tiles are compared with so many independent means of so many camera samples.
const MEANS: (u32, u32) = (4, 4);

/// Most pixels of the small image that tells where denoising changes much.
const SMALL: f64 = 36_864.0;

/// Least share of a squared error that is left. Less cannot be measured by so few samples.
const LEAST_LEFT: f64 = 1e-3;

/// Largest standard deviation of the logarithm of an error. Nothing is known then.
const UNKNOWN: f64 = 1.0;

/// Standard deviation of the logarithm of the error for every doubling of the samples beyond the measured
/// ones.
const BEYOND: f64 = 0.1;

/// A denoiser, and how it is run.
#[derive(Clone, Copy)]
pub struct DenoiseBy<'a> {
    /// The denoiser.
    pub denoiser: &'a Denoiser,
    /// CPU time that it takes for a pixel, nanoseconds.
    pub nanos_per_pixel: u64,
    /// Its folder and limits.
    pub run: &'a Run<'a>,
}

impl DenoiseBy<'_> {
    /// Lets `work` denoise in a temporary folder of this machine, on all threads of the current pool.
    ///
    /// # Errors
    /// Those of `work`, and if the denoiser does not work or there can be no folder.
    pub fn here<T>(
        denoiser: &Denoiser,
        cancel: &AtomicBool,
        work: impl FnOnce(DenoiseBy<'_>) -> Result<T, ShotError>,
    ) -> Result<T, ShotError> {
        let nanos_per_pixel = denoiser.try_out(None).map_err(RenderError::Denoiser)?.nanos_per_pixel;
        with_folder(cancel, |run| Ok(work(DenoiseBy { denoiser, nanos_per_pixel, run })))?
    }
}

/// Error of an image, relative to its mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noisy {
    /// By the variance of its camera samples.
    pub noise: ImageError,
    /// By its irradiance cache: no denoiser removes that.
    pub of_cache: ImageError,
}

/// What a denoiser leaves of the noise of one kind of setting.
#[derive(Debug, Clone, PartialEq)]
pub struct Left {
    /// In rising order of noise.
    points: Vec<Point>,
    /// CPU nanoseconds for each pixel: of the denoiser, and of one camera sample of what pixels show.
    denoiser: f64,
    feature: f64,
}

/// Natural logarithms of errors relative to the image's mean.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    /// Forecast of the error before, by the samples' variance.
    noise: f64,
    /// Measured error after.
    left: f64,
    /// Standard deviation of `left`.
    deviation: f64,
}

/// Tiles of a frame, and the mean of its small image. The mean is absent if the tiles are the whole image.
pub type Chosen = (Tiles, Option<f64>);

/// Chooses tiles of a frame.
pub fn choose(
    shot: &OwnShot,
    frame: u32,
    asked: &RenderSettings,
    seed: u64,
    by: DenoiseBy<'_>,
    observer: &dyn AccuracyObserver,
) -> Result<(Chosen, Spent), ShotError> {
    let (mut mean, mut spent) = (None, Spent::default());
    let tiles = Tiles::choose((asked.width, asked.height), seed, |rects| {
        let smaller = (SMALL / asked.pixels() as f64).sqrt().min(1.0);
        let side = |side: u32| ((f64::from(side) * smaller) as u32).max(1);
        let settings = RenderSettings {
            width: side(asked.width),
            height: side(asked.height),
            spp: 1,
            cache: CacheMode::Off,
            ..asked.clone()
        };
        let ready = shot.frame(frame, &settings)?;
        let mut small = rendered(&ready, &settings, observer)?;
        let cost =
            remove_noise(&ready, &mut small.image, by.denoiser, by.run)?.ok_or(ShotError::Cancelled)?;
        let cpu_seconds = small.stats.cpu_seconds + cost.denoiser + cost.features;
        spent = Spent { work: small.stats.work, cpu_nanos: (cpu_seconds * 1e9) as u64 };
        let noisy = traced_colors(&small.image);
        mean = Some(mean_of(&noisy));
        let denoised = small.image.denoised.map(|denoised| denoised.colors).unwrap_or_default();
        let change = |(before, after): (&[f32; 3], &[f32; 3])| -> f64 {
            let squares = before.iter().zip(after).map(|(before, after)| f64::from(after - before).powi(2));
            let change: f64 = squares.sum();
            if change.is_finite() { change } else { 0.0 }
        };
        let changes: Vec<f64> = noisy.iter().zip(&denoised).map(change).collect();
        Ok::<_, ShotError>(rects.iter().map(|rect| sum_in(*rect, &changes, &settings)).collect())
    })?;
    Ok(((tiles, mean), spent))
}

/// Sum of the values of an image's pixels in a rectangle, whose borders are shares of its sides. A pixel that
/// overlaps it in part counts whole.
fn sum_in([left, top, right, bottom]: [f64; 4], values: &[f64], settings: &RenderSettings) -> f64 {
    let first = |at: f64, side: u32| ((at * f64::from(side)) as u32).min(side - 1);
    let end = |at: f64, side: u32| ((at * f64::from(side)).ceil() as u32).clamp(1, side);
    let (x, y) = (first(left, settings.width), first(top, settings.height));
    let (width, height) = (end(right, settings.width) - x, end(bottom, settings.height) - y);
    let pixels = Rect { left: x, top: y, width, height }.pixels();
    pixels.map(|(x, y)| values[(y * settings.width + x) as usize]).sum()
}

impl Left {
    /// Measures tiles of a frame. `mean` is that of the image; without it, the tiles are the whole image. `noise`
    /// is the forecast error with a number of camera samples.
    pub fn measure(
        ready: &OwnFrame<'_>,
        tiles: &Tiles,
        mean: Option<f64>,
        noise: impl Fn(u32) -> Result<f64, ShotError>,
        by: DenoiseBy<'_>,
        observer: &dyn AccuracyObserver,
    ) -> Result<(Self, Spent), ShotError> {
        let (pictured, stop) = (tiles.pictured(), || is_cancelled(observer));
        // The independent samples hardly ever need other records: tiles are without gaps.
        let mut spent = ready.fill_for(&pictured, &stop).ok_or(ShotError::Cancelled)?;
        let samples: Vec<u32> =
            SAMPLES.into_iter().filter(|&samples| samples <= ready.tracer.settings().spp).collect();
        let (colors, cost) = ready.trace_first(&pictured, &samples, &stop).ok_or(ShotError::Cancelled)?;
        spent = spent.plus(cost);
        let (mut denoised, mut nanos_of_features) = (Vec::new(), 0);
        for (&samples, colors) in samples.iter().zip(&colors) {
            let (features, nanos) =
                ready.tracer.features_of(&pictured, samples, &stop).ok_or(ShotError::Cancelled)?;
            nanos_of_features += nanos;
            let (color, of_denoiser) = self::denoised(&tiles.pictures, colors, &features, by)?;
            denoised.push(color);
            spent = spent.plus(Spent { work: 0, cpu_nanos: nanos + of_denoiser });
        }
        let (numbers, cost) =
            compared(ready, tiles, &colors, &denoised, &stop).ok_or(ShotError::Cancelled)?;
        spent = spent.plus(cost);
        let mean = mean.or(colors.last().map(|colors| mean_of(colors))).unwrap_or_default();
        let whole = mean * mean * ready.frame().camera.pixels() as f64;
        let mut points = Vec::new();
        for (samples, sums) in samples.iter().zip(&numbers).rev() {
            let (left, deviation) = root(sums, whole);
            let noise = noise(*samples)?.ln();
            // Noise that does not fall with the samples tells nothing more. Black images have none.
            let is_more = points.last().is_none_or(|last: &Point| noise > last.noise);
            if noise.is_finite() && left.is_finite() && is_more {
                points.push(Point { noise, left, deviation });
            }
        }
        // What is left may be too little to be measured by so few samples.
        let is_known = |point: &Point| point.deviation < UNKNOWN;
        if points.iter().any(is_known) {
            points.retain(is_known);
        }
        let all_samples = f64::from(samples.iter().sum::<u32>());
        let feature = nanos_of_features as f64 / (pictured.len() as f64 * all_samples);
        Ok((Self { points, denoiser: by.nanos_per_pixel as f64, feature }, spent))
    }

    /// The error of a denoised image.
    pub fn error(&self, Noisy { noise, of_cache }: Noisy) -> ImageError {
        let left = self.at(noise.p50.ln());
        let at = |of: fn(&ImageError) -> f64, normal: f64| {
            let left = left.map_or(of(&noise), |point| (point.left + normal * point.deviation).exp());
            left.hypot(of(&of_cache))
        };
        ImageError {
            p05: at(|error| error.p05, -1.645),
            p50: at(|error| error.p50, 0.0),
            p80: at(|error| error.p80, 0.842),
            p95: at(|error| error.p95, 1.645),
        }
    }

    /// CPU seconds of denoising an image, and of measuring what is left. `traced`: those of tracing its
    /// pixels.
    pub fn cpu_seconds(&self, settings: &RenderSettings, traced: f64) -> f64 {
        let of_pixel = self.denoiser + self.feature * f64::from(feature_samples(settings.spp));
        1e-9 * added_nanos((settings.pixels() as usize, settings.spp), of_pixel, 1e9 * traced)
    }

    /// What is left of this noise. `None` if there is none, or nothing was measured.
    fn at(&self, noise: f64) -> Option<Point> {
        let (first, last) = (self.points.first()?, self.points.last()?);
        if !noise.is_finite() {
            return None;
        }
        if noise >= last.noise {
            return Some(Point { noise, left: last.left + noise - last.noise, ..*last });
        }
        let next = self.points.partition_point(|point| point.noise <= noise);
        if next > 0 {
            let [a, b] = [self.points[next - 1], self.points[next]];
            let part = (noise - a.noise) / (b.noise - a.noise);
            let mix = |a: f64, b: f64| a + part * (b - a);
            let (left, deviation) = (mix(a.left, b.left), mix(a.deviation, b.deviation));
            return Some(Point { noise, left, deviation });
        }
        // Less noise leaves no more, and does not fall more quickly than itself.
        let slope = self.points.get(1).map_or(1.0, |b| (b.left - first.left) / (b.noise - first.noise));
        let beyond = first.noise - noise;
        let doublings = 2.0 * beyond / std::f64::consts::LN_2;
        Some(Point {
            noise,
            left: first.left - slope.clamp(0.0, 1.0) * beyond,
            deviation: first.deviation.hypot(BEYOND * doublings).min(UNKNOWN),
        })
    }
}

/// Pictures of the same size, denoised together, and the CPU time of that, nanoseconds. One is below the
/// other, with repeated rows between them, so that they do not run into each other.
fn denoised(
    pictures: &[Rect],
    colors: &[[f32; 3]],
    features: &[Feature],
    by: DenoiseBy<'_>,
) -> Result<(Vec<[f32; 3]>, u64), ShotError> {
    let (width, of_picture) = (pictures[0].width as usize, colors.len() / pictures.len());
    let gap = if pictures.len() > 1 { MARGIN as usize } else { 0 };
    let (color, features) =
        (stacked(colors, of_picture, width, gap), stacked(features, of_picture, width, gap));
    let size = (pictures[0].width, (color.len() / width) as u32);
    let made = without_noise(size, &color, &features, by.denoiser, by.run)?.ok_or(ShotError::Cancelled)?;
    let stack = made.color.chunks_exact(of_picture + 2 * gap * width);
    Ok((
        stack.flat_map(|picture| &picture[gap * width..][..of_picture]).copied().collect(),
        made.usage.cpu_nanos,
    ))
}

/// Pictures one below the other, each between `gap` copies of its first row and of its last.
fn stacked<T: Copy>(values: &[T], of_picture: usize, width: usize, gap: usize) -> Vec<T> {
    let with_gaps = |picture: &[T]| {
        [picture[..width].repeat(gap), picture.to_vec(), picture[of_picture - width..].repeat(gap)].concat()
    };
    values.chunks_exact(of_picture).flat_map(with_gaps).collect()
}

/// Squared errors of a tile, weighted.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Sums {
    noisy: f64,
    denoised: f64,
    /// Sum of the squares of each pixel's part of `denoised`.
    squares: f64,
    /// How often the tile was drawn.
    draws: u32,
}

/// Compares tiles with independent samples, for each number of samples. `None` if `stop` returned `true`.
fn compared(
    ready: &OwnFrame<'_>,
    tiles: &Tiles,
    colors: &[Vec<[f32; 3]>],
    denoised: &[Vec<[f32; 3]>],
    stop: &(dyn Fn() -> bool + Sync),
) -> Option<(Vec<Vec<Sums>>, Spent)> {
    let mut numbers = vec![Vec::new(); colors.len()];
    let mut spent = Spent::default();
    for tile in &tiles.tiles {
        let (means, cost) = ready.tracer.independent_pixels(&tiles.pixels(tile), MEANS, stop)?;
        spent = spent.plus(crate::costs::spent(cost));
        let places = tiles.places(tile);
        let of_numbers = colors.iter().zip(denoised);
        for (sums, (noisy, denoised)) in numbers.iter_mut().zip(of_numbers) {
            let mut sum = Sums { draws: tile.draws, ..Sums::default() };
            for (&place, means) in places.iter().zip(&means) {
                let left = tile.weight * square(denoised[place], means);
                sum.noisy += tile.weight * square(noisy[place], means);
                sum.denoised += left;
                sum.squares += left * left;
            }
            sums.push(sum);
        }
    }
    Some((numbers, spent))
}

/// Logarithm of the error of all tiles that is left, and its standard deviation. `whole`: number of the
/// image's pixels, times the square of its mean.
fn root(sums: &[Sums], whole: f64) -> (f64, f64) {
    let all = |of: fn(&Sums) -> f64| sums.iter().map(of).sum::<f64>();
    let (noisy, denoised) = (all(|sum| sum.noisy), all(|sum| sum.denoised));
    let root = |noisy: f64, denoised: f64| 0.5 * (denoised.max(LEAST_LEFT * noisy) / whole).ln();
    let count = all(|sum| f64::from(sum.draws));
    // The other draws stand for the one that is left out.
    let without = |sum: &Sums| {
        let draws = f64::from(sum.draws);
        let rest = |all: f64, own: f64| (all - own / draws) * count / (count - 1.0);
        (draws, root(rest(noisy, sum.noisy), rest(denoised, sum.denoised)))
    };
    let each: Vec<(f64, f64)> = sums.iter().filter(|_| count > 1.0).map(without).collect();
    let mean = each.iter().map(|(draws, root)| draws * root).sum::<f64>() / count;
    let squares = each.iter().map(|(draws, root)| draws * (root - mean).powi(2)).sum::<f64>();
    let of_tiles = (squares * (count - 1.0) / count).sqrt();
    // Within a tile, few pixels may hold most of the error.
    let of_pixels = 0.5 * all(|sum| sum.squares).sqrt() / denoised.max(LEAST_LEFT * noisy);
    let deviation = of_tiles.hypot(of_pixels);
    // `min` leaves out what is no number.
    (root(noisy, denoised), deviation.min(UNKNOWN))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn left(points: &[(f64, f64)]) -> Left {
        let point =
            |&(noise, left): &(f64, f64)| Point { noise: noise.ln(), left: left.ln(), deviation: 0.1 };
        Left { points: points.iter().map(point).collect(), denoiser: 0.0, feature: 0.0 }
    }

    fn known(error: f64) -> ImageError {
        ImageError { p05: error, p50: error, p80: error, p95: error }
    }

    fn noise(noise: f64) -> Noisy {
        Noisy { noise: known(noise), of_cache: known(0.0) }
    }

    #[test]
    fn other_noise_is_placed_between_what_was_measured_and_beyond_it() {
        let left = left(&[(0.1, 0.05), (0.2, 0.08), (0.4, 0.12)]);
        for (given, expected) in [
            (0.2, 0.08),
            // Halfway on logarithmic axes.
            (0.02f64.sqrt(), 0.004f64.sqrt()),
            // More noise: the same share is left. Less: as between the last two.
            (0.8, 0.24),
            (0.05, 0.05 * 0.05 / 0.08),
        ] {
            let found = left.error(noise(given));
            assert!((found.p50 / expected - 1.0).abs() < 1e-12, "{given}: {found:?}, not {expected}");
            assert!(found.p05 < found.p50 && found.p50 < found.p80 && found.p80 < found.p95, "{found:?}");
        }
        // The farther beyond, the less sure.
        let width = |given: f64| left.error(noise(given)).p95 / left.error(noise(given)).p05;
        assert!(width(0.01) > width(0.05) && width(0.05) > width(0.1));
        assert_eq!(left.error(noise(0.0)), known(0.0), "there is nothing to remove");
        assert!(width(f64::MIN_POSITIVE) < 30.0, "nothing is known, which is no reason for infinite errors");
    }

    #[test]
    fn less_noise_never_leaves_more() {
        let left = left(&[(0.1, 0.09), (0.4, 0.08)]);
        let at = |given: f64| left.error(noise(given)).p50;
        assert_eq!(at(0.01), at(0.1), "a denoiser that blurs what is there leaves as much");
    }

    #[test]
    fn what_a_cache_gets_wrong_stays() {
        let left = left(&[(0.1, 0.06), (0.2, 0.09)]);
        let of_cache = ImageError { p05: 0.01, p50: 0.08, p80: 0.1, p95: 0.2 };
        let found = left.error(Noisy { of_cache, ..noise(0.1) });
        assert!((found.p50 - 0.1).abs() < 1e-12, "{found:?}");
        assert!(found.p05 < found.p50 && found.p50 < found.p80 && found.p95 > 0.2, "{found:?}");
    }

    fn sums(denoised: f64, draws: u32) -> Sums {
        Sums { noisy: 8.0 * f64::from(draws), denoised, squares: 0.0, draws }
    }

    #[test]
    fn tiles_add_up_to_the_error_of_the_image_and_their_differences_to_its_deviation() {
        // 100 pixels of mean 2.
        let whole = 400.0;
        let (log, deviation) = root(&[sums(2.0, 1); 8], whole);
        assert!((log.exp() - 0.2).abs() < 1e-12 && deviation < 1e-12, "{log} {deviation}");
        // The squares of independent tiles vary by a fifth: their sum by a fourteenth, the root by half of
        // that.
        let uneven = [1.6, 2.4, 1.6, 2.4, 1.6, 2.4, 1.6, 2.4].map(|denoised| sums(denoised, 1));
        let found = root(&uneven, whole);
        let expected = 0.5 * 0.2 / 8f64.sqrt();
        assert!((0.9..1.2).contains(&(found.1 / expected)), "{found:?} {expected}");
        // A tile that was drawn several times counts as several.
        let merged = root(&[sums(6.4, 4), sums(9.6, 4)], whole);
        assert!((merged.0 - found.0).abs() < 1e-12 && (merged.1 - found.1).abs() < 1e-12, "{merged:?}");
        // Nothing measurable is left; a black image.
        let least = 0.5 * (64.0 * LEAST_LEFT / whole).ln();
        assert!((root(&[sums(-1.0, 1); 8], whole).0 - least).abs() < 1e-12);
        assert!(!root(&[Sums { draws: 1, ..Sums::default() }], 0.0).0.is_finite());
    }

    #[test]
    fn the_deviation_of_a_whole_image_comes_from_its_pixels() {
        // A hundred pixels of squares 0.1 ± 0.1: the sum varies by a tenth and the even part of it.
        let one = Sums { squares: 100.0 * 0.02, ..sums(10.0, 1) };
        let (log, deviation) = root(&[one], 1000.0);
        assert!((log.exp() - 0.1).abs() < 1e-12 && (deviation - 0.5 * 2f64.sqrt() / 10.0).abs() < 1e-12);
    }
}
