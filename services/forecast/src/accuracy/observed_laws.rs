//! How the variance of an unfinished image falls with samples, by the image itself.
//!
//! When a pixel goes from n to m samples, its mean moves by V(n) − V(m) in the mean square. So all pixels
//! together show how far the variance has fallen, and which terms of the law ([`super::Terms`]) explain that.
//! Tiles with many samples show edges of lamps and glossy things. So tiles are grouped by number of samples,
//! and each group has its own law.

use super::Terms;
use super::allot::Zone;
use super::sampled_pixel::SampledPixel;
use super::variance_curve::{powers_of_pixel, weighted, with_least_share};
use crate::interval::Part;
use crate::moments::sum;

/// Bound on the factor by which a law may differ from one that explains the movement, in both directions.
const MAX_FACTOR: f64 = 4.0;
/// Weight of all tiles in the law of a group of tiles, as a number of tiles.
const ALL_TILES_WEIGHT: f64 = 4.0;
/// The terms are told apart where the flattest moves pixels this many times as far as the steepest. At eight
/// samples it is 2.7 times, at four 1.3 times.
const APART: f64 = 2.0;

/// Laws of the variances of an image's tiles.
#[derive(Clone, Debug)]
pub(super) struct ObservedLaws {
    /// Entry k is for tiles with 2ᵏ up to 2ᵏ⁺¹ samples per pixel. `None` where these show too little.
    octaves: Vec<Option<Octave>>,
    /// For all tiles together. `None` where these show too little.
    all: Option<Octave>,
    /// The octave of each tile, as an index into `octaves`.
    of_tiles: Vec<usize>,
}

/// The law of tiles whose numbers of samples lie within a factor of two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Octave {
    /// Their variance, over that of one sample.
    pub law: Terms,
    /// Variance of the error of what the law says, relative to its square.
    pub uncertainty: Part,
}

/// Sums over pixels of the squared movement of their means, and of what would explain it.
#[derive(Clone, Copy, Default)]
struct Movement {
    observed: f64,
    /// By the guess.
    guessed: f64,
    /// If the variance were of one term alone.
    of_terms: Terms,
    /// Sum of the guessed variances, with as many samples as the pixels have, if they were of one term alone.
    left: Terms,
    /// Sum of the guessed variances, term by term.
    variance: Terms,
}

impl ObservedLaws {
    /// Finds the laws of `tiles` from the guesses `zones` and the tiles' mean samples per pixel.
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
        let octaves = (0..count).map(|octave| all?.shrunk(&known(Some(octave)))).collect();
        Self { octaves, all, of_tiles }
    }

    /// The law of each tile, in the order of the tiles. `None`: the guess stands.
    pub fn by_tile(&self) -> impl Iterator<Item = Option<&Octave>> {
        self.of_tiles.iter().map(|&of| self.octaves[of].as_ref().or(self.all.as_ref()))
    }

    /// Variance that the laws cause in the sum of the tiles' errors, as independent parts.
    pub fn uncertainties(&self, errors: &[f64]) -> Vec<Part> {
        // Octaves without a law of their own share one law, and so one error.
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
        own.chain(self.all.as_ref().map(|all| part(all, shared))).collect()
    }

    /// The same laws, taken as certain.
    pub fn without_uncertainty(mut self) -> Self {
        let octaves = self.octaves.iter_mut().chain([&mut self.all]).flatten();
        octaves.for_each(|octave| {
            octave.uncertainty = Part { variance: 0.0, degrees_of_freedom: f64::INFINITY };
        });
        self
    }
}

impl Movement {
    fn of(tile: &[SampledPixel], zone: &Zone) -> Self {
        let of_one = sum(zone.variance.iter().copied());
        let mut moved = Self::default();
        for (pixel, (before, square)) in tile.iter().filter_map(|pixel| Some((pixel, pixel.grown?))) {
            let [then, now] = [before, pixel.samples].map(powers_of_pixel);
            let of_terms: Terms = std::array::from_fn(|k| then[k] - now[k]);
            moved += Self {
                observed: square,
                guessed: weighted(&zone.variance, &of_terms),
                of_terms: of_terms.map(|term| of_one * term),
                left: now.map(|power| of_one * power),
                variance: zone.variance,
            };
        }
        moved
    }

    fn of_all(tiles: &[Self]) -> Self {
        let mut all = Self::default();
        tiles.iter().for_each(|tile| all += *tile);
        all
    }

    /// The law that explains a movement of `observed`.
    fn law(&self, observed: f64) -> Terms {
        let [steep, edges, random] = self.of_terms;
        let of_one = sum(self.variance.iter().copied());
        let bounded = |factor: f64| factor.clamp(1.0 / MAX_FACTOR, MAX_FACTOR);
        if !(steep < edges && edges < random && APART * steep <= random) {
            let factor = bounded(observed / self.guessed);
            return self.variance.map(|term| factor * term / of_one);
        }
        // A mixture of the two terms between which the movement lies.
        let flat = if observed > edges { 2 } else { 1 };
        let [lower, upper] = [self.of_terms[flat - 1], self.of_terms[flat]];
        let share = ((observed - lower) / (upper - lower)).clamp(0.0, 1.0);
        let mut law = Terms::default();
        (law[flat - 1], law[flat]) = (1.0 - share, share);
        let law = with_least_share(&law, &self.left).unwrap_or(law);
        let factor = bounded(observed / weighted(&law, &self.of_terms));
        law.map(|term| factor * term)
    }

    /// The variance that a law leaves.
    fn left_by(&self, law: &Terms) -> f64 {
        weighted(law, &self.left)
    }

    /// By how many per cent the variance that is left changes, if the movement changes by one.
    fn elasticity(&self) -> f64 {
        const CHANGE: f64 = 1.05;
        let left = |observed: f64| self.left_by(&self.law(observed));
        libm::log(left(self.observed * CHANGE) / left(self.observed)) / libm::log(CHANGE)
    }
}

impl std::ops::AddAssign for Movement {
    fn add_assign(&mut self, other: Self) {
        let add = |to: &mut Terms, other: Terms| to.iter_mut().zip(other).for_each(|(to, term)| *to += term);
        self.observed += other.observed;
        self.guessed += other.guessed;
        add(&mut self.of_terms, other.of_terms);
        add(&mut self.left, other.left);
        add(&mut self.variance, other.variance);
    }
}

impl Octave {
    /// The law of some tiles, with the relative variance of a ratio estimator (Cochran 1977, section 6.4).
    /// `None` if they show too little.
    fn from_tiles(tiles: &[Movement]) -> Option<Self> {
        let all = Movement::of_all(tiles);
        if tiles.len() < 2 || all.observed <= 0.0 || !(all.observed / all.guessed).is_finite() {
            return None;
        }
        let law = all.law(all.observed);
        let factor = all.observed / weighted(&law, &all.of_terms);
        let rest = |tile: &Movement| tile.observed - factor * weighted(&law, &tile.of_terms);
        let freedom = (tiles.len() - 1) as f64;
        let squares = sum(tiles.iter().map(|tile| rest(tile) * rest(tile)));
        let relative = squares / (all.observed * all.observed) * (tiles.len() as f64 / freedom);
        // A bounded law is no surer than one that follows the movement.
        let elasticity = all.elasticity().max(1.0);
        let variance = elasticity * elasticity * relative;
        Some(Self { law, uncertainty: Part { variance, degrees_of_freedom: freedom } })
    }

    /// The law of some of the tiles, shrunk towards `self`. `None` if they show too little.
    fn shrunk(&self, some: &[Movement]) -> Option<Self> {
        let own = Self::from_tiles(some)?;
        let count = some.len() as f64;
        let weight = count / (count + ALL_TILES_WEIGHT);
        let law = std::array::from_fn(|k| weight * own.law[k] + (1.0 - weight) * self.law[k]);
        let moved = Movement::of_all(some);
        let larger = moved.left_by(&own.law) / moved.left_by(&law);
        let variance = own.uncertainty.variance * weight * larger * larger;
        Some(Self { law, uncertainty: Part { variance, ..own.uncertainty } })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::variance_curve::powers;

    /// A tile of 64 pixels that went from half of these samples to all. Means moved by `factor` times what
    /// `law` says in the mean square, if the variance of one sample is 4.
    fn tile(samples: u32, law: Terms, factor: f64) -> Vec<SampledPixel> {
        let [then, now] = [samples / 2, samples].map(|n| weighted(&law, &powers(f64::from(n))));
        let pixel = |i: usize| SampledPixel {
            samples,
            brightness: 2.0,
            variance: None,
            cost: 8.0,
            profiled: GUESS,
            grown: (!i.is_multiple_of(3))
                .then_some((samples / 2, factor * 4.0 * (then - now) * [0.8, 1.2][i % 2])),
        };
        (0..64).map(pixel).collect()
    }

    const GUESS: Terms = [0.0, 3.0, 1.0];

    /// As the guess says, after four samples.
    fn guessed(factor: f64) -> Vec<SampledPixel> {
        tile(4, GUESS.map(|term| term / 4.0), factor)
    }

    fn laws(tiles: &[Vec<SampledPixel>], samples: &[f64]) -> ObservedLaws {
        let zone = Zone { pixels: 64.0, variance: GUESS, cost: 2.0 };
        ObservedLaws::new(tiles, &vec![zone; tiles.len()], samples)
    }

    /// Of each tile: the variance of one sample, over the guess.
    fn factors(found: &ObservedLaws) -> Vec<f64> {
        found.by_tile().map(|octave| octave.map_or(1.0, |octave| octave.law.iter().sum())).collect()
    }

    #[test]
    fn what_few_samples_changed_says_how_far_the_variance_has_fallen() {
        for (factor, taken) in [(1.0, 1.0), (1.7, 1.7), (0.6, 0.6), (9.0, MAX_FACTOR)] {
            let found = laws(&vec![guessed(factor); 20], &[4.0; 20]);
            let octave = found.by_tile().next().unwrap().unwrap();
            assert!((factors(&found)[0] / taken - 1.0).abs() < 0.02, "{factor}: {found:?}");
            assert!((octave.law[1] / octave.law[2] - 3.0).abs() < 1e-9 && octave.law[0] == 0.0, "{octave:?}");
            assert!(octave.uncertainty.variance < 1e-3 && octave.uncertainty.degrees_of_freedom == 19.0);
        }
        // Where nothing is known, the guess stands.
        for tiles in [vec![], vec![guessed(2.0)], vec![guessed(0.0); 9]] {
            let found = laws(&tiles, &vec![4.0; tiles.len()]);
            assert!(found.by_tile().all(|octave| octave.is_none()));
        }
    }

    #[test]
    fn what_many_samples_changed_says_by_which_law_the_variance_falls() {
        for (samples, law) in [
            (64, [0.0, 0.97, 0.03]),
            (64, [0.0, 0.95, 0.05]),
            (16, [0.0, 0.0, 1.0]),
            (16, [0.0, 0.5, 0.5]),
            (64, [0.0, 0.9, 0.1]),
            (64, [0.0, 1.0, 0.0]),
            (16, [1.0, 0.0, 0.0]),
            (64, [0.7, 0.3, 0.0]),
        ] {
            let found = laws(&vec![tile(samples, law, 1.0); 20], &[f64::from(samples); 20]);
            let octave = found.by_tile().next().unwrap().unwrap();
            for more in [1.0, 4.0] {
                let at = |law: &Terms| weighted(law, &powers(more * f64::from(samples)));
                // At least a third of what is left counts as found by chance.
                let chance = law[2] / f64::from(samples) / weighted(&law, &powers(f64::from(samples)));
                let bound = if chance > 0.34 { 1.01 } else { 1.33 * more.sqrt() };
                let ratio = at(&octave.law) / at(&law);
                assert!(ratio > 0.95 && ratio < bound, "{law:?}, {more}: {ratio} {octave:?}");
            }
        }
    }

    #[test]
    fn more_movement_never_forecasts_less_variance() {
        let steep = tile(16, [1.0, 0.0, 0.0], 1.0);
        let mut before = Terms::default();
        for factor in 1..60 {
            let moved: Vec<SampledPixel> = steep
                .iter()
                .map(|pixel| SampledPixel {
                    grown: pixel.grown.map(|(n, square)| (n, 0.1 * f64::from(factor) * square)),
                    ..*pixel
                })
                .collect();
            let found = laws(&vec![moved; 20], &[16.0; 20]);
            let law = found.by_tile().next().unwrap().unwrap().law;
            for samples in [16.0, 64.0, 1024.0] {
                let [was, is] = [before, law].map(|law| weighted(&law, &powers(samples)));
                assert!(is >= was * (1.0 - 1e-9), "{samples} samples, {factor}: {law:?} after {before:?}");
            }
            before = law;
        }
    }

    #[test]
    fn tiles_of_many_samples_speak_for_themselves_where_they_are_many() {
        let tiles: Vec<Vec<SampledPixel>> =
            [vec![guessed(1.0); 40], vec![guessed(3.0); 12], vec![guessed(4.0); 1]].concat();
        let samples: Vec<f64> = [vec![5.0; 40], vec![70.0; 12], vec![300.0; 1]].concat();
        let factors = factors(&laws(&tiles, &samples));
        let all = (40.0 + 36.0 + 4.0) / 53.0;
        assert!(factors[0] < 1.06 && factors[45] > 2.6 && factors[45] < 3.0, "{factors:?}");
        assert!((factors[52] - all).abs() < 0.05, "one tile alone is as all are: {factors:?}");
    }

    #[test]
    fn tiles_that_do_not_agree_leave_it_unsure() {
        let split = [vec![guessed(6.0); 4], vec![guessed(1.0); 16]].concat();
        let found = laws(&split, &[4.0; 20]);
        let of = |found: &ObservedLaws| {
            crate::interval::combined(&found.uncertainties(&[2.0; 20])).variance / 1600.0
        };
        assert!(of(&found) > 0.02, "{found:?}");
        assert_eq!(of(&found.without_uncertainty()), 0.0);
    }
}
