//! Parts of a frame that are forecast to cost the same.
//!
//! A part is a range of pixels along a curve ([`PixelCurve`]). One pixel of every *run* of pixels is probed with one
//! camera sample ([`probes`]), and stands for the others. [`parts_of_equal_cost`] cuts where the sum of the
//! runs passes a multiple of its share.

mod curve;

pub use curve::PixelCurve;

use crate::random::{below, hash};

/// A run of pixels along the curve, and the one that stands for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Probe {
    /// First place.
    pub from: u32,
    /// Place after the last.
    pub to: u32,
    /// Place of the pixel to trace. Each place of the run is equally likely.
    pub at: u32,
}

/// At least this many samples for each part, and at most this share of the frame's samples.
const LEAST_OF_PART: u64 = 16;
const MOST_OF_FRAME: f64 = 1.0 / 64.0;

/// Number of camera samples to trace before a frame of `samples` camera samples is divided into parts.
///
/// Probing n of S samples delays the frame by n / S of its cost. The longest of P parts then takes 1 / P, and
/// about a √(P / n) of that longer. The sum is least for n = (a S / 2 √P)^⅔. Measured on seven scenes with
/// three integrators, a is 0.3 to 0.8, and 1.4 where a few objects are dear. As nodes wait for the longest
/// part, a = 2 is used.
pub fn probing_samples(samples: u64, parts: u32) -> u64 {
    let best = libm::cbrt((samples as f64).powi(2) / f64::from(parts.max(1))) as u64;
    let most = (samples as f64 * MOST_OF_FRAME) as u64;
    best.max(LEAST_OF_PART * u64::from(parts)).min(most).max(u64::from(parts)).max(1)
}

/// About `count` runs that cover `pixels` places. Their lengths differ by at most one.
pub fn probes(pixels: u32, count: u32, seed: u64) -> Vec<Probe> {
    let count = count.clamp(1, pixels.max(1));
    let cut = |at: u32| (u64::from(pixels) * u64::from(at) / u64::from(count)) as u32;
    let probe = |run: u32| {
        let (from, to) = (cut(run), cut(run + 1));
        let inside = below(hash(&[seed, u64::from(run)]), u64::from(to - from)) as u32;
        Probe { from, to, at: from + inside }
    };
    (0..count).map(probe).filter(|probe| probe.to > probe.from).collect()
}

/// The end of a run or a part, and its cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stretch {
    /// Place after its last pixel. It begins where the one before ends.
    pub to: u32,
    /// Its cost in any unit.
    pub cost: u64,
}

/// Divides runs, in their order, into parts of equal cost. The cost of a run is spread evenly over its pixels.
/// Every part has at least one pixel while there are enough, and the last ends with the last run.
pub fn parts_of_equal_cost(runs: &[Stretch], parts: u32) -> Vec<Stretch> {
    let sums = Sums::of(runs);
    let (pixels, total) = (runs.last().map_or(0, |run| run.to), sums.before[runs.len()]);
    let mut start = 0;
    let mut end_of = |part: u32| {
        let wanted = match total {
            // Nothing is known of the costs: equal areas.
            0 => (u64::from(pixels) * u64::from(part) / u64::from(parts)) as u32,
            total => sums.place_of(total * u128::from(part) / u128::from(parts)),
        };
        // One pixel at least for each part that follows.
        let last = pixels.saturating_sub(parts - part);
        start = wanted.max(start + 1).min(last.max(start));
        start
    };
    let mut spent = 0;
    (1..=parts)
        .map(|part| {
            let to = if part == parts { pixels } else { end_of(part) };
            let sum = sums.cost_before(to);
            let cost = sum - std::mem::replace(&mut spent, sum);
            Stretch { to, cost: u64::try_from(cost).unwrap_or(u64::MAX) }
        })
        .collect()
}

/// Running sums of the costs of runs.
struct Sums<'a> {
    runs: &'a [Stretch],
    /// Cost before each run, and of all.
    before: Vec<u128>,
}

impl<'a> Sums<'a> {
    fn of(runs: &'a [Stretch]) -> Self {
        let mut sum = 0;
        let sums = runs.iter().map(|run| {
            sum += u128::from(run.cost);
            sum
        });
        Self { runs, before: std::iter::once(0).chain(sums).collect() }
    }

    fn start(&self, run: usize) -> u32 {
        run.checked_sub(1).map_or(0, |before| self.runs[before].to)
    }

    /// The cost of all places before this one.
    fn cost_before(&self, place: u32) -> u128 {
        let run = self.runs.partition_point(|run| run.to <= place);
        let Some(&Stretch { to, cost }) = self.runs.get(run) else { return self.before[run] };
        let from = self.start(run);
        self.before[run] + u128::from(cost) * u128::from(place - from) / u128::from(to - from)
    }

    /// The place before which everything costs this much.
    fn place_of(&self, wanted: u128) -> u32 {
        let run = self.before[1..].partition_point(|&sum| sum < wanted);
        let Some(&Stretch { to, cost }) = self.runs.get(run) else { return self.start(run) };
        let (from, rest) = (self.start(run), wanted - self.before[run]);
        let cost = u128::from(cost).max(1);
        from + ((rest * u128::from(to - from) + cost / 2) / cost) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn runs_cover_all_places_once_and_are_as_many_as_asked_for() {
        for (pixels, count) in [(1, 1), (1, 9), (100, 7), (1000, 1000), (5, 0), (921_600, 14_400)] {
            let probes = probes(pixels, count, 3);
            assert_eq!(probes.len() as u32, count.clamp(1, pixels));
            let mut end = 0;
            for probe in &probes {
                assert!(probe.from == end && (probe.from..probe.to).contains(&probe.at), "{probe:?}");
                end = probe.to;
            }
            assert_eq!(end, pixels);
        }
        assert!(probes(0, 4, 3).is_empty());
        assert_ne!(probes(1000, 10, 3), probes(1000, 10, 4));
    }

    #[test]
    fn a_small_share_of_a_frame_is_probed_and_more_of_it_for_few_parts() {
        let share = |samples, parts| probing_samples(samples, parts) as f64 / samples as f64;
        assert!((0.002..0.003).contains(&share(1280 * 720 * 8, 8)));
        assert!((0.001..0.0015).contains(&share(1280 * 720 * 8, 64)));
        assert_eq!(share(32 * 24 * 2, 2), 1.0 / 64.0);
        assert_eq!([probing_samples(4, 2), probing_samples(0, 1), probing_samples(9, 9)], [2, 1, 9]);
    }

    #[test]
    fn every_place_of_a_run_is_probed_equally_often() {
        let mut found = [0u32; 10];
        (0..10_000).for_each(|seed| found[probes(20, 2, seed)[1].at as usize - 10] += 1);
        let chi_square: f64 = found.iter().map(|&n| (f64::from(n) - 1000.0).powi(2) / 1000.0).sum();
        assert!(chi_square < 27.9, "9 degrees of freedom, 0.1 % level: {chi_square}");
    }

    #[test]
    fn a_run_that_costs_more_than_a_part_is_divided_among_several() {
        let runs =
            [Stretch { to: 10, cost: 100 }, Stretch { to: 20, cost: 700 }, Stretch { to: 24, cost: 0 }];
        let parts = parts_of_equal_cost(&runs, 4);
        let found: Vec<(u32, u64)> = parts.iter().map(|part| (part.to, part.cost)).collect();
        assert_eq!(found, [(11, 170), (14, 210), (17, 210), (24, 210)]);
    }

    #[test]
    fn without_costs_parts_have_equal_areas_and_too_few_pixels_leave_empty_parts() {
        let ends = |runs: &[Stretch], parts| {
            parts_of_equal_cost(runs, parts).into_iter().map(|part| part.to).collect::<Vec<_>>()
        };
        assert_eq!(ends(&[Stretch { to: 12, cost: 0 }], 3), [4, 8, 12]);
        assert_eq!(ends(&[Stretch { to: 2, cost: 5 }], 4), [0, 0, 1, 2]);
        assert_eq!(ends(&[], 2), [0, 0]);
    }

    proptest! {
        #[test]
        fn parts_cover_all_places_once_and_differ_by_less_than_two_pixels_cost(
            costs in prop::collection::vec((1u32..40, 0u64..1_000_000), 1..60),
            parts in 1u32..40,
        ) {
            let mut to = 0;
            let runs: Vec<Stretch> =
                costs.into_iter().map(|(length, cost)| { to += length; Stretch { to, cost } }).collect();
            let found = parts_of_equal_cost(&runs, parts);
            prop_assert_eq!(found.len() as u32, parts);
            prop_assert_eq!(found.last().unwrap().to, to);
            let total: u64 = runs.iter().map(|run| run.cost).sum();
            prop_assert_eq!(found.iter().map(|part| part.cost).sum::<u64>(), total);
            if to >= parts {
                prop_assert!(found.windows(2).all(|pair| pair[0].to < pair[1].to) && found[0].to > 0);
            }
            let mut start = 0;
            let dearest = runs
                .iter()
                .map(|run| run.cost.div_ceil(u64::from(run.to - std::mem::replace(&mut start, run.to))))
                .max();
            // Where every part has more than its least pixel, only whole pixels keep parts from being equal.
            let share = total / u64::from(parts);
            let mut start = 0;
            for part in &found {
                let long = part.to - std::mem::replace(&mut start, part.to) > 1;
                if long {
                    prop_assert!(part.cost <= share + 2 * dearest.unwrap() + 2, "{} of {share}", part.cost);
                }
            }
        }
    }
}
