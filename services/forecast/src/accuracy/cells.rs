//! Which sampled pixels stand for which pixels of an image.
//!
//! Some pixels are *profiled*, with many camera samples. Many others may be *scanned*, with their first few. A
//! small part of an image may hold most of its error: 1 % of the pixels held 77 % in one room. Few profiled
//! pixels meet such a part by chance alone. The same number of camera samples, spread over more pixels, finds
//! it.
//!
//! A scan shows the first drops alone. The later ones are taken to be in proportion, as in the profiled pixels
//! (double sampling with a ratio estimator: Cochran, *Sampling Techniques*, 3rd edition 1977, section 12.8).

use serde::{Deserialize, Serialize};

use super::PixelNoise;
use crate::error::ForecastError;
use crate::moments::sum;
use crate::strata::Stratum;

/// A profiled or scanned pixel with the statistics of its camera samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseSample {
    /// Index of the pixel's stratum.
    pub stratum: u32,
    /// Statistics of its camera samples.
    pub noise: PixelNoise,
}

/// A set of pixels and the sampled ones among them. Each was equally likely to be sampled, or values are weighted
/// ([`NoiseGroup::cells`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseCell {
    /// Number of pixels in the set.
    pub pixels: u64,
    /// The sampled pixels.
    pub samples: Vec<PixelNoise>,
}

/// Strata that are estimated together, and the samples that stand for them.
#[derive(Clone, Debug, PartialEq)]
pub struct NoiseGroup {
    /// Indices of the strata. Each has at least one pixel in the image.
    pub strata: Vec<usize>,
    /// Indices of the profiled pixels: those of the strata, or all if these have fewer than two.
    pub samples: Vec<usize>,
    /// One cell of profiled pixels or, where pixels were scanned, one of profiled and one of scanned pixels, for
    /// half of the group's pixels each. Values of these are weighted: the mean of both cells is the estimate. A
    /// scattered pixel counts as a scanned one for brightness and first drops. Later drops rest on all profiled
    /// pixels alone, and so does their uncertainty.
    pub cells: Vec<NoiseCell>,
}

/// Pixels of an image whose noise was measured.
#[derive(Clone, Copy, Debug)]
pub struct Sampled<'a> {
    /// Profiled pixels, all with the same number of camera samples.
    pub profiled: &'a [NoiseSample],
    /// The first of them, this many, are scattered over their strata. The others may lie where pixels are dear.
    pub scattered: usize,
    /// Scanned pixels, all with the same number of camera samples, and at least two. There may be none.
    pub scanned: &'a [NoiseSample],
}

impl Sampled<'_> {
    /// Groups the strata of an image so that every group has at least two profiled pixels where possible.
    /// `counts[h]` is the number of pixels of stratum h. Strata with fewer samples are joined by material,
    /// then into one last group, which may use all samples.
    ///
    /// # Errors
    /// If the lengths of `strata` and `counts` differ, a sample names an unknown stratum, or no pixel was
    /// profiled.
    pub fn groups(self, strata: &[Stratum], counts: &[u32]) -> Result<Vec<NoiseGroup>, ForecastError> {
        if counts.len() != strata.len() {
            return Err(ForecastError::CountsLength { frame: 0, counts: counts.len(), strata: strata.len() });
        }
        if self.profiled.is_empty() {
            return Err(ForecastError::NoSamples);
        }
        let [own, scanned] =
            [by_stratum(self.profiled, strata.len())?, by_stratum(self.scanned, strata.len())?];
        let of = |all: &[Vec<usize>], members: &[usize]| -> Vec<usize> {
            members.iter().flat_map(|&h| all[h].iter().copied()).collect()
        };
        let join = |members: &[usize]| Joined {
            strata: members.to_vec(),
            samples: of(&own, members),
            scanned: of(&scanned, members),
        };
        let shown: Vec<usize> = (0..strata.len()).filter(|&h| counts[h] > 0).collect();
        let (alone, few): (Vec<_>, Vec<_>) = shown.into_iter().partition(|&h| own[h].len() >= 2);
        let mut groups: Vec<Joined> = alone.iter().map(|&h| join(&[h])).collect();
        let mut materials: Vec<u32> = few.iter().map(|&h| strata[h].material).collect();
        materials.sort_unstable();
        materials.dedup();
        let mut rest = Vec::new();
        for material in materials {
            let members: Vec<usize> =
                few.iter().copied().filter(|&h| strata[h].material == material).collect();
            let group = join(&members);
            if group.samples.len() >= 2 { groups.push(group) } else { rest.extend(members) }
        }
        if !rest.is_empty() {
            let mut group = join(&rest);
            if group.samples.len() < 2 {
                group.samples = (0..self.profiled.len()).collect();
            }
            groups.push(group);
        }
        Ok(self.with_cells(groups, counts))
    }

    fn with_cells(self, groups: Vec<Joined>, counts: &[u32]) -> Vec<NoiseGroup> {
        let of_group = |group: &Joined| {
            let is_scattered =
                |i: usize| i < self.scattered && group.strata.contains(&(self.profiled[i].stratum as usize));
            Phases {
                pixels: group.strata.iter().map(|&h| u64::from(counts[h])).sum(),
                scattered: group.samples.iter().map(|&i| is_scattered(i)).collect(),
                profiled: group.samples.iter().map(|&i| self.profiled[i].noise.clone()).collect(),
                scanned: group.scanned.iter().map(|&i| self.scanned[i].noise.clone()).collect(),
            }
        };
        let phases: Vec<Phases> = groups.iter().map(of_group).collect();
        let seen = self.scanned.iter().map(|pixel| pixel.noise.drops.len()).min().unwrap_or(0);
        let total =
            |of: &dyn Fn(&Phases) -> f64| sum(phases.iter().map(|group| group.pixels as f64 * of(group)));
        let profiled = total(&|group| mean(group.profiled.iter().map(|pixel| first_drops(pixel, seen))));
        let ratio = if profiled > 0.0 { total(&|group| group.first_drops(seen)) / profiled } else { 1.0 };
        let whole = |(group, phases): (Joined, Phases)| NoiseGroup {
            strata: group.strata,
            samples: group.samples,
            cells: phases.cells(seen, ratio),
        };
        groups.into_iter().zip(phases).map(whole).collect()
    }
}

/// The strata of a group, and the indices of its profiled and its scanned pixels.
struct Joined {
    strata: Vec<usize>,
    samples: Vec<usize>,
    scanned: Vec<usize>,
}

/// The pixels of a group by how they were sampled.
struct Phases {
    pixels: u64,
    profiled: Vec<PixelNoise>,
    /// For each profiled pixel, whether it shows the group and is scattered.
    scattered: Vec<bool>,
    scanned: Vec<PixelNoise>,
}

impl Phases {
    /// Whether there is a cell of scanned pixels. A single pixel has no halves.
    fn is_shared(&self) -> bool {
        !self.scanned.is_empty() && self.pixels > 1
    }

    /// Weight of a scattered or scanned pixel in their mean.
    fn weight(&self) -> f64 {
        let scattered = self.scattered.iter().filter(|is| **is).count();
        1.0 / (scattered + self.scanned.len()) as f64
    }

    /// Mean of [`first_drops`] over scattered and scanned pixels or, without a scan, over all.
    fn first_drops(&self, seen: usize) -> f64 {
        let of = |pixel| first_drops(pixel, seen);
        if !self.is_shared() {
            return mean(self.profiled.iter().map(of));
        }
        let scattered = self.profiled.iter().zip(&self.scattered).filter(|(_, is)| **is);
        mean(scattered.map(|(pixel, _)| pixel).chain(&self.scanned).map(of))
    }

    fn cells(mut self, seen: usize, ratio: f64) -> Vec<NoiseCell> {
        let (is_shared, weight) = (self.is_shared(), self.weight());
        let levels = self.profiled.iter().map(|pixel| pixel.drops.len()).min().unwrap_or(0);
        let of_scan = if is_shared { self.pixels / 2 } else { 0 };
        let of_profile = self.pixels - of_scan;
        // A cell's mean counts as its share of the pixels.
        let all = |pixels: u64| self.pixels as f64 / pixels.max(1) as f64;
        let (profiled, scanned) = (all(of_profile), all(of_scan));
        let count = self.profiled.len() as f64;
        for (pixel, is_scattered) in self.profiled.iter_mut().zip(&self.scattered) {
            let first = match (is_shared, is_scattered) {
                (false, _) => 1.0,
                (true, true) => profiled * weight * count,
                (true, false) => 0.0,
            };
            pixel.brightness *= first;
            pixel.bias_square *= profiled;
            for (k, drop) in pixel.drops.iter_mut().enumerate() {
                *drop *= if k < seen { first } else { profiled * ratio };
            }
        }
        let first = scanned * weight * self.scanned.len() as f64;
        for pixel in &mut self.scanned {
            pixel.brightness *= first;
            pixel.drops.iter_mut().for_each(|drop| *drop *= first);
            pixel.drops.resize(levels, 0.0);
        }
        let cells = [(of_profile, self.profiled), (of_scan, self.scanned)];
        let cell = |(pixels, samples)| NoiseCell { pixels, samples };
        cells.into_iter().filter(|(pixels, _)| *pixels > 0).map(cell).collect()
    }
}

/// Sum of the first `seen` drops of a pixel. Each counts as much as the first if samples are independent.
fn first_drops(pixel: &PixelNoise, seen: usize) -> f64 {
    let first = pixel.drops.iter().take(seen).enumerate();
    sum(first.map(|(k, drop)| drop * libm::exp2(k as f64)))
}

/// 0 without values.
fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    sum(values.iter().copied()) / values.len().max(1) as f64
}

/// The indices of samples, by stratum.
fn by_stratum(samples: &[NoiseSample], strata: usize) -> Result<Vec<Vec<usize>>, ForecastError> {
    let mut all: Vec<Vec<usize>> = vec![Vec::new(); strata];
    for (index, NoiseSample { stratum, .. }) in samples.iter().enumerate() {
        let unknown = ForecastError::UnknownStratum { stratum: *stratum, strata };
        all.get_mut(*stratum as usize).ok_or(unknown)?.push(index);
    }
    Ok(all)
}
