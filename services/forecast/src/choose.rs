//! Which pixels of a frame to profile.

use serde::{Deserialize, Serialize};

use crate::allocate::{Cell, allocate};
use crate::cost::{Observation, WORK};
use crate::curve::{hilbert, order_for};
use crate::error::ForecastError;
use crate::moments::Moments;
use crate::random::{GOLDEN_STEP, hash};
use crate::strata::{Grouping, Stratum, check};

/// A pixel to profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pick {
    /// Index of the pixel in row order.
    pub pixel: u32,
    /// What the preview sees there.
    pub stratum: u32,
}

/// Least number of samples in each group: two give a variance.
const FLOOR: u64 = 2;

/// Degrees of freedom at which a material's own spread counts as much as the spread of everything.
const HALF_TRUSTED_FREEDOM: f64 = 8.0;

/// The sampling design of one frame, in two phases.
///
/// Each group of strata has its pixels in the order of a Hilbert curve, strata of a joined group one after
/// the other. The group's picks are the terms of a Kronecker sequence along that order: place i is the
/// fraction (u + i φ) mod 1, with the golden ratio φ and a start u drawn from the seed, the frame and the
/// group. Three things follow.
///
/// * Every single pick falls on every pixel with the same probability (u is uniform), so the mean of a fixed
///   number of picks is unbiased.
/// * Every prefix of the sequence is spread evenly (three-distance theorem), so the picks of the second phase
///   fall into the gaps that the first one left, whatever their number turns out to be, and the two phases
///   together work like one systematic sample.
/// * A pixel that comes up again is passed over, so none is picked twice, and a full sample is every pixel
///   once.
///
/// The one bias is that the *number* of picks of a group depends on the costs seen in its first phase:
/// pooling both phases gives a first phase that saw a costly pixel less weight. Half of the samples go to the
/// first phase, by expected cost, and the second goes by shrunk spreads of materials, which keeps this small;
/// a test on synthetic populations measures it.
#[derive(Clone, Debug)]
pub struct FrameDesign {
    counts: Vec<u32>,
    stratum_ids: Vec<u32>,
    grouping: Grouping,
    /// Pixels of each group in the order of the curve.
    orders: Vec<Vec<u32>>,
    starts: Vec<u64>,
    first: Vec<u64>,
    samples: u64,
}

impl FrameDesign {
    /// A design of `samples` picks (or all pixels, if these are fewer) for a frame whose preview shows stratum
    /// `stratum_ids[pixel]`, in rows of `width` pixels.
    ///
    /// Strata that stand apart have no pixels and change nothing.
    ///
    /// # Errors
    /// If an id has no stratum, the pixels are not whole rows, or a prior cost is not positive.
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

    /// Pixels of each stratum, N_h.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// The first picks: two in each group, then in proportion to expected cost, up to half of all samples.
    pub fn first_phase(&self) -> Vec<Pick> {
        self.picks(&vec![0; self.first.len()], &self.first)
    }

    /// The other picks, placed by what the first ones cost in work (observations may come in any order).
    ///
    /// The spread of a group is taken as S_material^λ S_all^(1−λ) with λ = ν / (ν + 8), where ν are the
    /// degrees of freedom behind the material's: two values alone say little about a spread, and a group
    /// whose own few picks decide how many more it gets is biased (see the type's documentation).
    ///
    /// # Errors
    /// If an observation names an unknown stratum.
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

    /// Terms `from` to `to` of each group's sequence.
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

/// Pixels of each stratum of an image; checks what every design needs.
///
/// # Errors
/// As of [`FrameDesign::new`].
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

/// The first `wanted` distinct places among `size` of the Kronecker sequence that starts at `start` (all in
/// units of 2^-64 of the whole order, so that nothing is rounded).
fn distinct_places(start: u64, size: usize, wanted: usize) -> Vec<usize> {
    let mut taken = vec![false; size];
    let mut places = Vec::with_capacity(wanted);
    let mut fraction = start;
    // The gaps of n terms are below 3 / n, so 3 · size terms reach every place.
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

/// The pooled coefficient of variation √( Σ (n−1) s² / Σ (n−1) ȳ² ) of all groups of two or more picks, times
/// the mean of all these picks. Zero where there is no such group.
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
