//! Reads glTF 2.0 scenes: nodes with meshes (objects), cameras, lights and animations, of the default or
//! first scene. Unsupported features give one warning.

mod accessors;
mod base;
mod channels;
mod document;
mod draco;
mod extensions;
mod meshopt;
mod motion;
mod primitive;
mod surface;

use crate::assembly::{Assembly, NodeLight, NodeLightKind};
use crate::camera_source::{DEFAULT_ASPECT, DEFAULT_HEIGHT, FovAxis, NodeCamera};
use crate::error::SceneError;
use crate::limits::LARGEST_COORDINATE;
use crate::shot::{Mesh, Node, Part, Placement};
use document::{Opened, UNDERSTOOD};
use glam::{DMat3, DMat4, DQuat, DVec3, DVec4, Vec3};
use gltf::camera::Projection;
use gltf::khr_lights_punctual::Kind;
use gltf::scene::Transform;
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

/// Luminous efficacy in lm/W by the SI definition of the candela, which exporters use too.
const LUMENS_PER_WATT: f32 = 683.0;

/// How far an exporter's rounding may carry a value out of its range.
const ROUNDING: f32 = 1e-5;

/// Reads a `.gltf` or `.glb` file into the assembly.
pub(crate) fn load(assembly: &mut Assembly<'_>, path: &str) -> Result<(), SceneError> {
    let opened = document::open(assembly.bundle, path)?;
    let nodes = vec![None; opened.document.nodes().len()];
    let mut reader = Reader {
        assembly,
        opened: &opened,
        file: path.into(),
        nodes,
        materials: BTreeMap::new(),
        meshes: BTreeMap::new(),
        ignored: BTreeSet::new(),
        renamed: Vec::new(),
        means: BTreeMap::new(),
        elements: 0,
    };
    reader.find_means();
    reader.hierarchy()?;
    reader.warn_renamed();
    reader.animations()?;
    if opened.nodeless_channels {
        reader.ignore("animation channels that move no node");
    }
    reader.note_unknown_extensions();
    let ignored: Vec<&str> = reader.ignored.iter().map(Cow::as_ref).collect();
    if !ignored.is_empty() {
        let warning = format!("{path}: not fully supported: {}", ignored.join("; "));
        reader.assembly.warn(warning);
    }
    Ok(())
}

/// The state of reading one glTF file into an assembly.
struct Reader<'r, 'a> {
    assembly: &'r mut Assembly<'a>,
    opened: &'r Opened,
    file: Arc<str>,
    /// The assembly's node for each of the file's nodes that belong to the scene.
    nodes: Vec<Option<usize>>,
    /// The assembly's material for each of the file's materials in use. `None`: no material.
    materials: BTreeMap<Option<usize>, u32>,
    /// Meshes by (mesh, primitive). Several nodes can share one.
    meshes: BTreeMap<(usize, usize), Option<Arc<Mesh>>>,
    /// Features of the file that are not fully supported.
    ignored: BTreeSet<Cow<'static, str>>,
    /// Names of the objects that were renamed, because others have their names.
    renamed: Vec<String>,
    /// Mean roughness and metalness in the images that give them. `None` if one cannot be read.
    means: BTreeMap<usize, Option<(f32, f32)>>,
    /// Number of elements read from accessors so far.
    elements: u64,
}

impl Reader<'_, '_> {
    fn ignore(&mut self, what: &'static str) {
        self.ignored.insert(what.into());
    }

    /// Notes the extensions that the file uses and this crate does not read, such as mesh instancing.
    fn note_unknown_extensions(&mut self) {
        /// Longer names are not extension names.
        const LONGEST: usize = 60;
        const MOST: usize = 10;
        let is_name = |name: &&str| {
            name.len() <= LONGEST && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-')
        };
        let used = self.opened.document.extensions_used();
        let unknown = used.filter(|name| !UNDERSTOOD.contains(name)).filter(is_name).take(MOST);
        self.ignored.extend(unknown.map(|name| format!("the extension `{name}`").into()));
    }

    /// Gives one warning for all objects that were renamed.
    fn warn_renamed(&mut self) {
        const SHOWN: usize = 3;
        let (file, count) = (&self.opened.file, self.renamed.len());
        let shown = self.renamed.iter().take(SHOWN).map(|name| format!("`{name}`")).collect::<Vec<_>>();
        let (shown, more) = (shown.join(", "), if count > SHOWN { ", …" } else { "" });
        let warning = match count {
            0 => return,
            1 => format!("{file}: an object has the name of another; it is renamed to {shown}"),
            _ => format!("{file}: {count} objects have names of others; they are renamed to {shown}{more}"),
        };
        self.assembly.warn(warning);
    }

    /// Counts elements read from accessors, and returns how many more may be read. A small file can name a
    /// large accessor many times.
    fn spend(&mut self, elements: u64) -> Result<u64, SceneError> {
        let limit = self.assembly.bundle.limits().triangles.saturating_mul(12);
        self.elements += elements;
        limit.checked_sub(self.elements).ok_or_else(|| SceneError::Limit {
            file: self.opened.file.clone(),
            what: "elements of accessors",
            found: self.elements,
            limit,
        })
    }

    /// Walks the scene's nodes, parents before children.
    fn hierarchy(&mut self) -> Result<(), SceneError> {
        let opened = self.opened;
        let scene = opened.document.default_scene().or_else(|| opened.document.scenes().next());
        let Some(scene) = scene else { return opened.fail("/scenes", "there is no scene") };
        let mut stack: Vec<(gltf::Node<'_>, Option<usize>)> =
            scene.nodes().map(|node| (node, None)).collect();
        stack.reverse();
        while let Some((node, parent)) = stack.pop() {
            let at = format!("/nodes/{}", node.index());
            if self.nodes[node.index()].is_some() {
                return opened.fail(&at, "the node is its own ancestor, or has two parents");
            }
            let placement = self.placement(&node, &at)?;
            let name = node.name().map_or_else(|| format!("node {}", node.index()), str::to_owned);
            self.assembly.shot.nodes.push(Node::new(name, parent, placement));
            let own = self.assembly.shot.nodes.len() - 1;
            self.nodes[node.index()] = Some(own);
            if let Some(mesh) = node.mesh() {
                self.object(&mesh, own)?;
            }
            if node.skin().is_some() {
                self.ignore("skins");
            }
            if let Some(camera) = node.camera() {
                self.camera(&camera, own)?;
            }
            if let Some(light) = node.light() {
                self.light(&light, own)?;
            }
            let first_child = stack.len();
            stack.extend(node.children().map(|child| (child, Some(own))));
            stack[first_child..].reverse();
        }
        Ok(())
    }

    fn placement(&self, node: &gltf::Node<'_>, at: &str) -> Result<Placement, SceneError> {
        let fits = |v: &f32| v.is_finite() && f64::from(v.abs()) <= LARGEST_COORDINATE;
        match node.transform() {
            Transform::Matrix { matrix } => {
                let mut matrix = DMat4::from_cols_array_2d(&matrix.map(|column| column.map(f64::from)));
                if !matrix.to_cols_array().iter().all(|&v| fits(&(v as f32))) {
                    return self.opened.fail(&format!("{at}/matrix"), "a number is not finite or too large");
                }
                if !matrix.row(3).abs_diff_eq(DVec4::W, ROUNDING.into()) {
                    return self.opened.fail(&format!("{at}/matrix"), "the last row must be 0 0 0 1");
                }
                if matrix.row(3) != DVec4::W {
                    matrix = DMat4::from_mat3_translation(DMat3::from_mat4(matrix), matrix.w_axis.truncate());
                }
                Ok(Placement::Matrix(matrix))
            }
            Transform::Decomposed { translation, rotation, scale } => {
                if !translation.iter().chain(&rotation).chain(&scale).all(fits) {
                    return self.opened.fail(at, "a number of its transform is not finite or too large");
                }
                let vector = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
                let rotation = DQuat::from_array(rotation.map(f64::from));
                if rotation.length_squared() < 1e-12 {
                    return self
                        .opened
                        .fail(&format!("{at}/rotation"), "a rotation must be a unit quaternion");
                }
                let (translation, scale) = (vector(translation), vector(scale));
                Ok(Placement::Parts { translation, rotation: rotation.normalize(), scale })
            }
        }
    }

    /// Creates an object for a node with a mesh.
    fn object(&mut self, mesh: &gltf::Mesh<'_>, node: usize) -> Result<(), SceneError> {
        let name = self.assembly.shot.nodes[node].name.clone();
        let (object, renamed) = self.assembly.shot.add_object(&name);
        if renamed {
            let unique = self.assembly.shot.strata.objects[object as usize].clone();
            self.renamed.push(unique.clone());
            self.assembly.shot.nodes[node].name = unique;
        }
        for primitive in mesh.primitives() {
            let key = (mesh.index(), primitive.index());
            let local = match self.meshes.get(&key) {
                Some(known) => known.clone(),
                None => {
                    let at = format!("/meshes/{}/primitives/{}", key.0, key.1);
                    let read = self.mesh(&primitive, key, &at)?.map(Arc::new);
                    self.meshes.insert(key, read.clone());
                    read
                }
            };
            let Some(local) = local else { continue };
            self.assembly.check_size(
                &self.opened.file,
                local.triangles.len() as u64,
                local.positions.len() as u64,
            )?;
            let material = self.material(&primitive.material())?;
            let stratum = self.assembly.shot.stratum(object, material);
            let file = self.file.clone();
            self.assembly.shot.add_part(Part { node, stratum, mesh: local, file });
        }
        Ok(())
    }

    fn camera(&mut self, camera: &gltf::Camera<'_>, node: usize) -> Result<(), SceneError> {
        let at = format!("/cameras/{}", camera.index());
        let Projection::Perspective(perspective) = camera.projection() else {
            self.ignore("orthographic cameras");
            return Ok(());
        };
        let yfov = f64::from(perspective.yfov());
        if !(yfov > 0.0 && yfov < std::f64::consts::PI) {
            return self.opened.fail(&format!("{at}/perspective/yfov"), "must be between 0 and pi");
        }
        let aspect = perspective.aspect_ratio().map_or(DEFAULT_ASPECT, f64::from);
        let width = (aspect * f64::from(DEFAULT_HEIGHT)).round();
        let most = self.assembly.bundle.limits().image_pixels as f64 / f64::from(DEFAULT_HEIGHT);
        if !(width >= 1.0 && width <= most.min(f64::from(u32::MAX))) {
            let reason = format!("an aspect ratio of {aspect} gives an image that is empty or too large");
            return self.opened.fail(&format!("{at}/perspective/aspectRatio"), reason);
        }
        let kept_axis = perspective.aspect_ratio().map_or(FovAxis::Y, |_| FovAxis::X);
        let (width, height) = (width as u32, DEFAULT_HEIGHT);
        self.assembly.cameras.push(NodeCamera { node, yfov, kept_axis, width, height });
        Ok(())
    }

    fn light(&mut self, light: &gltf::khr_lights_punctual::Light<'_>, node: usize) -> Result<(), SceneError> {
        let at = format!("/extensions/KHR_lights_punctual/lights/{}", light.index());
        let power = Vec3::from_array(light.color()) * light.intensity() / LUMENS_PER_WATT;
        if !power.is_finite() || power.min_element() < 0.0 || power.max_element() > 1e12 {
            return self.opened.fail(&at, "colour × intensity is negative, not finite or too large");
        }
        let kind = match light.kind() {
            Kind::Directional => NodeLightKind::Directional { irradiance: power },
            Kind::Point => NodeLightKind::Point { intensity: power, cone: None },
            Kind::Spot { inner_cone_angle, outer_cone_angle } => {
                let (inner, outer) = (f64::from(inner_cone_angle), f64::from(outer_cone_angle));
                // Equal angles are a cone with a sharp edge.
                if !(0.0 <= inner && inner <= outer && 0.0 < outer && outer <= FRAC_PI_2 + 1e-6) {
                    let reason = "the cone angles must satisfy 0 ≤ inner ≤ outer ≤ pi/2, and 0 < outer";
                    return self.opened.fail(&format!("{at}/spot"), reason);
                }
                let cone = Some((libm::cos(inner) as f32, libm::cos(outer) as f32));
                NodeLightKind::Point { intensity: power, cone }
            }
        };
        self.assembly.lights.push(NodeLight { node, kind });
        Ok(())
    }
}
