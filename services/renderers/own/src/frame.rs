//! One frame, ready to be traced.

use crate::accuracy::Blocks;
use crate::answers::{CacheUse, Finished, Previewed, Progress, Step};
use crate::costs::{by_class, spent, spent_on};
use crate::error::RenderError;
use crate::preview_cost::{backend, preview_spent};
use crate::shot::{OwnShot, Ready, records};
use forelight_forecast::accuracy::{PixelNoise, PixelSamples};
use forelight_protocol::RenderSettings;
use forelight_protocol::{ByClass, FixedCosts, LeftOut, ProcessCosts, Spent};
use forelight_scene::Frame;
use forelight_tracer::{
    Cache, CacheTotals, Effects, Passes, Pixel, PixelsFinished, Profile, RecordCost, SampleCounts, Settings,
    Shared, Totals, Tracer, clocked,
};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// A frame at one quality, ready to be previewed, profiled and rendered. It counts what each of these costs.
pub struct OwnFrame<'a> {
    pub(crate) shot: &'a OwnShot,
    pub(crate) tracer: Tracer,
    /// CPU time of reading and taking over a cache that was made before, nanoseconds.
    pub(crate) taking: AtomicU64,
    /// Without the cache plan.
    pub(crate) fixed: FixedCosts,
    pub(crate) built_now: Spent,
}

impl OwnShot {
    /// Sets up one frame.
    pub fn frame(&self, frame: u32, settings: &RenderSettings) -> Result<OwnFrame<'_>, RenderError> {
        let settings = Settings::from(settings);
        let (frame, moved) = clocked(|| self.frame_of(frame, &settings));
        let frame = frame?;
        let Ready { tracer, own_tree, built_now } = self.tracer(&frame, &settings);
        Ok(OwnFrame {
            shot: self,
            tracer,
            taking: AtomicU64::default(),
            fixed: FixedCosts {
                load: Spent { work: 0, cpu_nanos: moved },
                build: own_tree,
                ..FixedCosts::default()
            },
            built_now,
        })
    }
}

impl OwnFrame<'_> {
    /// Totals of the irradiance cache, if there is one. A cache that was given is taken now if it was not needed
    /// before.
    pub(crate) fn cache_use(&self, taken_over: CacheTotals) -> Option<CacheUse> {
        self.tracer.plan();
        let use_of =
            |cache: &Cache| CacheUse { all: cache.totals(), taken_over, shared: cache.shared().clone() };
        self.tracer.cache().map(use_of)
    }

    /// The cache in a profile of this image, if it holds one.
    pub(crate) fn own_cache(&self, profile: &Profile) -> Result<Option<Cache>, RenderError> {
        let pixels = self.tracer.frame().camera.pixels();
        if profile.fingerprint != self.tracer.fingerprint() || !profile.fits(pixels) {
            let differs = profile.origin.unlike_image(&self.tracer.origin());
            return Err(RenderError::ForeignProfile { differs });
        }
        Ok(profile.cache.as_deref().map(Cache::from_bytes).transpose()?)
    }

    /// Takes the shared cache, as far as it is valid here.
    fn take(&self, cache: Cache) -> Result<Shared, RenderError> {
        if cache.suits(&self.tracer) {
            let kept = cache.records();
            let shared = Shared { dropped: vec![0; kept.len()], kept };
            self.tracer.take_cache(cache.as_given(shared.clone()))?;
            return Ok(shared);
        }
        let settings = self.tracer.settings();
        let from = self.shot.tracer(&self.shot.frame_of(cache.frame(), settings)?, settings).tracer;
        cache.check(&from)?;
        let (carried, shared) = cache.carried(&from, &self.tracer);
        self.tracer.take_cache(carried.as_given(shared.clone()))?;
        Ok(shared)
    }

    /// Finished pixels on the current thread, with their noise. `None` if `stop` returned true.
    fn traced(&self, pixels: &[u32], stop: &dyn Fn() -> bool) -> Option<Vec<(Pixel, PixelNoise)>> {
        let mut samples = vec![PixelSamples::default(); pixels.len()];
        let mut each = |place: usize, sample| samples[place].push(sample);
        let traced = self.tracer.profile_samples(pixels, &mut each, stop)?;
        Some(traced.into_iter().zip(samples.iter().map(PixelSamples::noise)).collect())
    }
}

/// Pixels per batch: thread clocks are read rarely, and every thread has work.
const BATCH: usize = 16;

impl OwnFrame<'_> {
    /// The frame as it is traced.
    pub fn frame(&self) -> &Frame {
        self.tracer.frame()
    }

    /// What each pixel shows.
    pub fn preview(&self) -> Result<Previewed, RenderError> {
        let frame = self.tracer.frame();
        Ok(self.shot.previewer.with(|previewer| {
            let preview = previewer.preview(frame)?;
            Ok(Previewed { preview, backend: backend(previewer), spent: preview_spent(previewer, frame, 0) })
        })?)
    }

    /// Costs of every render of this frame that do not depend on its pixels: set-up (`load`), the cache
    /// plan (`plan`, made now if needed) and, if something moves in the shot, an acceleration structure
    /// (`build`). Reusing a structure changes nothing: the cost does not depend on earlier work.
    pub fn fixed(&self) -> FixedCosts {
        self.tracer.plan();
        match self.tracer.cache() {
            None => self.fixed,
            Some(cache) => {
                let CacheTotals { plan, plan_rays, .. } = cache.totals();
                let taking = Spent { work: 0, cpu_nanos: self.taking.load(Ordering::Relaxed) };
                FixedCosts { plan: spent(plan).plus(taking), plan_rays, ..self.fixed }
            }
        }
    }

    /// What this process has paid once for the shot: loading, and a shared acceleration structure.
    pub fn once(&self) -> ProcessCosts {
        self.shot.once()
    }

    /// Records of the irradiance cache by level, which is planned now if needed. Empty without a cache.
    pub fn cache_records(&self) -> Vec<u32> {
        self.tracer.plan();
        records(&self.tracer)
    }

    /// Cost of setting the frame up this time, without the cache plan. Includes any acceleration structure
    /// that was built, even the shot's, which is in no frame's cost.
    pub fn spent_on_setup(&self) -> Spent {
        self.fixed.load.plus(self.built_now)
    }

    /// Effects of the frame by name, sorted.
    pub fn effects(&self) -> Vec<String> {
        // Not a matter of tracing, but frames of such a shot cannot share an acceleration structure.
        let motion = self.shot.moves.then_some("motion");
        let mut effects: Vec<String> =
            self.tracer.effects().names().chain(motion).map(str::to_owned).collect();
        effects.sort();
        effects
    }

    /// Lights and objects that cannot matter to the image, and why.
    pub fn left_out(&self) -> Vec<LeftOut> {
        let all = self.tracer.left_out();
        let shown = if all.len() > LeftOut::MOST { LeftOut::MOST - 1 } else { all.len() };
        let entry = |what: String, reason: String| LeftOut { what, reason };
        let first = all[..shown].iter().map(|left| entry(left.what.to_string(), left.reason.to_string()));
        let others = all.len() - shown;
        let rest = (others > 0).then(|| entry(format!("{others} others"), "as those before them".into()));
        first.chain(rest).collect()
    }

    /// Work by class of everything traced so far: of pixels, and of gathering records.
    pub fn work_by_class(&self) -> (ByClass, ByClass) {
        let triangles = self.tracer.frame().geometry.triangles.len();
        let (pixels, gathers) = self.tracer.work_by_class();
        (by_class(pixels, triangles), by_class(gathers, triangles))
    }

    /// The same. `None` if `stop` returned true.
    pub fn trace_unless(
        &self,
        pixels: &[u32],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<(Pixel, PixelNoise)>> {
        self.tracer.plan();
        let batches = pixels.par_chunks(BATCH).map(|batch| self.traced(batch, stop));
        Some(batches.collect::<Option<Vec<_>>>()?.concat())
    }

    /// Fills the irradiance cache as far as these pixels need, on the current thread pool. Colours are then
    /// nearly final: a full cache averages its records. `None` if `stop` returned true.
    pub fn fill_for(&self, pixels: &[u32], stop: &(dyn Fn() -> bool + Sync)) -> Option<Spent> {
        self.tracer.fill_for(pixels, stop).map(spent)
    }

    /// Plans and fills any irradiance cache, on the current thread pool. `false` if `cancel` was set.
    pub fn fill(&self, progress: &(dyn Fn(Progress) + Sync), cancel: &AtomicBool) -> bool {
        if !self.tracer.effects().has(Effects::CACHE) {
            return true;
        }
        progress(Progress { step: Step::Planning, done: 0, all: 1 });
        self.tracer.plan();
        self.tracer.fill(&|done, all| progress(Progress { step: Step::Filling, done, all }), cancel)
    }

    /// The image in blocks of pixels, and its cost. Any cache must be filled. Uses the current thread pool. `None`
    /// if `cancel` was set.
    pub fn blocks(&self, seed: u64, cancel: &AtomicBool) -> Option<(Blocks, Spent)> {
        Blocks::of(&self.tracer, seed, cancel).map(|(blocks, cost)| (blocks, spent(cost)))
    }

    /// Cost of the irradiance cache so far: planning and gathering. Zero without one.
    pub fn spent_on_cache(&self) -> Spent {
        let of = |totals: CacheTotals| spent(totals.plan).plus(spent(totals.fill));
        self.tracer.cache().map_or_else(Spent::default, |cache| of(cache.totals()))
    }

    /// Whether traced pixels have the image's colours: without an irradiance cache, or once it is filled. It is
    /// planned now if needed.
    pub fn has_final_colours(&self) -> bool {
        self.tracer.plan();
        self.tracer.cache().is_none_or(Cache::is_complete)
    }

    /// Sets the camera samples of every pixel. Can be called once.
    pub fn allot(&self, samples: SampleCounts) -> Result<(), RenderError> {
        Ok(self.tracer.allot(samples)?)
    }

    /// Starts an image in passes, without samples.
    pub fn begin(&self) -> Passes {
        Passes::new(&self.tracer)
    }

    /// Brings pixels to these camera samples, on the current thread pool. Any irradiance cache must be
    /// filled. `stop` is checked before each pixel. `progress` is called [`Passes::parts`] times.
    pub fn go_on(
        &self,
        passes: &mut Passes,
        wanted: &SampleCounts,
        stop: &(dyn Fn() -> bool + Sync),
        progress: &(dyn Fn() + Sync),
    ) -> Result<Totals, RenderError> {
        Ok(passes.go_on(&self.tracer, wanted, stop, &|_| progress())?)
    }

    /// The image so far.
    pub fn finished(&self, passes: &Passes) -> Finished {
        Finished { image: passes.image(), cache: self.cache_use(CacheTotals::default()) }
    }

    /// As [`OwnFrame::trace_unless`] for runs of pixels. One thread traces a run in order, like a tile.
    pub fn trace_runs(
        &self,
        runs: &[Vec<u32>],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<Vec<(Pixel, PixelNoise)>>> {
        self.tracer.plan();
        runs.par_iter().map(|run| self.traced(run, stop)).collect()
    }

    /// Costs of gathering `each` records of every level, chosen uniformly, on the current thread pool.
    pub fn sample_records(&self, each: usize, seed: u64) -> Vec<RecordCost> {
        self.tracer.sample_records(each, seed)
    }

    /// A profile for [`OwnFrame::render`]: these pixels or, with an irradiance cache, the cache so far.
    pub fn profile(&self, pixels: &[(u32, Pixel)]) -> Profile {
        let cache = self.tracer.cache().map(|cache| cache.to_bytes());
        // Pixels that read an unfilled cache do not have the image's colours.
        let pixels = if cache.is_none() { pixels.to_vec() } else { Vec::new() };
        let (origin, fingerprint) = (self.tracer.origin(), self.tracer.fingerprint());
        Profile { origin, fingerprint, pixels, cache }
    }

    /// Checks that [`OwnFrame::render`] can take over a profile.
    pub fn check(&self, profile: &Profile) -> Result<(), RenderError> {
        Ok(self.own_cache(profile)?.iter().try_for_each(|cache| cache.check(&self.tracer))?)
    }

    /// Gives the frame the shared cache, before anything is planned. Records whose light has changed here are
    /// dropped, and the frame plans what it lacks. Returns both counts.
    pub fn share(&self, cache: Cache) -> Result<Shared, RenderError> {
        let reading = cache.reading_nanos();
        let (shared, taking) = clocked(|| self.take(cache));
        let shared = shared?;
        self.taking.store(reading + taking, Ordering::Relaxed);
        Ok(shared)
    }

    /// Renders the image on the current thread pool, taking over `reuse`. `None` if `cancel` was set.
    pub fn render(
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

    /// Colours of pixels with their first camera samples, for each of these numbers of samples, and the cost.
    /// Uses the current thread pool. `None` if `stop` returned `true`.
    pub(crate) fn trace_first(
        &self,
        pixels: &[u32],
        numbers: &[u32],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<(Vec<Vec<[f32; 3]>>, Spent)> {
        self.tracer.plan();
        let batch = |pixels: &[u32]| {
            let mut samples = vec![Vec::new(); pixels.len()];
            let mut each = |place: usize, sample: [f32; 3]| samples[place].push(sample);
            let traced = self.tracer.profile_samples(pixels, &mut each, stop)?;
            Some(traced.into_iter().zip(samples).collect::<Vec<_>>())
        };
        let batches = pixels.par_chunks(BATCH).map(batch).collect::<Option<Vec<_>>>()?;
        let traced = batches.concat();
        let mean = |samples: &[[f32; 3]]| -> [f32; 3] {
            let sum = |channel: usize| samples.iter().map(|sample| f64::from(sample[channel])).sum::<f64>();
            std::array::from_fn(|channel| (sum(channel) / samples.len() as f64) as f32)
        };
        let first = |&number: &u32| {
            traced.iter().map(|(_, samples)| mean(&samples[..number as usize])).collect::<Vec<_>>()
        };
        let all = traced.iter().map(|(pixel, _)| spent_on(pixel)).sum();
        Some((numbers.iter().map(first).collect(), all))
    }

    /// Traces pixels by index, in order, on the current thread pool. Returns them with their noise. Their
    /// colours are final once the irradiance cache, if there is one, is filled ([`OwnFrame::fill_for`]).
    pub fn trace(&self, pixels: &[u32]) -> Vec<(Pixel, PixelNoise)> {
        self.trace_unless(pixels, &|| false).unwrap_or_default()
    }
}
