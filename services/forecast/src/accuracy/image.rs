//! From the noise of some pixels to the error of the whole image.

use serde::{Deserialize, Serialize};

use super::PixelNoise;
use super::law::{EXPONENTS, between, powers, powers_of_pixel};
use crate::error::ForecastError;
use crate::interval::{Calibration, Part, quantity, together};
use crate::moments::sum;
use crate::strata::Stratum;

/// A profiled pixel with what its camera samples say.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseSample {
    /// Index of the pixel's stratum.
    pub stratum: u32,
    /// What its samples say.
    pub noise: PixelNoise,
}

/// Pixels of an image that some of them stand for, one by one with the same chance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseCell {
    /// All of them.
    pub pixels: u64,
    /// Those that were sampled.
    pub samples: Vec<PixelNoise>,
}

/// The error that an image is expected to have, as a share of its mean: the values that it stays below with these probabilities.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorQuantiles {
    /// 5 % quantile.
    pub p05: f64,
    /// The error is as likely above as below this.
    pub p50: f64,
    /// 80 % quantile.
    pub p80: f64,
    /// 95 % quantile.
    pub p95: f64,
}

/// An estimated mean square error, relative to the square of the image's mean, with its uncertainty.
#[derive(Clone, Copy, Debug)]
pub struct MeanSquare {
    /// The estimate, not negative.
    pub value: f64,
    /// Its variance.
    pub variance: f64,
    /// Degrees of freedom behind the variance.
    pub degrees_of_freedom: f64,
}

impl MeanSquare {
    /// The mean square of two independent errors together.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        let Part { variance, degrees_of_freedom } = together(&[self.part(), other.part()]);
        Self { value: self.value + other.value, variance, degrees_of_freedom }
    }

    /// The mean square error of several images together, each counting the same. Their samples are independent.
    pub fn mean(images: &[Self]) -> Option<Self> {
        let count = images.len() as f64;
        let all = images.iter().copied().reduce(Self::plus)?;
        Some(all.scaled(1.0 / count))
    }

    /// Its root, with quantiles by a log-t interval.
    pub fn error(&self, calibration: Calibration) -> ErrorQuantiles {
        let square = quantity(self.value, self.part(), calibration);
        // Half the logarithm: the interval of the root is as wide below as above.
        let low = if square.p95 > 0.0 { square.mean * (square.mean / square.p95) } else { 0.0 };
        let [p05, p50, p80, p95] = [low, square.p50, square.p80, square.p95].map(libm::sqrt);
        ErrorQuantiles { p05, p50, p80, p95 }
    }

    fn scaled(self, factor: f64) -> Self {
        Self { value: self.value * factor, variance: self.variance * factor * factor, ..self }
    }

    fn part(&self) -> Part {
        Part { variance: self.variance, degrees_of_freedom: self.degrees_of_freedom }
    }
}

/// At least this share of the variance at the last sampled number of samples is taken to be random. Few drops of few pixels may well say that
/// nothing is; on the test scenes that was never so, and halved the error that was forecast for sixteen times the samples.
const LEAST_RANDOM: f64 = 1.0 / 3.0;

/// Doublings of one sample that are looked at: numbers of samples are of 32 bits.
const MOST_LEVELS: usize = 31;

/// The error of an image by its number of camera samples.
#[derive(Clone, Debug)]
pub struct ImageNoise {
    cells: Vec<NoiseCell>,
    /// Doublings that every pixel has a drop for.
    levels: usize,
    /// Mean brightness of the image, and the relative variance of that.
    mean: f64,
    mean_variance: f64,
    fit: Fit,
}

/// How A and B follow from drops: both are linear in them, and so add up over pixels.
#[derive(Clone, Debug, Default)]
struct Fit {
    /// Weight of each drop in A and in B.
    weights: [Vec<f64>; 2],
    /// The same of B if all were random, where less than [`LEAST_RANDOM`] came out: what it may be at most.
    at_most: Option<Vec<f64>>,
}

impl ImageNoise {
    /// Of an image that is made of these cells. All pixels were traced with the same number of camera samples.
    ///
    /// # Errors
    /// If nothing was sampled of a cell, or with one camera sample only.
    pub fn new(cells: Vec<NoiseCell>) -> Result<Self, ForecastError> {
        let cells: Vec<NoiseCell> = cells.into_iter().filter(|cell| cell.pixels > 0).collect();
        if cells.iter().any(|cell| cell.samples.is_empty()) {
            return Err(ForecastError::NoSamples);
        }
        let all = cells.iter().flat_map(|cell| &cell.samples);
        let levels = all.map(|sample| sample.drops.len()).min();
        let levels = levels.filter(|&levels| levels > 0).ok_or(ForecastError::NoSamples)?.min(MOST_LEVELS);
        let mut noise = Self { cells, levels, mean: 0.0, mean_variance: 0.0, fit: Fit::default() };
        let (mean, part) = noise.stratified(|pixel| pixel.brightness);
        noise.mean = mean;
        noise.mean_variance = if mean > 0.0 { part.variance / mean / mean } else { 0.0 };
        noise.fit = Fit::of(&noise.drops());
        Ok(noise)
    }

    /// Mean brightness of the image.
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// The image's own drops, of [`PixelNoise::drops`]: means over its pixels, in the unit of brightness squared.
    pub fn drops(&self) -> Vec<f64> {
        (0..self.levels).map(|k| self.stratified(|pixel| pixel.drops[k]).0).collect()
    }

    /// A and B of the image's variance A / n^1.5 + B / n, mean of its pixels, in the unit of brightness squared.
    pub fn curve(&self) -> [f64; 2] {
        [0, 1].map(|which| self.stratified(|pixel| self.curve_of(pixel)[which]).0)
    }

    /// What one pixel says of them; of a single one they may be negative.
    pub fn curve_of(&self, pixel: &PixelNoise) -> [f64; 2] {
        [0, 1].map(|which| weighted(&self.fit.weights[which], pixel))
    }

    /// The mean square error of the image at a number of camera samples a pixel, at least 1, with what does not fall with samples.
    pub fn at(&self, spp: u32) -> MeanSquare {
        self.noise_at(spp).plus(self.bias_square())
    }

    /// The part of it that does not fall with samples.
    pub fn bias_square(&self) -> MeanSquare {
        self.mean_square(|pixel| pixel.bias_square)
    }

    /// The part of it that falls with samples.
    ///
    /// At the powers of two that were sampled it is the sum of all further drops and of what is left beyond them, which is taken to fall as
    /// the law A / n^1.5 + B / n says; of numbers between them too. Its variance is that of the estimate and that of the error of a single image, in
    /// which a few pixels may come out well or badly: 2 V² of each, as of a normal number.
    pub fn noise_at(&self, spp: u32) -> MeanSquare {
        let spp = spp.max(1);
        let below = spp.ilog2() as usize;
        if below >= self.levels {
            return self.noise(|pixel| self.fit.beyond(pixel, spp), spp);
        }
        let at = |k: usize| {
            let samples = 1 << self.levels;
            let value = move |pixel: &PixelNoise| {
                sum(pixel.drops[k..self.levels].iter().copied()) + self.fit.beyond(pixel, samples)
            };
            self.noise(value, samples)
        };
        let known = at(below);
        let ratio = if known.value > 0.0 { at(below + 1).value / known.value } else { 0.0 };
        let between = between(spp);
        known.scaled(between + (1.0 - between) * ratio)
    }

    /// The mean square of an image by the variances of its pixels, of which all beyond so many samples is extrapolated.
    fn noise(&self, variance: impl Fn(&PixelNoise) -> f64, samples: u32) -> MeanSquare {
        let mut square = self.mean_square(&variance);
        if self.mean > 0.0 {
            let scale = 1.0 / (self.mean * self.mean);
            let pixels = self.cells.iter().map(|cell| cell.pixels).sum::<u64>() as f64;
            let of_cell = |cell: &NoiseCell| {
                let fourth = cell.samples.iter().map(|pixel| 2.0 * variance(pixel) * variance(pixel));
                cell.pixels as f64 / pixels * sum(fourth) / cell.samples.len() as f64
            };
            square.variance += sum(self.cells.iter().map(of_cell)) / pixels * scale * scale;
            if let Some(weights) = &self.fit.at_most {
                let at_most =
                    self.stratified(|pixel| weighted(weights, pixel)).0 / f64::from(samples) * scale;
                let is = self.stratified(|pixel| self.fit.beyond(pixel, samples)).0 * scale;
                // All of it is at the 95 % quantile of a normal number.
                let deviation = (at_most - is).max(0.0) / 1.645;
                square.variance += deviation * deviation;
            }
        }
        square
    }

    /// A mean square over the image's pixels, relative to the square of the image's mean. What is estimated as a product may come out
    /// below 0, and is then 0, but no surer.
    fn mean_square(&self, value: impl Fn(&PixelNoise) -> f64) -> MeanSquare {
        let (mean, part) = self.stratified(value);
        if self.mean <= 0.0 {
            return MeanSquare { value: 0.0, variance: 0.0, degrees_of_freedom: f64::INFINITY };
        }
        let scale = 1.0 / (self.mean * self.mean);
        let value = (mean * scale).max(0.0);
        // The relative variance of the square of the mean is four times that of the mean.
        let of_mean = 4.0 * self.mean_variance * value * value;
        let variance = part.variance * scale * scale + of_mean;
        MeanSquare { value, variance, degrees_of_freedom: part.degrees_of_freedom }
    }

    /// Mean over the image of a value of the sampled pixels, Σ N_g ȳ_g / N, with its variance (see [`crate::estimate`]) and the same
    /// tail allowance: the square of what one more pixel as far out as the farthest would add.
    fn stratified(&self, value: impl Fn(&PixelNoise) -> f64) -> (f64, Part) {
        let all = self.cells.iter().map(|cell| cell.pixels).sum::<u64>() as f64;
        let mut means = Vec::with_capacity(self.cells.len());
        let mut parts = Vec::with_capacity(self.cells.len() + 1);
        let mut influence = 0.0f64;
        for cell in &self.cells {
            let (pixels, count) = (cell.pixels as f64, cell.samples.len() as f64);
            let values: Vec<f64> = cell.samples.iter().map(&value).collect();
            let own = sum(values.iter().copied()) / count;
            let weight = pixels / all;
            // A cell that has more samples than pixels has borrowed them.
            let unseen = if count > pixels { 1.0 } else { 1.0 - count / pixels };
            let squares = sum(values.iter().map(|v| (v - own) * (v - own)));
            let reach = values.iter().map(|v| (v - own).abs()).fold(0.0, f64::max);
            influence = influence.max(weight * unseen * reach / count);
            means.push(weight * own);
            // A single sample shows no spread: its value may be off by all of itself.
            let variance = if count > 1.0 { squares / (count - 1.0) / count } else { own * own };
            let freedom = (count - 1.0).max(1.0);
            parts.push(Part { variance: weight * weight * unseen * variance, degrees_of_freedom: freedom });
        }
        parts.push(Part { variance: influence * influence, degrees_of_freedom: f64::INFINITY });
        (sum(means), together(&parts))
    }
}

impl Fit {
    /// Least squares over the image's drops, each relative to itself; A and B are not negative.
    fn of(drops: &[f64]) -> Self {
        // Drop k of A / n^1.5 and of B / n.
        let shape = |which: usize, k: usize| {
            libm::exp2(-EXPONENTS[which] * k as f64) * (1.0 - libm::exp2(-EXPONENTS[which]))
        };
        let largest = drops.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let weight =
            |k: usize| 1.0 / drops[k].max(1e-6 * largest) / drops[k].max(1e-6 * largest) * largest * largest;
        let levels = 0..drops.len();
        let product = |one: usize, other: usize| {
            sum(levels.clone().map(|k| weight(k) * shape(one, k) * shape(other, k)))
        };
        let alone = |which: usize| -> Vec<f64> {
            levels.clone().map(|k| weight(k) * shape(which, k) / product(which, which)).collect()
        };
        let none = vec![0.0; drops.len()];
        let independent = Self { weights: [none.clone(), alone(1)], at_most: None };
        let determinant = product(0, 0) * product(1, 1) - product(0, 1) * product(0, 1);
        if drops.len() < 2 || determinant <= 0.0 {
            return independent;
        }
        let both: [Vec<f64>; 2] = [(0, 1), (1, 0)].map(|(own, other)| {
            let of = |k: usize| {
                weight(k) * (product(other, other) * shape(own, k) - product(own, other) * shape(other, k))
            };
            levels.clone().map(|k| of(k) / determinant).collect()
        });
        let value = |weights: &[f64]| sum(weights.iter().zip(drops).map(|(weight, drop)| weight * drop));
        if value(&both[0]) <= 0.0 {
            return independent;
        }
        let samples = libm::exp2(drops.len() as f64);
        let powers = powers(samples);
        let fitted = if value(&both[1]) > 0.0 { both } else { [alone(0), none] };
        let [of_edges, of_rest] = [0, 1].map(|which| value(&fitted[which]) * powers[which]);
        if of_rest >= LEAST_RANDOM * (of_edges + of_rest) {
            return Self { weights: fitted, at_most: None };
        }
        // What is left at that number of samples stays, and is shared out anew.
        let left = |k: usize| fitted[0][k] * powers[0] + fitted[1][k] * powers[1];
        let share = |part: f64, power: f64| levels.clone().map(|k| part * left(k) / power).collect();
        Self {
            weights: [share(1.0 - LEAST_RANDOM, powers[0]), share(LEAST_RANDOM, powers[1])],
            at_most: Some(alone(1)),
        }
    }

    /// V(n) of a pixel beyond what was sampled.
    fn beyond(&self, pixel: &PixelNoise, samples: u32) -> f64 {
        let powers = powers_of_pixel(samples);
        sum([0, 1].map(|which| weighted(&self.weights[which], pixel) * powers[which]))
    }
}

/// A linear function of a pixel's drops.
fn weighted(weights: &[f64], pixel: &PixelNoise) -> f64 {
    sum(weights.iter().zip(&pixel.drops).map(|(weight, drop)| weight * drop))
}

/// Strata that are looked at together, and the samples that stand for them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NoiseGroup {
    /// Indices of strata; all of them are shown.
    pub strata: Vec<usize>,
    /// Indices of samples: those of the strata or, if they have none, all that there are.
    pub samples: Vec<usize>,
}

/// Groups for an image of which `counts` pixels show each stratum: strata of two samples or more alone, others with those of
/// their material, and what is still too few with all such, or, where even these have none, like everything.
///
/// # Errors
/// If strata, counts and samples do not fit together, or there is no sample.
pub fn noise_groups(
    strata: &[Stratum],
    counts: &[u32],
    samples: &[NoiseSample],
) -> Result<Vec<NoiseGroup>, ForecastError> {
    if counts.len() != strata.len() {
        return Err(ForecastError::CountsLength { frame: 0, counts: counts.len(), strata: strata.len() });
    }
    if samples.is_empty() {
        return Err(ForecastError::NoSamples);
    }
    let mut own: Vec<Vec<usize>> = vec![Vec::new(); strata.len()];
    for (index, NoiseSample { stratum, .. }) in samples.iter().enumerate() {
        let unknown = ForecastError::UnknownStratum { stratum: *stratum, strata: strata.len() };
        own.get_mut(*stratum as usize).ok_or(unknown)?.push(index);
    }
    let join = |members: &[usize]| NoiseGroup {
        strata: members.to_vec(),
        samples: members.iter().flat_map(|&h| own[h].iter().copied()).collect(),
    };
    let shown: Vec<usize> = (0..strata.len()).filter(|&h| counts[h] > 0).collect();
    let (alone, few): (Vec<_>, Vec<_>) = shown.into_iter().partition(|&h| own[h].len() >= 2);
    let mut groups: Vec<NoiseGroup> = alone.iter().map(|&h| join(&[h])).collect();
    let mut materials: Vec<u32> = few.iter().map(|&h| strata[h].material).collect();
    materials.sort_unstable();
    materials.dedup();
    let mut rest = Vec::new();
    for material in materials {
        let members: Vec<usize> = few.iter().copied().filter(|&h| strata[h].material == material).collect();
        let group = join(&members);
        if group.samples.len() >= 2 { groups.push(group) } else { rest.extend(members) }
    }
    if !rest.is_empty() {
        let mut group = join(&rest);
        if group.samples.len() < 2 {
            group.samples = (0..samples.len()).collect();
        }
        groups.push(group);
    }
    Ok(groups)
}

/// The cells of [`noise_groups`].
///
/// # Errors
/// The same.
pub fn noise_cells(
    strata: &[Stratum],
    counts: &[u32],
    samples: &[NoiseSample],
) -> Result<Vec<NoiseCell>, ForecastError> {
    let cell = |group: NoiseGroup| NoiseCell {
        pixels: group.strata.iter().map(|&h| u64::from(counts[h])).sum(),
        samples: group.samples.iter().map(|&i| samples[i].noise.clone()).collect(),
    };
    Ok(noise_groups(strata, counts, samples)?.into_iter().map(cell).collect())
}
