//! Gathers a few records to measure the cost of one.

use super::index::direction_of;
use super::places::Cells;
use super::record::{Planned, RecordCost};
use super::{Cache, Level};
use crate::cost::Cost;
use crate::random::hash;
use crate::tracer::Tracer;
use rayon::prelude::*;

impl Cache {
    /// See [`Tracer::sample_records`].
    pub fn sample(&self, tracer: &Tracer, each: usize, seed: u64) -> Vec<RecordCost> {
        self.levels.iter().for_each(Level::make_ready_to_gather);
        let picks: Vec<(usize, usize)> = (0u64..)
            .zip(&self.levels)
            .flat_map(|(level, here)| {
                let own = u64::from(tracer.frame.number) << 32 | level;
                let picks = here.spread(each, hash(hash(seed) ^ own));
                picks.into_iter().map(move |index| (level as usize, index))
            })
            .collect();
        let sample = |(level, index): (usize, usize)| {
            let gathered = || self.gathered(tracer, level, index);
            // Records that read no others have their final value.
            let record = if self.levels[level + 1..].iter().all(|deeper| deeper.planned.is_empty()) {
                *self.levels[level].records[index].get_or_init(gathered)
            } else {
                gathered()
            };
            let nanos = self.levels[level].smoothing_nanos(index, &record);
            let smoothing = Cost { work: 0, cpu_nanos: nanos };
            RecordCost { level: level as u32, index, cost: record.cost + smoothing, rays: record.rays }
        };
        picks.into_par_iter().map(sample).collect()
    }
}

impl Level {
    /// Number of rays of a record's gather.
    fn number_of_rays(&self, index: usize) -> u32 {
        let one_each = self.strata.len() as u32;
        self.rays_of(index).map_or(one_each, |counts| counts.into_iter().map(u32::from).sum())
    }

    /// Chooses `each` records, or all, with equal probability. They are ordered by their number of rays,
    /// which is known before they are gathered, and then along a space-filling curve per axis direction.
    /// Every n-th is taken (systematic sampling: Cochran, *Sampling Techniques*, 3rd edition 1977, chapter
    /// 8). `start` is the offset of the first, in units of 2⁻⁶⁴ of a step.
    fn spread(&self, each: usize, start: u64) -> Vec<usize> {
        let count = self.planned.len();
        let picks = each.min(count);
        let cells = Cells::around(&self.planned);
        let key = |index: usize| (self.number_of_rays(index), curve(&self.planned[index], &cells));
        let mut order: Vec<((u32, u64), usize)> =
            (0..count).into_par_iter().map(|index| (key(index), index)).collect();
        order.sort_unstable();
        let place = |pick: usize| {
            let at = (pick as u128) << 64 | u128::from(start);
            // Below `count`, because `at` is below picks · 2⁶⁴.
            ((at * count as u128 / picks as u128) >> 64) as usize
        };
        (0..picks).map(|pick| order[place(pick)].1).collect()
    }
}

/// Position along the curve: the axis direction of the normal, then the Morton order of the position.
fn curve(planned: &Planned, cells: &Cells) -> u64 {
    direction_of(planned.site.normal) as u64 * Cells::COUNT + cells.number(planned.site.position)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cache::Site;
    use glam::Vec3;

    fn level(count: usize) -> Level {
        let place = |index: usize| {
            let position = Vec3::new((index * 37 % count) as f32, 0.0, (index % 7) as f32 * 1e-3);
            let normal = if index.is_multiple_of(4) { Vec3::Y } else { Vec3::NEG_Z };
            Planned::in_the_open(Site::bare(position, normal), 1.0)
        };
        Level { planned: (0..count).map(place).collect(), ..Level::default() }
    }

    #[test]
    fn every_record_has_the_same_chance_and_none_is_picked_twice() {
        let level = level(101);
        let mut times = vec![0; 101];
        // The starts are so close that each moves the picks by a fraction of a record.
        for start in 0..1010u64 {
            let mut picks = level.spread(10, start * (u64::MAX / 1010));
            assert_eq!(picks.len(), 10);
            picks.iter().for_each(|&pick| times[pick] += 1);
            picks.sort_unstable();
            picks.dedup();
            assert_eq!(picks.len(), 10, "no record twice");
        }
        assert!(times.iter().all(|&n| (98..=102).contains(&n)), "{times:?}");
        let mut all = level.spread(usize::MAX, 77);
        all.sort_unstable();
        assert!(all.into_iter().eq(0..101));
        assert!(Level::default().spread(5, 0).is_empty());
    }

    #[test]
    fn picks_are_spread_over_space_and_over_the_directions_that_surfaces_face() {
        let level = level(400);
        for start in [0, u64::MAX / 3, u64::MAX] {
            let picks = level.spread(40, start);
            let up = picks.iter().filter(|&&pick| level.planned[pick].site.normal == Vec3::Y).count();
            assert!((9..=11).contains(&up), "a quarter of the records face upwards, of 40 picks {up}");
            let mut along: Vec<f32> = picks.iter().map(|&pick| level.planned[pick].site.position.x).collect();
            along.sort_by(f32::total_cmp);
            let widest = along.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f32::max);
            assert!(widest < 40.0, "{widest} of 400 m without a pick");
        }
    }
}
