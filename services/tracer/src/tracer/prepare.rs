//! Prepares a frame for tracing: builds the tree, collects the lights, and composes the kernel.

use super::Tracer;
use crate::Settings;
use crate::cost::{Tally, clocked};
use crate::effects::{CalledFor, Effects};
use crate::environment::Sky;
use crate::fresnel;
use crate::integrator::Kernel;
use crate::lights::{Lights, Looks, Luminaires};
use crate::media::{Media, Ranks};
use crate::reach::{Reach, reachable};
use crate::tree::{Tree, TreeCost};
use forelight_kept::Folder;
use forelight_protocol::{Integrator, MaterialMode};
use forelight_scene::{Color, Frame, Material, Sun, Surface};
use glam::Vec3;
use parking_lot::Mutex;
use std::sync::{Arc, OnceLock};

/// Trees that need not be built again.
#[derive(Default)]
pub struct Trees<'a> {
    /// A tree that was built before for the same geometry.
    pub known: Option<Arc<Tree>>,
    /// Where trees are kept.
    pub kept: Option<&'a Folder>,
}

impl Tracer {
    /// Builds the tree and collects the lights. The camera is resized to the settings. Objects and lights
    /// that cannot affect the image are left out; see [`Self::left_out`].
    pub fn new(frame: &Frame, settings: &Settings) -> Self {
        Self::with_trees(frame, settings, Trees::default())
    }

    /// Like [`Self::new`], with a tree built earlier for the same geometry, if the same triangles can affect
    /// this image.
    pub fn with_bvh(frame: &Frame, settings: &Settings, bvh: Arc<Tree>) -> Self {
        Self::with_trees(frame, settings, Trees { known: Some(bvh), ..Trees::default() })
    }

    /// The same with any tree from elsewhere.
    pub fn with_trees(frame: &Frame, settings: &Settings, trees: Trees<'_>) -> Self {
        Self::build(frame, settings, trees, false)
    }

    /// Like [`Self::new`], but leaves nothing out, for comparison; images have the same bits. Lights that
    /// cannot affect the image are sampled only if all lights are, never by a choice among many.
    pub fn complete(frame: &Frame, settings: &Settings) -> Self {
        Self::build(frame, settings, Trees::default(), true)
    }

    fn build(frame: &Frame, settings: &Settings, trees: Trees<'_>, complete: bool) -> Self {
        let mut frame = frame.clone();
        frame.camera = frame.camera.resized(settings.width, settings.height);
        let materials: Vec<Material> = match settings.materials {
            MaterialMode::Full => frame.materials.to_vec(),
            MaterialMode::Lambert => frame.materials.iter().map(as_lambert).collect(),
        };
        let internal = materials.iter().map(|m| match m.surface {
            Surface::Plastic { ior, .. } => fresnel::internal_diffuse(ior),
            _ => 0.0,
        });
        let (reach, finding) = clocked(|| reachable(&frame, &materials));
        let everything = Reach::everything(&frame);
        let included = if complete { &everything } else { &reach };
        let known = trees.known.filter(|bvh| bvh.is_over(&frame.geometry, included));
        let (bvh, tree) = known.map(|bvh| (bvh, TreeCost::default())).unwrap_or_else(|| {
            let (tree, cost) = Tree::new(&frame.geometry, included, trees.kept);
            (Arc::new(tree), cost.after(finding))
        });
        let luminaires = Luminaires::new(&frame, &reach, complete);
        let sky = if included.environment() { Sky::new(&frame) } else { Sky::Black };
        let points: Vec<usize> = (0..frame.points.len()).filter(|&i| included.point_light(i)).collect();
        let suns: Vec<usize> = (0..frame.suns.len()).filter(|&i| included.sun(i)).collect();
        // Lights that cannot affect the image are never chosen, so they do not count.
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
            kernel: Kernel::new(effects, settings.integrator, looks),
            materials,
            settings: settings.clone(),
            bvh,
            frame,
            tree,
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

    /// Uses a kernel with additional effects, for comparison; images and counters have the same bits.
    pub fn with_kernel_for(self, effects: Effects) -> Self {
        Self {
            kernel: Kernel::new(self.effects | effects.bits(), self.settings.integrator, self.looks),
            ..self
        }
    }
}

/// The material as two-sided Lambertian with its emission: diffuse colour or texture, 0.5 grey for metals and
/// glass.
fn as_lambert(material: &Material) -> Material {
    let albedo = match material.surface {
        Surface::Lambert { albedo } | Surface::Plastic { albedo, .. } => albedo,
        _ => Color::plain(Vec3::splat(0.5)),
    };
    Material { surface: Surface::Lambert { albedo }, ..material.clone() }
}
