//! What the samples of an image underway say of where more of them pay.
//!
//! A profile of some pixels knows of a material that it varies, not of the bright spot on the wall beside a lamp. Once every pixel
//! has some samples, the image itself knows: each tile of it is a zone (see [`super::allot`]), whose variance is the mean of its pixels'
//! sample variances. How that falls with samples is what the profile says of the same materials: a pixel's few samples do not show it.
//! By how much that guess is off, where the image has come to, all pixels together show: by what the later half of their samples changed.

use super::allot::{Zone, samples_for_budget, samples_for_variance};
use super::law::{powers, powers_of_pixel};
use super::settling::Settling;
use super::{ErrorQuantiles, MeanSquare};
use crate::error::ForecastError;
use crate::interval::{Calibration, Part, together};
use crate::moments::sum;

/// A tile's own pixels are believed like this many of the profile's.
const PROFILE_COUNTS: f64 = 0.1;

/// A pixel of an image underway.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Its samples.
    pub samples: u32,
    /// Their mean over the three channels.
    pub brightness: f64,
    /// Variance of one sample, mean over the channels; not known of a single one.
    pub variance: Option<f64>,
    /// What they cost, in any unit.
    pub cost: f64,
    /// What the profile says of pixels like this: their variance at n samples is the sum of these over n^1.5 and n.
    pub profiled: [f64; 2],
    /// How many samples there were before the later half of them came, or up to three quarters, and by how much these changed the mean of
    /// all: its square, mean over the channels. None of a pixel with one sample.
    pub grown: Option<(u32, f64)>,
}

/// An image underway, tile by tile.
#[derive(Clone, Debug)]
pub struct Survey {
    zones: Vec<Zone>,
    /// How sure each tile's error is, as a share of it.
    doubts: Vec<Part>,
    /// How far the guesses of them were off, and how sure they are together.
    settling: Settling,
    /// Mean samples of each tile's pixels.
    samples: Vec<f64>,
    /// Mean brightness of the image.
    mean: f64,
}

impl Survey {
    /// Of an image that is made of these tiles.
    ///
    /// # Errors
    /// If one of them has no pixels, or one of these no samples.
    pub fn new(tiles: &[Vec<Seen>]) -> Result<Self, ForecastError> {
        if tiles.iter().any(|tile| tile.is_empty() || tile.iter().any(|pixel| pixel.samples == 0)) {
            return Err(ForecastError::NoSamples);
        }
        let pixels = sum(tiles.iter().map(|tile| tile.len() as f64));
        let brightness = sum(tiles.iter().map(|tile| sum(tile.iter().map(|pixel| pixel.brightness))));
        let of_tiles: Vec<(Zone, Part)> = tiles.iter().map(|tile| surveyed(tile)).collect();
        let (mut zones, doubts): (Vec<Zone>, Vec<Part>) = of_tiles.into_iter().unzip();
        let samples =
            |tile: &Vec<Seen>| sum(tile.iter().map(|pixel| f64::from(pixel.samples))) / tile.len() as f64;
        let samples: Vec<f64> = tiles.iter().map(samples).collect();
        let settling = Settling::new(tiles, &zones, &samples);
        for ((zone, octave), (tile, samples)) in
            zones.iter_mut().zip(settling.of_tiles()).zip(tiles.iter().zip(&samples))
        {
            let factor = octave.off * unevenness(tile, zone, *samples);
            zone.variance = zone.variance.map(|part| part * factor);
        }
        Ok(Self { zones, doubts, settling, samples, mean: brightness / pixels.max(1.0) })
    }

    /// Its tiles, in their order.
    pub fn zones(&self) -> &[Zone] {
        &self.zones
    }

    /// Samples per pixel of each tile that cost `budget` all together, with the least error; of each at least as many as it has. `None` if
    /// these cost more.
    pub fn samples_for_budget(&self, budget: f64) -> Option<Vec<f64>> {
        samples_for_budget(&self.zones, &self.samples, budget)
    }

    /// Mean number of samples that the pixels of each have got.
    pub fn samples(&self) -> &[f64] {
        &self.samples
    }

    /// Samples per pixel of each tile for an error at one of its quantiles, as a share of the image's mean, with the least cost; as if it were known
    /// how variance falls with samples, for these will show it better.
    pub fn samples_to_see(
        &self,
        wanted: f64,
        quantile: impl Fn(&ErrorQuantiles) -> f64,
        calibration: Calibration,
    ) -> Vec<f64> {
        let sure = self.clone();
        Self { settling: sure.settling.undoubted(), ..sure }.samples_for_error(wanted, quantile, calibration)
    }

    /// The same, as sure as can be.
    pub fn samples_for_error(
        &self,
        wanted: f64,
        quantile: impl Fn(&ErrorQuantiles) -> f64,
        calibration: Calibration,
    ) -> Vec<f64> {
        // How sure the whole is depends on where the samples are, and so on how sure it is: once more is near enough.
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

    /// The image's error with so many samples in each tile.
    pub fn error(&self, samples: &[f64], calibration: Calibration) -> ErrorQuantiles {
        self.mean_square(samples).error(calibration)
    }

    /// The square of that, relative to the square of the image's mean.
    fn mean_square(&self, samples: &[f64]) -> MeanSquare {
        if self.mean <= 0.0 {
            return MeanSquare { value: 0.0, variance: 0.0, degrees_of_freedom: f64::INFINITY };
        }
        let pixels = sum(self.zones.iter().map(|zone| zone.pixels)).max(1.0);
        let square = self.mean * self.mean;
        // The error of a tile is in proportion to its variance.
        let error = |(zone, samples): (&Zone, &f64)| zone.error(*samples) / pixels / square;
        let errors: Vec<f64> = self.zones.iter().zip(samples).map(error).collect();
        let mut parts = self.settling.doubts(&errors);
        let doubts = self.doubts.iter().zip(&errors);
        parts
            .extend(doubts.map(|(doubt, error)| Part { variance: doubt.variance * error * error, ..*doubt }));
        let Part { variance, degrees_of_freedom } = together(&parts);
        MeanSquare { value: sum(errors), variance, degrees_of_freedom }
    }
}

/// The variance of a tile's pixels, each with the samples that it has, in units of what it would be if all had equally many.
fn unevenness(tile: &[Seen], zone: &Zone, samples: f64) -> f64 {
    let variance = |powers: [f64; 2]| sum((0..2).map(|k| zone.variance[k] * powers[k]));
    let are = sum(tile.iter().map(|pixel| variance(powers_of_pixel(pixel.samples)))) / tile.len() as f64;
    let even = variance(powers(samples));
    if even > 0.0 && even.is_finite() { are / even } else { 1.0 }
}

/// A tile as a zone, and how sure its error is, as a share of it.
fn surveyed(tile: &[Seen]) -> (Zone, Part) {
    let pixels = tile.len() as f64;
    let profiled = [0, 1].map(|k| sum(tile.iter().map(|pixel| pixel.profiled[k].max(0.0))) / pixels);
    let expected = profiled[0] + profiled[1];
    let shape = if expected > 0.0 { profiled.map(|part| part / expected) } else { [0.0, 1.0] };
    // Samples of a pixel lie more evenly than chance would have them, so n of them vary by V(1) − V(n), not by V(1) (1 − 1 / n).
    let unbiased = |pixel: &Seen| {
        let samples = f64::from(pixel.samples);
        let seen =
            1.0 - sum(shape.iter().zip(powers_of_pixel(pixel.samples)).map(|(share, power)| share * power));
        pixel.variance.map(|variance| variance * (1.0 - 1.0 / samples) / seen)
    };
    let mut known: Vec<f64> = tile.iter().filter_map(unbiased).collect();
    if known.is_empty() {
        // Nobody knows how much of it is noise: what differs within the tile is worth a second look.
        known.extend(spread(tile));
    }
    let count = known.len() as f64;
    let own = sum(known.iter().copied());
    let variance = (own + PROFILE_COUNTS * expected) / (count + PROFILE_COUNTS);
    let cost = sum(tile.iter().map(|pixel| pixel.cost)) / sum(tile.iter().map(|p| f64::from(p.samples)));
    let doubt = if count > 1.0 && variance > 0.0 {
        let mean = own / count;
        let squares = sum(known.iter().map(|v| (v - mean) / variance * ((v - mean) / variance)));
        let doubt = squares / (count - 1.0) / count;
        // And few pixels of an image may come out well or badly: 2 V² of each, as of normal numbers, is so much of the square of their sum.
        let luck = 2.0 * (doubt + 1.0 / count);
        Part { variance: doubt + luck, degrees_of_freedom: count - 1.0 }
    } else {
        // Nothing shows how pixels differ: it may be off by all of itself.
        Part { variance: 1.0, degrees_of_freedom: 1.0 }
    };
    (Zone { pixels, variance: shape.map(|share| share * variance), cost }, doubt)
}

/// Variance of the brightness of a tile's pixels, which takes two of them.
fn spread(tile: &[Seen]) -> Option<f64> {
    let count = tile.len() as f64;
    let mean = sum(tile.iter().map(|pixel| pixel.brightness)) / count;
    let squares = sum(tile.iter().map(|pixel| (pixel.brightness - mean) * (pixel.brightness - mean)));
    (tile.len() > 1).then(|| squares / (count - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixel(variance: Option<f64>) -> Seen {
        Seen { samples: 4, brightness: 2.0, variance, cost: 8.0, profiled: [3.0, 1.0], grown: None }
    }

    #[test]
    fn a_tile_varies_as_its_pixels_do_and_falls_as_the_profile_says() {
        let calm = vec![pixel(Some(1e-4)); 64];
        let wild = vec![pixel(Some(0.5)), pixel(Some(1.5))];
        let unknown = vec![pixel(None)];
        // Each with a single sample: a bright spot.
        let once = |brightness| Seen { samples: 1, brightness, cost: 2.0, ..pixel(None) };
        let spot = vec![once(2.0), once(102.0)];
        let survey = Survey::new(&[calm, wild, unknown, spot]).unwrap();
        let [calm, wild, unknown, spot] = survey.zones() else { panic!() };
        let total = |zone: &Zone| zone.variance[0] + zone.variance[1];
        assert!(total(calm) < 0.02 && total(calm) > 1e-4, "{calm:?}");
        // Four samples of numbers whose variance falls so vary by 1 - 0.75 / 8 - 0.25 / 4 of it, times 4 / 3.
        let variance = 2.0 * 0.75 / (1.0 - 0.75 / 8.0 - 0.25 / 4.0);
        assert!((total(wild) - (variance + 0.1 * 4.0) / 2.1).abs() < 1e-12);
        assert!(total(spot) > 4000.0, "{spot:?}");
        assert_eq!(total(unknown), 4.0, "the profile's word alone");
        for zone in [calm, wild, unknown, spot] {
            assert!((zone.variance[0] / zone.variance[1] - 3.0).abs() < 1e-9);
            assert_eq!(zone.cost, 2.0);
        }
        assert_eq!(survey.samples(), [4.0, 4.0, 4.0, 1.0]);
        // Without a word of the profile, as random numbers do.
        let still = Seen { profiled: [0.0; 2], ..pixel(Some(1.0)) };
        assert_eq!(Survey::new(&[vec![still]]).unwrap().zones()[0].variance[0], 0.0);
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
        let black = Seen { brightness: 0.0, variance: Some(0.0), profiled: [0.0; 2], ..pixel(None) };
        let survey = Survey::new(&[vec![black; 5]]).unwrap();
        assert_eq!(survey.samples_for_error(0.01, |e| e.p50, Calibration::NONE), [1.0]);
        assert_eq!(survey.error(&[1.0], Calibration::NONE).p95, 0.0);
        let single = Survey::new(&[vec![pixel(None)]]).unwrap();
        assert!(single.error(&[4.0], Calibration::NONE).p95.is_finite());
        assert!(Survey::new(&[vec![]]).is_err());
        assert!(Survey::new(&[vec![Seen { samples: 0, ..black }]]).is_err());
        assert!(Survey::new(&[]).is_ok());
    }
}
