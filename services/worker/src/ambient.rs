//! Our renderer: `scene`, `preview` and the `ambient` integrator of `tracer`.

use crate::renderer::{
    Counted, FrameRenderer, OpenRenderer, Previewed, RenderError, Renderer, ShotInfo, StratumInfo,
};
use crate::shot::plus;
use forelight_bvh::Bvh;
use forelight_preview::{Choice, PreviewError, Previewer};
use forelight_protocol::{
    FixedCosts, MaterialMode, PreviewBackend, RenderSettings, SceneDigest, SceneSummary, Spent, StratumName,
};
use forelight_scene::{Frame, Geometry, Limits, Scene};
use forelight_tracer::{Image, MaterialOverride, Pixel, Profile, Settings, Tracer, thread_cpu_nanos};
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

/// Opens bundles for our renderer. One previewer serves them all: a process has one device.
#[derive(Clone)]
pub struct Ambient {
    previewer: Arc<SharedPreviewer>,
    limits: Limits,
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

    /// Opens a bundle.
    pub fn open(&self, path: &Path) -> Result<AmbientShot, RenderError> {
        let start = thread_cpu_nanos();
        let scene = Scene::load(path, &self.limits)?;
        let load = Spent { work: 0, cpu_nanos: thread_cpu_nanos() - start };
        let first = scene.frame(0)?;
        Ok(AmbientShot {
            info: ShotInfo { summary: summary(&scene, &first), strata: strata(&first), load },
            moves: scene.geometry_moves(),
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
        ambient_bounces: settings.ambient_bounces,
        ambient_divisions: settings.ambient_divisions,
        max_depth: settings.max_depth,
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
    /// The geometry of frame 0, which frames in which nothing has moved share.
    still: Arc<Geometry>,
    still_tree: Mutex<Option<Tree>>,
    /// The tree of the last frame in which something had moved.
    moved_tree: Mutex<Option<Tree>>,
}

#[derive(Clone)]
struct Tree {
    geometry: Arc<Geometry>,
    bvh: Arc<Bvh>,
    build: Spent,
}

/// A tracer, and what its tree took.
struct Ready {
    tracer: Tracer,
    /// Building the tree, whenever that was, if the shot's frames cannot all share one.
    own_tree: Spent,
    /// Building the tree, if that was done just now.
    built_now: Spent,
}

impl AmbientShot {
    fn frame_of(&self, frame: u32, settings: &Settings) -> Result<Frame, RenderError> {
        settings.validate()?;
        Ok(self.scene.frame_with(frame, Some((settings.width, settings.height)))?)
    }

    fn tracer(&self, frame: &Frame, settings: &Settings) -> Ready {
        // In a shot in which something moves every frame is charged for a tree, so that what stands still for a while, or comes
        // back to where it was, does not make one frame cheaper than the next.
        let own = |build: Spent| if self.moves { build } else { Spent::default() };
        let known = |tree: &Tree| {
            let shares = Arc::ptr_eq(&tree.geometry, &frame.geometry);
            shares.then(|| Ready {
                tracer: Tracer::with_bvh(frame, settings, tree.bvh.clone()),
                own_tree: own(tree.build),
                built_now: Spent::default(),
            })
        };
        let build = || {
            let tracer = Tracer::new(frame, settings);
            let cost = tracer.build_cost();
            let build = Spent { work: cost.work, cpu_nanos: cost.cpu_nanos };
            let tree = Tree { geometry: frame.geometry.clone(), bvh: tracer.bvh().clone(), build };
            (Ready { tracer, own_tree: own(build), built_now: build }, tree)
        };
        if Arc::ptr_eq(&frame.geometry, &self.still) {
            // Held while the tree is built, so that workers that share this shot wait for one build instead of doing two.
            let mut still = lock(&self.still_tree);
            if let Some(ready) = still.as_ref().and_then(known) {
                return ready;
            }
            let (ready, tree) = build();
            *still = Some(tree);
            return ready;
        }
        // Not held: workers on different frames build different trees, at the same time.
        if let Some(ready) = lock(&self.moved_tree).as_ref().and_then(known) {
            return ready;
        }
        let (ready, tree) = build();
        *lock(&self.moved_tree) = Some(tree);
        ready
    }
}

impl Renderer for AmbientShot {
    fn info(&self) -> &ShotInfo {
        &self.info
    }

    fn count(&self, frame: u32, settings: &RenderSettings) -> Result<Counted, RenderError> {
        let start = thread_cpu_nanos();
        let frame = self.frame_of(frame, &tracer_settings(settings))?;
        let setup = thread_cpu_nanos() - start;
        Ok(self.previewer.with(|previewer| {
            let counts = previewer.counts(&frame)?;
            Ok(Counted {
                counts,
                backend: backend(previewer),
                spent: preview_spent(previewer, &frame, setup),
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
            previewer: &self.previewer,
            fingerprint: OnceLock::new(),
            tracer,
            fixed: FixedCosts {
                load: Spent { work: 0, cpu_nanos: moved },
                build: own_tree,
                write: Spent::default(),
            },
            built_now,
        }))
    }
}

/// One frame, ready.
struct AmbientFrame<'a> {
    previewer: &'a SharedPreviewer,
    tracer: Tracer,
    /// Hashing the geometry takes a while, and only profiles need it.
    fingerprint: OnceLock<[u8; 32]>,
    fixed: FixedCosts,
    built_now: Spent,
}

impl AmbientFrame<'_> {
    fn fingerprint(&self) -> [u8; 32] {
        *self.fingerprint.get_or_init(|| self.tracer.fingerprint())
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
        Ok(self.previewer.with(|previewer| {
            let preview = previewer.preview(frame)?;
            Ok(Previewed { preview, backend: backend(previewer), spent: preview_spent(previewer, frame, 0) })
        })?)
    }

    fn fixed(&self) -> FixedCosts {
        self.fixed
    }

    fn spent_on_setup(&self) -> Spent {
        plus(self.fixed.load, self.built_now)
    }

    fn effects(&self) -> Vec<String> {
        let mut effects: Vec<String> = self.tracer.effects().names().map(str::to_owned).collect();
        effects.sort();
        effects
    }

    fn trace(&self, pixels: &[u32]) -> Vec<Pixel> {
        pixels.par_chunks(BATCH).flat_map_iter(|batch| self.tracer.profile(batch)).collect()
    }

    fn trace_runs(&self, runs: &[Vec<u32>]) -> Vec<Vec<Pixel>> {
        runs.par_iter().map(|run| self.tracer.profile(run)).collect()
    }

    fn profile(&self, pixels: Vec<(u32, Pixel)>) -> Profile {
        Profile { frame: self.tracer.frame().number, fingerprint: self.fingerprint(), pixels }
    }

    fn render(
        &self,
        reuse: Option<&Profile>,
        progress: &(dyn Fn(u64) + Sync),
        cancel: &AtomicBool,
    ) -> Result<Option<Image>, RenderError> {
        if let Some(profile) = reuse {
            let camera = &self.tracer.frame().camera;
            if profile.fingerprint != self.fingerprint() || !profile.fits(camera.pixels()) {
                return Err(RenderError::ForeignProfile { frame: profile.frame });
            }
        }
        Ok(self.tracer.render(reuse, progress, cancel))
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
