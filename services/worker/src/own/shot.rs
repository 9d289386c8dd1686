//! A bundle, opened by our renderer.

use super::frame::AmbientFrame;
use super::{SharedPreviewer, backend, preview_spent};
use crate::render::{counts, spent};
use crate::renderer::{Counted, FrameRenderer, RenderError, Renderer, ShotInfo, StratumInfo};
use forelight_protocol::{
    FixedCosts, PlanCount, ProcessCosts, RenderSettings, SceneDigest, SceneSummary, Spent, StratumName,
};
use forelight_scene::{Frame, Geometry, Limits, Scene};
use forelight_tracer::{Cache, CacheTotals, Effects, Settings, Tracer, clocked, tracer_version};
use parking_lot::Mutex;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A bundle, opened by our renderer.
pub struct AmbientShot {
    scene: Scene,
    info: ShotInfo,
    pub(super) previewer: Arc<SharedPreviewer>,
    /// Whether anything but the camera and the lights moves in the shot.
    pub(super) moves: bool,
    /// Whether everything is traced, also what cannot matter.
    everything: bool,
    /// The geometry of frame 0, which frames in which nothing has moved share.
    still: Arc<Geometry>,
    /// Reading the bundle.
    load: Spent,
    still_tree: Mutex<Still>,
    /// The tree of the last frame in which something had moved.
    moved_tree: Mutex<Option<Tree>>,
}

#[derive(Clone)]
struct Tree {
    geometry: Arc<Geometry>,
    bvh: Arc<forelight_tracer::Tree>,
    build: Spent,
}

/// The tree of the geometry that frames share.
#[derive(Default)]
struct Still {
    tree: Option<Tree>,
    /// Building it, and others before it: a camera that leaves a closed room sees another scene.
    built: Spent,
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
    pub(super) fn open(
        path: &Path,
        limits: &Limits,
        previewer: Arc<SharedPreviewer>,
    ) -> Result<Self, RenderError> {
        let (scene, loading) = clocked(|| Scene::load(path, limits));
        let scene = scene?;
        let load = Spent { work: 0, cpu_nanos: loading };
        let first = scene.frame(0)?;
        Ok(Self {
            info: ShotInfo {
                summary: summary(&scene, &first),
                renderer: format!("forelight {}, tracer {}", env!("CARGO_PKG_VERSION"), tracer_version()),
                strata: strata(&first),
            },
            load,
            moves: scene.geometry_moves(),
            everything: false,
            scene,
            previewer,
            still: first.geometry.clone(),
            still_tree: Mutex::default(),
            moved_tree: Mutex::default(),
        })
    }

    /// The same with code for all effects in the path, and with everything left in: for showing what leaving it out saves. Images
    /// keep their bits.
    pub fn with_everything(self) -> Self {
        Self { everything: true, ..self }
    }

    /// What this process has paid once for the shot, as far as it has.
    pub(super) fn once(&self) -> ProcessCosts {
        let build = if self.moves { Spent::default() } else { self.still_tree.lock().built };
        ProcessCosts { load: self.load, build }
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
            let mut still = self.still_tree.lock();
            let (ready, tree) = ready(still.tree.as_ref());
            *still = Still { tree: Some(tree), built: still.built.plus(ready.built_now) };
            return ready;
        }
        // Not held: workers on different frames build different trees, at the same time.
        let known = self.moved_tree.lock().clone();
        let (ready, tree) = ready(known.as_ref());
        *self.moved_tree.lock() = Some(tree);
        ready
    }

    /// Records of a frame's irradiance cache by level, none without one, and what planning them took, with any tree that had
    /// to be built for it.
    fn planned_records(&self, frame: &Frame, settings: &Settings) -> (Vec<u32>, Option<PlanCount>, Spent) {
        if settings.cache.is_none() {
            return (Vec::new(), None, Spent::default());
        }
        let Ready { tracer, built_now, .. } = self.tracer(frame, settings);
        tracer.plan();
        let CacheTotals { plan, plan_rays, .. } = tracer.cache().map(Cache::totals).unwrap_or_default();
        let count = PlanCount { work: plan.work, rays: plan_rays };
        (records(&tracer), Some(count), built_now.plus(spent(plan)))
    }
}

/// Records of the irradiance cache by level, once it is planned: one number for each level that the settings have, whether the frame
/// calls for it or not.
pub(super) fn records(tracer: &Tracer) -> Vec<u32> {
    let settings = tracer.settings();
    let levels = if settings.cache.is_some() { settings.ambient_bounces as usize } else { 0 };
    let planned = tracer.cache().map_or_else(|| vec![0; levels], Cache::records);
    counts(planned)
}

fn summary(scene: &Scene, first: &Frame) -> SceneSummary {
    let strata = scene.strata();
    SceneSummary {
        name: scene.name().to_owned(),
        digest: SceneDigest(scene.digest()),
        frames: scene.frame_count(),
        width: first.camera.width,
        height: first.camera.height,
        objects: strata.objects.len() as u64,
        materials: strata.materials() as u64,
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

impl Renderer for AmbientShot {
    fn info(&self) -> &ShotInfo {
        &self.info
    }

    fn count(&self, frame: u32, settings: &RenderSettings) -> Result<Counted, RenderError> {
        let settings = Settings::from(settings);
        let (frame, setup) = clocked(|| self.frame_of(frame, &settings));
        let frame = frame?;
        let (cache_records, cache_plan, planning) = self.planned_records(&frame, &settings);
        Ok(self.previewer.with(|previewer| {
            let counts = previewer.counts(&frame)?;
            Ok(Counted {
                counts,
                cache_records,
                cache_plan,
                shining: frame.shining(),
                triangles: frame.geometry.triangles.len() as u64,
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
        let settings = Settings::from(settings);
        let (frame, moved) = clocked(|| self.frame_of(frame, &settings));
        let frame = frame?;
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
