//! Chooses which pixels of a frame to profile, in two phases: half of the samples by expected cost, the rest
//! by the spread of measured costs. Within a group of strata, pixels are picked evenly along a Hilbert curve.

use serde::{Deserialize, Serialize};

use crate::allocate::{Cell, allocate};
use crate::cost::{Observation, WORK};
use crate::error::ForecastError;
use crate::hilbert::{hilbert, order_for};
use crate::moments::Moments;
use crate::random::{GOLDEN_STEP, hash};
use crate::strata::{Grouping, Stratum, check};

/// A pixel to profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pick {
    /// Index of the pixel in row order.
    pub pixel: u32,
    /// Index of the stratum that the preview shows there.
    pub stratum: u32,
}

/// Least number of samples in each group. Two are needed for a variance.
const FLOOR: u64 = 2;

/// Degrees of freedom at which a material's own spread gets the same weight as the overall spread.
const HALF_TRUSTED_FREEDOM: f64 = 8.0;

/// The sampling design of one frame, in two phases.
///
/// Pixels of each group of strata are ordered along a Hilbert curve; joined strata follow one another. Pick i
/// of a group is at the fraction (u + i φ) mod 1 of that order (Kronecker sequence). φ is the golden ratio; u
/// is drawn from seed, frame and group.
///
/// * Every pick hits each pixel with the same probability, so the mean of a fixed number of picks is
///   unbiased.
/// * Every prefix is spread evenly (three-distance theorem), so both phases work like one systematic sample.
/// * A pixel that was picked before is skipped, so a full sample is every pixel once.
///
/// One bias remains: the *number* of picks of a group depends on the costs in its first phase. It is small
/// because half of the samples go by expected cost, and the second phase by spreads of materials, shrunk
/// towards the overall spread. A test on synthetic populations measures it.
#[derive(Clone, Debug)]
pub struct FrameDesign {
    counts: Vec<u32>,
    stratum_ids: Vec<u32>,
    grouping: Grouping,
    /// Pixels of each group, in the order of the curve.
    orders: Vec<Vec<u32>>,
    starts: Vec<u64>,
    first: Vec<u64>,
    samples: u64,
}

impl FrameDesign {
    /// A design of `samples` picks for a frame whose preview shows stratum `stratum_ids[pixel]`, in rows of
    /// `width` pixels. With fewer pixels, all are picked. Strata without pixels get no picks.
    ///
    /// # Errors
    /// If an id has no stratum, the pixels do not fill whole rows, or a prior cost is not positive and
    /// finite.
    pub fn new(
        strata: &[Stratum],
        stratum_ids: &[u32],
        width: u32,
        samples: u32,
        seed: u64,
        frame: i64,
    ) -> Result<Self, ForecastError> {
        let counts = count_pixels(strata, stratum_ids, width, frame)?;
        let height = stratum_ids.len() as u32 / width;
        let samples = u64::from(samples).min(stratum_ids.len() as u64);
        let grouping = Grouping::new(strata, &counts, samples);

        let order = order_for(width, height);
        let mut keyed: Vec<Vec<(u32, u64, u32)>> = vec![Vec::new(); grouping.groups.len()];
        for (pixel, &stratum) in (0u32..).zip(stratum_ids) {
            if let Some(group) = grouping.of[stratum as usize] {
                keyed[group].push((stratum, hilbert(order, pixel % width, pixel / width), pixel));
            }
        }
        let orders = keyed
            .into_iter()
            .map(|mut pixels| {
                pixels.sort_unstable();
                pixels.into_iter().map(|(_, _, pixel)| pixel).collect()
            })
            .collect();
        let starts = (0..grouping.groups.len() as u64)
            .map(|group| hash(&[seed, frame.cast_unsigned(), group]))
            .collect();

        let cells: Vec<Cell> = grouping
            .groups
            .iter()
            .map(|g| Cell { size: g.pixels, spread: g.weight / g.pixels as f64, floor: FLOOR })
            .collect();
        let floors: u64 = grouping.groups.iter().map(|g| FLOOR.min(g.pixels)).sum();
        let first = allocate(&cells, samples.div_ceil(2).max(floors).min(samples));
        Ok(FrameDesign {
            counts,
            stratum_ids: stratum_ids.to_vec(),
            grouping,
            orders,
            starts,
            first,
            samples,
        })
    }

    /// Number of pixels of each stratum, N_h.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Picks of the first phase: two per group, then by expected cost. Half of the samples, or the floors.
    pub fn first_phase(&self) -> Vec<Pick> {
        self.picks(&vec![0; self.first.len()], &self.first)
    }

    /// The picks of the second phase, by the work that the first picks cost, in any order.
    ///
    /// The spread of a group is S_material^λ S_all^(1−λ) with λ = ν / (ν + 8), with ν degrees of freedom of
    /// the material's spread. A group's own spread would bias the estimate (see [`FrameDesign`]).
    ///
    /// # Errors
    /// [`ForecastError::UnknownStratum`] if an observation names a stratum that the frame does not show.
    pub fn second_phase(&self, first: &[Observation]) -> Result<Vec<Pick>, ForecastError> {
        let mut moments = vec![Moments::default(); self.grouping.groups.len()];
        for observation in first {
            let stratum = observation.stratum;
            let group = self
                .grouping
                .of
                .get(stratum as usize)
                .copied()
                .flatten()
                .ok_or(ForecastError::UnknownStratum { stratum, strata: self.grouping.of.len() })?;
            moments[group].push(&observation.cost);
        }
        let pooled = |material: Option<u32>| {
            let alike = self.grouping.groups.iter().zip(&moments);
            let alike = alike.filter(|(group, _)| material.is_none() || group.material == material);
            pooled_spread(alike.map(|(_, moments)| moments))
        };
        let overall = pooled(None);
        let cells: Vec<Cell> = (0..moments.len())
            .map(|g| {
                let group = &self.grouping.groups[g];
                let own = group.material.map_or(Spread::default(), |material| pooled(Some(material)));
                let trust = own.freedom / (own.freedom + HALF_TRUSTED_FREEDOM);
                let spread = libm::pow(own.deviation, trust) * libm::pow(overall.deviation, 1.0 - trust);
                Cell { size: group.pixels, spread, floor: self.first[g] }
            })
            .collect();
        Ok(self.picks(&self.first, &allocate(&cells, self.samples)))
    }

    /// Terms `from[g]` to `to[g]` of the sequence of each group g.
    fn picks(&self, from: &[u64], to: &[u64]) -> Vec<Pick> {
        let mut picks = Vec::new();
        for (group, order) in self.orders.iter().enumerate() {
            let (from, to) = (from[group] as usize, to[group] as usize);
            let places = distinct_places(self.starts[group], order.len(), to);
            picks.extend(places.into_iter().skip(from).map(|place| {
                let pixel = order[place];
                Pick { pixel, stratum: self.stratum_ids[pixel as usize] }
            }));
        }
        picks
    }
}

/// Number of pixels of each stratum of an image. Errors as for [`FrameDesign::new`].
pub(crate) fn count_pixels(
    strata: &[Stratum],
    stratum_ids: &[u32],
    width: u32,
    frame: i64,
) -> Result<Vec<u32>, ForecastError> {
    let row = usize::try_from(width).unwrap_or(usize::MAX);
    if stratum_ids.len() > u32::MAX as usize || row == 0 || !stratum_ids.len().is_multiple_of(row) {
        return Err(ForecastError::ImageShape { pixels: stratum_ids.len(), width });
    }
    let mut counts = vec![0u32; strata.len()];
    for &stratum in stratum_ids {
        *counts
            .get_mut(stratum as usize)
            .ok_or(ForecastError::UnknownStratum { stratum, strata: strata.len() })? += 1;
    }
    check(strata, frame, &counts)?;
    Ok(counts)
}

/// The first `wanted` distinct places, out of `size`, of the Kronecker sequence from `start`. Fractions are
/// in units of 2^−64, so nothing is rounded.
fn distinct_places(start: u64, size: usize, wanted: usize) -> Vec<usize> {
    let mut taken = vec![false; size];
    let mut places = Vec::with_capacity(wanted);
    let mut fraction = start;
    // The gaps between n terms are below 3 / n, so 3 · size terms reach every place.
    for _ in 0..3 * size {
        if places.len() >= wanted {
            break;
        }
        let place = ((u128::from(fraction) * size as u128) >> 64) as usize;
        if !std::mem::replace(&mut taken[place], true) {
            places.push(place);
        }
        fraction = fraction.wrapping_add(GOLDEN_STEP);
    }
    places
}

/// A standard deviation pooled over groups.
#[derive(Clone, Copy, Debug, Default)]
struct Spread {
    deviation: f64,
    freedom: f64,
}

/// The pooled coefficient of variation √( Σ (n−1) s² / Σ (n−1) ȳ² ) over all groups with two or more picks,
/// times the mean of all their picks. Zero if there is no such group.
fn pooled_spread<'a>(moments: impl Iterator<Item = &'a Moments>) -> Spread {
    let (mut deviations, mut squares, mut freedom) = (0.0, 0.0, 0.0);
    let mut all = Moments::default();
    for m in moments.filter(|m| m.count >= 2) {
        let own = (m.count - 1) as f64;
        deviations += m.deviations(WORK);
        squares += own * m.mean(WORK) * m.mean(WORK);
        freedom += own;
        all.merge(m);
    }
    let deviation = if squares > 0.0 { libm::sqrt(deviations / squares) * all.mean(WORK) } else { 0.0 };
    Spread { deviation, freedom }
}

#[cfg(test)]
mod tests {
    use super::distinct_places;

    #[test]
    fn a_full_sequence_is_a_permutation_for_any_size() {
        for size in 1..600 {
            let mut places = distinct_places((size as u64).wrapping_mul(0x1234_5678_9abc_def1), size, size);
            assert_eq!(places.len(), size);
            places.sort_unstable();
            assert!(places.into_iter().eq(0..size));
        }
    }

    #[test]
    fn a_later_phase_continues_the_sequence_of_the_first() {
        let all = distinct_places(99, 1000, 40);
        assert_eq!(distinct_places(99, 1000, 7), all[..7]);
    }

    #[test]
    fn every_prefix_is_spread_evenly() {
        for wanted in [2usize, 5, 17, 100] {
            let mut places = distinct_places(u64::MAX / 3, 10_000, wanted);
            places.sort_unstable();
            let widest = places.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(0);
            assert!(widest < 3 * 10_000 / wanted, "{wanted} places leave a gap of {widest}");
        }
    }
}
