//! Allots camera samples to the parts of an image: least error for a budget, or least cost for an error.
//!
//! Let zone *h* have N_h pixels, each with variance v_h(n) at n samples ([`super::Terms`]) and cost c_h per
//! sample. The error Σ N_h v_h(n_h) under a budget Σ N_h c_h n_h is least where
//!
//! ```text
//! −v_h'(n_h) = λ c_h ,   n_h ≥ 1 .
//! ```
//!
//! This extends the optimum allocation of Neyman (1934) (Cochran, *Sampling Techniques*, 3rd edition 1977,
//! section 5.5) to variances that fall faster than 1 / n.
//!
//! In a zone with 2.5 samples per pixel, every second pixel gets 3 and the others 2. Samples of a pixel
//! spread evenly only if their number is a power of two, or one and a half times one. The error at 46 samples
//! is 6 % smaller than at 40, and at 48 it is 16 % smaller. So [`whole`] mixes only such numbers.

use super::variance_curve::{EXPONENTS, Terms, powers, weighted};
use super::{ImageNoise, NoiseCell};
use crate::error::ForecastError;
use crate::moments::sum;

/// The largest number of camera samples of a pixel.
pub const MOST_SAMPLES: f64 = 65_535.0;

/// Weight of the whole image's curve in the curve of a zone, as a number of sampled pixels.
const IMAGE_WEIGHT: f64 = 2.0;

/// A set of pixels that all get the same number of camera samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zone {
    /// Number of pixels.
    pub pixels: f64,
    /// A pixel's variance.
    pub variance: Terms,
    /// Cost of one camera sample of one pixel, in any unit that all zones share.
    pub cost: f64,
}

impl Zone {
    /// Builds a zone of an image from its cells ([`super::NoiseGroup::cells`]) and the costs of its profiled
    /// pixels at `spp` camera samples. Its curve is shrunk towards that of the whole image, which stands
    /// beside the image ([`ImageNoise::curve`]).
    ///
    /// # Errors
    /// [`ForecastError::NoSamples`] if a cell or `costs` is empty.
    pub fn new(
        (image, of_image): (&ImageNoise, Terms),
        cells: &[NoiseCell],
        costs: &[f64],
        spp: u32,
    ) -> Result<Self, ForecastError> {
        if costs.is_empty() || cells.iter().any(|cell| cell.samples.is_empty()) {
            return Err(ForecastError::NoSamples);
        }
        let pixels = sum(cells.iter().map(|cell| cell.pixels as f64));
        let count = cells.iter().map(|cell| cell.samples.len()).sum::<usize>() as f64;
        let variance = std::array::from_fn(|which| {
            let mean = |cell: &NoiseCell| {
                let curves = cell.samples.iter().map(|pixel| image.curve_of(pixel)[which]);
                cell.pixels as f64 * sum(curves) / cell.samples.len() as f64
            };
            let own = sum(cells.iter().map(mean)) / pixels.max(1.0);
            ((count * own + IMAGE_WEIGHT * of_image[which]) / (count + IMAGE_WEIGHT)).max(0.0)
        });
        let cost = sum(costs.iter().copied()) / costs.len() as f64 / f64::from(spp);
        Ok(Self { pixels, variance, cost })
    }

    /// Sum of the variances of the zone's pixels at `samples` samples each.
    pub(super) fn error(&self, samples: f64) -> f64 {
        self.pixels * weighted(&self.variance, &powers(samples))
    }

    /// How much the error falls per unit of additional cost, at `samples` samples per pixel.
    fn gain(&self, samples: f64) -> f64 {
        weighted(&self.slopes(), &powers(samples)) / samples / self.cost()
    }

    /// Coefficients of the variance's fall with samples.
    fn slopes(&self) -> Terms {
        std::array::from_fn(|k| EXPONENTS[k] * self.variance[k])
    }

    fn cost(&self) -> f64 {
        self.cost.max(f64::MIN_POSITIVE)
    }

    /// The number of samples at which the gain has fallen to `price`.
    fn samples_at(&self, price: f64) -> f64 {
        if self.gain(1.0) <= price {
            return 1.0;
        }
        if self.gain(MOST_SAMPLES) >= price {
            return MOST_SAMPLES;
        }
        // Times n³, gain = price is a polynomial in s = √n: price s⁶ − square s² − linear s − constant = 0.
        // It has one positive root and is convex beyond it, so Newton's method started above descends to it.
        let [constant, linear, square] = self.slopes();
        let price = price * self.cost();
        // The root is above 1. Hence s⁴ is at most three times the largest coefficient over the price.
        let above = libm::sqrt(libm::sqrt(3.0 * constant.max(linear).max(square) / price));
        let step = |s: f64| {
            let fourth = price * s * s * s * s;
            let value = ((fourth - square) * s - linear) * s - constant;
            s - value / ((6.0 * fourth - 2.0 * square) * s - linear)
        };
        let mut root = above;
        while step(root) < root {
            root = step(root);
        }
        (root * root).clamp(1.0, MOST_SAMPLES)
    }
}

/// Samples per pixel of each zone with the least error for the total cost `budget`. Zone *h* gets at least
/// `has[h]` ≥ 1 samples per pixel. `None` if these alone cost more.
pub(super) fn samples_for_budget(zones: &[Zone], has: &[f64], budget: f64) -> Option<Vec<f64>> {
    let with =
        |samples: &[f64]| -> Vec<f64> { samples.iter().zip(has).map(|(n, has)| n.max(*has)).collect() };
    let left = |samples: &[f64]| libm::log(budget / cost(zones, &with(samples)));
    (cost(zones, has) <= budget).then(|| with(&by_price(zones, left)))
}

/// Samples per pixel for the mean pixel variance `variance` at the least cost, at most [`MOST_SAMPLES`].
pub fn samples_for_variance(zones: &[Zone], variance: f64) -> Vec<f64> {
    by_price(zones, |samples| libm::log(mean_variance(zones, samples) / variance))
}

/// Tolerance on logarithms: values this close to zero count as zero.
const NEAR_ZERO: f64 = 1e-10;

/// The samples at the lowest price with `slack` ≥ 0, else at the highest price. `slack` grows as samples get
/// fewer. It is the logarithm of roughly a power of the price.
fn by_price(zones: &[Zone], slack: impl Fn(&[f64]) -> f64) -> Vec<f64> {
    let at = |price: f64| -> Vec<f64> { zones.iter().map(|zone| zone.samples_at(price)).collect() };
    // Within this range of prices, all zones go from the most samples to one.
    let gains = |samples: f64| zones.iter().map(move |zone| zone.gain(samples)).filter(|gain| *gain > 0.0);
    let (Some(low), Some(high)) = (gains(MOST_SAMPLES).reduce(f64::min), gains(1.0).reduce(f64::max)) else {
        return vec![1.0; zones.len()];
    };
    let (most, mut best) = (at(low), at(high));
    let (least, mut left) = (slack(&most), slack(&best));
    if least >= 0.0 {
        return most;
    }
    let mut ends = [(libm::log(low), least), (libm::log(high), left)];
    // The Illinois method (regula falsi): an end that is kept twice in a row counts half. Every fourth step
    // bisects, because slack is not linear where zones reach a limit.
    let mut moved = None;
    for step in 1..100 {
        let [below, above] = ends;
        if left <= NEAR_ZERO || above.0 - below.0 <= NEAR_ZERO {
            break;
        }
        let line = above.0 - above.1 * (above.0 - below.0) / (above.1 - below.1);
        let is_between = step % 4 > 0 && line > below.0 && line < above.0;
        let price = if is_between { line } else { 0.5 * (below.0 + above.0) };
        let samples = at(libm::exp(price));
        let here = slack(&samples);
        let end = usize::from(here >= 0.0);
        if moved == Some(end) {
            ends[1 - end].1 *= 0.5;
        }
        (ends[end], moved) = ((price, here), Some(end));
        if end == 1 {
            (best, left) = (samples, here);
        }
    }
    best
}

/// Total cost of the zones with `samples` samples per pixel.
pub fn cost(zones: &[Zone], samples: &[f64]) -> f64 {
    sum(zones.iter().zip(samples).map(|(zone, n)| zone.pixels * zone.cost * n))
}

/// Mean variance over all pixels, with `samples` samples per pixel of each zone.
pub(super) fn mean_variance(zones: &[Zone], samples: &[f64]) -> f64 {
    let pixels = sum(zones.iter().map(|zone| zone.pixels));
    sum(zones.iter().zip(samples).map(|(zone, n)| zone.error(*n))) / pixels.max(1.0)
}

/// Whole numbers of samples for the pixels of a zone, in order: a mixture of the two [`even_numbers`] with
/// the mean `samples`. If `samples` grows, no pixel gets fewer.
pub fn whole(samples: f64, pixels: usize) -> impl Iterator<Item = u32> {
    let step = coprime_to(pixels);
    let [below, above] = even_numbers(samples);
    let fraction = (samples - f64::from(below)) / f64::from(above - below);
    // Each pixel compares the fraction with a threshold of its own. The thresholds are evenly spaced, and
    // those of neighbouring pixels differ by about the golden section.
    (0..pixels).map(move |i| {
        let threshold = (((i as u128 * step as u128) % pixels as u128) as f64 + 0.5) / pixels as f64;
        if fraction + threshold >= 1.0 { above } else { below }
    })
}

/// The largest evenly spreading number of samples not above `samples`, and the next larger one: powers of
/// two, and one and a half times these.
pub fn even_numbers(samples: f64) -> [u32; 2] {
    // The conversion turns NaN into 0, and `max` into 1.
    let samples = (samples.clamp(1.0, MOST_SAMPLES) as u32).max(1);
    let power = 1 << samples.ilog2();
    match power / 2 {
        0 => [1, 2],
        half if samples < power + half => [power, power + half],
        half => [power + half, 2 * power],
    }
}

/// The smallest number from `count` times the golden section on that is coprime to `count`.
fn coprime_to(count: usize) -> usize {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let share_no_divisor = |&step: &usize| {
        let (mut a, mut b) = (count, step);
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a == 1
    };
    let first = libm::round(GOLDEN * count as f64) as usize;
    (first.max(1)..).find(share_no_divisor).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn zones() -> Vec<Zone> {
        vec![
            Zone { pixels: 1000.0, variance: [0.0, 0.0, 1.0], cost: 1.0 },
            Zone { pixels: 50.0, variance: [10.0, 30.0, 10.0], cost: 2.0 },
            Zone { pixels: 200.0, variance: [0.0; 3], cost: 1.0 },
        ]
    }

    #[test]
    fn a_budget_is_spent_and_no_exchange_between_zones_lowers_the_error() {
        let zones = zones();
        let samples = samples_for_budget(&zones, &[1.0; 3], 20_000.0).unwrap();
        assert!((cost(&zones, &samples) / 20_000.0 - 1.0).abs() < 1e-9);
        assert_eq!(samples[2], 1.0, "what does not vary gets one sample");
        assert!(samples[1] > 2.0 * samples[0], "{samples:?}");
        let best = mean_variance(&zones, &samples);
        for moved in [-0.05, 0.05] {
            let mut other = samples.clone();
            other[0] += moved;
            other[1] -= moved * zones[0].pixels / (zones[1].pixels * zones[1].cost);
            assert!(mean_variance(&zones, &other) > best);
        }
    }

    #[test]
    fn what_zones_have_already_is_counted_and_the_others_share_the_rest() {
        let zones = zones();
        let free = samples_for_budget(&zones, &[1.0; 3], 20_000.0).unwrap();
        let has = [1.0, 2.0 * free[1], 3.0];
        let samples = samples_for_budget(&zones, &has, 20_000.0).unwrap();
        assert!((cost(&zones, &samples) / 20_000.0 - 1.0).abs() < 1e-9);
        assert_eq!(samples[1..], has[1..]);
        assert!(samples[0] < free[0]);
        assert_eq!(samples_for_budget(&zones, &has, 0.99 * cost(&zones, &has)), None);
    }

    #[test]
    fn an_error_costs_what_its_own_budget_gives_it_for() {
        let zones = zones();
        let samples = samples_for_variance(&zones, 0.02);
        assert!((mean_variance(&zones, &samples) / 0.02 - 1.0).abs() < 1e-6);
        let again = samples_for_budget(&zones, &[1.0; 3], cost(&zones, &samples)).unwrap();
        assert!(samples.iter().zip(&again).all(|(a, b)| (a / b - 1.0).abs() < 1e-4), "{samples:?} {again:?}");
    }

    proptest! {
        /// Whatever the zones, a budget is never exceeded, and is spent unless all zones have the most
        /// samples.
        #[test]
        fn any_budget_is_spent_and_never_exceeded(
            zones in prop::collection::vec(
                (1.0..1e6f64, prop::array::uniform3(-12.0..12.0f64), 0.01..100.0f64, 1.0..50.0f64),
                1..40,
            ),
            more in 0.0..12.0f64,
        ) {
            let has: Vec<f64> = zones.iter().map(|zone| zone.3).collect();
            let zones: Vec<Zone> = zones
                .into_iter()
                .map(|(pixels, variance, cost, _)| Zone { pixels, variance: variance.map(libm::exp), cost })
                .collect();
            let budget = cost(&zones, &has) * libm::exp(more);
            let samples = samples_for_budget(&zones, &has, budget).unwrap();
            let spent = cost(&zones, &samples);
            prop_assert!(spent <= budget, "{spent} of {budget}");
            let all_have_the_most = samples.iter().all(|n| *n >= 0.999 * MOST_SAMPLES);
            prop_assert!(all_have_the_most || spent >= budget * (1.0 - 1e-6), "{spent} of {budget}");
        }
    }

    #[test]
    fn samples_for_a_price_gain_just_that() {
        let variances = [
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [2.0, 3.0, 1.0],
            [0.0, 1e-9, 7.0],
            [5e12, 1.0, 1e-3],
        ];
        for zone in variances.map(|variance| Zone { pixels: 3.0, variance, cost: 0.7 }) {
            for samples in [1.5, 2.0, 37.25, 1000.0, 60_000.0] {
                let found = zone.samples_at(zone.gain(samples));
                assert!((found / samples - 1.0).abs() < 1e-9, "{zone:?}: {found} for {samples}");
            }
            assert_eq!((zone.samples_at(1e300), zone.samples_at(0.0)), (1.0, MOST_SAMPLES));
        }
    }

    #[test]
    fn what_cannot_be_had_is_said_or_comes_as_near_as_it_can() {
        let zones = zones();
        assert_eq!(
            samples_for_budget(&zones, &[1.0; 3], 1299.0),
            None,
            "one sample of every pixel costs 1300"
        );
        assert!(samples_for_budget(&zones, &[1.0; 3], 1300.0).is_some());
        let most = samples_for_variance(&zones, 0.0);
        assert_eq!(most[0], MOST_SAMPLES);
        assert_eq!(samples_for_variance(&zones, f64::INFINITY), [1.0; 3]);
        let black = [Zone { pixels: 5.0, variance: [0.0; 3], cost: 0.0 }];
        assert_eq!(samples_for_budget(&black, &[1.0], 0.0), Some(vec![1.0]));
        assert_eq!(samples_for_budget(&[], &[], 1.0), Some(vec![]));
    }

    #[test]
    fn whole_numbers_of_samples_have_the_mean_of_the_broken_one() {
        for (samples, pixels) in [(2.25, 1000), (1.0, 7), (3.999, 500), (1.5, 1), (7.1, 3), (46.0, 640)] {
            let all: Vec<u32> = whole(samples, pixels).collect();
            let mean = f64::from(all.iter().sum::<u32>()) / pixels as f64;
            let [below, above] = even_numbers(samples);
            assert!(
                (mean - samples).abs() <= 0.5 * f64::from(above - below) / pixels as f64 + 1e-9,
                "{samples}: {mean}"
            );
            assert!(all.iter().all(|n| [below, above].contains(n)));
        }
        assert_eq!(whole(1.5, 0).count(), 0);
    }

    #[test]
    fn samples_lie_evenly_at_powers_of_two_and_half_as_many_more() {
        let numbers = [1.0, 1.9, 2.0, 3.5, 4.0, 5.0, 6.0, 46.0, 48.0, 1000.0].map(even_numbers);
        let pairs = [(1, 2), (1, 2), (2, 3), (3, 4), (4, 6), (4, 6), (6, 8), (32, 48), (48, 64), (768, 1024)];
        assert_eq!(numbers, pairs.map(|(below, above)| [below, above]));
        assert_eq!(even_numbers(MOST_SAMPLES), [49_152, 65_536]);
        assert_eq!([f64::NAN, 0.0, f64::INFINITY].map(|n| even_numbers(n)[0]), [1, 1, 49_152]);
    }

    #[test]
    fn with_more_samples_no_pixel_gets_fewer_and_every_stretch_of_pixels_its_share() {
        for pixels in [1, 2, 6, 97, 1000] {
            let mut before = vec![0; pixels];
            for step in 0..50 {
                let now: Vec<u32> = whole(1.0 + 0.23 * f64::from(step), pixels).collect();
                assert!(before.iter().zip(&now).all(|(before, now)| before <= now), "{pixels}");
                before = now;
            }
        }
        let all: Vec<u32> = whole(2.25, 1000).collect();
        for stretch in all.chunks(50) {
            let mean = f64::from(stretch.iter().sum::<u32>()) / 50.0;
            assert!((mean - 2.25).abs() < 0.05, "{stretch:?}");
        }
    }
}
