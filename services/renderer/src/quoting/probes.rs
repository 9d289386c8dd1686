//! What is measured of a frame: a few cheap parts, from which the cost of the whole follows as a line.

use crate::door::{Capabilities, Capability, Measured, Part, Region, Settings};
use forelight_protocol::{SampleCost, Varied};

/// Share of a frame's samples that are measured, as a divisor. More make the quote surer, and cost more.
const SHARE: u32 = 50;

/// Shares of the samples that are measured in addition, one after the other, where fixed costs hide the cost
/// of samples.
const LARGER_SHARES: [u32; 2] = [16, 4];

/// Divisors of width and height of the smaller images that are measured. The last one tells by which power of
/// the pixels costs grow. It is measured in every fourth frame, and where fixed costs hide the cost of
/// pixels.
const SIZES: [u32; 3] = [8, 4, 2];
const EVERY: u32 = 4;

/// Divisors of width and height of the regions that are measured, and their number. The first is a single
/// small one. The last are measured only where fixed costs hide the cost of pixels.
const REGIONS: [(u32, usize); 3] = [(32, 1), (8, 8), (4, 4)];

/// Side of the regions of a renderer that measures many at once, in pixels, where the image is small. Of a
/// large image, this divisor of its width and height.
const SMALL_REGION: u32 = 8;
const MOST_DIVISOR: u32 = 64;

/// Share of the image that many regions cover, as a divisor, and the least number of them.
const MANY: u32 = 50;
const LEAST_MANY: u32 = 16;

/// Measured costs hide the cost of what is varied if the largest is less than this multiple of the smallest.
const CLEARLY_MORE: u64 = 2;

/// Ratios of the additive sequence that spreads regions over an image: powers of the inverse of the plastic
/// number (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
const SPREAD: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];

/// A part to measure.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Probe {
    pub settings: Settings,
    pub part: Part,
    /// How much of what is varied it has, or each of its pieces.
    pub amount: u32,
    /// Number of pieces that are measured one by one.
    pub pieces: usize,
    /// Whether it is only needed if those before it do not tell the costs apart.
    pub in_addition: bool,
}

/// The best that a renderer can vary at these settings.
pub(super) fn best(can: &Capabilities, settings: &Settings) -> Varied {
    let has = |capability| can.contains(&capability);
    // Without one, a frame of one sample has no smaller share of them.
    let other = [(Capability::Resize, Varied::Size), (Capability::MeasureRegions, Varied::Regions)];
    let other = other.into_iter().find(|&(capability, _)| has(capability)).map(|(_, varied)| varied);
    match other {
        _ if has(Capability::MeasureSamples) && settings.common.samples > 1 => Varied::Samples,
        Some(varied) => varied,
        None if has(Capability::MeasureSamples) => Varied::Samples,
        None => Varied::Nothing,
    }
}

/// How much of it a whole frame has.
pub(super) fn whole(varied: Varied, settings: &Settings) -> u32 {
    match varied {
        Varied::Samples => settings.common.samples,
        Varied::Size | Varied::Regions => u32::try_from(settings.pixels()).unwrap_or(u32::MAX),
        Varied::Nothing => 1,
    }
}

/// The parts to measure of a frame that has so much of what is varied, cheap ones first. `turn` is the number of
/// frames that are measured before this one: regions are spread over the measured frames together.
pub(super) fn probes(
    varied: Varied,
    can: &Capabilities,
    settings: &Settings,
    whole: u32,
    turn: u32,
) -> Vec<Probe> {
    let probe =
        |part, amount| Probe { settings: settings.clone(), part, amount, pieces: 1, in_addition: false };
    let samples = settings.common.samples;
    match varied {
        Varied::Samples => {
            let more = (whole / SHARE).saturating_sub(1);
            let counts = [(1, false), (more, false)].into_iter();
            let counts = counts.chain(LARGER_SHARES.map(|divisor| ((whole / divisor).max(2), true)));
            let mut end = 0;
            let mut shares = Vec::new();
            for (count, in_addition) in counts {
                let count = count.min(samples - end);
                if count > 0 {
                    let part = Part::Samples { offset: end, count };
                    shares.push(Probe { in_addition, ..probe(part, count) });
                }
                end += count;
            }
            shares
        }
        Varied::Size => {
            let smaller = |(index, divisor): (usize, u32)| {
                let mut settings = settings.clone();
                for side in [&mut settings.common.width, &mut settings.common.height] {
                    *side = side.div_ceil(divisor);
                }
                let amount = u32::try_from(settings.pixels()).unwrap_or(u32::MAX);
                let part = Part::Samples { offset: 0, count: samples };
                Probe {
                    settings,
                    part,
                    amount,
                    pieces: 1,
                    in_addition: index == SIZES.len() - 1 && !turn.is_multiple_of(EVERY),
                }
            };
            SIZES.into_iter().enumerate().map(smaller).collect()
        }
        Varied::Regions => {
            let several = |(index, (divisor, number)): (usize, (u32, usize))| {
                let regions = regions(settings, divisor, number, turn as usize * number);
                let amount = regions.first().map_or(0, |region| region.width * region.height);
                let (pieces, in_addition) = (regions.len(), index == REGIONS.len() - 1);
                Probe { pieces, in_addition, ..probe(Part::Regions(regions), amount) }
            };
            if can.contains(&Capability::MeasureManyRegions) {
                let shorter = settings.common.width.min(settings.common.height);
                let divisor = (shorter / SMALL_REGION).clamp(1, MOST_DIVISOR);
                let cells = divisor * divisor;
                let number = (cells / MANY).max(LEAST_MANY).min(cells);
                return vec![several((0, (divisor, number as usize)))];
            }
            REGIONS.into_iter().enumerate().map(several).collect()
        }
        Varied::Nothing => vec![probe(Part::Samples { offset: 0, count: samples }, 1)],
    }
}

/// Costs that a measurement tells: of the part, and of its fixed costs where they are known. Of several
/// pieces, the mean.
pub(super) fn costs(varied: Varied, probe: &Probe, measured: &Measured) -> Vec<SampleCost> {
    let cost = |amount, cpu_nanos| SampleCost { amount, cpu_nanos };
    let fixed: u64 = measured.fixed.values().sum();
    let whole = match measured.pieces.as_slice() {
        [] => measured.cost.cpu_nanos.saturating_sub(fixed),
        pieces => pieces.iter().map(|piece| piece.cpu_nanos).sum(),
    };
    let each = whole / probe.pieces.max(1) as u64;
    let mut costs = vec![cost(probe.amount, fixed + each)];
    if !measured.fixed.is_empty() {
        costs.push(cost(0, fixed));
    } else if varied == Varied::Nothing {
        // All of the cost is the frame's.
        costs.push(cost(0, 0));
    }
    costs
}

/// Whether the measured costs hide the cost of what is varied behind fixed costs.
pub(super) fn hide(costs: &[SampleCost]) -> bool {
    let all = || costs.iter().map(|cost| cost.cpu_nanos);
    let knows_fixed = costs.iter().any(|cost| cost.amount == 0);
    !knows_fixed && all().max() < all().min().map(|least| CLEARLY_MORE * least)
}

/// `number` regions of equal size, without overlap, spread over the image: the sequence from `first` on.
fn regions(settings: &Settings, divisor: u32, number: usize, first: usize) -> Vec<Region> {
    let size = [settings.common.width, settings.common.height];
    let sides = size.map(|all| all.div_ceil(divisor));
    let cells = [0, 1].map(|axis| size[axis] / sides[axis]);
    let mut regions: Vec<Region> = Vec::with_capacity(number);
    for index in first..first + 64 * number {
        let cell = |axis: usize| {
            let place = (0.5 + SPREAD[axis] * index as f64).fract();
            let cell = ((place * f64::from(cells[axis])) as u32).min(cells[axis] - 1);
            // What is left over is spread between the cells.
            let left = size[axis] - cells[axis] * sides[axis];
            cell * sides[axis] + left * cell / (cells[axis] - 1).max(1)
        };
        let region = Region { x: cell(0), y: cell(1), width: sides[0], height: sides[1] };
        if !regions.contains(&region) {
            regions.push(region);
        }
        if regions.len() == number {
            break;
        }
    }
    regions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::door::Common;

    fn settings(width: u32, height: u32, samples: u32) -> Settings {
        Settings { common: Common { width, height, samples, seed: 0 }, own: Default::default() }
    }

    #[test]
    fn samples_are_varied_before_size_and_size_before_regions() {
        let all = [Capability::MeasureSamples, Capability::Resize, Capability::MeasureRegions];
        let best =
            |can: &[Capability], samples| best(&can.iter().copied().collect(), &settings(64, 64, samples));
        assert_eq!(best(&all, 16), Varied::Samples);
        assert_eq!(best(&all, 1), Varied::Size);
        assert_eq!(best(&all[1..], 16), Varied::Size);
        assert_eq!(best(&all[2..], 16), Varied::Regions);
        assert_eq!(best(&all[..1], 1), Varied::Samples);
        assert_eq!(best(&[], 16), Varied::Nothing);
    }

    #[test]
    fn shares_of_the_samples_have_no_gaps() {
        for samples in [1, 2, 3, 4, 16, 256] {
            let mut end = 0;
            for probe in probes(Varied::Samples, &Capabilities::new(), &settings(8, 8, samples), samples, 0) {
                let Part::Samples { offset, count } = probe.part else { panic!("{probe:?}") };
                assert_eq!((offset, count), (end, probe.amount));
                end += count;
            }
            assert!(end <= samples, "{samples}");
        }
    }

    #[test]
    fn regions_lie_in_the_image_and_do_not_overlap() {
        for (width, height) in [(96, 54), (1920, 1080), (33, 7), (3, 1)] {
            for turn in 0..4 {
                for probe in probes(
                    Varied::Regions,
                    &Capabilities::new(),
                    &settings(width, height, 1),
                    width * height,
                    turn,
                ) {
                    let Part::Regions(regions) = probe.part else { panic!() };
                    assert_eq!(regions.len(), probe.pieces);
                    for (i, r) in regions.iter().enumerate() {
                        assert!(r.x + r.width <= width && r.y + r.height <= height, "{r:?}");
                        assert_eq!(r.width * r.height, probe.amount);
                        let apart = |o: &Region| {
                            r.x + r.width <= o.x
                                || o.x + o.width <= r.x
                                || r.y + r.height <= o.y
                                || o.y + o.height <= r.y
                        };
                        assert!(regions[..i].iter().all(apart), "{r:?}");
                    }
                }
            }
        }
        let many: Vec<Region> =
            (0..8).flat_map(|turn| regions(&settings(640, 360, 1), 8, 8, 8 * turn)).collect();
        let mean = many.iter().map(|r| f64::from(r.x + r.width / 2)).sum::<f64>() / many.len() as f64;
        assert!((mean / 320.0 - 1.0).abs() < 0.05, "{mean}");
    }

    #[test]
    fn many_regions_are_small_and_cover_a_fiftieth_of_the_image() {
        let can = Capabilities::from([Capability::MeasureRegions, Capability::MeasureManyRegions]);
        for (width, height, count) in [(256, 256, 20), (1920, 1080, 81), (96, 96, 16), (4, 4, 1)] {
            let [probe] = &probes(Varied::Regions, &can, &settings(width, height, 64), width * height, 3)[..]
            else {
                panic!()
            };
            let Part::Regions(regions) = &probe.part else { panic!() };
            assert_eq!((regions.len(), probe.pieces), (count, count), "{width} × {height}");
        }
    }

    #[test]
    fn costs_that_hardly_differ_hide_what_is_varied() {
        let costs = |all: &[(u32, u64)]| -> Vec<SampleCost> {
            all.iter().map(|&(amount, cpu_nanos)| SampleCost { amount, cpu_nanos }).collect()
        };
        assert!(hide(&costs(&[(1, 300), (16, 500)])));
        assert!(!hide(&costs(&[(1, 300), (16, 700)])));
        assert!(!hide(&costs(&[(1, 300), (0, 290), (16, 500)])), "the fixed cost is known");
    }
}
