//! A frame, ready to be traced.

use crate::cache::{Cache, CacheError, RecordCost};
use crate::cost::{Cost, Tally, WorkByClass, WorkByRay, build_work, clocked};
use crate::effects::{CalledFor, Effects};
use crate::environment::Sky;
use crate::fingerprint::{fingerprint, light_fingerprint, of_content};
use crate::fresnel;
use crate::image::Image;
use crate::kernel::{Trace, kernel};
use crate::lights::{Lights, Looks, Luminaires};
use crate::media::{Media, Ranks};
use crate::origin::Origin;
use crate::profile::Profile;
use crate::reach::{LeftOut, Reach, reachable};
use crate::tiling::Tiling;
use crate::tree::Tree;
use crate::{Integrator, MaterialOverride, SampleCounts, SampleCountsError, Settings};
use forelight_bvh::Hit;
use forelight_scene::{Color, Frame, Material, Sun, Surface};
use glam::Vec3;
use parking_lot::Mutex;
use rayon::prelude::*;
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

/// Edge of the square tiles in which an image is worked off, pixels.
pub(crate) const TILE: u32 = 16;

/// One finished pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pixel {
    /// Linear Rec. 709 radiance, the mean over the samples.
    pub color: [f32; 3],
    /// Rays by category, in the order of [`crate::RAY_NAMES`].
    pub rays: [u32; 7],
    /// Deterministic work.
    pub work: u64,
    /// The same by the ray that brought it about.
    pub work_by_ray: WorkByRay,
    /// The part of `work` that is in the rays above the least of gathers where the irradiance cache had no record: later samples have fewer of them
    /// ([`crate::UncoveredGathers`]). All other work is in proportion to the samples.
    pub extra_work: u64,
    /// CPU time, nanoseconds.
    pub cpu_nanos: u64,
    /// Samples and gathers that asked the irradiance cache where it had no record, and gathered for themselves.
    pub uncovered: u32,
    /// Stratum that the first camera sample met, or [`Pixel::NOTHING`].
    pub stratum: u32,
}

/// Is given pixels of an image, by their row-major index, as soon as they are finished.
pub type PixelsFinished<'a> = dyn Fn(&[(u32, Pixel)]) + Sync + 'a;

impl Pixel {
    /// Stratum of a pixel whose first sample met no surface.
    pub const NOTHING: u32 = u32::MAX;
}

/// Everything that tracing a frame needs. Cheap to share between threads.
pub struct Tracer {
    pub(crate) frame: Frame,
    pub(crate) settings: Settings,
    pub(crate) bvh: Arc<Tree>,
    pub(crate) materials: Vec<Material>,
    /// What matters to the picture.
    reach: Reach,
    pub(crate) luminaires: Luminaires,
    /// Lights without surface that are looked at, by their indices in the frame.
    pub(crate) points: Vec<usize>,
    /// The same of distant lights.
    pub(crate) suns: Vec<usize>,
    /// Everything that shines, for choosing one light out of it; empty where the integrator does not choose so.
    pub(crate) lights: Lights,
    /// How many of the lights with a position a point looks at.
    pub(crate) looks: Looks,
    pub(crate) sky: Sky,
    /// Internal diffuse reflectance of each coated material.
    pub(crate) internal: Vec<f32>,
    /// Solid dielectrics that may overlap.
    pub(crate) ranks: Ranks,
    /// Those that the camera is inside of.
    pub(crate) camera_media: Media,
    /// Planned or taken over when it is first needed; never set if the settings ask for none.
    cache: OnceLock<Cache>,
    /// From which to plan.
    given: Mutex<Option<Cache>>,
    effects: Effects,
    pub(crate) kernel: Box<dyn Trace>,
    build: Cost,
    /// Work of all pixels that were traced so far, and of all gathers.
    pub(crate) pixel_work: Tally,
    pub(crate) gather_work: Tally,
    /// Camera samples by pixel, where they differ.
    samples: OnceLock<SampleCounts>,
    /// What the frame holds, hashed when it is first asked for.
    content: OnceLock<blake3::Hasher>,
}

impl Tracer {
    /// Builds the tree and finds the lights. The camera is resized to the settings' width and height. What cannot matter to the picture
    /// is left out: see [`Self::left_out`].
    pub fn new(frame: &Frame, settings: &Settings) -> Self {
        Self::build(frame, settings, None, false)
    }

    /// The same with a tree that was built for the same geometry. If this frame sees other triangles of it, it gets a tree of its own
    /// nevertheless.
    pub fn with_bvh(frame: &Frame, settings: &Settings, bvh: Arc<Tree>) -> Self {
        Self::build(frame, settings, Some(bvh), false)
    }

    /// The same with everything left in, whether it matters or not: for showing what leaving it out saves. Images keep their bits.
    /// (Lights that cannot matter are looked at, if all lights are; they are never among some that are chosen out of many.)
    pub fn complete(frame: &Frame, settings: &Settings) -> Self {
        Self::build(frame, settings, None, true)
    }

    fn build(frame: &Frame, settings: &Settings, bvh: Option<Arc<Tree>>, complete: bool) -> Self {
        let mut frame = frame.clone();
        frame.camera = frame.camera.resized(settings.width, settings.height);
        let materials: Vec<Material> = match settings.materials {
            MaterialOverride::Full => frame.materials.to_vec(),
            MaterialOverride::Lambert => frame.materials.iter().map(as_lambert).collect(),
        };
        let internal = materials.iter().map(|m| match m.surface {
            Surface::Plastic { ior, .. } => fresnel::internal_diffuse(ior),
            _ => 0.0,
        });
        let (reach, finding) = clocked(|| reachable(&frame, &materials));
        let everything = Reach::everything(&frame);
        let included = if complete { &everything } else { &reach };
        let known = bvh.filter(|bvh| bvh.is_over(&frame.geometry, included));
        let (bvh, build) = known.map(|bvh| (bvh, Cost::default())).unwrap_or_else(|| {
            let (tree, building) = clocked(|| Tree::new(&frame.geometry, included));
            let work = build_work(tree.triangles(frame.geometry.triangles.len()), tree.size().0);
            (Arc::new(tree), Cost { work, cpu_nanos: finding + building })
        });
        let luminaires = Luminaires::new(&frame, &reach, complete);
        let sky = if included.environment() { Sky::new(&frame) } else { Sky::Black };
        let points: Vec<usize> = (0..frame.points.len()).filter(|&i| included.point_light(i)).collect();
        let suns: Vec<usize> = (0..frame.suns.len()).filter(|&i| included.sun(i)).collect();
        // Of those that are put back, none is ever among the chosen.
        let choice =
            luminaires.reaching() + (0..frame.points.len()).filter(|&i| reach.point_light(i)).count();
        let looks = Looks::new(choice);
        let called_for = CalledFor {
            materials: &included.materials(&frame.geometry, &materials),
            area_lights: luminaires.all.len(),
            points: points.len(),
            suns: &suns.iter().map(|&i| frame.suns[i]).collect::<Vec<Sun>>(),
            looks,
            sky: &sky,
            camera: &frame.camera,
            settings,
        };
        let effects = called_for.effects();
        let chosen = settings.integrator == Integrator::Path || effects.has(Effects::LIGHT_CHOICE);
        let lights = if chosen { Lights::new(&frame, &materials, &sky, &reach) } else { Lights::default() };
        let mut tracer = Self {
            internal: internal.collect(),
            ranks: Ranks::new(&materials),
            camera_media: Media::default(),
            cache: OnceLock::new(),
            given: Mutex::default(),
            reach,
            luminaires,
            points,
            suns,
            lights,
            sky,
            effects,
            looks,
            kernel: kernel(effects, settings.integrator, looks),
            materials,
            settings: settings.clone(),
            bvh,
            frame,
            build,
            pixel_work: Tally::default(),
            gather_work: Tally::default(),
            samples: OnceLock::new(),
            content: OnceLock::new(),
        };
        if !tracer.ranks.is_empty() {
            tracer.camera_media = tracer.media_at(tracer.frame.camera.origin);
        }
        tracer
    }

    /// Gives every pixel a number of camera samples of its own, in place of [`Settings::spp`]; once. A pixel's first samples are the same
    /// whatever their number. What was planned or filled before stays as it is.
    ///
    /// # Errors
    /// If the numbers are not those of this image's pixels, or others were given before.
    pub fn allot(&self, samples: SampleCounts) -> Result<(), SampleCountsError> {
        samples.for_pixels(self.frame.camera.pixels())?;
        self.samples.set(samples).map_err(|_| SampleCountsError::Late)
    }

    /// Camera samples of a pixel.
    pub(crate) fn samples_of(&self, pixel: u32) -> u32 {
        self.samples.get().map_or(self.settings.spp, |samples| u32::from(samples.as_slice()[pixel as usize]))
    }

    /// Plans the irradiance cache, on the current thread pool, if one is called for and there is none.
    pub fn plan(&self) {
        if let Some(settings) = self.settings.cache.filter(|_| self.effects.has(Effects::CACHE)) {
            self.cache.get_or_init(|| {
                let mut cache = self.given.lock().take().unwrap_or_default();
                cache.plan(self, &settings);
                cache
            });
        }
    }

    /// Starts the plan from a cache that was planned, and perhaps filled, for this image or for others of the same scene and light;
    /// call it before [`Self::plan`]. What the image needs beyond it will be planned anew.
    pub fn take_cache(&self, cache: Cache) -> Result<(), CacheError> {
        cache.check(self)?;
        *self.given.lock() = Some(cache);
        Ok(())
    }

    /// Takes a cache as it is, without planning what this image needs beyond it: for filling it.
    ///
    /// # Errors
    /// If it belongs to another scene, other light or other settings.
    pub fn hold_cache(&self, cache: Cache) -> Result<&Cache, CacheError> {
        cache.check(self)?;
        Ok(self.cache.get_or_init(|| cache))
    }

    /// The frame's irradiance cache, planned and filled as far as it was.
    pub fn into_cache(self) -> Option<Cache> {
        self.cache.into_inner()
    }

    /// Hash of all that the records of a cache depend on.
    pub fn cache_fingerprint(&self) -> [u8; 32] {
        light_fingerprint(self.content(), &self.settings, &self.reach)
    }

    /// The frame's irradiance cache, if it is called for and planned.
    pub fn cache(&self) -> Option<&Cache> {
        self.cache.get()
    }

    /// The cache in a kernel that reads one.
    pub(crate) fn planned(&self) -> &Cache {
        self.cache.get().expect("what traces a frame plans its cache first")
    }

    /// Gathers the records that the cache lacks, on the current thread pool, having planned it if need be. `progress` is told the
    /// records done, and all records; `false` if `cancel` was set.
    pub fn fill(&self, progress: &(dyn Fn(u64, u64) + Sync), cancel: &AtomicBool) -> bool {
        self.plan();
        let Some(cache) = self.cache.get() else { return true };
        let records = cache.records();
        let all = records.iter().sum();
        let mut before = 0;
        // A level's gathers read the next one.
        for (level, &count) in records.iter().enumerate().rev() {
            if !cache.fill(self, level, 0..count as usize, &|done| progress(before + done, all), cancel) {
                return false;
            }
            before += count;
        }
        true
    }

    /// What gathering a few records takes, `each` of every level that has as many, spread evenly over space and begun as `seed` says:
    /// every record has the same chance. Those of the deepest level, whose values depend on no other record, are filled by it.
    pub fn sample_records(&self, each: usize, seed: u64) -> Vec<RecordCost> {
        self.plan();
        self.cache.get().map_or_else(Vec::new, |cache| cache.sample(self, each, seed))
    }

    /// The tree, to be shared with other frames of the same geometry.
    pub fn bvh(&self) -> &Arc<Tree> {
        &self.bvh
    }

    /// Lights and objects that cannot matter to the picture, and why. Unless the tracer is [`Self::complete`], they take no rays, no
    /// memory and no time.
    pub fn left_out(&self) -> &[LeftOut] {
        self.reach.left_out()
    }

    /// What was asked of it.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The frame as it is traced.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// What building the tree took, and finding out what belongs into it; nothing if it existed.
    pub fn build_cost(&self) -> Cost {
        self.build
    }

    /// Work by class of all that was traced so far: of pixels, and of the irradiance cache's gathers, without planning them.
    pub fn work_by_class(&self) -> (WorkByClass, WorkByClass) {
        (self.pixel_work.sum(), self.gather_work.sum())
    }

    /// Hash of all that a pixel's value depends on: frame, settings, and the version of this tracer.
    pub fn fingerprint(&self) -> [u8; 32] {
        fingerprint(self.content(), &self.frame, &self.settings, self.samples.get())
    }

    /// What is made for this image says that it was.
    pub fn origin(&self) -> Origin {
        Origin::of(self.content(), &self.frame, &self.settings)
    }

    fn content(&self) -> &blake3::Hasher {
        self.content.get_or_init(|| of_content(&self.frame))
    }

    /// The effects that this frame calls for.
    pub fn effects(&self) -> Effects {
        self.effects
    }

    /// The same, traced by a kernel that also holds code for effects that are not called for: for showing what leaving them out
    /// saves. Images and counters keep their bits.
    pub fn with_kernel_for(self, effects: Effects) -> Self {
        Self { kernel: kernel(self.effects | effects.bits(), self.settings.integrator, self.looks), ..self }
    }

    /// One finished pixel by its row-major index. Its colour, rays and work depend on nothing but frame, settings and index.
    /// With a cache that is not filled, all but the colour is.
    pub fn pixel(&self, index: u32) -> Pixel {
        self.plan();
        self.kernel.pixel(self, index, &mut |_| ())
    }

    /// The same as [`Self::profile`], with the radiance of every camera sample told to `each`, after the place of its pixel in `pixels`, in
    /// the order of the samples. Before each pixel `stop` is asked whether they are not wanted any more: then there are none.
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

    /// Gathers what the cache lacks for the colours of these pixels: the records of the first level that they read. The colours are then
    /// nearly those of the image: fewer records are averaged, so they are a little noisier, and deeper levels are followed by single rays. Once, and
    /// for these pixels alone: an image is not to be rendered by this tracer any more. On the current thread pool; says what
    /// that took, nothing without a cache. `None` if `stop` said on the way that they are not wanted any more.
    pub fn fill_for(&self, pixels: &[u32], stop: &(dyn Fn() -> bool + Sync)) -> Option<Cost> {
        self.plan();
        self.cache.get().map_or(Some(Cost::default()), |cache| cache.fill_for(self, pixels, stop))
    }

    /// Finished pixels by index, in the order given; see [`Self::pixel`] for their colours. With a cache, call [`Self::plan`] before
    /// calling this from several threads of a pool.
    pub fn profile(&self, pixels: &[u32]) -> Vec<Pixel> {
        self.plan();
        timed(|| pixels.iter().map(|&i| self.kernel.pixel(self, i, &mut |_| ())).collect())
    }

    /// The whole image, on the current rayon pool: pixels of `reuse` are taken over, the others traced. `progress` is told the
    /// number of pixels done, now and then; `None` is the answer when `cancel` was set.
    ///
    /// # Panics
    /// If `reuse` was made for another image: compare fingerprints first.
    pub fn render(
        &self,
        reuse: Option<&Profile>,
        progress: &(dyn Fn(u64) + Sync),
        cancel: &AtomicBool,
    ) -> Option<Image> {
        self.render_watched(reuse, progress, &|_| (), cancel)
    }

    /// The same; `finished` is given the pixels of every tile as soon as they are traced, also those of a tile in which the
    /// work was stopped.
    ///
    /// # Panics
    /// As [`Self::render`].
    pub fn render_watched(
        &self,
        reuse: Option<&Profile>,
        progress: &(dyn Fn(u64) + Sync),
        finished: &PixelsFinished<'_>,
        cancel: &AtomicBool,
    ) -> Option<Image> {
        let (width, height) = (self.settings.width, self.settings.height);
        let mut known: Vec<Option<Pixel>> = vec![None; (width * height) as usize];
        if let Some(profile) = reuse {
            assert_eq!(profile.fingerprint, self.fingerprint(), "the profile belongs to another image");
            for (index, pixel) in &profile.pixels {
                known[*index as usize] = Some(*pixel);
            }
        }
        if !self.fill(&|_, _| (), cancel) {
            return None;
        }
        let tiling = Tiling::new(width, height, TILE);
        let done = AtomicU64::new(0);
        let tiles: Vec<Vec<(u32, Pixel)>> = (0..tiling.count())
            .into_par_iter()
            .map(|tile| {
                if cancel.load(Ordering::Relaxed) {
                    return Vec::new();
                }
                let indices = tiling.pixels(tile);
                let traced: Vec<u32> =
                    indices.iter().copied().filter(|&i| known[i as usize].is_none()).collect();
                let wanted = || !cancel.load(Ordering::Relaxed);
                let pixels = || {
                    traced
                        .iter()
                        .take_while(|_| wanted())
                        .map(|&i| self.kernel.pixel(self, i, &mut |_| ()))
                        .collect()
                };
                let values = timed(pixels);
                let tile: Vec<(u32, Pixel)> = traced.into_iter().zip(values).collect();
                finished(&tile);
                progress(done.fetch_add(indices.len() as u64, Ordering::Relaxed) + indices.len() as u64);
                tile
            })
            .collect();
        if cancel.load(Ordering::Relaxed) {
            return None;
        }
        let reused = known.iter().map(Option::is_some).collect();
        for (index, pixel) in tiles.into_iter().flatten() {
            known[index as usize] = Some(pixel);
        }
        let pixels: Option<Vec<Pixel>> = known.into_iter().collect();
        Some(Image { width, height, pixels: pixels?, reused })
    }

    /// Whether a surface is there at a hit, or cut out by its texture.
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

/// Traces a batch of pixels and turns their wall-clock times into CPU time: see [`share_cpu_time`].
fn timed(trace: impl FnOnce() -> Vec<Pixel>) -> Vec<Pixel> {
    let mut pixels = Vec::new();
    share_cpu_time(|| {
        pixels = trace();
        pixels.iter_mut().map(|pixel| (0, &mut pixel.cpu_nanos)).collect()
    });
    pixels
}

/// Runs what traces some pixels and turns the wall-clock time that it has added to each, from what was there before, into CPU time. A pixel's
/// clock is cheap but counts what other processes took; the thread's CPU clock is exact but too dear to read twice a pixel. So each
/// pixel gets the share of the batch's CPU time that it had of the batch's wall time.
pub(crate) fn share_cpu_time<'a>(trace: impl FnOnce() -> Vec<(u64, &'a mut u64)>) {
    let (pixels, cpu) = clocked(trace);
    let wall: u64 = pixels.iter().map(|(before, now)| **now - before).sum();
    if wall > 0 {
        let share = cpu as f64 / wall as f64;
        for (before, now) in pixels {
            *now = before + ((*now - before) as f64 * share).round() as u64;
        }
    }
}

/// The material as two-sided Lambert: its diffuse colour or texture, 0.5 grey for metals and glass. Emission stays.
fn as_lambert(material: &Material) -> Material {
    let albedo = match material.surface {
        Surface::Lambert { albedo } | Surface::Plastic { albedo, .. } => albedo,
        _ => Color::plain(Vec3::splat(0.5)),
    };
    Material { surface: Surface::Lambert { albedo }, ..material.clone() }
}
