//! Fits the law of [`super::variance_curve`] to the drops of an image's variance
//! ([`super::PixelNoise::drops`]).

use super::PixelNoise;
use super::variance_curve::{EXPONENTS, RANDOM, Terms, powers, powers_of_pixel, weighted, with_least_share};
use crate::moments::sum;

/// By how much a drop may differ from the law for each doubling before the last. The last ones tell best how
/// the variance goes on, where they are sure. (Plain scenes at 240 × 135, forecasts for 16 and for 64 samples
/// from 16. With the same deviation for all drops: 1.2 to 1.4 times the true error. With this: 1.03 to 1.3
/// times.)
const DEVIATION_OF_LAW: f64 = 0.15;

/// The same of the last doubling.
const LEAST_DEVIATION: f64 = 0.01;

/// How the terms follow from the drops. They are linear in the drops, and so can be added over pixels.
#[derive(Clone, Debug, Default)]
pub(super) struct VarianceFit {
    /// Weight of each drop in each term.
    weights: [Vec<f64>; 3],
    /// Weights for the largest plausible C (all C / n). Only set where C got its least share.
    pub at_most: Option<Vec<f64>>,
}

impl VarianceFit {
    /// Non-negative least squares over an image's drops, of which these are the variances: of one term or of
    /// two neighbouring ones. C then gets its least share.
    pub fn new(drops: &[f64], variances: &[f64]) -> Self {
        let least_squares = LeastSquares::new(drops, variances);
        let powers = powers(libm::exp2(drops.len() as f64));
        let value = |weights: &[f64]| weighted(weights, drops);
        let fits = least_squares.fits(drops).into_iter();
        // That of random samples alone is among them.
        let best = fits.min_by(|one, other| one.misfit.total_cmp(&other.misfit));
        let weights = best.map(|best| best.weights).unwrap_or_default();
        let terms = std::array::from_fn(|which| value(&weights[which]));
        match with_least_share(&terms, &powers) {
            None => Self { weights, at_most: None },
            // Fitted once more, with that share.
            Some(terms) => {
                Self { weights: least_squares.of(terms), at_most: Some(least_squares.factor(RANDOM)) }
            }
        }
    }

    /// The terms of a pixel's variance. These are estimates without bias, so they may be negative.
    pub fn terms(&self, pixel: &PixelNoise) -> Terms {
        std::array::from_fn(|which| weighted(&self.weights[which], &pixel.drops))
    }

    /// V(n) of a pixel at `samples` samples, beyond what was sampled.
    pub fn beyond(&self, pixel: &PixelNoise, samples: u32) -> f64 {
        weighted(&self.terms(pixel), &powers_of_pixel(samples))
    }
}

/// A fit of some terms.
struct Fit {
    /// Weight of each drop in each term.
    weights: [Vec<f64>; 3],
    /// Sum of the weighted squares of what it does not explain.
    misfit: f64,
}

/// Weighted least squares over an image's drops.
struct LeastSquares {
    /// Weight of each drop.
    weights: Vec<f64>,
}

impl LeastSquares {
    /// A drop's deviation is that of its estimate and that of the law, relative to its scale. Few pixels may
    /// look alike by chance, so no drop is taken to be surer than those before it.
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

    /// The fits of each term and of two neighbouring ones, as far as no term is negative. A single drop tells
    /// no two terms apart. Noise looks like A and C without B, too: with that choice, forecasts in
    /// modern-hall were 1.2 and 1.35 times the true error at 16 and at 64 samples.
    fn fits(&self, drops: &[f64]) -> Vec<Fit> {
        let alone = [RANDOM, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]].map(|terms| self.of(terms));
        let both = [(1, 2), (0, 1)].map(|(one, other)| {
            let mut weights = [(); 3].map(|()| vec![0.0; drops.len()]);
            [weights[one], weights[other]] = self.of_two(one, other);
            weights
        });
        let pairs = if drops.len() < 2 { 0 } else { both.len() };
        let fit = |weights: [Vec<f64>; 3]| {
            let terms: Terms = std::array::from_fn(|which| weighted(&weights[which], drops));
            let rest = |k: usize| drops[k] - sum((0..3).map(|which| terms[which] * drop_of(which, k)));
            let misfit = sum((0..drops.len()).map(|k| self.weights[k] * rest(k) * rest(k)));
            terms.iter().all(|term| *term >= 0.0).then_some(Fit { weights, misfit })
        };
        alone.into_iter().chain(both.into_iter().take(pairs)).filter_map(fit).collect()
    }

    /// Weight of each drop in each term, if the variance is a multiple of `terms`.
    fn of(&self, terms: Terms) -> [Vec<f64>; 3] {
        let factor = self.factor(terms);
        terms.map(|term| factor.iter().map(|weight| term * weight).collect())
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

/// Scales of drops: the fit's errors count relative to them. A scale is the drop itself, but after the one
/// before it falls at least as C / n and at most as B / n^1.5. Later drops come from fewer pairs of samples.
/// Relative to themselves, those that are low by chance would count most, and forecasts were too low by up to
/// a quarter (country-kitchen at 240 × 135, 16 samples: 8.3 % instead of 11.5 % for 11.3 %).
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
