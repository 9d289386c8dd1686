//! What a single pixel may cost.
//!
//! A forecast says what the pixels of a stratum cost on average; a pixel costs more or less. One that was not profiled is as likely to have any place
//! among the n of its stratum that were as these are themselves, so it costs less than the k-th cheapest of them with probability
//! k / (n + 1), whatever the distribution (conformal prediction, stratum by stratum: Vovk, Gammerman, Shafer 2005). Between these probabilities
//! the quantile is interpolated (definition 6 of Hyndman, Fan 1996): the dearest of six pixels stays above in six cases of seven, which is
//! too much for four in five. Pixels are profiled evenly over what they show, which rather makes quantiles too large than too small.
//!
//! For four in five that takes 4 pixels, for 19 in 20 it takes 19. Strata with fewer speak together, by the *scores* y_i / ȳ_(−i) of
//! their pixels, each held against the mean of the others (as in the jackknife+: Barber, Candès, Ramdas, Tibshirani 2021), with the pixels that
//! it stands for as its weight (Tibshirani, Barber, Candès, Ramdas 2019); if these are too few as well, all strata do. The one pixel more, that is
//! asked about, is given the mean weight: its own would promise nothing in a large stratum of which few were profiled. So together they hold
//! for the pixels of all these strata, and not for each of them: an approximation, which `forelight bench coverage` judges.

use crate::cost::{Observation, WORK};
use crate::strata::Stratum;
use std::collections::BTreeMap;

/// The profiled pixels of a frame, as what they say of the others.
#[derive(Clone, Debug)]
pub struct PixelCosts {
    strata: Vec<OfStratum>,
}

/// What the pixels that were not profiled take at most, with one probability.
#[derive(Clone, Debug)]
pub struct PixelQuantiles {
    /// By stratum: work, by its own pixels alone.
    own: Vec<Option<f64>>,
    /// For the others: so many times their mean.
    together: Option<f64>,
}

impl PixelQuantiles {
    /// Work that a pixel of a stratum takes at most where those of the stratum are forecast to take `here` each, by what was profiled where they
    /// were forecast to take `there` each; none where too few were profiled to say.
    pub fn of(&self, stratum: usize, there: f64, here: f64) -> Option<f64> {
        match self.own.get(stratum)? {
            Some(own) if there > 0.0 => Some(own * (here / there)),
            Some(own) if here == there => Some(*own),
            _ => self.together.map(|times| times * here),
        }
    }
}

/// The profiled pixels of a stratum.
#[derive(Clone, Debug, Default)]
struct OfStratum {
    /// Ascending.
    works: Vec<f64>,
    /// In the order in which they were profiled.
    scores: Vec<f64>,
    /// Pixels that one of them stands for.
    weight: f64,
}

impl OfStratum {
    /// The quantile by its own pixels alone.
    fn own(&self, probability: f64) -> Option<f64> {
        quantile(self.works.iter().map(|&work| (work, 1.0)), 1.0, probability)
    }
}

/// Works of pixels, added up.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    work: f64,
    count: f64,
}

impl Sum {
    fn add(&mut self, work: f64) {
        (self.work, self.count) = (self.work + work, self.count + 1.0);
    }
}

impl PixelCosts {
    /// Of the work of the pixels that were profiled in a frame with so many pixels of each stratum. What stands apart has no pixels.
    pub fn new(strata: &[Stratum], counts: &[u32], observations: &[Observation]) -> Self {
        let is_pixel = |observation: &&Observation| {
            strata.get(observation.stratum as usize).is_some_and(|stratum| !stratum.apart)
        };
        let pixels: Vec<&Observation> = observations.iter().filter(is_pixel).collect();
        let mut sums = vec![Sum::default(); strata.len()];
        let mut of_material: BTreeMap<u32, Sum> = BTreeMap::new();
        let mut of_all = Sum::default();
        for pixel in &pixels {
            let (work, stratum) = (work(pixel), pixel.stratum as usize);
            sums[stratum].add(work);
            of_material.entry(strata[stratum].material).or_default().add(work);
            of_all.add(work);
        }
        let mut found = vec![OfStratum::default(); strata.len()];
        for pixel in &pixels {
            let (work, stratum) = (work(pixel), pixel.stratum as usize);
            // Alone of its stratum, it is held against those of its material, or against all.
            let alike = of_material.get(&strata[stratum].material).copied();
            let score = [Some(sums[stratum]), alike, Some(of_all)].into_iter().flatten();
            found[stratum].works.push(work);
            found[stratum].scores.extend(score.filter_map(|sum| self::score(sum, work)).next());
        }
        for (stratum, &count) in found.iter_mut().zip(counts) {
            stratum.works.sort_by(f64::total_cmp);
            stratum.weight = f64::from(count) / (stratum.works.len() as f64).max(1.0);
        }
        Self { strata: found }
    }

    /// What the pixels take at most, with this probability.
    pub fn at(&self, probability: f64) -> PixelQuantiles {
        let own: Vec<Option<f64>> = self.strata.iter().map(|stratum| stratum.own(probability)).collect();
        let together = |of: &dyn Fn(&Option<f64>) -> bool| {
            let those = self.strata.iter().zip(&own).filter(|(_, own)| of(own));
            let scores = |(one, _): (&OfStratum, _)| {
                one.scores.iter().map(|&score| (score, one.weight)).collect::<Vec<_>>()
            };
            let mut weighted: Vec<(f64, f64)> = those.flat_map(scores).collect();
            weighted.sort_by(|one, other| one.0.total_cmp(&other.0));
            let next = weighted.iter().map(|(_, weight)| weight).sum::<f64>() / weighted.len().max(1) as f64;
            quantile(weighted.into_iter(), next, probability)
        };
        let together = together(&|own| own.is_none()).or_else(|| together(&|_| true));
        PixelQuantiles { own, together }
    }
}

fn work(pixel: &Observation) -> f64 {
    pixel.cost.columns()[WORK] as f64
}

/// The score of one of so many pixels of this sum; none if it is alone.
///
/// With σ² for the variance of a pixel's logarithm, that of y_i / ȳ_(−i) is about σ² (1 + 1 / (n − 1)), and that of a new pixel over the mean of all n
/// is σ² (1 + 1 / n): so logarithms of scores are brought closer to zero by √(1 − 1 / n²).
fn score(Sum { work: sum, count }: Sum, work: f64) -> Option<f64> {
    if count < 2.0 {
        return None;
    }
    let mean = (sum - work) / (count - 1.0);
    let closer = libm::sqrt(1.0 - 1.0 / (count * count));
    Some(if work == mean { 1.0 } else { libm::pow(work / mean, closer) })
}

/// The quantile of ascending weighted scores and of one more, of weight `next`, that may lie anywhere; none if it may be that one.
fn quantile(scores: impl Iterator<Item = (f64, f64)> + Clone, next: f64, probability: f64) -> Option<f64> {
    let all = scores.clone().map(|(_, weight)| weight).sum::<f64>() + next;
    // A little less than asked for, so that a whole number of scores is not passed by the rounding of p.
    let wanted = probability * all * (1.0 - 1e-12);
    let mut before: Option<f64> = None;
    let mut reached = 0.0;
    for (score, weight) in scores {
        if reached + weight >= wanted {
            let from = before.unwrap_or(score);
            let found =
                if from == score { score } else { from + (score - from) * (wanted - reached) / weight };
            return Some(found).filter(|found| found.is_finite());
        }
        (before, reached) = (Some(score), reached + weight);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::Cost;

    fn seen(stratum: u32, work: u64) -> Observation {
        Observation { stratum, cost: Cost { work, ..Cost::default() } }
    }

    fn strata(materials: &[u32]) -> Vec<Stratum> {
        let one = |(object, &material)| Stratum { object, material, prior_cost: 1.0, apart: false };
        (0..).zip(materials).map(one).collect()
    }

    fn is(found: Option<f64>, expected: f64) {
        let found = found.unwrap();
        assert!((found - expected).abs() < 1e-9 * expected, "{found} is not {expected}");
    }

    #[test]
    fn a_stratum_speaks_for_itself_as_soon_as_it_has_enough_pixels_and_with_others_before() {
        let strata = strata(&[0, 0, 1]);
        // Nine pixels of 1 to 9; two that stand for ten each; one alone of its material.
        let mut observed: Vec<Observation> = (1..10).map(|work| seen(0, work)).collect();
        observed.extend([seen(1, 10), seen(1, 30), seen(2, 100)]);
        let costs = PixelCosts::new(&strata, &[90, 20, 10], &observed);
        // Of ten places the eighth, the fifth, and three quarters of the way from there to the next.
        is(costs.at(0.8).of(0, 5.0, 5.0), 8.0);
        is(costs.at(0.5).of(0, 5.0, 5.0), 5.0);
        is(costs.at(0.575).of(0, 5.0, 5.0), 5.75);
        // The others have three scores together, the greatest of them that of the pixel that is held against all others.
        let closer = |score: f64, count: f64| score.powf((1.0 - 1.0 / (count * count)).sqrt());
        let (alone, one_of_two) = (closer(100.0 / (85.0 / 11.0), 12.0), closer(3.0, 2.0));
        for stratum in [1, 2] {
            is(costs.at(0.75).of(stratum, 7.0, 7.0), 7.0 * alone);
            // Too few for more, so that all speak: of twelve and one more, each for ten pixels, the eleventh.
            is(costs.at(11.0 / 13.0).of(stratum, 7.0, 7.0), 7.0 * one_of_two);
            assert_eq!(costs.at(0.95).of(stratum, 7.0, 7.0), None, "it may be the one more");
        }
        assert_eq!(costs.at(0.5).of(3, 7.0, 7.0), None, "there is no such stratum");
        // Elsewhere they cost twice as much, or what costs nothing there costs something.
        is(costs.at(0.8).of(0, 5.0, 10.0), 16.0);
        is(costs.at(0.75).of(0, 0.0, 3.0), 3.0 * alone);
    }

    #[test]
    fn pixels_that_cost_the_same_cost_just_that_and_those_without_cost_are_no_nan() {
        // Whatever the mean is thought to be.
        let constant: Vec<Observation> = (0..30).map(|_| seen(0, 7)).collect();
        let costs = PixelCosts::new(&strata(&[0]), &[900], &constant);
        for probability in [0.05, 0.5, 0.95] {
            is(costs.at(probability).of(0, 7.3, 7.3), 7.0);
        }
        let mut free: Vec<Observation> = (0..30).map(|_| seen(0, 0)).collect();
        assert_eq!(PixelCosts::new(&strata(&[0]), &[900], &free).at(0.95).of(0, 0.0, 0.0), Some(0.0));
        free.extend([seen(1, 5), seen(1, 0)]);
        let costs = PixelCosts::new(&strata(&[0, 0]), &[900, 9], &free);
        assert_eq!(
            (costs.at(0.2).of(1, 2.5, 2.5), costs.at(0.99).of(1, 2.5, 2.5)),
            (Some(0.0), None),
            "endlessly more than none"
        );
    }

    #[test]
    fn nothing_profiled_says_nothing() {
        assert_eq!(PixelCosts::new(&strata(&[0]), &[9], &[]).at(0.5).of(0, 1.0, 1.0), None);
        is(PixelCosts::new(&strata(&[0]), &[9], &[seen(0, 1)]).at(0.5).of(0, 1.0, 1.0), 1.0);
    }
}
