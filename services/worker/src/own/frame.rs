//! One frame, ready to be traced.

use super::shot::{AmbientShot, records};
use super::{backend, preview_spent};
use crate::profile::work_classes::by_class;
use crate::render::spent;
use crate::renderer::{CacheUse, Finished, FrameRenderer, Previewed, Progress, RenderError, Step};
use forelight_forecast::accuracy::{PixelNoise, PixelSamples};
use forelight_protocol::{ByClass, FixedCosts, LeftOut, ProcessCosts, Spent};
use forelight_scene::Frame;
use forelight_tracer::{
    Cache, CacheTotals, Effects, Passes, Pixel, PixelsFinished, Profile, RecordCost, SampleCounts, Shared,
    Totals, Tracer, clocked,
};
use parking_lot::Mutex;
use rayon::prelude::*;
use std::sync::atomic::AtomicBool;

/// One frame, ready.
pub(super) struct AmbientFrame<'a> {
    pub(super) shot: &'a AmbientShot,
    pub(super) tracer: Tracer,
    /// What became of the shot's cache, if it was given one, and the CPU time that taking it took, nanoseconds.
    pub(super) shared: Mutex<(Shared, u64)>,
    /// Without the plan of its irradiance cache.
    pub(super) fixed: FixedCosts,
    pub(super) built_now: Spent,
}

impl AmbientFrame<'_> {
    /// What the irradiance cache came to, if there is one.
    fn cache_use(&self, taken_over: CacheTotals) -> Option<CacheUse> {
        let shared = || self.shared.lock().0.clone();
        self.tracer.cache().map(|cache| CacheUse { all: cache.totals(), taken_over, shared: shared() })
    }

    /// The cache of a profile of this image, if it holds one.
    fn own_cache(&self, profile: &Profile) -> Result<Option<Cache>, RenderError> {
        let pixels = self.tracer.frame().camera.pixels();
        if profile.fingerprint != self.tracer.fingerprint() || !profile.fits(pixels) {
            let differs = profile.origin.unlike_image(&self.tracer.origin());
            return Err(RenderError::ForeignProfile { differs });
        }
        Ok(profile.cache.as_deref().map(Cache::from_bytes).transpose()?)
    }

    /// Takes the cache of the shot, as far as it holds here.
    fn take(&self, cache: Cache) -> Result<Shared, RenderError> {
        if cache.suits(&self.tracer) {
            let kept = cache.records();
            self.tracer.take_cache(cache.as_given())?;
            return Ok(Shared { dropped: vec![0; kept.len()], kept });
        }
        let settings = self.tracer.settings();
        let from = self.shot.tracer(&self.shot.frame_of(cache.frame(), settings)?, settings).tracer;
        cache.check(&from)?;
        let (carried, shared) = cache.carried(&from, &self.tracer);
        self.tracer.take_cache(carried.as_given())?;
        Ok(shared)
    }

    /// Finished pixels on the current thread, with what their camera samples say; nothing if `stop` says on the way that they are not
    /// wanted any more.
    fn traced(&self, pixels: &[u32], stop: &dyn Fn() -> bool) -> Option<Vec<(Pixel, PixelNoise)>> {
        let mut samples = vec![PixelSamples::default(); pixels.len()];
        let mut each = |place: usize, sample| samples[place].push(sample);
        let traced = self.tracer.profile_samples(pixels, &mut each, stop)?;
        Some(traced.into_iter().zip(samples.iter().map(PixelSamples::noise)).collect())
    }
}

/// Pixels that are traced in one go, so that a thread's clock is read seldom and every thread has work.
const BATCH: usize = 16;

impl FrameRenderer for AmbientFrame<'_> {
    fn frame(&self) -> &Frame {
        self.tracer.frame()
    }

    fn preview(&self) -> Result<Previewed, RenderError> {
        let frame = self.tracer.frame();
        Ok(self.shot.previewer.with(|previewer| {
            let preview = previewer.preview(frame)?;
            Ok(Previewed { preview, backend: backend(previewer), spent: preview_spent(previewer, frame, 0) })
        })?)
    }

    fn fixed(&self) -> FixedCosts {
        self.tracer.plan();
        match self.tracer.cache() {
            None => self.fixed,
            Some(cache) => {
                let CacheTotals { plan, plan_rays, .. } = cache.totals();
                let taking = Spent { work: 0, cpu_nanos: self.shared.lock().1 };
                FixedCosts { plan: spent(plan).plus(taking), plan_rays, ..self.fixed }
            }
        }
    }

    fn once(&self) -> ProcessCosts {
        self.shot.once()
    }

    fn cache_records(&self) -> Vec<u32> {
        self.tracer.plan();
        records(&self.tracer)
    }

    fn spent_on_setup(&self) -> Spent {
        self.fixed.load.plus(self.built_now)
    }

    fn effects(&self) -> Vec<String> {
        // Not a matter of how it is traced, but frames of such a shot cannot share an acceleration structure.
        let motion = self.shot.moves.then_some("motion");
        let mut effects: Vec<String> =
            self.tracer.effects().names().chain(motion).map(str::to_owned).collect();
        effects.sort();
        effects
    }

    fn left_out(&self) -> Vec<LeftOut> {
        let all = self.tracer.left_out();
        let shown = if all.len() > LeftOut::MOST { LeftOut::MOST - 1 } else { all.len() };
        let entry = |what: String, reason: String| LeftOut { what, reason };
        let first = all[..shown].iter().map(|left| entry(left.what.to_string(), left.reason.to_string()));
        let others = all.len() - shown;
        let rest = (others > 0).then(|| entry(format!("{others} others"), "as those before them".into()));
        first.chain(rest).collect()
    }

    fn work_by_class(&self) -> (ByClass, ByClass) {
        let triangles = self.tracer.frame().geometry.triangles.len();
        let (pixels, gathers) = self.tracer.work_by_class();
        (by_class(pixels, triangles), by_class(gathers, triangles))
    }

    fn trace_unless(
        &self,
        pixels: &[u32],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<(Pixel, PixelNoise)>> {
        self.tracer.plan();
        let batches = pixels.par_chunks(BATCH).map(|batch| self.traced(batch, stop));
        Some(batches.collect::<Option<Vec<_>>>()?.concat())
    }

    fn fill_for(&self, pixels: &[u32], stop: &(dyn Fn() -> bool + Sync)) -> Option<Spent> {
        self.tracer.fill_for(pixels, stop).map(spent)
    }

    fn fill(&self, progress: &(dyn Fn(Progress) + Sync), cancel: &AtomicBool) -> bool {
        if !self.tracer.effects().has(Effects::CACHE) {
            return true;
        }
        progress(Progress { step: Step::Planning, done: 0, all: 1 });
        self.tracer.plan();
        self.tracer.fill(&|done, all| progress(Progress { step: Step::Filling, done, all }), cancel)
    }

    fn spent_on_cache(&self) -> Spent {
        let of = |totals: CacheTotals| spent(totals.plan).plus(spent(totals.fill));
        self.tracer.cache().map_or_else(Spent::default, |cache| of(cache.totals()))
    }

    fn has_final_colours(&self) -> bool {
        self.tracer.cache().is_none_or(Cache::is_complete)
    }

    fn allot(&self, samples: SampleCounts) -> Result<(), RenderError> {
        Ok(self.tracer.allot(samples)?)
    }

    fn begin(&self) -> Passes {
        Passes::new(&self.tracer)
    }

    fn go_on(
        &self,
        passes: &mut Passes,
        wanted: &SampleCounts,
        stop: &(dyn Fn() -> bool + Sync),
        progress: &(dyn Fn() + Sync),
    ) -> Result<Totals, RenderError> {
        Ok(passes.go_on(&self.tracer, wanted, stop, &|_| progress())?)
    }

    fn finished(&self, passes: &Passes) -> Finished {
        Finished { image: passes.image(), cache: self.cache_use(CacheTotals::default()) }
    }

    fn trace_runs(
        &self,
        runs: &[Vec<u32>],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<Vec<(Pixel, PixelNoise)>>> {
        self.tracer.plan();
        runs.par_iter().map(|run| self.traced(run, stop)).collect()
    }

    fn sample_records(&self, each: usize, seed: u64) -> Vec<RecordCost> {
        self.tracer.sample_records(each, seed)
    }

    fn profile(&self, pixels: &[(u32, Pixel)]) -> Profile {
        let cache = self.tracer.cache().map(|cache| cache.to_bytes());
        // The colours of pixels that read a cache before it is filled are not the image's.
        let pixels = if cache.is_none() { pixels.to_vec() } else { Vec::new() };
        let (origin, fingerprint) = (self.tracer.origin(), self.tracer.fingerprint());
        Profile { origin, fingerprint, pixels, cache }
    }

    fn check(&self, profile: &Profile) -> Result<(), RenderError> {
        Ok(self.own_cache(profile)?.iter().try_for_each(|cache| cache.check(&self.tracer))?)
    }

    fn share(&self, cache: Cache) -> Result<Shared, RenderError> {
        let reading = cache.reading_nanos();
        let (shared, taking) = clocked(|| self.take(cache));
        let shared = shared?;
        *self.shared.lock() = (shared.clone(), reading + taking);
        Ok(shared)
    }

    fn render(
        &self,
        reuse: Option<&Profile>,
        progress: &(dyn Fn(Progress) + Sync),
        finished: &PixelsFinished<'_>,
        cancel: &AtomicBool,
    ) -> Result<Option<Finished>, RenderError> {
        let pixels = self.tracer.frame().camera.pixels();
        let mut taken_over = CacheTotals::default();
        if let Some(cache) = reuse.map(|profile| self.own_cache(profile)).transpose()?.flatten() {
            taken_over = cache.totals();
            self.tracer.take_cache(cache)?;
        }
        if !self.fill(progress, cancel) {
            return Ok(None);
        }
        let traced = |done| progress(Progress { step: Step::Tracing, done, all: pixels as u64 });
        let image = self.tracer.render_watched(reuse, &traced, finished, cancel);
        Ok(image.map(|image| Finished { image, cache: self.cache_use(taken_over) }))
    }
}
