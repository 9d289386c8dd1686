//! The irradiance cache of a divided frame: planned by one task, filled by others, read by its parts.

use crate::costs::spent;
use crate::error::RenderError;
use crate::frame::OwnFrame;
use forelight_protocol::Spent;
use forelight_tracer::{Cache, CacheTotals, Profile, clocked};
use std::sync::atomic::Ordering;

impl OwnFrame<'_> {
    /// Gives the frame the irradiance cache that was planned for it before, with its costs, before anything is
    /// planned. Records of a shared cache are part of it. Returns what the cache has cost so far.
    pub fn take_own_cache(&self, cache: Cache) -> Result<Spent, RenderError> {
        let totals = cache.totals();
        let reading = cache.reading_nanos();
        let (taken, taking) = clocked(|| self.tracer.take_cache(cache));
        taken?;
        self.taking.store(reading + taking, Ordering::Relaxed);
        Ok(spent(totals.plan + totals.fill))
    }

    /// The same with the cache in a profile of this image, if it holds one.
    pub fn take_profiled_cache(&self, profile: &Profile) -> Result<Spent, RenderError> {
        self.own_cache(profile)?.map_or(Ok(Spent::default()), |cache| self.take_own_cache(cache))
    }

    /// Totals of the cache in a profile of this image: what a render takes over. Zero without one.
    pub fn totals_of_profiled_cache(&self, profile: Option<&Profile>) -> Result<CacheTotals, RenderError> {
        let cache = profile.map(|profile| self.own_cache(profile)).transpose()?.flatten();
        Ok(cache.map(|cache| cache.totals()).unwrap_or_default())
    }

    /// Cost of the irradiance cache here: reading, planning and gathering, without `before`, which was spent on
    /// it when it was taken.
    pub fn spent_on_cache_here(&self, before: Spent) -> Spent {
        let taking = Spent { work: 0, cpu_nanos: self.taking.load(Ordering::Relaxed) };
        self.spent_on_cache().less(before).plus(taking)
    }

    /// The irradiance cache, planned if needed, which the frame's parts need beside a shared one. `None` without
    /// a cache, and if the shared cache was planned for this frame too and is filled.
    pub fn cache_for_parts(&self) -> Option<&Cache> {
        self.tracer.plan();
        let cache = self.tracer.cache()?;
        let kept: u64 = cache.shared().kept.iter().sum();
        let shared_is_enough = kept == cache.records().iter().sum::<u64>()
            && cache.totals().plan.work == 0
            && cache.is_complete();
        (!shared_is_enough).then_some(cache)
    }
}
