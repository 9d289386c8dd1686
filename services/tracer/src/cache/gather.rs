//! Fill: gathers the irradiance at planned records.

use super::hemisphere::Irradiance;
use super::smooth::Value;
use super::{Cache, Planned, Record};
use crate::cost::{Cost, SMOOTHING, SMOOTHING_WORK, clocked};
use crate::tracer::Tracer;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

impl Cache {
    /// Gathers a range of a level's records, on the current thread pool. Filled records stay unchanged.
    ///
    /// The next deeper level must be filled, because gathers read it. If the level is then full, it is
    /// smoothed. `progress` receives the number of records done. Returns `false` if `cancel` was set.
    pub fn fill(
        &self,
        tracer: &Tracer,
        level: usize,
        range: Range<usize>,
        progress: &(dyn Fn(u64) + Sync),
        cancel: &AtomicBool,
    ) -> bool {
        self.smooth(level + 1);
        let done = AtomicU64::new(0);
        range.into_par_iter().for_each(|index| {
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
            let (irradiance, counters) = tracer.kernel.gather(tracer, &here.strata, level as u32, planned);
            (Record::new(planned, &irradiance, here.smallest), counters)
        };
        let ((record, counters), cpu_nanos) = clocked(gather);
        tracer.gather_work.add(counters.work_by_class());
        tracer.gather_work.add(SMOOTHING);
        let cost = Cost { work: counters.work() + SMOOTHING_WORK, cpu_nanos };
        Record { cost, rays: counters.rays, ..record }
    }
}

impl Record {
    /// The record for a gather. Its gradients are limited (Křivánek et al. 2006).
    ///
    /// A gradient that would change the irradiance by its full value within a distance shows that the record
    /// is valid for that distance at most. The trusted radius is reduced to it. If the distance is below the
    /// smallest radius, the gradient itself is reduced.
    fn new(planned: &Planned, irradiance: &Irradiance, smallest: f32) -> Self {
        let (value, mut translation) = (irradiance.value, irradiance.translation);
        let mut trusted = planned.radius;
        for channel in 0..3 {
            let slope = translation[channel].length();
            let level_within = if slope > 0.0 { value[channel] / slope } else { f32::INFINITY };
            trusted = trusted.min(level_within.max(smallest));
            if level_within < smallest {
                translation[channel] *= level_within / smallest;
            }
        }
        let mut record = Self {
            rejected: false,
            irradiance: value,
            rotation: irradiance.rotation,
            translation,
            trusted,
            noise: irradiance.noise,
            cost: Cost::default(),
            rays: [0; 7],
        };
        record.rejected = !record.is_finite();
        record
    }

    /// Returns `true` if every value is finite.
    pub fn is_finite(&self) -> bool {
        Value::of(self).is_finite() && self.noise.is_finite()
    }
}
