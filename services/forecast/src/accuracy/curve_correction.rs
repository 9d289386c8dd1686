//! Corrects the variance curve of a profile by the unfinished image.
//!
//! The profile's curve rests on few pixels with few samples. When a pixel goes from n to m samples, its mean
//! moves by V(n) − V(m) in the mean square. So all pixels together show the curve's error at the present
//! number of samples. Tiles with many samples show edges of lamps and glossy things. So tiles are grouped by
//! number of samples, and each group corrects itself.

use super::allot::Zone;
use super::sampled_pixel::SampledPixel;
use super::variance_curve::{powers_of_pixel, weighted};
use crate::interval::Part;
use crate::moments::sum;

/// Bound on the correction factor, in both directions.
const MAX_FACTOR: f64 = 4.0;
/// Weight of all tiles in the correction of a group of tiles, as a number of tiles.
const ALL_TILES_WEIGHT: f64 = 4.0;

/// Correction factors of the guessed variances of an image's tiles.
#[derive(Clone, Debug)]
pub(super) struct CurveCorrection {
    /// Entry k is for tiles with 2ᵏ up to 2ᵏ⁺¹ samples per pixel. `None` where these show too little.
    octaves: Vec<Option<Octave>>,
    /// For all tiles together.
    all: Octave,
    /// The octave of each tile, as an index into `octaves`.
    of_tiles: Vec<usize>,
}

/// The correction of tiles whose numbers of samples lie within a factor of two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Octave {
    /// The variance of the tiles, over the guess.
    pub factor: f64,
    /// Variance of `factor`, relative to its square.
    pub uncertainty: Part,
}

/// Sums over a tile's pixels of the squared movement of their means: as observed, and as guessed.
#[derive(Clone, Copy)]
struct Movement {
    observed: f64,
    guessed: f64,
}

impl CurveCorrection {
    /// Builds the corrections for `tiles` from the guesses `zones` and the tiles' mean samples per pixel.
    pub fn new(tiles: &[Vec<SampledPixel>], zones: &[Zone], samples: &[f64]) -> Self {
        let of_tiles: Vec<usize> = samples.iter().map(|n| (n.max(1.0) as u32).ilog2() as usize).collect();
        let moved: Vec<Movement> =
            tiles.iter().zip(zones).map(|(tile, zone)| Movement::of(tile, zone)).collect();
        let known = |octave: Option<usize>| -> Vec<Movement> {
            let is_of = |of: &usize| octave.is_none_or(|octave| octave == *of);
            let pairs = moved.iter().zip(&of_tiles);
            pairs.filter(|(moved, of)| moved.guessed > 0.0 && is_of(of)).map(|(moved, _)| *moved).collect()
        };
        let all = Octave::from_tiles(&known(None));
        let count = of_tiles.iter().max().map_or(0, |most| most + 1);
        let octaves = (0..count).map(|octave| all.shrunk(&known(Some(octave)))).collect();
        Self { octaves, all, of_tiles }
    }

    /// The correction of each tile, in the order of the tiles.
    pub fn of_tiles(&self) -> impl Iterator<Item = &Octave> {
        self.of_tiles.iter().map(|&of| self.octaves[of].as_ref().unwrap_or(&self.all))
    }

    /// Variance that the corrections cause in the sum of the tiles' errors, as independent parts.
    pub fn uncertainties(&self, errors: &[f64]) -> Vec<Part> {
        // Octaves without a correction of their own share one correction, and so one error.
        let mut sums = vec![0.0; self.octaves.len()];
        let mut shared = 0.0;
        for (&of, error) in self.of_tiles.iter().zip(errors) {
            *(if self.octaves[of].is_some() { &mut sums[of] } else { &mut shared }) += error;
        }
        let part = |octave: &Octave, error: f64| Part {
            variance: octave.uncertainty.variance * error * error,
            ..octave.uncertainty
        };
        let own = self.octaves.iter().zip(sums).filter_map(|(octave, sum)| Some(part(octave.as_ref()?, sum)));
        own.chain([part(&self.all, shared)]).collect()
    }

    /// The same corrections, taken as certain.
    pub fn without_uncertainty(mut self) -> Self {
        let octaves = self.octaves.iter_mut().flatten();
        octaves.chain([&mut self.all]).for_each(|octave| octave.uncertainty = CERTAIN);
        self
    }
}

/// No uncertainty.
const CERTAIN: Part = Part { variance: 0.0, degrees_of_freedom: f64::INFINITY };

impl Movement {
    fn of(tile: &[SampledPixel], zone: &Zone) -> Self {
        let guess = |pixel: &SampledPixel, before: u32| {
            let [then, now] = [before, pixel.samples].map(powers_of_pixel);
            weighted(&zone.variance, &then) - weighted(&zone.variance, &now)
        };
        let known = || tile.iter().filter_map(|pixel| Some((pixel, pixel.grown?)));
        Self {
            observed: sum(known().map(|(_, (_, square))| square)),
            guessed: sum(known().map(|(pixel, (before, _))| guess(pixel, before))),
        }
    }
}

impl Octave {
    /// A ratio of sums with the relative variance of a ratio estimator (Cochran 1977, section 6.4).
    fn from_tiles(tiles: &[Movement]) -> Self {
        let [observed, guessed] =
            [sum(tiles.iter().map(|tile| tile.observed)), sum(tiles.iter().map(|tile| tile.guessed))];
        if tiles.len() < 2 || observed <= 0.0 || !(observed / guessed).is_finite() {
            return Self { factor: 1.0, uncertainty: CERTAIN };
        }
        let factor = observed / guessed;
        let rest = |tile: &Movement| {
            (tile.observed - factor * tile.guessed) * (tile.observed - factor * tile.guessed)
        };
        let freedom = (tiles.len() - 1) as f64;
        let variance = sum(tiles.iter().map(rest)) / (observed * observed) * (tiles.len() as f64 / freedom);
        let uncertainty = Part { variance, degrees_of_freedom: freedom };
        Self { factor: factor.clamp(1.0 / MAX_FACTOR, MAX_FACTOR), uncertainty }
    }

    /// The correction of some of the tiles, shrunk towards `self`. `None` if they show nothing.
    fn shrunk(&self, some: &[Movement]) -> Option<Self> {
        let own = Self::from_tiles(some);
        if own.uncertainty == CERTAIN {
            return None;
        }
        let count = some.len() as f64;
        let weight = count / (count + ALL_TILES_WEIGHT);
        let factor = weight * own.factor + (1.0 - weight) * self.factor;
        let variance = own.uncertainty.variance * weight * (own.factor / factor) * (own.factor / factor);
        Some(Self { factor, uncertainty: Part { variance, ..own.uncertainty } })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tile of 64 pixels after two and four samples. Means moved by `factor` times the guess in the mean
    /// square.
    fn tile(factor: f64) -> Vec<SampledPixel> {
        let guess = 3.0 * (1.0 / 8f64.sqrt() - 1.0 / 8.0) + (1.0 / 2.0 - 1.0 / 4.0);
        let pixel = |i: usize| SampledPixel {
            samples: 4,
            brightness: 2.0,
            variance: None,
            cost: 8.0,
            profiled: [0.0, 3.0, 1.0],
            grown: (!i.is_multiple_of(3)).then_some((2, factor * guess * [0.8, 1.2][i % 2])),
        };
        (0..64).map(pixel).collect()
    }

    fn correction(tiles: &[Vec<SampledPixel>], samples: &[f64]) -> CurveCorrection {
        let zone = Zone { pixels: 64.0, variance: [0.0, 3.0, 1.0], cost: 2.0 };
        CurveCorrection::new(tiles, &vec![zone; tiles.len()], samples)
    }

    #[test]
    fn what_the_last_samples_changed_says_how_variance_falls() {
        for (factor, taken) in [(1.0, 1.0), (1.7, 1.7), (0.6, 0.6), (9.0, MAX_FACTOR)] {
            let found = correction(&vec![tile(factor); 20], &[4.0; 20]);
            let octave = found.of_tiles().next().unwrap();
            assert!((octave.factor / taken - 1.0).abs() < 0.02, "{factor}: {found:?}");
            assert!(octave.uncertainty.variance < 1e-3 && octave.uncertainty.degrees_of_freedom == 19.0);
        }
        // Where nothing is known, the guess stands.
        for tiles in [vec![], vec![tile(2.0)], vec![tile(0.0); 9]] {
            let found = correction(&tiles, &vec![4.0; tiles.len()]);
            assert!(found.of_tiles().all(|octave| *octave == Octave { factor: 1.0, uncertainty: CERTAIN }));
        }
    }

    #[test]
    fn tiles_of_many_samples_speak_for_themselves_where_they_are_many() {
        let tiles: Vec<Vec<SampledPixel>> =
            [vec![tile(1.0); 40], vec![tile(3.0); 12], vec![tile(4.0); 1]].concat();
        let samples: Vec<f64> = [vec![5.0; 40], vec![70.0; 12], vec![300.0; 1]].concat();
        let found = correction(&tiles, &samples);
        let factors: Vec<f64> = found.of_tiles().map(|octave| octave.factor).collect();
        let all = (40.0 + 36.0 + 4.0) / 53.0;
        assert!(factors[0] < 1.06 && factors[45] > 2.6 && factors[45] < 3.0, "{factors:?}");
        assert!((factors[52] - all).abs() < 0.05, "one tile alone is as all are: {factors:?}");
    }

    #[test]
    fn tiles_that_do_not_agree_leave_it_unsure() {
        let split = [vec![tile(6.0); 4], vec![tile(1.0); 16]].concat();
        let found = correction(&split, &[4.0; 20]);
        let of = |found: &CurveCorrection| {
            crate::interval::combined(&found.uncertainties(&[2.0; 20])).variance / 1600.0
        };
        assert!(of(&found) > 0.02, "{found:?}");
        assert_eq!(of(&found.without_uncertainty()), 0.0);
    }
}
