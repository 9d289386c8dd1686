//! Fits the law of [`super::variance_curve`] to the drops of an image's variance ([`super::PixelNoise::drops`]).

use super::PixelNoise;
use super::variance_curve::{self, EXPONENTS, RANDOM, Terms, powers, powers_of_pixel};
use crate::moments::sum;

/// Least share of C / n in the variance at the last sampled number of samples. Few pixels may suggest none,
/// which halved the error forecast for sixteen times as many samples on the test scenes. In three rooms the
/// variance at 16 samples was 5.8 times that at 64. With this share, and the rest at n^−1.5, it is 6 times.
pub(super) const MIN_INDEPENDENT_SHARE: f64 = 1.0 / 3.0;

/// By how much a drop may differ from the law for each doubling before the last. The last ones tell best how the
/// variance goes on, where they are sure. (Plain scenes at 240 × 135, forecasts for 16 and for 64 samples from 16.
/// With the same deviation for all drops: 1.2 to 1.4 times the true error. With this: 1.03 to 1.25 times.)
const DEVIATION_OF_LAW: f64 = 0.15;

/// The same of the last doubling.
const LEAST_DEVIATION: f64 = 0.01;

/// How the terms follow from the drops. They are linear in the drops, and so can be added over pixels.
#[derive(Clone, Debug, Default)]
pub(super) struct VarianceFit {
    /// Weight of each drop in each term.
    weights: [Vec<f64>; 3],
    /// Weights for the largest plausible C (all C / n). Only set where C was below [`MIN_INDEPENDENT_SHARE`].
    pub at_most: Option<Vec<f64>>,
}

impl VarianceFit {
    /// Weighted least squares over an image's drops, of which these are the variances. It has one term, or two
    /// neighbouring ones, and neither is negative.
    pub fn new(drops: &[f64], variances: &[f64]) -> Self {
        let least_squares = LeastSquares::new(drops, variances);
        let value = |weights: &[f64]| weighted(weights, drops);
        // From the flattest terms to the steepest. A single drop tells no two terms apart.
        let pairs = if drops.len() < 2 { 0..0 } else { 0..2 };
        let fitted = pairs.rev().find_map(|steep| {
            let flat = steep + 1;
            let [of_steep, of_flat] = least_squares.of_two(steep, flat);
            if value(&of_steep) <= 0.0 {
                return Some(least_squares.of_one(flat));
            }
            if value(&of_flat) > 0.0 {
                let mut both = [(); 3].map(|()| vec![0.0; drops.len()]);
                (both[steep], both[flat]) = (of_steep, of_flat);
                return Some(both);
            }
            (steep == 0).then(|| least_squares.of_one(steep))
        });
        let weights = fitted.unwrap_or_else(|| least_squares.of_one(2));
        let powers = powers(libm::exp2(drops.len() as f64));
        let parts: Terms = std::array::from_fn(|which| value(&weights[which]) * powers[which]);
        let [steep, edges, random] = parts;
        if random >= MIN_INDEPENDENT_SHARE * (steep + edges + random) {
            return Self { weights, at_most: None };
        }
        // Fitted once more, with that share.
        let rest = (1.0 - MIN_INDEPENDENT_SHARE) / (steep + edges);
        let shares = [rest * steep, rest * edges, MIN_INDEPENDENT_SHARE];
        Self {
            weights: least_squares.of(std::array::from_fn(|which| shares[which] / powers[which])),
            at_most: Some(least_squares.factor(RANDOM)),
        }
    }

    /// The terms of a pixel's variance. These are estimates without bias, so they may be negative.
    pub fn terms(&self, pixel: &PixelNoise) -> Terms {
        std::array::from_fn(|which| weighted(&self.weights[which], &pixel.drops))
    }

    /// V(n) of a pixel at `samples` samples, beyond what was sampled.
    pub fn beyond(&self, pixel: &PixelNoise, samples: u32) -> f64 {
        variance_curve::weighted(&self.terms(pixel), &powers_of_pixel(samples))
    }
}

/// A linear combination of drops.
pub(super) fn weighted(weights: &[f64], drops: &[f64]) -> f64 {
    sum(weights.iter().zip(drops).map(|(weight, drop)| weight * drop))
}

/// Weighted least squares over an image's drops.
struct LeastSquares {
    /// Weight of each drop.
    weights: Vec<f64>,
}

impl LeastSquares {
    /// A drop's deviation is that of its estimate and that of the law, relative to its scale. Few pixels may look
    /// alike by chance, so no drop is taken to be surer than those before it.
    fn new(drops: &[f64], variances: &[f64]) -> Self {
        let mut estimate = 0.0f64;
        let weight = |(k, scale): (usize, f64)| {
            let relative = variances[k] / (drops[k] * drops[k]);
            estimate = if relative.is_finite() { estimate.max(relative) } else { estimate };
            let law = LEAST_DEVIATION + DEVIATION_OF_LAW * (drops.len() - 1 - k) as f64;
            1.0 / (scale * scale * (estimate + law * law))
        };
        Self { weights: scales(drops).into_iter().enumerate().map(weight).collect() }
    }

    /// Weight of each drop in each term, if the variance is a multiple of `terms`.
    fn of(&self, terms: Terms) -> [Vec<f64>; 3] {
        let factor = self.factor(terms);
        terms.map(|term| factor.iter().map(|weight| term * weight).collect())
    }

    /// The same for a single term.
    fn of_one(&self, which: usize) -> [Vec<f64>; 3] {
        let mut terms = Terms::default();
        terms[which] = 1.0;
        self.of(terms)
    }

    /// Weight of each drop in the factor of `terms`.
    fn factor(&self, terms: Terms) -> Vec<f64> {
        let shape = |k: usize| sum((0..3).map(|which| terms[which] * drop_of(which, k)));
        let levels = 0..self.weights.len();
        let product = sum(levels.clone().map(|k| self.weights[k] * shape(k) * shape(k)));
        levels.map(|k| self.weights[k] * shape(k) / product).collect()
    }

    /// Weight of each drop in each of two terms.
    fn of_two(&self, one: usize, other: usize) -> [Vec<f64>; 2] {
        let levels = 0..self.weights.len();
        let product = |one: usize, other: usize| {
            sum(levels.clone().map(|k| self.weights[k] * drop_of(one, k) * drop_of(other, k)))
        };
        let (of_one, of_other, mixed) = (product(one, one), product(other, other), product(one, other));
        let determinant = of_one * of_other - mixed * mixed;
        [(one, of_other, other), (other, of_one, one)].map(|(own, square, other)| {
            let of = |k: usize| self.weights[k] * (square * drop_of(own, k) - mixed * drop_of(other, k));
            levels.clone().map(|k| of(k) / determinant).collect()
        })
    }
}

/// Drop k of a term with the coefficient 1.
fn drop_of(which: usize, k: usize) -> f64 {
    let exponent = EXPONENTS[which];
    libm::exp2(-exponent * k as f64) * (1.0 - libm::exp2(-exponent))
}

/// Scales of drops: the fit's errors count relative to them. A scale is the drop itself, but after the one before
/// it falls by no less than B / n^1.5 and no more than C / n would. Later drops come from fewer pairs of
/// samples. Relative to themselves, those that are low by chance would count most, and forecasts were too low
/// by up to a quarter (country-kitchen at 240 × 135, 16 samples: 8.3 % instead of 11.5 % for 11.3 %).
fn scales(drops: &[f64]) -> Vec<f64> {
    let largest = drops.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let [_, steep, flat] = EXPONENTS.map(|exponent| libm::exp2(-exponent));
    let mut before = None;
    let scale = |drop: &f64| {
        let own = (drop / largest).max(1e-6);
        let scale = before.map_or(own, |before: f64| own.clamp(before * steep, before * flat));
        before = Some(scale);
        scale
    };
    drops.iter().map(scale).collect()
}
