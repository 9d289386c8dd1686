//! Costs of pixels that share values of indirect light, such as Radiance's ambient values.
//!
//! The first pixels gather values, and most of the later ones only read them. So pixels are measured from a
//! coarse grid to finer ones, which a render goes on with. Of each grid, the share of pixels that still
//! gather is known. It falls from grid to grid: by a half where values lie along edges, by a quarter where
//! they cover areas (a grid has four times the pixels of the one before it). The grids that are not measured
//! are taken to be between the fall that was measured and the latter: at the geometric mean of both.

use crate::door::{PixelCost, Settings};

/// Fall of the share of gathering pixels, from a grid to one of half its spacing, where values cover areas.
const FALL_OF_AREAS: f64 = 0.25;

/// Grids that are measured.
const GRIDS: u32 = 3;

/// Index of the kind of ray that gathers.
const AMBIENT: usize = 5;

/// Pixels of the grids to measure. About `samples` are in the first.
pub(super) fn grids(settings: &Settings, samples: u32) -> Vec<Vec<u32>> {
    let (width, height) = (settings.common.width, settings.common.height);
    let wanted = (settings.pixels() as f64 / f64::from(samples.max(1))).sqrt();
    let mut spacing = 1u32 << (wanted.max(1.0).log2().round() as u32).min(15);
    let mut grids = Vec::new();
    let mut before = None;
    for _ in 0..GRIDS {
        let is_new = |x: u32, y: u32| {
            before.is_none_or(|step: u32| !x.is_multiple_of(step) || !y.is_multiple_of(step))
        };
        let rows = (0..height).step_by(spacing as usize);
        let pixels = rows.flat_map(|y| {
            let columns = (0..width).step_by(spacing as usize);
            columns.filter(move |&x| is_new(x, y)).map(move |x| y * width + x)
        });
        grids.push(pixels.collect());
        if spacing == 1 {
            break;
        }
        before = Some(spacing);
        spacing /= 2;
    }
    grids
}

/// What the mean cost of all pixels is, over that of the measured ones: of CPU time, and of each kind of ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ratio {
    pub cpu: f64,
    pub rays: [f64; 7],
}

/// Mean cost of pixels.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    cpu: f64,
    rays: [f64; 7],
}

impl Mean {
    fn of<'a>(costs: impl Iterator<Item = &'a PixelCost>) -> Self {
        let (mut sum, mut count) = (Self::default(), 0u32);
        for cost in costs {
            sum.cpu += cost.cpu_nanos as f64;
            sum.rays.iter_mut().zip(cost.rays).for_each(|(sum, rays)| *sum += rays as f64);
            count += 1;
        }
        sum.times(1.0 / f64::from(count.max(1)))
    }

    fn times(self, factor: f64) -> Self {
        Self { cpu: self.cpu * factor, rays: self.rays.map(|rays| rays * factor) }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            cpu: self.cpu + other.cpu,
            rays: std::array::from_fn(|kind| self.rays[kind] + other.rays[kind]),
        }
    }
}

/// The ratio for measured grids of an image of `pixels`.
pub(super) fn ratio(grids: &[Vec<PixelCost>], pixels: u64) -> Ratio {
    let gathers = |cost: &&PixelCost| cost.rays[AMBIENT] > 0;
    let share = |grid: &Vec<PixelCost>| grid.iter().filter(gathers).count() as f64 / grid.len().max(1) as f64;
    let measured: u64 = grids.iter().map(|grid| grid.len() as u64).sum();
    let all = grids.iter().flatten();
    let mean = Mean::of(all.clone());
    let gathering = Mean::of(all.filter(gathers));
    let last = grids.last().map_or(&[][..], Vec::as_slice);
    let reading = Mean::of(last.iter().filter(|cost| cost.rays[AMBIENT] == 0));
    let shares: Vec<f64> = grids.iter().map(share).collect();
    let falls =
        shares.windows(2).filter(|pair| pair[0] > 0.0).map(|pair| (pair[1] / pair[0]).clamp(0.01, 1.0));
    let (product, count) = falls.fold((1.0, 0), |(product, count), fall| (product * fall, count + 1));
    let measured_fall = if count > 0 { f64::powf(product, 1.0 / f64::from(count)) } else { FALL_OF_AREAS };
    let fall = (measured_fall * FALL_OF_AREAS).sqrt();
    let mut total = mean.times(measured as f64);
    let (mut done, mut share) = (measured, shares.last().copied().unwrap_or(0.0));
    while done < pixels {
        // The next grid has three times the pixels of all before it.
        let next = (3 * done.max(1)).min(pixels - done);
        share *= fall;
        let each = reading.times(1.0 - share).plus(gathering.times(share));
        total = total.plus(each.times(next as f64));
        done += next;
    }
    let of_all = total.times(1.0 / pixels.max(1) as f64);
    let over = |all: f64, measured: f64| if measured > 0.0 { all / measured } else { 1.0 };
    Ratio {
        cpu: over(of_all.cpu, mean.cpu),
        rays: std::array::from_fn(|kind| over(of_all.rays[kind], mean.rays[kind])),
    }
}

impl Ratio {
    /// The cost that a measured pixel stands for.
    pub fn of(&self, cost: &PixelCost) -> PixelCost {
        let times = |value: u64, ratio: f64| (value as f64 * ratio).round() as u64;
        PixelCost {
            cpu_nanos: times(cost.cpu_nanos, self.cpu),
            rays: std::array::from_fn(|kind| times(cost.rays[kind], self.rays[kind])),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::door::Common;
    use std::collections::BTreeSet;

    fn settings(width: u32, height: u32) -> Settings {
        Settings { common: Common { width, height, samples: 1, seed: 0 }, own: Default::default() }
    }

    #[test]
    fn grids_have_no_pixel_twice_and_each_has_three_times_those_before_it() {
        let grids = grids(&settings(256, 256), 256);
        assert_eq!(grids.iter().map(Vec::len).collect::<Vec<_>>(), [256, 768, 3072]);
        let all: BTreeSet<u32> = grids.iter().flatten().copied().collect();
        assert_eq!(all.len(), 4096);
        let small = super::grids(&settings(3, 2), 256);
        assert_eq!(small, [vec![0, 1, 2, 3, 4, 5]]);
    }

    #[test]
    fn gathering_pixels_become_rare_and_reading_ones_cost_what_they_do() {
        let cost = |gathers: bool| PixelCost {
            cpu_nanos: if gathers { 5_000_000 } else { 50_000 },
            rays: [1, 7, 0, 0, 0, if gathers { 128 } else { 0 }, 0],
        };
        let grid =
            |pixels: usize, every: usize| (0..pixels).map(|n| cost(n % every == 0)).collect::<Vec<_>>();
        // All pixels of the first grid gather, then a quarter, then a sixteenth: the fall of areas.
        let found = ratio(&[grid(256, 1), grid(768, 4), grid(3072, 16)], 65_536);
        let gathering = 256.0 + 192.0 + 192.0;
        let later = 12_288.0 / 64.0 + 49_152.0 / 256.0;
        let mean = |gathering: f64, pixels: f64| (gathering * 5e6 + (pixels - gathering) * 5e4) / pixels;
        let expected = mean(gathering + later, 65_536.0) / mean(gathering, 4096.0);
        assert!((found.cpu / expected - 1.0).abs() < 1e-9, "{} {expected}", found.cpu);
        assert!((found.rays[0] - 1.0).abs() < 1e-9 && found.rays[AMBIENT] < 0.2, "{found:?}");
        assert_eq!(found.of(&cost(false)).rays[1], 7);
    }

    #[test]
    fn a_frame_that_was_measured_completely_is_what_it_is() {
        let cost = PixelCost { cpu_nanos: 70, rays: [1, 0, 0, 0, 0, 0, 0] };
        let found = ratio(&[vec![cost; 6]], 6);
        assert!((found.cpu - 1.0).abs() < 1e-12 && found.rays[0] == 1.0);
        assert_eq!(found.of(&cost), cost);
    }
}
