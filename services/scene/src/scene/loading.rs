//! Loads a scene: reads `scene.json` and the geometry files into an [`Assembly`], adds defaults, and bakes
//! frame 0. A scene far from the origin is moved to it, so that f32 coordinates keep their precision.

use super::{Scene, light_at};
use crate::animation::Animated;
use crate::assembly::{Assembly, plain_material};
use crate::bundle::Bundle;
use crate::camera_source::{CameraSource, default_view};
use crate::description::{DEFAULT_FPS, Description, EnvironmentSource, Frames};
use crate::error::{Place, SceneError};
use crate::light_source::LightSource;
use crate::limits::Limits;
use crate::shot::{Mesh, Node, Part, Placement};
use crate::{Color, Environment, Surface};
use glam::{DVec3, Vec2, Vec3};
use parking_lot::Mutex;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

/// The file that describes a bundle.
const DESCRIPTION: &str = "scene.json";

impl Scene {
    /// Loads a bundle: a folder, a `.zip`, or a single `.gltf` or `.glb` file with its folder.
    ///
    /// A bundle without `scene.json` must hold exactly one glTF file, which is the scene. The defaults are:
    /// - The frame rate is 24 fps.
    /// - Without `scene.json`, the shot runs from the first to the last key of all animations, since
    ///   exporters count from frame 0 or 1. With it, frame 0 is time 0 of the glTF files, and the shot ends
    ///   at the last key or track.
    /// - Without a camera, the view shows the whole bounding box from the front right and above, at 1280 ×
    ///   720 pixels. This gives a warning.
    /// - A glTF scene without any light gets a white environment of radiance 1. This gives a warning.
    ///
    /// The error is the first one found, with file, place and reason.
    pub fn load(path: &Path, limits: &Limits) -> Result<Self, SceneError> {
        let (bundle, entry) = Self::opened(path, limits)?;
        Self::of(&bundle, &entry)
    }

    /// The files of a bundle that its scene is made of, relative to its folder. The error is that of
    /// [`load`](Self::load).
    pub fn files(path: &Path, limits: &Limits) -> Result<Vec<String>, SceneError> {
        let (bundle, entry) = Self::opened(path, limits)?;
        Self::of(&bundle, &entry)?;
        Ok(bundle.files_read())
    }

    /// Opens a bundle, and says where its scene begins.
    pub(crate) fn opened(path: &Path, limits: &Limits) -> Result<(Bundle, Entry), SceneError> {
        let (root, single) = match single_file(path) {
            Some((folder, file)) => (folder, Some(file)),
            None => (path, None),
        };
        let bundle = Bundle::open(root, limits)?;
        let entry = match single {
            Some(file) if file != DESCRIPTION => Entry::Gltf(file),
            _ if bundle.contains(DESCRIPTION) => Entry::Description,
            _ => Entry::Gltf(only_geometry(&bundle)?),
        };
        Ok((bundle, entry))
    }

    /// Loads the scene of an opened bundle.
    pub(crate) fn of(bundle: &Bundle, entry: &Entry) -> Result<Self, SceneError> {
        match entry {
            Entry::Description => Self::of_description(bundle),
            Entry::Gltf(file) => Self::of_gltf(bundle, file),
        }
    }

    fn of_gltf(bundle: &Bundle, path: &str) -> Result<Self, SceneError> {
        let mut assembly = Assembly::new(bundle, DEFAULT_FPS);
        load_geometry(&mut assembly, path)?;
        let name = path.rsplit_once('.').map_or(path, |(stem, _)| stem).to_owned();
        let specification = Specification { file: path.to_owned(), name, ..Specification::default() };
        Self::finish(assembly, specification)
    }

    fn of_description(bundle: &Bundle) -> Result<Self, SceneError> {
        let description = Description::parse(DESCRIPTION, &bundle.read(DESCRIPTION)?, bundle.limits())?;
        let mut assembly = Assembly::new(bundle, description.fps);
        let mut known = BTreeSet::new();
        for (i, path) in description.geometry.iter().enumerate() {
            // The same triangles twice would only hide each other.
            if !known.insert(path) {
                continue;
            }
            if !bundle.contains(path) {
                let reason = format!("the bundle has no file `{path}`");
                return Err(SceneError::pointer(DESCRIPTION, format!("/geometry/{i}"), reason));
            }
            load_geometry(&mut assembly, path)?;
        }
        let listed = description.geometry.len();
        if known.len() < listed {
            let (files, again) = (known.len(), listed - known.len());
            assembly.warn(format!(
                "{DESCRIPTION}: `geometry` lists {files} files, and {again} times one that it lists before; each \
                 is loaded once"
            ));
        }
        let mut emission = Vec::new();
        for (i, light) in description.lights.iter().enumerate() {
            if let LightSource::Quad { corner, edge_u, edge_v, radiance } = light {
                let material = add_quad(&mut assembly, &format!("light:{i}"), *corner, *edge_u, *edge_v);
                emission.push((material, radiance.clone()));
            }
        }
        let mut motions = Vec::new();
        let nodes = assembly.shot.nodes_by_name();
        for track in description.object_tracks {
            let reason = match nodes.get(track.object.as_str()) {
                Some(Some(node)) => {
                    motions.push((*node, track.motion));
                    continue;
                }
                Some(None) => format!("more than one object is named `{}`", track.object),
                None => format!("there is no object `{}`", track.object),
            };
            return Err(SceneError::pointer(DESCRIPTION, &track.pointer, reason));
        }
        for (node, motion) in motions {
            assembly.shot.nodes[node].animate(motion);
        }
        let environment = match description.environment {
            EnvironmentSource::Black => Environment::Black,
            EnvironmentSource::Constant(radiance) => Environment::Constant(radiance.as_vec3()),
            EnvironmentSource::Image { path, scale, rotation_deg } => {
                let place = || Place::Pointer("/environment/path".into());
                let loaded = assembly.textures.load(&path);
                let texture = loaded.map_err(|e| e.within(DESCRIPTION, place(), "the environment"))?;
                Environment::Image { texture, scale: scale as f32, rotation_deg: rotation_deg as f32 }
            }
        };
        let specification = Specification {
            file: DESCRIPTION.to_owned(),
            name: description.name.unwrap_or_else(|| bundle.name().to_owned()),
            described: true,
            camera: description.camera.map(|c| CameraSource::LookAt(Box::new(c))),
            environment,
            lights: description.lights,
            emission,
            frames: description.frames,
        };
        Self::finish(assembly, specification)
    }

    /// Combines geometry files and description, and adds defaults for what is missing.
    fn finish(mut assembly: Assembly<'_>, specification: Specification) -> Result<Self, SceneError> {
        let Specification { file, name, described, camera, mut environment, lights, emission, frames } =
            specification;
        for (material, radiance) in &emission {
            assembly.materials[*material].emission.factor = light_at(radiance, 0.0);
        }
        let (first_key, last_key) = assembly.keys.unwrap_or((0.0, 0.0));
        let start = if described { 0.0 } else { first_key };
        let keyed = ((last_key - start).round() as u32).saturating_add(1);
        let frames = frame_count(frames, keyed, &file, assembly.bundle.limits())?;
        let mut still_world = assembly.shot.world(start);
        let mut still = assembly.shot.bake(&still_world)?;
        if let Some(centre) = far_centre(&still.geometry.positions) {
            assembly.shot.origin = centre;
            still_world = assembly.shot.world(start);
            still = assembly.shot.bake(&still_world)?;
        }
        let moving = assembly.shot.moving();
        let mut movers: Vec<usize> =
            assembly.shot.parts.iter().map(|part| part.node).filter(|&node| moving[node]).collect();
        movers.sort_unstable();
        movers.dedup();
        if assembly.shot.triangle_count() == 0
            || (still.geometry.triangles.is_empty() && !moving.contains(&true))
        {
            return Err(SceneError::file(file, "the scene has no triangle with an area"));
        }
        if still.dropped > 0 {
            assembly.warn(format!("{file}: {} triangles have no area and are left out", still.dropped));
        }
        if lights.is_empty() && !is_lit(&assembly) && environment == Environment::Black {
            if described {
                assembly.warn(format!("{file}: the scene has no light"));
            } else {
                assembly.warn(format!("{file}: the scene has no light; a white environment is added"));
                environment = Environment::Constant(Vec3::ONE);
            }
        }
        let camera = match (camera, assembly.cameras.first()) {
            (Some(camera), _) => camera,
            (None, Some(camera)) => CameraSource::Node(camera.clone()),
            (None, None) => {
                assembly.warn(format!("{file}: the scene has no camera; a default view shows all of it"));
                let (low, high) = bounds(&still.geometry.positions);
                let origin = assembly.shot.origin;
                CameraSource::LookAt(Box::new(default_view(low + origin, high + origin)))
            }
        };
        assembly.shot.forget_still(&moving);
        let digest = assembly.bundle.digest();
        let Assembly { fps, shot, materials, textures, lights: node_lights, warnings, .. } = assembly;
        let scene = Self {
            name,
            file,
            fps,
            frames,
            start,
            warnings,
            digest,
            camera,
            shot,
            moving,
            movers,
            still_world,
            still,
            recent: Mutex::new(None),
            materials: materials.into(),
            emission,
            textures: textures.into_textures().into(),
            lights,
            node_lights,
            environment,
        };
        scene.check_views()?;
        Ok(scene)
    }
}

/// Where the scene of a bundle begins.
#[derive(Debug)]
pub(crate) enum Entry {
    /// With its `scene.json`.
    Description,
    /// With this glTF file.
    Gltf(String),
}

/// The scene's description. For a scene without `scene.json`, most fields have their defaults.
#[derive(Default)]
struct Specification {
    file: String,
    name: String,
    /// Whether the scene has a `scene.json`.
    described: bool,
    camera: Option<CameraSource>,
    environment: Environment,
    lights: Vec<LightSource>,
    emission: Vec<(usize, Animated<DVec3>)>,
    frames: Option<Frames>,
}

/// The number of frames. `keyed` is the number up to the last key in geometry files.
fn frame_count(given: Option<Frames>, keyed: u32, file: &str, limits: &Limits) -> Result<u32, SceneError> {
    let frames = match given {
        Some(Frames::Given(frames)) => frames,
        Some(Frames::Keyed(frames)) => frames.max(keyed),
        None => keyed,
    };
    if frames > limits.frames {
        let (found, limit) = (u64::from(frames), u64::from(limits.frames));
        return Err(SceneError::Limit { file: file.to_owned(), what: "frames", found, limit });
    }
    Ok(frames)
}

/// Returns `true` if geometry files bring any light: a light on a node, or a surface that emits.
fn is_lit(assembly: &Assembly<'_>) -> bool {
    let emits = |part: &Part| {
        let (_, material) = assembly.shot.strata.pairs[part.stratum as usize];
        assembly.materials[material as usize].is_emissive()
    };
    !assembly.lights.is_empty() || assembly.shot.parts.iter().any(emits)
}

/// Splits the path of a single geometry file or description into folder and name. `None` for other paths.
fn single_file(path: &Path) -> Option<(&Path, String)> {
    let name = path.file_name()?.to_str()?;
    if !path.is_file() || !(is_gltf(name) || name == DESCRIPTION) {
        return None;
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Some((folder, name.to_owned()))
}

fn extension(path: &str) -> String {
    path.rsplit_once('.').map_or_else(String::new, |(_, e)| e.to_ascii_lowercase())
}

fn is_gltf(path: &str) -> bool {
    matches!(extension(path).as_str(), "gltf" | "glb")
}

/// The glTF file of a bundle without `scene.json`.
fn only_geometry(bundle: &Bundle) -> Result<String, SceneError> {
    let mut names = bundle.top_level()?;
    names.retain(|name| is_gltf(name) || extension(name) == "obj");
    match names.as_slice() {
        [name] if is_gltf(name) => Ok(name.clone()),
        [] => Err(SceneError::file(bundle.name(), "has neither a `scene.json` nor a glTF file")),
        _ => {
            let reason =
                format!("needs a `scene.json` that lists its geometry files; it has {}", names.join(", "));
            Err(SceneError::file(bundle.name(), reason))
        }
    }
}

fn load_geometry(assembly: &mut Assembly<'_>, path: &str) -> Result<(), SceneError> {
    match extension(path).as_str() {
        "obj" => crate::obj::load(assembly, path),
        "gltf" | "glb" => crate::gltf_file::load(assembly, path),
        _ => Err(SceneError::file(path, "is not a supported geometry file (.obj, .gltf, .glb)")),
    }
}

/// Adds the two triangles of a quad light. Returns its material.
fn add_quad(assembly: &mut Assembly<'_>, name: &str, corner: DVec3, edge_u: DVec3, edge_v: DVec3) -> usize {
    let black = Surface::Lambert { albedo: Color::plain(Vec3::ZERO) };
    let material = assembly.add_material(plain_material(name, black));
    let (object, _) = assembly.shot.add_object(name);
    let stratum = assembly.shot.stratum(object, material);
    let unique = assembly.shot.strata.objects[object as usize].clone();
    assembly.shot.nodes.push(Node::new(unique, None, Placement::IDENTITY));
    let corners = [corner, corner + edge_u, corner + edge_u + edge_v, corner + edge_v];
    let mesh = Mesh {
        positions: corners.map(|c| c.as_vec3()).to_vec(),
        normals: vec![Vec3::ZERO; 4],
        uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    let node = assembly.shot.nodes.len() - 1;
    assembly.shot.add_part(Part { node, stratum, mesh: Arc::new(mesh), file: DESCRIPTION.into() });
    material as usize
}

fn bounds(positions: &[Vec3]) -> (DVec3, DVec3) {
    let low = positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
    let high = positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
    (low.as_dvec3(), high.as_dvec3())
}

/// The centre of positions that are much farther from the origin than from each other, as in a georeferenced
/// building. `None` for other scenes, whose coordinates stay the same bit for bit.
fn far_centre(positions: &[Vec3]) -> Option<DVec3> {
    let (low, high) = bounds(positions);
    let (centre, extent) = (0.5 * (low + high), (high - low).max_element());
    (extent > 0.0 && centre.abs().max_element() > FAR * extent).then_some(centre)
}

/// A scene is re-centred if its distance from the origin is more than this many times its extent.
const FAR: f64 = 16.0;
