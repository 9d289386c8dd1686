//! Filling in part: what some pixels read, so that their colours are known before the image is rendered.
//!
//! All but for the averaging of records that agree (`smooth`), which takes all of a level: the colours are those of a cache of the
//! same records that is a little noisier, and so no better than the image's.

use super::{Cache, READ_RELAXED};
use crate::cost::{Cost, Counters, thread_cpu_nanos};
use crate::tracer::Tracer;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

impl Cache {
    /// See [`Tracer::fill_for`].
    pub fn fill_for(&self, tracer: &Tracer, pixels: &[u32]) -> Cost {
        let Some(first) = self.levels.first() else { return Cost::default() };
        let before = self.totals().fill;
        // The gathers of a level read the next deeper one, and where they do is not known before.
        for level in (1..self.levels.len()).rev() {
            let all = 0..self.levels[level].planned.len();
            self.fill(tracer, level, all, &|_| (), &AtomicBool::new(false));
        }
        self.smooth(1);
        let allowed = first.accuracy * READ_RELAXED;
        let found = pixels.par_iter().map(|&pixel| {
            let start = thread_cpu_nanos();
            let (mut sites, mut counters) = (Vec::new(), Counters::default());
            tracer.kernel.sites(tracer, pixel, tracer.settings.spp, &mut sites, &mut counters);
            let reads = |index: &u32, site| first.planned[*index as usize].error(site, allowed).is_some();
            let read: BTreeSet<u32> = sites
                .iter()
                .flat_map(|(_, site)| {
                    first.octree.near(site.position).filter(move |index| reads(index, site))
                })
                .collect();
            (read, Cost { work: counters.work(), cpu_nanos: thread_cpu_nanos() - start })
        });
        let found: Vec<(BTreeSet<u32>, Cost)> = found.collect();
        let looking = found.iter().fold(Cost::default(), |sum, (_, cost)| sum + *cost);
        let read: BTreeSet<u32> = found.into_iter().flat_map(|(read, _)| read).collect();
        let read: Vec<u32> = read.into_iter().collect();
        read.par_iter().for_each(|&index| {
            let index = index as usize;
            first.records[index].get_or_init(|| self.gathered(tracer, 0, index));
        });
        // Does nothing unless these were all that there are.
        self.smooth(0);
        let after = self.totals().fill;
        let gathering =
            Cost { work: after.work - before.work, cpu_nanos: after.cpu_nanos - before.cpu_nanos };
        looking + gathering
    }
}
