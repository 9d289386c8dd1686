//! Quantiles of the cost of a single pixel.
//!
//! If n pixels of a stratum were profiled, another one has any rank among them with the same probability. So
//! it costs less than the k-th cheapest with probability k / (n + 1), whatever the distribution (conformal
//! prediction by stratum: Vovk, Gammerman, Shafer 2005). In between, the quantile is interpolated (definition
//! 6 of Hyndman, Fan 1996). Profiled pixels are spread evenly, so quantiles tend to be too large.
//!
//! P80 needs 4 profiled pixels, and P95 needs 19. Strata with fewer are pooled by the *scores* y_i / ȳ_(−i),
//! each pixel relative to the mean of the others (as in the jackknife+: Barber, Candès, Ramdas, Tibshirani
//! 2021), weighted by the pixels they stand for (Tibshirani, Barber, Candès, Ramdas 2019). If that is too
//! few, all strata are pooled. The unknown pixel gets the mean weight. Pooled quantiles hold for these strata
//! together, not for each; `forelight bench coverage` measures the error.

use crate::cost::{Observation, WORK};
use crate::strata::Stratum;
use std::collections::BTreeMap;

/// The profiled pixels of a frame, as evidence on the pixels that were not profiled.
#[derive(Clone, Debug)]
pub struct PixelCosts {
    strata: Vec<StratumPixels>,
}

/// One quantile of the work of pixels that were not profiled.
#[derive(Clone, Debug)]
pub struct PixelQuantiles {
    /// Work by stratum, from its own pixels alone.
    own: Vec<Option<f64>>,
    /// For the other strata: a multiple of their mean.
    pooled: Option<f64>,
}

impl PixelQuantiles {
    /// The quantile of the work of a pixel of `stratum`, scaled from its mean work in the profiled frame,
    /// `there`, to that in the frame in question, `here`. `None` if too few pixels were profiled.
    pub fn of(&self, stratum: usize, there: f64, here: f64) -> Option<f64> {
        match self.own.get(stratum)? {
            Some(own) if there > 0.0 => Some(own * (here / there)),
            Some(own) if here == there => Some(*own),
            _ => self.pooled.map(|times| times * here),
        }
    }
}

/// The profiled pixels of one stratum.
#[derive(Clone, Debug, Default)]
struct StratumPixels {
    /// Work of the pixels, ascending.
    works: Vec<f64>,
    /// Scores, in the order in which the pixels were profiled.
    scores: Vec<f64>,
    /// Number of pixels that each profiled one stands for.
    weight: f64,
}

impl StratumPixels {
    /// The quantile from its own pixels alone.
    fn own(&self, probability: f64) -> Option<f64> {
        quantile(self.works.iter().map(|&work| (work, 1.0)), 1.0, probability)
    }
}

/// Sum of the work of some pixels.
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
    /// Collects the profiled pixels of a frame. `counts[h]` is the number of pixels of stratum h.
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
        let mut found = vec![StratumPixels::default(); strata.len()];
        for pixel in &pixels {
            let (work, stratum) = (work(pixel), pixel.stratum as usize);
            // A pixel that is alone in its stratum is compared with its material, or else with all pixels.
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

    /// The quantile at this probability.
    pub fn at(&self, probability: f64) -> PixelQuantiles {
        let own: Vec<Option<f64>> = self.strata.iter().map(|stratum| stratum.own(probability)).collect();
        let pooled = |of: &dyn Fn(&Option<f64>) -> bool| {
            let those = self.strata.iter().zip(&own).filter(|(_, own)| of(own));
            let scores = |(one, _): (&StratumPixels, _)| {
                one.scores.iter().map(|&score| (score, one.weight)).collect::<Vec<_>>()
            };
            let mut weighted: Vec<(f64, f64)> = those.flat_map(scores).collect();
            weighted.sort_by(|one, other| one.0.total_cmp(&other.0));
            let next = weighted.iter().map(|(_, weight)| weight).sum::<f64>() / weighted.len().max(1) as f64;
            quantile(weighted.into_iter(), next, probability)
        };
        let pooled = pooled(&|own| own.is_none()).or_else(|| pooled(&|_| true));
        PixelQuantiles { own, pooled }
    }
}

fn work(pixel: &Observation) -> f64 {
    pixel.cost.columns()[WORK] as f64
}

/// The score of one of the pixels of a sum. `None` if it is the only one.
///
/// Let σ² be the variance of the logarithm of a pixel's work. Then ln(y_i / ȳ_(−i)) has about σ² (1 + 1 / (n
/// − 1)). A new pixel over the mean of n has σ² (1 + 1 / n). So logarithms of scores are multiplied by √(1 −
/// 1 / n²).
fn score(Sum { work: sum, count }: Sum, work: f64) -> Option<f64> {
    if count < 2.0 {
        return None;
    }
    let mean = (sum - work) / (count - 1.0);
    let closer = libm::sqrt(1.0 - 1.0 / (count * count));
    Some(if work == mean { 1.0 } else { libm::pow(work / mean, closer) })
}

/// Quantile of ascending weighted scores and one unknown of weight `next`. `None` if it may be that one.
fn quantile(scores: impl Iterator<Item = (f64, f64)> + Clone, next: f64, probability: f64) -> Option<f64> {
    let all = scores.clone().map(|(_, weight)| weight).sum::<f64>() + next;
    // Slightly less than the exact value, so that the rounding of p does not skip a score.
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
        // Nine pixels of 1 to 9; two that stand for ten each; one that is alone in its material.
        let mut observed: Vec<Observation> = (1..10).map(|work| seen(0, work)).collect();
        observed.extend([seen(1, 10), seen(1, 30), seen(2, 100)]);
        let costs = PixelCosts::new(&strata, &[90, 20, 10], &observed);
        // Of ten ranks: the eighth, the fifth, and three quarters of the way from there to the next.
        is(costs.at(0.8).of(0, 5.0, 5.0), 8.0);
        is(costs.at(0.5).of(0, 5.0, 5.0), 5.0);
        is(costs.at(0.575).of(0, 5.0, 5.0), 5.75);
        // The other strata have three scores; the greatest is that of the pixel against all others.
        let closer = |score: f64, count: f64| score.powf((1.0 - 1.0 / (count * count)).sqrt());
        let (alone, one_of_two) = (closer(100.0 / (85.0 / 11.0), 12.0), closer(3.0, 2.0));
        for stratum in [1, 2] {
            is(costs.at(0.75).of(stratum, 7.0, 7.0), 7.0 * alone);
            // Too few for a higher quantile, so all strata are pooled: rank 11 of 13, each for ten pixels.
            is(costs.at(11.0 / 13.0).of(stratum, 7.0, 7.0), 7.0 * one_of_two);
            assert_eq!(costs.at(0.95).of(stratum, 7.0, 7.0), None, "it may be the one more");
        }
        assert_eq!(costs.at(0.5).of(3, 7.0, 7.0), None, "there is no such stratum");
        // In the other frame they cost twice as much, or cost something instead of nothing.
        is(costs.at(0.8).of(0, 5.0, 10.0), 16.0);
        is(costs.at(0.75).of(0, 0.0, 3.0), 3.0 * alone);
    }

    #[test]
    fn pixels_that_cost_the_same_cost_just_that_and_those_without_cost_are_no_nan() {
        // Whatever the forecast mean.
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
