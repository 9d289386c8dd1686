//! Chooses the settings of an irradiance cache for an error.
//!
//! The error of a cache is a root mean square over blocks of 4 × 4 pixels, as a share of the image's mean, without
//! the noise of camera samples. Two parts add up. One is random: the noise of the gathers, which differs from
//! seed to seed and falls with the rays of a record. The other is the same with any seed: what interpolation gets
//! wrong, which falls with the distance between records.
//!
//! The random part is measured: a small image is made from two cheap caches with different seeds. The other part
//! would need light gathered at every point. But both grow with the contrast of the light. So one law tells the error
//! at other settings, as a multiple of the measured part. It is made from these rooms (128 × 128 pixels, one bounce,
//! 192 rays), as multiples of the random part at an accuracy of 0.2:
//!
//! | accuracy | random: kitchen, corridor, hall, box | the same: kitchen, corridor, hall, box |
//! | ---: | --- | --- |
//! | 0.05 | 0.92, 0.87, 0.79, 0.71 | 0.28, 0.22, 0.28, 0.43 |
//! | 0.1 | 0.92, 0.93, 0.85, 0.76 | 0.28, 0.29, 0.27, 0.57 |
//! | 0.2 | 1 | 0.44, 0.41, 0.38, 0.95 |
//! | 0.4 | 1.28, 1.38, 1.28, 1.57 | 0.76, 1.04, 0.80, 1.76 |
//! | 0.7 | 1.44, 1.45, 1.36, 1.76 | 0.92, 1.24, 0.78, 2.00 |
//! | 1 | 1.48, 1.47, 1.57, 1.90 | 1.32, 1.29, 1.11, 2.14 |

use super::blocks::Blocks;
use super::observer::AccuracyObserver;
use crate::error::ShotError;
use crate::shot::OwnShot;
use forelight_protocol::{CacheMode, RenderSettings, Spent};

/// Settings of a cache that leaves at most a certain error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChosenCache {
    /// Allowed error of interpolation, thousandths.
    pub accuracy: u32,
    /// Rays of a record.
    pub rays: u32,
    /// Forecast of the error, as a share of the image's mean.
    pub error: f64,
    /// Cost of the choice.
    pub spent: Spent,
}

impl ChosenCache {
    /// The settings with this cache.
    pub fn settings(&self, settings: &RenderSettings) -> RenderSettings {
        let (cache, cache_accuracy, cache_rays) = (CacheMode::On, self.accuracy, self.rays);
        RenderSettings { cache, cache_accuracy, cache_rays, ..settings.clone() }
    }
}

/// Longest side of the small image, and the least of the other one, pixels.
const SIDE: u32 = 96;
const LEAST_SIDE: u64 = 24;

/// Camera samples per pixel of each small image.
const SPP: u32 = 2;

/// Settings of the cheap caches.
const ACCURACY: u32 = 200;
const RAYS: u32 = 48;

/// Seeds of the cheap caches: the image's with these bits flipped.
const SEEDS: [u64; 2] = [0x0065_7272, 0x6f72_7321];

/// Variance with [`RAYS`], as a multiple of that with `LAW_RAYS`.
const CHEAP: f64 = 2.4;
const LAW_RAYS: f64 = 192.0;

/// A line of the law: the error at an accuracy, as a multiple of the random part at 0.2 and 192 rays.
struct Line {
    accuracy: u32,
    random: f64,
    same: f64,
}

const fn line(accuracy: u32, random: f64, same: f64) -> Line {
    Line { accuracy, random, same }
}

const LAW: [Line; 11] = [
    line(50, 0.82, 0.28),
    line(70, 0.84, 0.33),
    line(100, 0.87, 0.39),
    line(140, 0.92, 0.50),
    line(200, 1.0, 0.66),
    line(280, 1.18, 0.92),
    line(400, 1.37, 1.22),
    line(550, 1.45, 1.38),
    line(700, 1.50, 1.50),
    line(850, 1.55, 1.65),
    line(1000, 1.60, 1.80),
];

/// About as many records cover a room at an accuracy of 0.2, and four times as many at half of it, if pixels are
/// small. The number only weighs the cost of settings against each other.
const RECORDS: f64 = 12_000.0;

/// About as many records per pixel are the most: they are at least 1.5 pixels apart.
const RECORDS_PER_PIXEL: f64 = 0.55;

/// Cost of planning a record and of what every record costs, in rays.
const RECORD_RAYS: f64 = 72.0;

/// Largest share of the error that may be the same with any seed. The law knows that part least.
const MOST_SAME: f64 = 0.95;

/// Most rays of a record: 48 strata, each cut into 12 × 12.
const MOST_CUTS: u32 = 12;
const MOST_RAYS: u32 = RAYS * MOST_CUTS * MOST_CUTS;

/// The cheapest settings of a cache with which a frame's image has at most this error, a share of its mean. If none
/// has, the most accurate ones, whose error is larger. Uses the current thread pool.
pub fn choose_cache(
    shot: &OwnShot,
    frame: u32,
    settings: &RenderSettings,
    error: f64,
    observer: &dyn AccuracyObserver,
) -> Result<ChosenCache, ShotError> {
    let (random, spent) = measured(shot, frame, settings, observer)?;
    Ok(ChosenCache { spent, ..chosen(random, error, settings.pixels()) })
}

/// The random part of the error at an accuracy of 0.2 and 192 rays, and what it cost to find it.
fn measured(
    shot: &OwnShot,
    frame: u32,
    settings: &RenderSettings,
    observer: &dyn AccuracyObserver,
) -> Result<(f64, Spent), ShotError> {
    let (width, height) = small(settings);
    let image = |seed: u64| -> Result<(Blocks, Spent), ShotError> {
        let cheap = RenderSettings {
            width,
            height,
            spp: SPP,
            ambient_bounces: 1,
            cache: CacheMode::On,
            cache_accuracy: ACCURACY,
            cache_rays: RAYS,
            seed: settings.seed ^ seed,
            ..settings.clone()
        };
        let ready = shot.frame(frame, &cheap)?;
        let cancel = observer.cancel();
        if !ready.fill(&|_| (), cancel) {
            return Err(ShotError::Cancelled);
        }
        let (blocks, cost) = ready.blocks(settings.seed, cancel).ok_or(ShotError::Cancelled)?;
        Ok((blocks, ready.spent_on_setup().plus(ready.spent_on_cache()).plus(cost)))
    };
    let (one, first) = image(SEEDS[0])?;
    observer.predicted(1, 2);
    let (other, second) = image(SEEDS[1])?;
    observer.predicted(2, 2);
    let mean = one.mean();
    let variance = 0.5 * one.minus(&other).mean_square().max(0.0);
    let random = if mean > 0.0 { (variance / CHEAP).sqrt() / mean } else { 0.0 };
    Ok((random, first.plus(second)))
}

/// Width and height of the small image. Its shape is that of the image, unless that is a thin stripe.
fn small(settings: &RenderSettings) -> (u32, u32) {
    let RenderSettings { width, height, .. } = *settings;
    let longest = width.max(height);
    let side =
        |side: u32| (u64::from(side) * u64::from(SIDE) / u64::from(longest.max(1))).max(LEAST_SIDE) as u32;
    (side(width), side(height))
}

/// The cheapest settings with at most this error, or else the most accurate ones, and the error that they leave.
fn chosen(random: f64, error: f64, pixels: u64) -> ChosenCache {
    let expected = |line: &Line, rays: u32| {
        let times = if rays == RAYS { CHEAP } else { LAW_RAYS / f64::from(rays) };
        random * (line.random * line.random * times + line.same * line.same).sqrt()
    };
    let of_line = |line: &'static Line| {
        let mut rays = (1..=MOST_CUTS).map(|cuts| RAYS * cuts * cuts);
        let rays = rays.find(|&rays| expected(line, rays) <= error)?;
        if random * line.same > MOST_SAME * expected(line, rays) {
            return None;
        }
        let coarser = (f64::from(line.accuracy) / f64::from(ACCURACY)).powi(2);
        let records = 1.0 / (coarser / RECORDS + 1.0 / (RECORDS_PER_PIXEL * pixels as f64));
        Some((records * (f64::from(rays) + RECORD_RAYS), line, rays))
    };
    let cheapest = LAW.iter().filter_map(of_line).min_by(|(one, ..), (other, ..)| one.total_cmp(other));
    let (line, rays) = cheapest.map_or((&LAW[0], MOST_RAYS), |(_, line, rays)| (line, rays));
    ChosenCache { accuracy: line.accuracy, rays, error: expected(line, rays), spent: Spent::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: u64 = 1920 * 1080;

    fn cost(cache: &ChosenCache) -> f64 {
        f64::from(cache.rays) / f64::from(cache.accuracy).powi(2)
    }

    #[test]
    fn a_larger_error_never_costs_more_and_is_kept() {
        let mut before = f64::INFINITY;
        for error in [0.004, 0.006, 0.01, 0.02, 0.04, 0.5] {
            let cache = chosen(0.01, error, PIXELS);
            assert!(cache.error <= error, "{cache:?}");
            assert!(cost(&cache) <= before, "{cache:?}");
            before = cost(&cache);
        }
    }

    #[test]
    fn light_of_more_contrast_needs_a_better_cache() {
        let rooms = [0.002, 0.005, 0.01, 0.02].map(|random| chosen(random, 0.01, PIXELS));
        assert!(rooms.is_sorted_by(|one, other| cost(one) <= cost(other)), "{rooms:?}");
        assert_eq!((rooms[0].accuracy, rooms[0].rays), (1000, RAYS), "the cheapest cache will do");
        assert!(cost(&rooms[3]) > 30.0 * cost(&rooms[0]), "{rooms:?}");
    }

    #[test]
    fn if_none_keeps_the_error_the_best_one_says_what_it_leaves() {
        let best = chosen(0.05, 0.001, PIXELS);
        assert!(best.error > 0.01 && best.rays == MOST_RAYS, "{best:?}");
        assert_eq!(chosen(0.0, 0.001, 1).rays, RAYS, "in the dark, any will do");
    }

    #[test]
    fn the_small_image_has_the_shape_of_the_large_one() {
        let of = |size| small(&forelight_protocol::RenderSettingsRequest::default().complete(size));
        assert_eq!(of((1920, 1080)), (96, 54));
        assert_eq!(of((1080, 1920)), (54, 96));
        assert_eq!(of((40, 30)), (96, 72));
        assert_eq!(of((65_536, 1)), (96, 24));
    }
}
