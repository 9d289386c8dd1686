//! The error of the whole image from the noise of some pixels. Their variances are averaged by stratum and
//! extrapolated to other numbers of camera samples by A / n² + B / n^1.5 + C / n.

use serde::{Deserialize, Serialize};

use super::variance_curve::{Terms, between, weighted};
use super::variance_fit::VarianceFit;
use super::{NoiseCell, PixelNoise};
use crate::error::ForecastError;
use crate::interval::{Calibration, Part, combined, quantity};
use crate::moments::sum;

/// Quantiles of the error of an image, as a share of the image's mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorQuantiles {
    /// 5 % quantile.
    pub p05: f64,
    /// Median.
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
    /// Variance of the estimate.
    pub variance: f64,
    /// Degrees of freedom behind the variance.
    pub degrees_of_freedom: f64,
}

impl MeanSquare {
    /// The mean square of the sum of two independent errors.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        let Part { variance, degrees_of_freedom } = combined(&[self.part(), other.part()]);
        Self { value: self.value + other.value, variance, degrees_of_freedom }
    }

    /// Mean of the mean square errors of several independent images. `None` without images.
    pub fn mean(images: &[Self]) -> Option<Self> {
        let count = images.len() as f64;
        let all = images.iter().copied().reduce(Self::plus)?;
        Some(all.scaled(1.0 / count))
    }

    /// The root mean square error, with quantiles from a log-t interval.
    pub fn error(&self, calibration: Calibration) -> ErrorQuantiles {
        let square = quantity(self.value, self.part(), calibration);
        // The root halves the logarithm, so the interval extends as far below the median as above it.
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

/// The most doublings of the number of samples that are considered, since that number has 32 bits.
const MOST_LEVELS: usize = 31;

/// The error of an image as a function of its number of camera samples per pixel.
#[derive(Clone, Debug)]
pub struct ImageNoise {
    cells: Vec<NoiseCell>,
    /// Number of doublings for which every sampled pixel has a drop.
    levels: usize,
    /// Mean brightness of the image.
    mean: f64,
    /// Variance of `mean`, relative to its square.
    mean_variance: f64,
    fit: VarianceFit,
}

impl ImageNoise {
    /// Builds the error curve of an image of these cells, all sampled with the same number of camera samples.
    /// Cells without pixels are ignored.
    ///
    /// # Errors
    /// [`ForecastError::NoSamples`] if a cell has no sampled pixel, or a pixel has only one camera sample.
    pub fn new(cells: Vec<NoiseCell>) -> Result<Self, ForecastError> {
        let cells: Vec<NoiseCell> = cells.into_iter().filter(|cell| cell.pixels > 0).collect();
        if cells.iter().any(|cell| cell.samples.is_empty()) {
            return Err(ForecastError::NoSamples);
        }
        let all = cells.iter().flat_map(|cell| &cell.samples);
        let levels = all.map(|sample| sample.drops.len()).min();
        let levels = levels.filter(|&levels| levels > 0).ok_or(ForecastError::NoSamples)?.min(MOST_LEVELS);
        let mut noise = Self { cells, levels, mean: 0.0, mean_variance: 0.0, fit: VarianceFit::default() };
        let (mean, part) = noise.stratified(|pixel| pixel.brightness);
        noise.mean = mean;
        noise.mean_variance = if mean > 0.0 { part.variance / mean / mean } else { 0.0 };
        let drops = (0..levels).map(|k| noise.drop(k));
        let (drops, parts): (Vec<f64>, Vec<Part>) = drops.unzip();
        let variances: Vec<f64> = parts.iter().map(|part| part.variance).collect();
        noise.fit = VarianceFit::new(&drops, &variances);
        Ok(noise)
    }

    /// Mean brightness of the image.
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// Mean drops of the image's variance (see [`PixelNoise::drops`]), in brightness squared.
    pub fn drops(&self) -> Vec<f64> {
        (0..self.levels).map(|k| self.drop(k).0).collect()
    }

    fn drop(&self, k: usize) -> (f64, Part) {
        self.stratified(|pixel| pixel.drops[k])
    }

    /// The image's variance: the mean over its pixels.
    pub fn curve(&self) -> Terms {
        std::array::from_fn(|which| self.stratified(|pixel| self.curve_of(pixel)[which]).0)
    }

    /// The variance of one pixel. These are estimates without bias, so they may be negative.
    pub fn curve_of(&self, pixel: &PixelNoise) -> Terms {
        self.fit.terms(pixel)
    }

    /// Mean square error of the image at `spp` ≥ 1 camera samples per pixel, with the squared bias.
    pub fn at(&self, spp: u32) -> MeanSquare {
        self.noise_at(spp).plus(self.bias_square())
    }

    /// The squared bias: the part of the mean square error that does not fall with samples.
    pub fn bias_square(&self) -> MeanSquare {
        self.mean_square(|pixel| pixel.bias_square)
    }

    /// The noise at `spp` camera samples per pixel: the part of the mean square error that falls with
    /// samples.
    ///
    /// At a sampled power of two it is the sum of all further drops, plus the rest, which follows A / n² +
    /// B / n^1.5 + C / n. Between powers of two, see `variance_curve::between`. Its variance is that of the
    /// estimate plus that of a single image's error, 2 V² each, as for a normally distributed number.
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

    /// The noise of the image, given the variance of each pixel. Everything beyond `samples` is extrapolated.
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
                    self.stratified(|pixel| weighted(weights, &pixel.drops)).0 / f64::from(samples) * scale;
                let is = self.stratified(|pixel| self.fit.beyond(pixel, samples)).0 * scale;
                // Takes `at_most` as the 95 % quantile of a lognormal distribution.
                if is > 0.0 && at_most > is {
                    let deviation = libm::log(at_most / is) / 1.645;
                    square.variance += is * is * libm::expm1(deviation * deviation);
                }
            }
        }
        square
    }

    /// Mean of `value` over the image's pixels, relative to the square of the image's mean. A negative
    /// estimate is set to 0 and keeps its variance.
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

    /// The stratified mean Σ N_g ȳ_g / N of a value of the sampled pixels, with its variance (see
    /// [`crate::estimate()`]). The tail allowance is the squared change of the mean if one more pixel were
    /// like the most extreme sample.
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
            // A cell with more samples than pixels has borrowed its samples from elsewhere.
            let unseen = if count > pixels { 1.0 } else { 1.0 - count / pixels };
            let squares = sum(values.iter().map(|v| (v - own) * (v - own)));
            let reach = values.iter().map(|v| (v - own).abs()).fold(0.0, f64::max);
            influence = influence.max(weight * unseen * reach / count);
            means.push(weight * own);
            // A single sample shows no spread. Its standard error is taken to be its whole value.
            let variance = if count > 1.0 { squares / (count - 1.0) / count } else { own * own };
            let freedom = (count - 1.0).max(1.0);
            parts.push(Part { variance: weight * weight * unseen * variance, degrees_of_freedom: freedom });
        }
        parts.push(Part { variance: influence * influence, degrees_of_freedom: f64::INFINITY });
        (sum(means), combined(&parts))
    }
}
