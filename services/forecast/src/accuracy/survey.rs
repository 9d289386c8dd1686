//! Where further samples reduce the error of an unfinished image most.
//!
//! A profile of some pixels misses, for example, the bright spot beside a lamp, but the image shows it. Each
//! tile becomes a zone ([`super::allot`]) with the mean sample variance of its pixels. How it falls with
//! samples is read from the later samples of all pixels (`observed_laws`). What these do not tell comes from
//! the profile of the same materials.

use super::allot::{Zone, samples_for_budget, samples_for_variance};
use super::observed_laws::{ObservedLaws, Octave};
use super::sampled_pixel::SampledPixel;
use super::variance_curve::{RANDOM, Terms, powers, powers_of_pixel, weighted};
use super::{ErrorQuantiles, MeanSquare};
use crate::error::ForecastError;
use crate::interval::{Calibration, Part, combined};
use crate::moments::sum;

/// Weight of the profile's variance in the variance of a tile, as a number of pixels.
const PROFILE_WEIGHT: f64 = 0.1;

/// The state of an unfinished image, tile by tile.
#[derive(Clone, Debug)]
pub struct Survey {
    zones: Vec<Zone>,
    /// Variance of the error of each tile, relative to its square.
    uncertainties: Vec<Part>,
    /// How the tiles' variances fall with samples, with the uncertainty that they share.
    laws: ObservedLaws,
    /// Mean number of samples per pixel of each tile.
    samples: Vec<f64>,
    /// Mean brightness of the image.
    mean: f64,
}

impl Survey {
    /// Builds the survey of an image of these tiles.
    ///
    /// # Errors
    /// [`ForecastError::NoSamples`] if a tile has no pixels, or a pixel no samples.
    pub fn new(tiles: &[Vec<SampledPixel>]) -> Result<Self, ForecastError> {
        if tiles.iter().any(|tile| tile.is_empty() || tile.iter().any(|pixel| pixel.samples == 0)) {
            return Err(ForecastError::NoSamples);
        }
        let pixels = sum(tiles.iter().map(|tile| tile.len() as f64));
        let brightness = sum(tiles.iter().map(|tile| sum(tile.iter().map(|pixel| pixel.brightness))));
        let of_tiles: Vec<(Zone, Part)> = tiles.iter().map(|tile| zone_of_tile(tile)).collect();
        let (mut zones, uncertainties): (Vec<Zone>, Vec<Part>) = of_tiles.into_iter().unzip();
        let samples = |tile: &Vec<SampledPixel>| {
            sum(tile.iter().map(|pixel| f64::from(pixel.samples))) / tile.len() as f64
        };
        let samples: Vec<f64> = tiles.iter().map(samples).collect();
        let laws = ObservedLaws::new(tiles, &zones, &samples);
        for ((zone, octave), (tile, samples)) in
            zones.iter_mut().zip(laws.by_tile()).zip(tiles.iter().zip(&samples))
        {
            if let Some(Octave { law, .. }) = octave {
                let of_one = sum(zone.variance.iter().copied());
                zone.variance = law.map(|term| of_one * term);
            }
            let factor = unevenness(tile, zone, *samples);
            zone.variance = zone.variance.map(|term| term * factor);
        }
        Ok(Self { zones, uncertainties, laws, samples, mean: brightness / pixels.max(1.0) })
    }

    /// One zone for each tile, in the order of the tiles.
    pub fn zones(&self) -> &[Zone] {
        &self.zones
    }

    /// Samples per pixel of each tile that give the least error for the total cost `budget`. No tile gets
    /// fewer than it has. `None` if the present samples cost more than the budget.
    pub fn samples_for_budget(&self, budget: f64) -> Option<Vec<f64>> {
        samples_for_budget(&self.zones, &self.samples, budget)
    }

    /// Mean number of samples per pixel of each tile so far.
    pub fn samples(&self) -> &[f64] {
        &self.samples
    }

    /// Like [`Self::samples_for_error`], but without a reserve for the fall of the variance. For an
    /// intermediate pass, whose samples will show it.
    pub fn samples_to_see(
        &self,
        wanted: f64,
        quantile: impl Fn(&ErrorQuantiles) -> f64,
        calibration: Calibration,
    ) -> Vec<f64> {
        let sure = self.clone();
        Self { laws: sure.laws.without_uncertainty(), ..sure }.samples_for_error(
            wanted,
            quantile,
            calibration,
        )
    }

    /// Samples per pixel of each tile that reach the error `wanted`, as a share of the image's mean, at the
    /// least cost. `quantile` picks the quantile of the error that must not exceed `wanted`.
    pub fn samples_for_error(
        &self,
        wanted: f64,
        quantile: impl Fn(&ErrorQuantiles) -> f64,
        calibration: Calibration,
    ) -> Vec<f64> {
        // The ratio of quantile to mean and the allocation depend on each other. Two rounds are close enough.
        let mut samples = self.samples.clone();
        for _ in 0..2 {
            let is = self.mean_square(&samples);
            let root = libm::sqrt(is.value);
            let sure = quantile(&is.error(calibration));
            let ratio = if root > 0.0 && sure > 0.0 { sure / root } else { 1.0 };
            let wanted = wanted / ratio * self.mean;
            samples = samples_for_variance(&self.zones, wanted * wanted);
        }
        samples
    }

    /// The image's error with `samples` samples per pixel of each tile, as a share of the image's mean.
    pub fn error(&self, samples: &[f64], calibration: Calibration) -> ErrorQuantiles {
        self.mean_square(samples).error(calibration)
    }

    /// The mean square error, relative to the square of the image's mean.
    fn mean_square(&self, samples: &[f64]) -> MeanSquare {
        if self.mean <= 0.0 {
            return MeanSquare { value: 0.0, variance: 0.0, degrees_of_freedom: f64::INFINITY };
        }
        let pixels = sum(self.zones.iter().map(|zone| zone.pixels)).max(1.0);
        let square = self.mean * self.mean;
        // The error of a tile is proportional to its variance, and so has the same relative uncertainty.
        let error = |(zone, samples): (&Zone, &f64)| zone.error(*samples) / pixels / square;
        let errors: Vec<f64> = self.zones.iter().zip(samples).map(error).collect();
        let mut parts = self.laws.uncertainties(&errors);
        let uncertainties = self.uncertainties.iter().zip(&errors);
        parts.extend(uncertainties.map(|(uncertainty, error)| Part {
            variance: uncertainty.variance * error * error,
            ..*uncertainty
        }));
        let Part { variance, degrees_of_freedom } = combined(&parts);
        MeanSquare { value: sum(errors), variance, degrees_of_freedom }
    }
}

/// Mean variance of a tile's pixels, over that with the mean number of samples everywhere.
fn unevenness(tile: &[SampledPixel], zone: &Zone, samples: f64) -> f64 {
    let variance = |powers: Terms| weighted(&zone.variance, &powers);
    let are = sum(tile.iter().map(|pixel| variance(powers_of_pixel(pixel.samples)))) / tile.len() as f64;
    let even = variance(powers(samples));
    if even > 0.0 && even.is_finite() { are / even } else { 1.0 }
}

/// A tile as a zone, with the variance of its error relative to the square.
fn zone_of_tile(tile: &[SampledPixel]) -> (Zone, Part) {
    let pixels = tile.len() as f64;
    let profiled: Terms =
        std::array::from_fn(|k| sum(tile.iter().map(|pixel| pixel.profiled[k].max(0.0))) / pixels);
    let expected = sum(profiled.iter().copied());
    let shape = if expected > 0.0 { profiled.map(|part| part / expected) } else { RANDOM };
    // The samples of a pixel are spread more evenly than random ones. So the expected spread of n of them is
    // V(1) − V(n), not V(1) (1 − 1 / n).
    let unbiased = |pixel: &SampledPixel| {
        let samples = f64::from(pixel.samples);
        let seen = 1.0 - weighted(&shape, &powers_of_pixel(pixel.samples));
        pixel.variance.map(|variance| variance * (1.0 - 1.0 / samples) / seen)
    };
    let mut known: Vec<f64> = tile.iter().filter_map(unbiased).collect();
    if known.is_empty() {
        // The differences within the tile stand in for its noise, so tiles with contrast get a second look.
        known.extend(spread(tile));
    }
    let count = known.len() as f64;
    let own = sum(known.iter().copied());
    let variance = (own + PROFILE_WEIGHT * expected) / (count + PROFILE_WEIGHT);
    let cost = sum(tile.iter().map(|pixel| pixel.cost)) / sum(tile.iter().map(|p| f64::from(p.samples)));
    let uncertainty = if count > 1.0 && variance > 0.0 {
        let mean = own / count;
        let squares = sum(known.iter().map(|v| (v - mean) / variance * ((v - mean) / variance)));
        let uncertainty = squares / (count - 1.0) / count;
        // A few pixels of a single image may by chance be very good or bad. Each pixel's error has the
        // variance 2 V², as for a normal distribution, given here relative to the square of their sum.
        let luck = 2.0 * (uncertainty + 1.0 / count);
        Part { variance: uncertainty + luck, degrees_of_freedom: count - 1.0 }
    } else {
        // Nothing shows how the pixels differ, so the standard error is the whole value.
        Part { variance: 1.0, degrees_of_freedom: 1.0 }
    };
    (Zone { pixels, variance: shape.map(|share| share * variance), cost }, uncertainty)
}

/// Variance of the brightness over a tile's pixels. `None` for fewer than two.
fn spread(tile: &[SampledPixel]) -> Option<f64> {
    let count = tile.len() as f64;
    let mean = sum(tile.iter().map(|pixel| pixel.brightness)) / count;
    let squares = sum(tile.iter().map(|pixel| (pixel.brightness - mean) * (pixel.brightness - mean)));
    (tile.len() > 1).then(|| squares / (count - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TERMS: Terms = [1.0, 2.0, 1.0];

    fn pixel(variance: Option<f64>) -> SampledPixel {
        SampledPixel { samples: 4, brightness: 2.0, variance, cost: 8.0, profiled: TERMS, grown: None }
    }

    #[test]
    fn a_tile_varies_as_its_pixels_do_and_falls_as_the_profile_says() {
        let calm = vec![pixel(Some(1e-4)); 64];
        let wild = vec![pixel(Some(0.5)), pixel(Some(1.5))];
        let unknown = vec![pixel(None)];
        // Two pixels with a single sample each, one of them very bright.
        let once = |brightness| SampledPixel { samples: 1, brightness, cost: 2.0, ..pixel(None) };
        let spot = vec![once(2.0), once(102.0)];
        let survey = Survey::new(&[calm, wild, unknown, spot]).unwrap();
        let [calm, wild, unknown, spot] = survey.zones() else { panic!() };
        let total = |zone: &Zone| sum(zone.variance.iter().copied());
        assert!(total(calm) < 0.02 && total(calm) > 1e-4, "{calm:?}");
        // Four samples: expected spread 1 − 0.25 / 16 − 0.5 / 8 − 0.25 / 4 of the variance; the sample
        // variance adds 4 / 3.
        let variance = 2.0 * 0.75 / (1.0 - 0.25 / 16.0 - 0.5 / 8.0 - 0.25 / 4.0);
        assert!((total(wild) - (variance + 0.1 * 4.0) / 2.1).abs() < 1e-12);
        assert!(total(spot) > 4000.0, "{spot:?}");
        assert_eq!(total(unknown), 4.0, "the profile's word alone");
        for zone in [calm, wild, unknown, spot] {
            let shares = zone.variance.map(|term| 4.0 * term / total(zone));
            assert!(shares.iter().zip(TERMS).all(|(share, is)| (share - is).abs() < 1e-9), "{zone:?}");
            assert_eq!(zone.cost, 2.0);
        }
        assert_eq!(survey.samples(), [4.0, 4.0, 4.0, 1.0]);
        // Without a profile, the variance falls as for random samples.
        let still = SampledPixel { profiled: [0.0; 3], ..pixel(Some(1.0)) };
        assert_eq!(Survey::new(&[vec![still]]).unwrap().zones()[0].variance[..2], [0.0; 2]);
    }

    #[test]
    fn an_error_that_is_asked_for_is_met_at_its_quantile() {
        let tile =
            |scale: f64| (0..64).map(|i| pixel(Some(scale * f64::from(1 + i % 7)))).collect::<Vec<_>>();
        let survey = Survey::new(&[tile(1.0), tile(30.0), tile(0.1)]).unwrap();
        let calibration = Calibration::NONE;
        let samples = survey.samples_for_error(0.05, |e| e.p80, calibration);
        let error = survey.error(&samples, calibration);
        assert!((error.p80 / 0.05 - 1.0).abs() < 0.01, "{error:?}");
        assert!(error.p50 < error.p80 && error.p80 < error.p95 && error.p05 < error.p50);
        assert!(samples[1] > 3.0 * samples[0] && samples[0] > samples[2], "{samples:?}");
        let surer = survey.samples_for_error(0.05, |e| e.p95, calibration);
        assert!(surer[1] > samples[1]);
    }

    #[test]
    fn black_images_and_single_samples_have_an_answer_and_empty_ones_an_error() {
        let black = SampledPixel { brightness: 0.0, variance: Some(0.0), profiled: [0.0; 3], ..pixel(None) };
        let survey = Survey::new(&[vec![black; 5]]).unwrap();
        assert_eq!(survey.samples_for_error(0.01, |e| e.p50, Calibration::NONE), [1.0]);
        assert_eq!(survey.error(&[1.0], Calibration::NONE).p95, 0.0);
        let single = Survey::new(&[vec![pixel(None)]]).unwrap();
        assert!(single.error(&[4.0], Calibration::NONE).p95.is_finite());
        assert!(Survey::new(&[vec![]]).is_err());
        assert!(Survey::new(&[vec![SampledPixel { samples: 0, ..black }]]).is_err());
        assert!(Survey::new(&[]).is_ok());
    }
}
