//! Fill: gathers the irradiance at planned records.

use super::{Cache, Record};
use crate::cost::{Cost, GUIDING_WORK, SMOOTHING_WORK, clocked};
use crate::tracer::Tracer;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

impl Cache {
    /// Gathers some of a level's records on the current thread pool, and smooths the level once it is full.
    /// The next deeper level must be filled. `progress` receives the number of records done. Returns
    /// `false` if `cancel` was set.
    pub fn fill(
        &self,
        tracer: &Tracer,
        level: usize,
        records: &[usize],
        progress: &(dyn Fn(u64) + Sync),
        cancel: &AtomicBool,
    ) -> bool {
        self.smooth(level + 1);
        if !records.is_empty() {
            self.levels[level].make_ready_to_gather();
        }
        let done = AtomicU64::new(0);
        records.par_iter().for_each(|&index| {
            if !cancel.load(Ordering::Relaxed) {
                self.levels[level].records[index].get_or_init(|| self.gathered(tracer, level, index));
                progress(done.fetch_add(1, Ordering::Relaxed) + 1);
            }
        });
        self.smooth(level);
        !cancel.load(Ordering::Relaxed)
    }

    /// Gathers the irradiance at a record. The result includes its cost.
    pub(super) fn gathered(&self, tracer: &Tracer, level: usize, index: usize) -> Record {
        let here = &self.levels[level];
        let planned = &here.planned[index];
        let gather = || {
            let counts = here.rays_of(index);
            let (irradiance, counters) =
                tracer.kernel.gather(tracer, &here.strata, counts.as_deref(), level as u32, planned);
            (Record::new(planned, &irradiance, here.smallest), counters)
        };
        let ((record, counters), cpu_nanos) = clocked(gather);
        tracer.gather_work.add(counters.work_by_class());
        let besides = SMOOTHING_WORK + if here.guide().is_asked() { GUIDING_WORK } else { 0 };
        tracer.gather_work.add([0, 0, 0, 0, besides]);
        let cost = Cost { work: counters.work() + besides, cpu_nanos };
        Record { cost, rays: counters.rays, ..record }
    }
}
