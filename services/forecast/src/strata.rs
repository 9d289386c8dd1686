//! Strata, and groups of strata that are large enough to be sampled.

use serde::{Deserialize, Serialize};

use crate::error::ForecastError;

/// An (object, material) pair that the preview can show. By convention the last one is the background; strata
/// of cache records follow it (see [`Stratum::apart`]).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stratum {
    /// The object, for tables by object.
    pub object: u32,
    /// The material. Strata of the same material borrow from each other first.
    pub material: u32,
    /// Expected cost of one pixel before anything is measured, relative to a plain diffuse pixel (1). It only
    /// steers where samples go, for example to glass rather than walls. No estimate depends on it otherwise.
    pub prior_cost: f64,
    /// Whether it consists of other things than pixels, such as cache records, of known number. It is never
    /// joined with another stratum, and borrows only from such strata of its material.
    #[serde(default)]
    pub apart: bool,
}

impl Stratum {
    /// The background, with the [`prior_cost`](Self::prior_cost) of its pixels.
    pub const fn background(prior_cost: f64) -> Self {
        Self { object: u32::MAX, material: u32::MAX, prior_cost, apart: false }
    }

    /// Pixels at the edges of lights: their own stratum for the error of an image, not for its cost. Such an
    /// edge may contribute more error than the rest of the image.
    pub const fn edges_of_lights() -> Self {
        Self { object: u32::MAX, material: u32::MAX - 2, prior_cost: 1.0, apart: false }
    }

    /// One stratum per level of an irradiance cache. Objects are numbered downwards from the background's.
    pub fn of_records(levels: usize, prior_cost: f64) -> impl Iterator<Item = Self> {
        (0..levels as u32).map(move |level| Self {
            object: u32::MAX - 1 - level,
            material: u32::MAX - 1,
            prior_cost,
            apart: true,
        })
    }
}

/// Least number of samples of a group by its share of the expected cost. Smaller groups are joined.
const LEAST_DESERVED_SAMPLES: f64 = 0.5;

/// Average samples per group. With this, the floor of two needs no more than half of the samples.
const SAMPLES_PER_GROUP: u64 = 4;

/// Strata joined into groups that can have two samples or more each.
///
/// Guessing the cost of unsampled small strata would cause a hidden bias. Sampling the small strata *of one
/// material together*, each pixel with the same probability, causes none (collapsed strata: Cochran 1977,
/// section 5A.12). The grouping never depends on measured costs, so the estimate finds the same groups as the
/// design.
#[derive(Clone, Debug)]
pub(crate) struct Grouping {
    /// Group of each stratum. `None` for strata without pixels.
    pub of: Vec<Option<usize>>,
    pub groups: Vec<Group>,
}

#[derive(Clone, Debug)]
pub(crate) struct Group {
    pub pixels: u64,
    /// The material, if all strata share it.
    pub material: Option<u32>,
    /// Expected cost of all pixels, in the unit of the prior costs.
    pub weight: f64,
    /// Whether it is a stratum that stands apart ([`Stratum::apart`]). Such groups are last.
    pub apart: bool,
}

/// Checks the prior costs of the strata and the number of a frame's counts.
pub(crate) fn check(strata: &[Stratum], frame: i64, counts: &[u32]) -> Result<(), ForecastError> {
    if let Some(stratum) = strata.iter().position(|s| !(s.prior_cost.is_finite() && s.prior_cost > 0.0)) {
        return Err(ForecastError::BadPriorCost { stratum });
    }
    if counts.len() != strata.len() {
        return Err(ForecastError::CountsLength { frame, counts: counts.len(), strata: strata.len() });
    }
    Ok(())
}

impl Grouping {
    /// Groups the strata of a frame with `counts` pixels each, for `samples` samples of pixels.
    pub fn new(strata: &[Stratum], counts: &[u32], samples: u64) -> Self {
        let of_pixels = || strata.iter().zip(counts).filter(|(s, _)| !s.apart);
        let pixels: u64 = of_pixels().map(|(_, &n)| u64::from(n)).sum();
        let samples = samples.min(pixels).max(1);
        let weights: Vec<f64> =
            strata.iter().zip(counts).map(|(s, &n)| f64::from(n) * s.prior_cost).collect();
        let total: f64 = of_pixels().map(|(s, &n)| f64::from(n) * s.prior_cost).sum();
        let most = (samples / SAMPLES_PER_GROUP).max(1) as usize;
        let mut share = LEAST_DESERVED_SAMPLES / samples as f64;
        let mut grouping = loop {
            let grouping = Self::with_least_weight(strata, counts, &weights, share * total);
            // Ends, because with a share above one everything is in one group.
            if grouping.groups.len() <= most || share > 1.0 {
                break grouping;
            }
            share *= 1.5;
        };
        for h in (0..strata.len()).filter(|&h| strata[h].apart && counts[h] > 0) {
            grouping.join(&[h], strata, counts, &weights);
        }
        grouping
    }

    /// Makes every stratum with pixels a group of its own.
    pub fn of_each(strata: &[Stratum], counts: &[u32]) -> Self {
        let weights: Vec<f64> =
            strata.iter().zip(counts).map(|(s, &n)| f64::from(n) * s.prior_cost).collect();
        let mut grouping = Grouping { of: vec![None; strata.len()], groups: Vec::new() };
        for apart in [false, true] {
            for h in (0..strata.len()).filter(|&h| strata[h].apart == apart && counts[h] > 0) {
                grouping.join(&[h], strata, counts, &weights);
            }
        }
        grouping
    }

    /// Strata of pixels with at least the weight `least` are groups of their own. The rest are joined by
    /// material; materials that are still too light form one last group.
    fn with_least_weight(strata: &[Stratum], counts: &[u32], weights: &[f64], least: f64) -> Self {
        let mut grouping = Grouping { of: vec![None; strata.len()], groups: Vec::new() };
        let small: Vec<usize> = (0..strata.len()).filter(|&h| !strata[h].apart && counts[h] > 0).collect();
        let (alone, small): (Vec<_>, Vec<_>) = small.into_iter().partition(|&h| weights[h] >= least);
        for h in alone {
            grouping.join(&[h], strata, counts, weights);
        }
        let mut materials: Vec<u32> = small.iter().map(|&h| strata[h].material).collect();
        materials.sort_unstable();
        materials.dedup();
        let mut rest = Vec::new();
        for material in materials {
            let members: Vec<usize> =
                small.iter().copied().filter(|&h| strata[h].material == material).collect();
            if members.iter().map(|&h| weights[h]).sum::<f64>() >= least {
                grouping.join(&members, strata, counts, weights);
            } else {
                rest.extend(members);
            }
        }
        if !rest.is_empty() {
            grouping.join(&rest, strata, counts, weights);
        }
        grouping
    }

    fn join(&mut self, members: &[usize], strata: &[Stratum], counts: &[u32], weights: &[f64]) {
        let material = strata[members[0]].material;
        for &h in members {
            self.of[h] = Some(self.groups.len());
        }
        self.groups.push(Group {
            pixels: members.iter().map(|&h| u64::from(counts[h])).sum(),
            material: members.iter().all(|&h| strata[h].material == material).then_some(material),
            weight: members.iter().map(|&h| weights[h]).sum(),
            apart: strata[members[0]].apart,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::{Grouping, Stratum};

    fn stratum(material: u32) -> Stratum {
        Stratum { object: 0, material, prior_cost: 1.0, apart: false }
    }

    #[test]
    fn large_strata_stand_alone_and_small_ones_join_by_material() {
        let strata = [stratum(0), stratum(1), stratum(1), stratum(2), stratum(3), stratum(0)];
        let counts = [60_000, 100, 100, 5, 3, 0];
        let grouping = Grouping::new(&strata, &counts, 256);
        assert_eq!(grouping.of, [Some(0), Some(1), Some(1), Some(2), Some(2), None]);
        assert_eq!(grouping.groups[1].material, Some(1));
        assert_eq!(grouping.groups[2].material, None);
        assert_eq!(grouping.groups.iter().map(|g| g.pixels).sum::<u64>(), 60_208);
    }

    #[test]
    fn strata_that_stand_apart_change_nothing_in_how_pixels_are_grouped() {
        let mut strata: Vec<Stratum> = (0..60).map(|i| stratum(i % 9)).collect();
        let mut counts: Vec<u32> = (0..60).map(|i| 1 + i * i % 97).collect();
        let without = Grouping::new(&strata, &counts, 100);
        strata.extend(Stratum::of_records(3, 500.0));
        counts.extend([100_000, 0, 3]);
        let with = Grouping::new(&strata, &counts, 100);
        let pixels = without.groups.len();
        assert_eq!(with.of[..60], without.of);
        assert_eq!(with.of[60..], [Some(pixels), None, Some(pixels + 1)]);
        assert!(with.groups[..pixels].iter().all(|group| !group.apart));
        let apart: Vec<u64> = with.groups[pixels..].iter().filter(|g| g.apart).map(|g| g.pixels).collect();
        assert_eq!(apart, [100_000, 3]);
    }

    #[test]
    fn there_are_never_more_groups_than_a_quarter_of_the_samples() {
        let strata: Vec<Stratum> = (0..1000).map(|i| stratum(i % 300)).collect();
        let counts: Vec<u32> = (0..1000).map(|i| 1 + i % 97).collect();
        for samples in [0, 1, 3, 4, 8, 64, 256, 4096] {
            let grouping = Grouping::new(&strata, &counts, samples);
            assert!(grouping.groups.len() as u64 <= (samples / 4).max(1), "{samples} samples");
            assert!(grouping.of.iter().all(Option::is_some));
        }
    }
}
