//! Partial fill: gathers only the records that some pixels read.
//!
//! The needed records of the first level are gathered, and averaged with filled neighbours. Deeper levels
//! would have to be filled completely, so single rays are followed instead. The colours are those of a cache
//! with a slightly noisier first level and exact deeper ones.

use super::{Cache, Level};
use crate::cost::{Cost, Counters, clocked};
use crate::tracer::Tracer;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::ops::Add;

impl Cache {
    /// See [`Tracer::fill_for`].
    pub fn fill_for(
        &self,
        tracer: &Tracer,
        pixels: &[u32],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Cost> {
        let Some(first) = self.levels.first() else { return Some(Cost::default()) };
        let before = self.totals().fill;
        if !self.levels[1..].iter().all(Level::is_full) {
            self.partial.get_or_init(|| ());
        }
        first.make_ready_to_gather();
        let allowed = first.allowed();
        let look = |pixel: u32| {
            let (mut sites, mut counters) = (Vec::new(), Counters::default());
            tracer.kernel.sites(tracer, pixel, tracer.samples_of(pixel), &mut sites, &mut counters);
            let reads = |index: &u32, site| first.planned[*index as usize].error(site, allowed).is_some();
            let read: BTreeSet<u32> = sites
                .iter()
                .flat_map(|(_, site)| {
                    first.index.around(site, |_| ()).filter(move |index| reads(index, site))
                })
                .collect();
            (read, counters.work())
        };
        let found: Vec<((BTreeSet<u32>, u64), u64)> =
            pixels.par_iter().map(|&pixel| clocked(|| look(pixel))).collect();
        let cost = |&((_, work), cpu_nanos): &(_, u64)| Cost { work, cpu_nanos };
        let looking = found.iter().map(cost).fold(Cost::default(), Cost::add);
        let read: BTreeSet<u32> = found.into_iter().flat_map(|((read, _), _)| read).collect();
        let read: Vec<u32> = read.into_iter().collect();
        read.par_iter().try_for_each(|&index| {
            let index = index as usize;
            first.records[index].get_or_init(|| self.gathered(tracer, 0, index));
            (!stop()).then_some(())
        })?;
        self.smooth_filled(0);
        let after = self.totals().fill;
        let gathering =
            Cost { work: after.work - before.work, cpu_nanos: after.cpu_nanos - before.cpu_nanos };
        Some(looking + gathering)
    }

    /// Returns `true` if points of this level are followed by rays although the level was planned.
    pub fn is_followed(&self, level: usize) -> bool {
        level > 0 && self.partial.get().is_some()
    }
}
