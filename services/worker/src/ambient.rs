//! Our renderer: `scene`, `preview` and the `ambient` integrator of `tracer`.

use crate::classes::by_class;
use crate::render::{counts, spent};
use crate::renderer::{
    CacheUse, Counted, Finished, FrameRenderer, OpenRenderer, Previewed, Progress, RenderError, Renderer,
    ShotInfo, Step, StratumInfo,
};
use forelight_forecast::accuracy::{PixelNoise, PixelSamples};
use forelight_preview::{Choice, PreviewError, Previewer};
use forelight_protocol::{
    ByClass, CacheMode, FixedCosts, Integrator, LeftOut, MaterialMode, PreviewBackend, RenderSettings,
    SceneDigest, SceneSummary, Spent, StratumName,
};
use forelight_scene::{Frame, Geometry, Limits, Scene};
use forelight_tracer::{
    Cache, CacheSettings, CacheTotals, Effects, MaterialOverride, Passes, Pixel, PixelsFinished, Profile,
    RecordCost, SampleCounts, Settings, Shared, Totals, Tracer, thread_cpu_nanos, tracer_version,
};
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Opens bundles for our renderer. One previewer serves them all: a process has one device.
#[derive(Clone)]
pub struct Ambient {
    previewer: Arc<SharedPreviewer>,
    limits: Limits,
}

/// A graphics device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Adapter {
    /// Its name, kind and driver.
    pub name: String,
    /// Whether it is a graphics processor, and no program that does its work.
    pub is_hardware: bool,
}

/// The previewer, made when it is first wanted: opening a graphics device takes longer than many a render.
struct SharedPreviewer {
    choice: Choice,
    made: Mutex<Option<Previewer>>,
}

impl SharedPreviewer {
    fn with<T>(
        &self,
        work: impl FnOnce(&mut Previewer) -> Result<T, PreviewError>,
    ) -> Result<T, PreviewError> {
        let mut made = lock(&self.made);
        let previewer = match &mut *made {
            Some(previewer) => previewer,
            none => none.insert(Previewer::new(self.choice)?),
        };
        work(previewer)
    }
}

impl Ambient {
    /// A renderer that makes previews as `choice` says.
    pub fn new(choice: Choice) -> Self {
        let previewer = SharedPreviewer { choice, made: Mutex::default() };
        Self { previewer: Arc::new(previewer), limits: Limits::default() }
    }

    /// Opens the graphics device now, if one is wanted, for a process that would rather not start than find out later that
    /// there is none.
    pub fn ready(&self) -> Result<(), PreviewError> {
        self.previewer.with(|_| Ok(()))
    }

    /// The graphics device that previews are made with; `None` if they are made on the processor.
    pub fn adapter(&self) -> Result<Option<Adapter>, PreviewError> {
        self.previewer.with(|previewer| {
            let adapter =
                |name: &str| Adapter { name: name.to_owned(), is_hardware: previewer.is_hardware() };
            Ok(previewer.adapter().map(adapter))
        })
    }

    /// Opens a bundle.
    pub fn open(&self, path: &Path) -> Result<AmbientShot, RenderError> {
        let start = thread_cpu_nanos();
        let scene = Scene::load(path, &self.limits)?;
        let load = Spent { work: 0, cpu_nanos: thread_cpu_nanos() - start };
        let first = scene.frame(0)?;
        Ok(AmbientShot {
            info: ShotInfo {
                summary: summary(&scene, &first),
                renderer: format!("forelight {}, tracer {}", env!("CARGO_PKG_VERSION"), tracer_version()),
                strata: strata(&first),
                load,
            },
            moves: scene.geometry_moves(),
            everything: false,
            scene,
            previewer: self.previewer.clone(),
            still: first.geometry.clone(),
            still_tree: Mutex::default(),
            moved_tree: Mutex::default(),
        })
    }
}

impl OpenRenderer for Ambient {
    fn open(&self, path: &Path) -> Result<Arc<dyn Renderer>, RenderError> {
        Ok(Arc::new(Ambient::open(self, path)?))
    }
}

fn summary(scene: &Scene, first: &Frame) -> SceneSummary {
    SceneSummary {
        name: scene.name().to_owned(),
        digest: SceneDigest(scene.digest()),
        frames: scene.frame_count(),
        width: first.camera.width,
        height: first.camera.height,
        objects: first.geometry.strata.objects.len() as u64,
        materials: first.materials.len() as u64,
        triangles: first.geometry.triangles.len() as u64,
    }
}

fn strata(frame: &Frame) -> Vec<StratumInfo> {
    let strata = &frame.geometry.strata;
    let info = |&(object, material): &(u32, u32)| StratumInfo {
        name: StratumName {
            object: strata.objects[object as usize].clone(),
            material: frame.materials[material as usize].name.clone(),
        },
        object,
        material,
        class: frame.materials[material as usize].class(),
    };
    strata.pairs.iter().map(info).collect()
}

/// The tracer's settings of a job's.
pub fn tracer_settings(settings: &RenderSettings) -> Settings {
    Settings {
        width: settings.width,
        height: settings.height,
        spp: settings.spp,
        integrator: match settings.integrator {
            Integrator::Ambient => forelight_tracer::Integrator::Ambient,
            Integrator::Path => forelight_tracer::Integrator::Path,
        },
        ambient_bounces: settings.ambient_bounces,
        ambient_divisions: settings.ambient_divisions,
        max_depth: settings.max_depth,
        cache: match settings.cache {
            CacheMode::On => {
                Some(CacheSettings { accuracy: settings.cache_accuracy, rays: settings.cache_rays })
            }
            CacheMode::Off => None,
        },
        materials: match settings.materials {
            MaterialMode::Full => MaterialOverride::Full,
            MaterialMode::Lambert => MaterialOverride::Lambert,
        },
        seed: settings.seed,
    }
}

/// A bundle, opened by our renderer.
pub struct AmbientShot {
    scene: Scene,
    info: ShotInfo,
    previewer: Arc<SharedPreviewer>,
    /// Whether anything but the camera and the lights moves in the shot.
    moves: bool,
    /// Whether everything is traced, also what cannot matter.
    everything: bool,
    /// The geometry of frame 0, which frames in which nothing has moved share.
    still: Arc<Geometry>,
    still_tree: Mutex<Option<Tree>>,
    /// The tree of the last frame in which something had moved.
    moved_tree: Mutex<Option<Tree>>,
}

#[derive(Clone)]
struct Tree {
    geometry: Arc<Geometry>,
    bvh: Arc<forelight_tracer::Tree>,
    build: Spent,
}

/// A tracer, and what its tree took.
pub(crate) struct Ready {
    pub(crate) tracer: Tracer,
    /// Building the tree, whenever that was, if the shot's frames cannot all share one.
    own_tree: Spent,
    /// Building the tree, if that was done just now.
    built_now: Spent,
}

impl AmbientShot {
    /// The same with code for all effects in the path, and with everything left in: for showing what leaving it out saves. Images
    /// keep their bits.
    pub fn with_everything(self) -> Self {
        Self { everything: true, ..self }
    }

    pub(crate) fn frame_of(&self, frame: u32, settings: &Settings) -> Result<Frame, RenderError> {
        settings.validate()?;
        Ok(self.scene.frame_with(frame, Some((settings.width, settings.height)))?)
    }

    /// The view of a frame onto the world of another.
    pub(crate) fn view_of(&self, frame: u32, world: &Frame) -> Result<Frame, RenderError> {
        let camera = self.scene.camera(frame)?.resized(world.camera.width, world.camera.height);
        Ok(Frame { number: frame, camera, ..world.clone() })
    }

    pub(crate) fn tracer(&self, frame: &Frame, settings: &Settings) -> Ready {
        // In a shot in which something moves every frame is charged for a tree, so that what stands still for a while, or comes
        // back to where it was, does not make one frame cheaper than the next.
        let own = |build: Spent| if self.moves { build } else { Spent::default() };
        let ready = |known: Option<&Tree>| {
            let known = known.filter(|tree| Arc::ptr_eq(&tree.geometry, &frame.geometry));
            let tracer = match known {
                _ if self.everything => {
                    Tracer::complete(frame, settings).with_kernel_for(Effects::default().with_all())
                }
                Some(tree) => Tracer::with_bvh(frame, settings, tree.bvh.clone()),
                None => Tracer::new(frame, settings),
            };
            // A frame that sees other parts of the scene has built a tree of its own.
            let shared = known.filter(|tree| Arc::ptr_eq(&tree.bvh, tracer.bvh()));
            let build = shared.map_or_else(|| spent(tracer.build_cost()), |tree| tree.build);
            let built_now = if shared.is_some() { Spent::default() } else { build };
            let tree = Tree { geometry: frame.geometry.clone(), bvh: tracer.bvh().clone(), build };
            (Ready { tracer, own_tree: own(build), built_now }, tree)
        };
        if Arc::ptr_eq(&frame.geometry, &self.still) {
            // Held while the tree is built, so that workers that share this shot wait for one build instead of doing two.
            let mut still = lock(&self.still_tree);
            let (ready, tree) = ready(still.as_ref());
            *still = Some(tree);
            return ready;
        }
        // Not held: workers on different frames build different trees, at the same time.
        let known = lock(&self.moved_tree).clone();
        let (ready, tree) = ready(known.as_ref());
        *lock(&self.moved_tree) = Some(tree);
        ready
    }

    /// Records of a frame's irradiance cache by level, none without one, and what planning them took, with any tree that had
    /// to be built for it.
    fn planned_records(&self, frame: &Frame, settings: &Settings) -> (Vec<u32>, Spent) {
        if settings.cache.is_none() {
            return (Vec::new(), Spent::default());
        }
        let Ready { tracer, built_now, .. } = self.tracer(frame, settings);
        tracer.plan();
        let planning = tracer.cache().map_or_else(Spent::default, |cache| spent(cache.totals().plan));
        (records(&tracer), built_now.plus(planning))
    }
}

/// Records of the irradiance cache by level, once it is planned: one number for each level that the settings have, whether the frame
/// calls for it or not.
fn records(tracer: &Tracer) -> Vec<u32> {
    let settings = tracer.settings();
    let levels = if settings.cache.is_some() { settings.ambient_bounces as usize } else { 0 };
    let planned = tracer.cache().map_or_else(|| vec![0; levels], Cache::records);
    counts(planned)
}

impl Renderer for AmbientShot {
    fn info(&self) -> &ShotInfo {
        &self.info
    }

    fn count(&self, frame: u32, settings: &RenderSettings) -> Result<Counted, RenderError> {
        let settings = tracer_settings(settings);
        let start = thread_cpu_nanos();
        let frame = self.frame_of(frame, &settings)?;
        let setup = thread_cpu_nanos() - start;
        let (cache_records, planning) = self.planned_records(&frame, &settings);
        Ok(self.previewer.with(|previewer| {
            let counts = previewer.counts(&frame)?;
            Ok(Counted {
                counts,
                cache_records,
                shining: frame.shining(),
                backend: backend(previewer),
                spent: preview_spent(previewer, &frame, setup).plus(planning),
            })
        })?)
    }

    fn frame(
        &self,
        frame: u32,
        settings: &RenderSettings,
    ) -> Result<Box<dyn FrameRenderer + '_>, RenderError> {
        let settings = tracer_settings(settings);
        let start = thread_cpu_nanos();
        let frame = self.frame_of(frame, &settings)?;
        let moved = thread_cpu_nanos() - start;
        let Ready { tracer, own_tree, built_now } = self.tracer(&frame, &settings);
        Ok(Box::new(AmbientFrame {
            shot: self,
            tracer,
            shared: Mutex::default(),
            fixed: FixedCosts {
                load: Spent { work: 0, cpu_nanos: moved },
                build: own_tree,
                ..FixedCosts::default()
            },
            built_now,
        }))
    }

    fn plan_cache(
        &self,
        frames: &[u32],
        settings: &RenderSettings,
        progress: &dyn Fn(u64),
        cancel: &AtomicBool,
    ) -> Result<Option<Cache>, RenderError> {
        AmbientShot::plan_cache(self, frames, settings, progress, cancel)
    }

    fn fill_cache(
        &self,
        cache: Cache,
        settings: &RenderSettings,
        part: (u32, u32),
        progress: &(dyn Fn(u64, u64) + Sync),
        cancel: &AtomicBool,
    ) -> Result<Option<Cache>, RenderError> {
        AmbientShot::fill_cache(self, cache, settings, part, progress, cancel)
    }
}

/// One frame, ready.
struct AmbientFrame<'a> {
    shot: &'a AmbientShot,
    tracer: Tracer,
    /// What became of the shot's cache, if it was given one.
    shared: Mutex<Shared>,
    /// Without the plan of its irradiance cache.
    fixed: FixedCosts,
    built_now: Spent,
}

impl AmbientFrame<'_> {
    /// What the irradiance cache came to, if there is one.
    fn cache_use(&self, taken_over: CacheTotals) -> Option<CacheUse> {
        let shared = || lock(&self.shared).clone();
        self.tracer.cache().map(|cache| CacheUse { all: cache.totals(), taken_over, shared: shared() })
    }

    /// Finished pixels on the current thread, with what their camera samples say.
    fn traced(&self, pixels: &[u32]) -> Vec<(Pixel, PixelNoise)> {
        let mut samples = vec![PixelSamples::default(); pixels.len()];
        let traced = self.tracer.profile_samples(pixels, &mut |place, sample| samples[place].push(sample));
        traced.into_iter().zip(samples.iter().map(PixelSamples::noise)).collect()
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
                FixedCosts { plan: spent(plan), plan_rays, ..self.fixed }
            }
        }
    }

    fn cache_records(&self) -> Vec<u32> {
        self.tracer.plan();
        records(&self.tracer)
    }

    fn spent_on_setup(&self) -> Spent {
        self.fixed.load.plus(self.built_now)
    }

    fn effects(&self) -> Vec<String> {
        let mut effects: Vec<String> = self.tracer.effects().names().map(str::to_owned).collect();
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

    fn trace(&self, pixels: &[u32]) -> Vec<(Pixel, PixelNoise)> {
        self.tracer.plan();
        pixels.par_chunks(BATCH).flat_map_iter(|batch| self.traced(batch)).collect()
    }

    fn fill_for(&self, pixels: &[u32]) -> Spent {
        spent(self.tracer.fill_for(pixels))
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

    fn trace_runs(&self, runs: &[Vec<u32>]) -> Vec<Vec<(Pixel, PixelNoise)>> {
        self.tracer.plan();
        runs.par_iter().map(|run| self.traced(run)).collect()
    }

    fn sample_records(&self, each: usize, seed: u64) -> Vec<RecordCost> {
        self.tracer.sample_records(each, seed)
    }

    fn profile(&self, pixels: &[(u32, Pixel)]) -> Profile {
        let cache = self.tracer.cache().map(|cache| cache.to_bytes());
        // The colours of pixels that read a cache before it is filled are not the image's.
        let pixels = if cache.is_none() { pixels.to_vec() } else { Vec::new() };
        Profile { frame: self.tracer.frame().number, fingerprint: self.tracer.fingerprint(), pixels, cache }
    }

    fn share(&self, mut cache: Cache) -> Result<Shared, RenderError> {
        let given = |cache: Cache| self.tracer.take_cache(cache.as_given());
        let shared = if cache.suits(&self.tracer) {
            let kept = cache.records();
            given(cache)?;
            Shared { dropped: vec![0; kept.len()], kept }
        } else {
            let settings = self.tracer.settings();
            let from = self.shot.tracer(&self.shot.frame_of(cache.frame(), settings)?, settings).tracer;
            cache.settle(&from)?;
            let (carried, shared) = cache.carried(&from, &self.tracer);
            given(carried)?;
            shared
        };
        *lock(&self.shared) = shared.clone();
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
        if let Some(profile) = reuse {
            if profile.fingerprint != self.tracer.fingerprint() || !profile.fits(pixels) {
                return Err(RenderError::ForeignProfile { frame: profile.frame });
            }
            if let Some(bytes) = &profile.cache {
                let cache = Cache::from_bytes(bytes)?;
                taken_over = cache.totals();
                self.tracer.take_cache(cache)?;
            }
        }
        if !self.fill(progress, cancel) {
            return Ok(None);
        }
        let traced = |done| progress(Progress { step: Step::Tracing, done, all: pixels as u64 });
        let image = self.tracer.render_watched(reuse, &traced, finished, cancel);
        Ok(image.map(|image| Finished { image, cache: self.cache_use(taken_over) }))
    }
}

fn backend(previewer: &Previewer) -> PreviewBackend {
    if previewer.backend() == "gpu" { PreviewBackend::Gpu } else { PreviewBackend::Cpu }
}

/// What the last preview took. Its work: on the CPU in the tracer's weights, on the GPU, where no node is visited, one
/// operation for each pixel and each triangle. Its time: this process's, and the device's, for a driver that renders in
/// software uses the same processor.
fn preview_spent(previewer: &Previewer, frame: &Frame, setup_nanos: u64) -> Spent {
    let cost = previewer.cost();
    let (pixels, triangles) = (frame.camera.pixels() as u64, frame.geometry.triangles.len() as u64);
    let work = match cost.nodes {
        0 => pixels + triangles,
        nodes => forelight_tracer::work(pixels, nodes, cost.triangles, 0, 0),
    };
    Spent { work, cpu_nanos: cost.cpu_nanos + cost.device_nanos + setup_nanos }
}

/// The data behind these locks is whole after every statement, so a panic elsewhere does not spoil it.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::RenderSettingsRequest;

    #[test]
    fn the_service_takes_exactly_the_settings_that_the_tracer_takes() {
        let plain = RenderSettingsRequest::default();
        let path = RenderSettingsRequest { integrator: Some(Integrator::Path), ..plain.clone() };
        let cached = RenderSettingsRequest { cache: Some(CacheMode::On), ..plain.clone() };
        let set: [fn(&mut RenderSettings, u32); 8] = [
            |settings, value| settings.width = value,
            |settings, value| settings.height = value,
            |settings, value| settings.spp = value,
            |settings, value| settings.ambient_bounces = value,
            |settings, value| settings.ambient_divisions = value,
            |settings, value| settings.max_depth = value,
            |settings, value| settings.cache_accuracy = value,
            |settings, value| settings.cache_rays = value,
        ];
        let mut refused = 0;
        for base in [plain, path, cached].map(|request| request.complete((64, 36))) {
            for (name, set) in set.iter().enumerate() {
                // What is not used without a cache is the service's to refuse, so that a mistake is not hidden.
                if name >= 6 && base.cache == CacheMode::Off {
                    continue;
                }
                for value in
                    (0..100).chain((9..17).flat_map(|bit| [(1 << bit) - 1, 1 << bit, (1 << bit) + 1]))
                {
                    let mut settings = base.clone();
                    set(&mut settings, value);
                    let (service, tracer) = (settings.check(), tracer_settings(&settings).validate());
                    assert_eq!(service.is_ok(), tracer.is_ok(), "{settings:?}: {service:?} {tracer:?}");
                    refused += u32::from(service.is_err());
                }
            }
        }
        assert!(refused > 100);
        let large =
            RenderSettingsRequest { width: Some(1 << 15), height: Some(1 << 14), ..Default::default() };
        let large = large.complete((1, 1));
        assert!(large.check().is_err() && tracer_settings(&large).validate().is_err());
    }

    #[test]
    fn a_preview_on_the_processor_is_charged_in_the_weights_of_rendering() {
        let folder = tempfile::tempdir().unwrap();
        let scene = r#"{"version":1,"name":"t","geometry":["t.obj"],
            "camera":{"origin":[0,0,4],"target":[0,0,0],"up":[0,1,0],"fov_deg":50,"fov_axis":"x","width":4,"height":4}}"#;
        std::fs::write(folder.path().join("scene.json"), scene).unwrap();
        std::fs::write(folder.path().join("t.obj"), "v -9 -9 0\nv 9 -9 0\nv 0 9 0\nf 1 2 3\n").unwrap();
        let frame = Scene::load(folder.path(), &Limits::default()).unwrap().frame(0).unwrap();
        let mut previewer = Previewer::new(Choice::Cpu).unwrap();
        let counts = previewer.counts(&frame).unwrap();
        assert_eq!(counts.per_stratum, [16], "every ray meets the one triangle");
        let cost = previewer.cost();
        assert!(cost.nodes >= 16 && cost.triangles >= 16, "{cost:?}");
        let expected = forelight_tracer::work(16, cost.nodes, cost.triangles, 0, 0);
        assert_eq!(preview_spent(&previewer, &frame, 0).work, expected);
    }
}
