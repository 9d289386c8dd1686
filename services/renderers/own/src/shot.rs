//! A bundle, opened by our renderer.

use crate::answers::{Counted, ShotInfo, StratumInfo};
use crate::costs::{counts, spent};
use crate::error::RenderError;
use crate::preview_cost::{backend, preview_spent};
use forelight_kept::Folder;
use forelight_preview::SharedPreviewer;
use forelight_protocol::{PlanCount, ProcessCosts, RenderSettings, Spent, StratumName};
use forelight_renderer::summary;
use forelight_scene::{Frame, Geometry, Limits, Scene};
use forelight_tracer::{
    Cache, CacheTotals, Effects, Settings, Tracer, TreeCost, Trees, clocked, tracer_version,
};
use parking_lot::Mutex;
use std::path::Path;
use std::sync::Arc;

/// A bundle, opened by our renderer.
pub struct OwnShot {
    scene: Scene,
    info: ShotInfo,
    pub(crate) previewer: Arc<SharedPreviewer>,
    /// Whether anything but the camera and the lights moves in the shot.
    pub(crate) moves: bool,
    /// Whether to trace everything, even what cannot matter.
    everything: bool,
    /// Geometry of frame 0. Frames in which nothing has moved share it.
    still: Arc<Geometry>,
    /// Cost of loading the bundle, as if nothing were kept.
    load: Spent,
    /// What was really spent on it.
    loading: Spent,
    kept: Option<Folder>,
    still_tree: Mutex<Still>,
    /// Tree of the last frame in which something had moved.
    moved_tree: Mutex<Option<Tree>>,
}

#[derive(Clone)]
struct Tree {
    geometry: Arc<Geometry>,
    bvh: Arc<forelight_tracer::Tree>,
    build: Spent,
}

#[derive(Default)]
struct Still {
    tree: Option<Tree>,
    /// Cost of building this tree and earlier ones: a camera that leaves a closed room sees another scene.
    built: Spent,
}

/// A tracer, and the cost of its tree.
pub(crate) struct Ready {
    pub(crate) tracer: Tracer,
    /// Cost of the tree whenever it was built, if the shot's frames cannot share one.
    pub(crate) own_tree: Spent,
    /// What this call spent on the tree.
    pub(crate) built_now: Spent,
}

impl OwnShot {
    pub(crate) fn open(
        path: &Path,
        limits: &Limits,
        previewer: Arc<SharedPreviewer>,
        kept: Option<Folder>,
    ) -> Result<Self, RenderError> {
        let (loaded, loading) = clocked(|| match &kept {
            Some(folder) => {
                Scene::load_or_keep(path, limits, folder).map(|(scene, load)| (scene, Some(load)))
            }
            None => Scene::load(path, limits).map(|scene| (scene, None)),
        });
        let (scene, load) = loaded?;
        let time = |cpu_nanos| Spent { work: 0, cpu_nanos };
        let first = scene.frame(0)?;
        Ok(Self {
            info: ShotInfo {
                summary: summary(&scene, &first),
                renderer: format!("forelight {}, tracer {}", env!("CARGO_PKG_VERSION"), tracer_version()),
                strata: strata(&first),
            },
            load: time(load.unwrap_or(loading)),
            loading: time(loading),
            kept,
            moves: scene.geometry_moves(),
            everything: false,
            scene,
            previewer,
            still: first.geometry.clone(),
            still_tree: Mutex::default(),
            moved_tree: Mutex::default(),
        })
    }

    /// Leaves nothing out, to measure what leaving out saves. Images stay the same, bit by bit.
    pub fn with_everything(self) -> Self {
        Self { everything: true, ..self }
    }

    /// What was spent on opening the bundle: little if its scene was kept.
    pub(crate) fn loading(&self) -> Spent {
        self.loading
    }

    /// What a process that has nothing kept pays once for the shot so far.
    pub(crate) fn once(&self) -> ProcessCosts {
        let build = if self.moves { Spent::default() } else { self.still_tree.lock().built };
        ProcessCosts { load: self.load, build }
    }

    pub(crate) fn frame_of(&self, frame: u32, settings: &Settings) -> Result<Frame, RenderError> {
        settings.validate()?;
        Ok(self.scene.frame_with(frame, Some((settings.width, settings.height)))?)
    }

    pub(crate) fn view_of(&self, frame: u32, world: &Frame) -> Result<Frame, RenderError> {
        let camera = self.scene.camera_with(frame, (world.camera.width, world.camera.height))?;
        Ok(Frame { number: frame, camera, ..world.clone() })
    }

    pub(crate) fn tracer(&self, frame: &Frame, settings: &Settings) -> Ready {
        // If something moves, every frame is charged for a tree. Its cost must not depend on earlier frames.
        let own = |build: Spent| if self.moves { build } else { Spent::default() };
        let ready = |known: Option<&Tree>, kept: Option<&Folder>| {
            let known = known.filter(|tree| Arc::ptr_eq(&tree.geometry, &frame.geometry));
            let tracer = match known {
                _ if self.everything => {
                    Tracer::complete(frame, settings).with_kernel_for(Effects::default().with_all())
                }
                _ => {
                    let trees = Trees { known: known.map(|tree| tree.bvh.clone()), kept };
                    Tracer::with_trees(frame, settings, trees)
                }
            };
            // A frame that sees other parts of the scene has built its own tree.
            let shared = known.filter(|tree| Arc::ptr_eq(&tree.bvh, tracer.bvh()));
            let TreeCost { build, spent: spent_now } = tracer.tree_cost();
            let build = shared.map_or_else(|| spent(build), |tree| tree.build);
            let built_now = if shared.is_some() { Spent::default() } else { spent(spent_now) };
            let new = if shared.is_some() { Spent::default() } else { build };
            let tree = Tree { geometry: frame.geometry.clone(), bvh: tracer.bvh().clone(), build };
            (Ready { tracer, own_tree: own(build), built_now }, tree, new)
        };
        if Arc::ptr_eq(&frame.geometry, &self.still) {
            // Locked while the tree is built, so that workers wait for one build instead of doing two.
            let mut still = self.still_tree.lock();
            let (ready, tree, new) = ready(still.tree.as_ref(), self.kept.as_ref());
            *still = Still { tree: Some(tree), built: still.built.plus(new) };
            return ready;
        }
        // Not locked: workers on different frames build different trees at the same time.
        let known = self.moved_tree.lock().clone();
        // Not kept: a shot may have thousands.
        let (ready, tree, _) = ready(known.as_ref(), None);
        *self.moved_tree.lock() = Some(tree);
        ready
    }

    /// Planned records of a frame by level, and the cost of planning, with any trees built for it.
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

/// Records of the planned irradiance cache, one number for each level of the settings, used or not.
pub(crate) fn records(tracer: &Tracer) -> Vec<u32> {
    let settings = tracer.settings();
    let levels = if settings.cache.is_some() { settings.ambient_bounces as usize } else { 0 };
    let planned = tracer.cache().map_or_else(|| vec![0; levels], Cache::records);
    counts(planned)
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

impl OwnShot {
    /// Contents of the bundle.
    pub fn info(&self) -> &ShotInfo {
        &self.info
    }

    /// Counts a frame's pixels by stratum, and its planned records. On the current thread pool.
    pub fn count(&self, frame: u32, settings: &RenderSettings) -> Result<Counted, RenderError> {
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
}
