//! A frame, ready to be traced. [`Tracer::new`] builds the tree, collects the lights and composes the kernel.
//! Tracers can be shared between threads.

mod beside;
mod prepare;

use crate::cache::{Cache, CacheError, RecordCost, SecondaryLights};
use crate::cost::{Cost, Tally, WorkByClass, clocked, share_cpu_time};
use crate::effects::Effects;
use crate::environment::Sky;
use crate::fingerprint::{fingerprint, light_fingerprint, of_content};
use crate::image::Image;
use crate::integrator::Kernel;
use crate::lights::{Lights, Looks, Luminaires};
use crate::media::{Media, Ranks};
use crate::origin::Origin;
use crate::pixel::{Pixel, PixelsFinished, Underway};
use crate::profile::Profile;
use crate::reach::{LeftOut, Reach};
use crate::tiling::{TILE, Tiling};
use crate::tree::{Tree, TreeCost};
use crate::{SampleCounts, SampleCountsError, Settings};
use forelight_bvh::Hit;
use forelight_scene::{Frame, Material};
use parking_lot::Mutex;
use rayon::prelude::*;
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

pub use prepare::Trees;

/// Pixels per batch of [`Tracer::first_samples`]: thread clocks are read rarely, and every thread has work.
const TOGETHER: usize = 64;

/// Everything needed to trace a frame. Threads can share it.
pub struct Tracer {
    pub(crate) frame: Frame,
    pub(crate) settings: Settings,
    pub(crate) bvh: Arc<Tree>,
    pub(crate) materials: Vec<Material>,
    /// What can affect the image.
    reach: Reach,
    pub(crate) luminaires: Luminaires,
    /// Indices of the point lights that are sampled.
    pub(crate) points: Vec<usize>,
    /// Indices of the suns that are sampled.
    pub(crate) suns: Vec<usize>,
    /// All lights, for choosing one of them. Empty if the integrator never chooses.
    pub(crate) lights: Lights,
    /// Number of lights with a position that each point samples.
    pub(crate) looks: Looks,
    pub(crate) sky: Sky,
    /// Internal diffuse reflectance of each coated material.
    pub(crate) internal: Vec<f32>,
    /// Priorities of solid dielectrics.
    pub(crate) ranks: Ranks,
    /// The solids that contain the camera.
    pub(crate) camera_media: Media,
    /// Planned or taken over when first needed. Never set if the settings have no cache.
    cache: OnceLock<Cache>,
    /// A cache from which planning starts.
    given: Mutex<Option<Cache>>,
    effects: Effects,
    pub(crate) kernel: Kernel,
    tree: TreeCost,
    /// Work of all pixels traced so far, and of all gathers.
    pub(crate) pixel_work: Tally,
    pub(crate) gather_work: Tally,
    /// Camera samples by pixel, if they differ.
    samples: OnceLock<SampleCounts>,
    /// Hash state of the frame's content, computed when first needed.
    content: OnceLock<blake3::Hasher>,
}

impl Tracer {
    /// Sets the number of camera samples of each pixel, in place of [`Settings::spp`]. A pixel's first
    /// samples and an existing cache do not depend on it. Fails on a second call, or if there is not one
    /// number per pixel.
    pub fn allot(&self, samples: SampleCounts) -> Result<(), SampleCountsError> {
        samples.for_pixels(self.frame.camera.pixels())?;
        self.samples.set(samples).map_err(|_| SampleCountsError::Late)
    }

    /// Number of camera samples of a pixel.
    pub(crate) fn samples_of(&self, pixel: u32) -> u32 {
        self.samples.get().map_or(self.settings.spp, |samples| u32::from(samples.as_slice()[pixel as usize]))
    }

    /// Plans the irradiance cache on the current thread pool, if the frame needs one and has none.
    pub fn plan(&self) {
        if let Some(settings) = self.settings.cache.filter(|_| self.effects.has(Effects::CACHE)) {
            self.cache.get_or_init(|| {
                let mut cache = self.given.lock().take().unwrap_or_default();
                cache.plan(self, &settings);
                cache
            });
        }
    }

    /// Sets a cache from which planning starts, before [`Self::plan`]. It may be planned or filled, for any
    /// image with the same scene and light. Fails if scene, light or settings differ.
    pub fn take_cache(&self, cache: Cache) -> Result<(), CacheError> {
        cache.check(self)?;
        *self.given.lock() = Some(cache);
        Ok(())
    }

    /// Uses a cache as it is, without planning more records; serves to fill it. Fails if scene, light or
    /// settings differ.
    pub fn hold_cache(&self, cache: Cache) -> Result<&Cache, CacheError> {
        cache.check(self)?;
        Ok(self.cache.get_or_init(|| cache))
    }

    /// The frame's irradiance cache in its current state.
    pub fn into_cache(self) -> Option<Cache> {
        self.cache.into_inner()
    }

    /// Hash of everything that the records of a cache depend on.
    pub fn cache_fingerprint(&self) -> [u8; 32] {
        light_fingerprint(self.content(), &self.settings, &self.reach)
    }

    /// The frame's irradiance cache, if it is needed and planned.
    pub fn cache(&self) -> Option<&Cache> {
        self.cache.get()
    }

    /// The cache, for kernels that read one.
    pub(crate) fn planned(&self) -> &Cache {
        self.cache.get().expect("the cache is planned before a kernel reads it")
    }

    /// The secondary lights of the cache. None without a cache.
    pub(crate) fn secondary_lights(&self) -> &SecondaryLights {
        static NONE: SecondaryLights = SecondaryLights::none();
        self.cache.get().and_then(Cache::secondary_lights).unwrap_or(&NONE)
    }

    /// Plans the cache if necessary, and gathers its missing records on the current thread pool. `progress`
    /// receives the number of these done, and all of them. Returns `false` if `cancel` was set.
    pub fn fill(&self, progress: &(dyn Fn(u64, u64) + Sync), cancel: &AtomicBool) -> bool {
        self.plan();
        let Some(cache) = self.cache.get() else { return true };
        let unfilled: Vec<Vec<usize>> =
            (0..cache.records().len()).map(|level| cache.unfilled(level)).collect();
        let all = unfilled.iter().map(|level| level.len() as u64).sum();
        let mut before = 0;
        // The gathers of a level read the next level.
        for (level, records) in unfilled.iter().enumerate().rev() {
            if !cache.fill(self, level, records, &|done| progress(before + done, all), cancel) {
                return false;
            }
            before += records.len() as u64;
        }
        true
    }

    /// Gathers `each` records of every level, or all, to measure their cost. They are spread evenly over
    /// space, with equal probability; `seed` selects the start. Records of the deepest level are kept.
    pub fn sample_records(&self, each: usize, seed: u64) -> Vec<RecordCost> {
        self.plan();
        self.cache.get().map_or_else(Vec::new, |cache| cache.sample(self, each, seed))
    }

    /// The tree, to be shared with other frames of the same geometry.
    pub fn bvh(&self) -> &Arc<Tree> {
        &self.bvh
    }

    /// Lights and objects that cannot affect the image, with reasons. They cost nothing, unless the tracer is
    /// [`Self::complete`].
    pub fn left_out(&self) -> &[LeftOut] {
        self.reach.left_out()
    }

    /// The settings of the image.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The frame as it is traced, with the resized camera.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Costs of the tree, and of finding what can affect the image. Zero for a tree that was given.
    pub fn tree_cost(&self) -> TreeCost {
        self.tree
    }

    /// Work by class so far: of all pixels, and of the cache's gathers. Planning is not included.
    pub fn work_by_class(&self) -> (WorkByClass, WorkByClass) {
        (self.pixel_work.sum(), self.gather_work.sum())
    }

    /// Hash of everything that a pixel depends on: frame, settings, and the version of this tracer.
    pub fn fingerprint(&self) -> [u8; 32] {
        fingerprint(self.content(), &self.frame, &self.settings, self.samples.get())
    }

    /// The origin to store in files made for this image.
    pub fn origin(&self) -> Origin {
        Origin::of(self.content(), &self.frame, &self.settings)
    }

    fn content(&self) -> &blake3::Hasher {
        self.content.get_or_init(|| of_content(&self.frame))
    }

    /// The effects that this frame needs.
    pub fn effects(&self) -> Effects {
        self.effects
    }

    /// Traces one pixel, by row-major index. Colour, rays and work depend only on frame, settings and index.
    /// With a cache that is not filled, the colour is not valid.
    pub fn pixel(&self, index: u32) -> Pixel {
        self.plan();
        self.kernel.pixel(self, index, &mut |_| ())
    }

    /// Like [`Self::profile`], and passes each camera sample to `each`: the position in `pixels` and the
    /// radiance, in order. `stop` is called before each pixel; if it returns `true`, the result is `None`.
    pub fn profile_samples(
        &self,
        pixels: &[u32],
        each: &mut dyn FnMut(usize, [f32; 3]),
        stop: &dyn Fn() -> bool,
    ) -> Option<Vec<Pixel>> {
        self.plan();
        let mut traced = |(place, &index): (usize, &u32)| {
            (!stop()).then(|| self.kernel.pixel(self, index, &mut |sample| each(place, sample)))
        };
        let traced: Vec<Pixel> = timed(|| pixels.iter().enumerate().map_while(&mut traced).collect());
        (traced.len() == pixels.len()).then_some(traced)
    }

    /// Gathers the records of the first level that these pixels read, on the current thread pool. Returns the
    /// cost, zero without a cache, or `None` if `stop` returned `true`. Colours are then slightly noisier
    /// than in the image. Call it once; the tracer can then only trace these pixels.
    pub fn fill_for(&self, pixels: &[u32], stop: &(dyn Fn() -> bool + Sync)) -> Option<Cost> {
        self.plan();
        self.cache.get().map_or(Some(Cost::default()), |cache| cache.fill_for(self, pixels, stop))
    }

    /// Traces pixels by row-major indices, in the given order; see [`Self::pixel`]. With a cache, call
    /// [`Self::plan`] before calling this from several threads of a pool.
    pub fn profile(&self, pixels: &[u32]) -> Vec<Pixel> {
        self.plan();
        timed(|| pixels.iter().map(|&i| self.kernel.pixel(self, i, &mut |_| ())).collect())
    }

    /// Renders the whole image on the current thread pool, except for pixels in `reuse`. `progress` receives
    /// the number of pixels done. `None` if `cancel` was set.
    ///
    /// # Panics
    /// If `reuse` was made for another image. Compare fingerprints first.
    pub fn render(
        &self,
        reuse: Option<&Profile>,
        progress: &(dyn Fn(u64) + Sync),
        cancel: &AtomicBool,
    ) -> Option<Image> {
        self.render_watched(reuse, progress, &|_| (), cancel)
    }

    /// Like [`Self::render`], and passes the pixels of each tile to `finished` once traced, including those
    /// of an interrupted tile. Panics like it.
    pub fn render_watched(
        &self,
        reuse: Option<&Profile>,
        progress: &(dyn Fn(u64) + Sync),
        finished: &PixelsFinished<'_>,
        cancel: &AtomicBool,
    ) -> Option<Image> {
        let mut known: Vec<Option<Pixel>> = vec![None; self.frame.camera.pixels()];
        if let Some(profile) = reuse {
            assert_eq!(profile.fingerprint, self.fingerprint(), "the profile belongs to another image");
            for (index, pixel) in &profile.pixels {
                known[*index as usize] = Some(*pixel);
            }
        }
        self.render_rest(known, progress, finished, cancel)
    }

    /// Like [`Self::render_watched`], with finished pixels in row-major order. Those that are `None` are
    /// traced. There must be one entry per pixel.
    pub fn render_rest(
        &self,
        mut known: Vec<Option<Pixel>>,
        progress: &(dyn Fn(u64) + Sync),
        finished: &PixelsFinished<'_>,
        cancel: &AtomicBool,
    ) -> Option<Image> {
        if !self.fill(&|_, _| (), cancel) {
            return None;
        }
        let (width, height) = (self.settings.width, self.settings.height);
        let tiling = Tiling::new(width, height, TILE);
        let reused: Vec<bool> = known.iter().map(Option::is_some).collect();
        let open = |tile: u32| tiling.pixels(tile).into_iter().filter(|&i| !reused[i as usize]).collect();
        let tiles: Vec<Vec<u32>> = (0..tiling.count()).map(open).collect();
        let before = reused.iter().filter(|&&known| known).count() as u64;
        progress(before);
        let traced = self.trace(&tiles, &|| false, &|done| progress(before + done), finished, cancel)?;
        for (index, pixel) in traced.into_iter().flatten() {
            known[index as usize] = Some(pixel);
        }
        let pixels: Option<Vec<Pixel>> = known.into_iter().collect();
        Some(Image { width, height, pixels: pixels?, reused, denoised: None })
    }

    /// Traces lists of pixels, by row-major indices, on the current thread pool. Lists are begun in their
    /// order, and one thread traces a list, in its order. Any cache must be filled. No further list is begun
    /// once `enough` returns true: the lists returned are the first ones. `progress` receives the number of
    /// pixels done, and `finished` the pixels of each list once traced, including those of an interrupted
    /// one. `None` if `cancel` was set.
    pub fn trace(
        &self,
        lists: &[Vec<u32>],
        enough: &(dyn Fn() -> bool + Sync),
        progress: &(dyn Fn(u64) + Sync),
        finished: &PixelsFinished<'_>,
        cancel: &AtomicBool,
    ) -> Option<Vec<Vec<(u32, Pixel)>>> {
        let (next, done) = (AtomicUsize::new(0), AtomicU64::new(0));
        let wanted = || !cancel.load(Ordering::Relaxed);
        let trace = |list: &Vec<u32>| {
            let pixels = || {
                let wanted = list.iter().take_while(|_| wanted());
                wanted.map(|&i| self.kernel.pixel(self, i, &mut |_| ())).collect()
            };
            let traced: Vec<(u32, Pixel)> = list.iter().copied().zip(timed(pixels)).collect();
            if !traced.is_empty() {
                finished(&traced);
            }
            let count = list.len() as u64;
            progress(done.fetch_add(count, Ordering::Relaxed) + count);
            traced
        };
        // Each thread takes the next list that nobody has begun.
        let take = |_| {
            let mut own = Vec::new();
            while wanted() && !enough() {
                let place = next.fetch_add(1, Ordering::Relaxed);
                let Some(list) = lists.get(place) else { break };
                own.push((place, trace(list)));
            }
            own
        };
        let threads = rayon::current_num_threads();
        let traced: Vec<Vec<_>> = (0..threads).into_par_iter().with_max_len(1).map(take).collect();
        let mut traced: Vec<_> = traced.into_iter().flatten().collect();
        traced.sort_unstable_by_key(|(place, _)| *place);
        wanted().then(|| traced.into_iter().map(|(_, pixels)| pixels).collect())
    }

    /// Traces the first camera samples alone of pixels, by row-major index, on the current thread pool.
    /// Returns each pixel after one sample, after two, and so on up to `samples`, and the cost. `None` if
    /// `stop` returned `true`.
    pub fn first_samples(
        &self,
        pixels: &[u32],
        samples: u32,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<(Vec<Vec<Pixel>>, Cost)> {
        self.plan();
        let first = |&index: &u32| -> Vec<Pixel> {
            let mut underway = Underway::default();
            let mut after = |samples| {
                self.kernel.go_on(self, index, &mut underway, samples, &mut |_| ());
                underway.finished()
            };
            (1..=samples).map(&mut after).collect()
        };
        let batch = |batch: &[u32]| {
            (!stop()).then(|| clocked(|| batch.iter().map(first).collect::<Vec<Vec<Pixel>>>()))
        };
        let batches = pixels.par_chunks(TOGETHER).map(batch).collect::<Option<Vec<_>>>()?;
        let (pixels, nanos): (Vec<_>, Vec<u64>) = batches.into_iter().unzip();
        let pixels = pixels.concat();
        let work = pixels.iter().filter_map(|after| after.last()).map(|pixel| pixel.work).sum();
        Some((pixels, Cost { work, cpu_nanos: nanos.into_iter().sum() }))
    }

    /// Returns `true` if the surface exists at a hit, `false` if its texture cuts it out.
    pub(crate) fn present(&self, hit: &Hit, texels: &Cell<u64>) -> bool {
        let geometry = &self.frame.geometry;
        match self.materials[geometry.material(hit.primitive) as usize].mask {
            None => true,
            Some(mask) => {
                texels.set(texels.get() + 1);
                let uv = geometry.uv(hit.primitive, hit.u, hit.v);
                self.frame.textures[mask.texture.0 as usize].alpha(uv) >= mask.cutoff
            }
        }
    }
}

/// Traces a batch of pixels, and converts their wall-clock times to CPU times; see [`share_cpu_time`].
fn timed(trace: impl FnOnce() -> Vec<Pixel>) -> Vec<Pixel> {
    let mut pixels = Vec::new();
    share_cpu_time(|| {
        pixels = trace();
        pixels.iter_mut().map(|pixel| (0, &mut pixel.cpu_nanos)).collect()
    });
    pixels
}
