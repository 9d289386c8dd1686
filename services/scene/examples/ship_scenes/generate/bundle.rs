//! The bundle writer: an OBJ file with its MTL library, PNG textures, and `scene.json`. Coordinates are
//! rounded, so that files are the same on every machine.

use std::collections::HashMap;
use std::fmt::Write as _;

use glam::DVec3;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ImageEncoder, RgbImage};
use serde::Serialize;

use super::mesh::Mesh;

/// Coordinates are written in steps of 0.1 mm; normals and texture coordinates in steps of 10⁻⁴.
const STEPS_PER_UNIT: f64 = 1e4;

/// The base colour of a surface.
#[derive(Clone, Copy, Debug)]
pub enum Base {
    /// A linear reflectance, red, green and blue.
    Colour([f64; 3]),
    /// The name of one of the scene's textures.
    Texture(&'static str),
}

/// The material of a surface.
#[derive(Clone, Copy, Debug)]
pub enum Surface {
    /// Lambertian.
    Matte(Base),
    /// A dielectric coat of this roughness over a Lambertian base.
    Plastic(Base, f64),
    /// A metal: reflectance at normal incidence, and roughness. Roughness 0 is a mirror.
    Metal([f64; 3], f64),
    /// A glass pane without thickness, with this transmittance.
    Pane([f64; 3]),
    /// Solid glass with this transmittance.
    Glass([f64; 3]),
    /// A light-emitting surface with this radiance on its front side.
    Lamp([f64; 3]),
}

/// An object: its name, and its parts with one material each.
#[derive(Clone, Debug)]
pub struct Object {
    /// The name, unique in the scene and without spaces.
    pub name: String,
    /// The parts: material name and mesh.
    pub parts: Vec<(&'static str, Mesh)>,
}

/// A file of a bundle.
#[derive(Clone, Debug)]
pub struct BundleFile {
    /// Path relative to the bundle's folder, with `/` as separator.
    pub path: String,
    /// Contents.
    pub contents: Vec<u8>,
}

/// The camera's position and view.
#[derive(Clone, Debug, Serialize)]
pub struct Camera {
    /// Eye point, in metres.
    pub origin: [f64; 3],
    /// A point in the centre of the image.
    pub target: [f64; 3],
    /// A direction that points up in the image.
    pub up: [f64; 3],
    /// Full angle of view along `fov_axis`, in degrees.
    pub fov_deg: f64,
    /// The axis of `fov_deg`: `x` or `y`.
    pub fov_axis: &'static str,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
}

/// Light from the surroundings.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename_all = "lowercase")]
pub enum Environment {
    /// The same radiance from every direction.
    Constant {
        /// Linear radiance, red, green and blue.
        radiance: [f64; 3],
    },
}

/// A light source.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename_all = "lowercase")]
pub enum Light {
    /// A parallelogram that emits towards `edge_u × edge_v`.
    Quad {
        /// One corner, in metres.
        corner: [f64; 3],
        /// First edge, in metres.
        edge_u: [f64; 3],
        /// Second edge, in metres.
        edge_v: [f64; 3],
        /// Linear radiance, red, green and blue.
        radiance: [f64; 3],
    },
}

/// A keyframe.
#[derive(Clone, Debug, Serialize)]
pub struct Key {
    /// Frame number.
    pub frame: u32,
    /// The value: three numbers, or the four of a quaternion.
    pub value: Vec<f64>,
}

/// The keyframes of one property.
#[derive(Clone, Debug, Serialize)]
pub struct Track {
    /// `camera` or `object:NAME`.
    pub target: String,
    /// The animated property.
    pub property: &'static str,
    /// `linear` or `catmull_rom`.
    pub interpolation: &'static str,
    /// Keyframes in ascending order.
    pub keys: Vec<Key>,
}

/// All animation of a scene.
#[derive(Clone, Debug, Serialize)]
pub struct Animation {
    /// Frames per second.
    pub fps: u32,
    /// Number of frames.
    pub frames: u32,
    /// The tracks.
    pub tracks: Vec<Track>,
}

/// A whole scene.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the scene and of its folder.
    pub name: &'static str,
    /// Camera of frame 0.
    pub camera: Camera,
    /// Light from the surroundings.
    pub environment: Environment,
    /// Light sources.
    pub lights: Vec<Light>,
    /// Animation.
    pub animation: Animation,
    /// Materials by name.
    pub materials: Vec<(&'static str, Surface)>,
    /// Textures by name.
    pub textures: Vec<(&'static str, RgbImage)>,
    /// Objects.
    pub objects: Vec<Object>,
}

/// The contents of `scene.json`, in the order in which they are written.
#[derive(Serialize)]
struct SceneFile<'a> {
    version: u32,
    name: &'a str,
    geometry: [&'a str; 1],
    camera: &'a Camera,
    environment: &'a Environment,
    lights: &'a [Light],
    animation: &'a Animation,
}

impl Scene {
    /// Adds a part to the object called `name`, which is created if necessary.
    pub fn add(&mut self, name: impl Into<String>, material: &'static str, mesh: Mesh) {
        self.add_parts(name, vec![(material, mesh)]);
    }

    /// Adds several parts to the object called `name`.
    pub fn add_parts(&mut self, name: impl Into<String>, parts: Vec<(&'static str, Mesh)>) {
        let name = name.into();
        match self.objects.iter_mut().find(|object| object.name == name) {
            Some(object) => object.parts.extend(parts),
            None => self.objects.push(Object { name, parts }),
        }
    }

    /// Number of triangles in the written bundle.
    pub fn triangle_count(&self) -> usize {
        self.geometry().lines().filter(|line| line.starts_with("f ")).count()
    }

    /// The files of the bundle.
    pub fn files(&self) -> Vec<BundleFile> {
        let text =
            |path: &str, contents: String| BundleFile { path: path.into(), contents: contents.into_bytes() };
        let scene = SceneFile {
            version: 1,
            name: self.name,
            geometry: ["scene.obj"],
            camera: &self.camera,
            environment: &self.environment,
            lights: &self.lights,
            animation: &self.animation,
        };
        let json = serde_json::to_string_pretty(&scene).expect("numbers and strings have a JSON form");
        let mut files = vec![
            text("scene.json", json + "\n"),
            text("scene.obj", self.geometry()),
            text("scene.mtl", self.material_library()),
        ];
        for (name, picture) in &self.textures {
            files.push(BundleFile { path: format!("textures/{name}.png"), contents: png(picture) });
        }
        files
    }

    fn material_library(&self) -> String {
        let mut text = String::new();
        for (name, surface) in &self.materials {
            text += &format!("newmtl {name}\n{}\n", definition(surface));
        }
        text
    }

    /// The OBJ text, equal values written once, without triangles that collapse when rounded.
    fn geometry(&self) -> String {
        let mut text = String::from("mtllib scene.mtl\n");
        let mut pools = [Pool::new("v"), Pool::new("vt"), Pool::new("vn")];
        for object in &self.objects {
            let _ = writeln!(text, "o {}", object.name);
            for (material, mesh) in &object.parts {
                let surface = self.materials.iter().find(|(name, _)| name == material);
                let (_, surface) = surface.expect("a scene defines the materials of its parts");
                let textured = matches!(
                    surface,
                    Surface::Matte(Base::Texture(_)) | Surface::Plastic(Base::Texture(_), _)
                );
                let corners: Vec<(usize, String)> = mesh
                    .vertices
                    .iter()
                    .map(|vertex| {
                        let [positions, coordinates, normals] = &mut pools;
                        let position = positions.index(&vertex.position.to_array(), &mut text);
                        let normal = normals.index(&vertex.normal.to_array(), &mut text);
                        let corner = if textured {
                            let coordinate = coordinates.index(&vertex.uv.to_array(), &mut text);
                            format!("{position}/{coordinate}/{normal}")
                        } else {
                            format!("{position}//{normal}")
                        };
                        (position, corner)
                    })
                    .collect();
                let _ = writeln!(text, "usemtl {material}");
                for triangle in &mesh.triangles {
                    let [a, b, c] = triangle.map(|i| &corners[i]);
                    if a.0 != b.0 && b.0 != c.0 && c.0 != a.0 {
                        let _ = writeln!(text, "f {} {} {}", a.1, b.1, c.1);
                    }
                }
            }
        }
        text
    }
}

/// The vectors of one kind that are already written, and their indices in the file.
struct Pool {
    keyword: &'static str,
    known: HashMap<Vec<i64>, usize>,
}

impl Pool {
    fn new(keyword: &'static str) -> Pool {
        Pool { keyword, known: HashMap::new() }
    }

    /// Returns the index of a vector, counted from 1 as in OBJ. A new vector is first written to `text`.
    fn index(&mut self, vector: &[f64], text: &mut String) -> usize {
        let rounded: Vec<i64> = vector.iter().map(|x| (x * STEPS_PER_UNIT).round() as i64).collect();
        let next = self.known.len() + 1;
        *self.known.entry(rounded).or_insert_with_key(|rounded| {
            let numbers: Vec<String> = rounded.iter().map(|&steps| decimal(steps)).collect();
            let _ = writeln!(text, "{} {}", self.keyword, numbers.join(" "));
            next
        })
    }
}

/// Formats a number of steps as a decimal number without trailing zeros.
fn decimal(steps: i64) -> String {
    let unit = STEPS_PER_UNIT as i64;
    let sign = if steps < 0 { "-" } else { "" };
    let (whole, rest) = (steps.abs() / unit, steps.abs() % unit);
    if rest == 0 {
        format!("{sign}{whole}")
    } else {
        format!("{sign}{whole}.{}", format!("{rest:04}").trim_end_matches('0'))
    }
}

fn definition(surface: &Surface) -> String {
    let rgb = |[r, g, b]: [f64; 3]| format!("{r} {g} {b}");
    let base = |base: &Base| match base {
        Base::Colour(colour) => format!("Kd {}\n", rgb(*colour)),
        Base::Texture(name) => format!("Kd 1 1 1\nmap_Kd textures/{name}.png\n"),
    };
    match surface {
        Surface::Matte(colour) => format!("{}illum 1\n", base(colour)),
        Surface::Plastic(colour, roughness) => {
            format!("{}Ks 0.04 0.04 0.04\nNi 1.5\nPr {roughness}\nillum 2\n", base(colour))
        }
        Surface::Metal(reflectance, roughness) => {
            format!("Kd 0 0 0\nKs {}\nPr {roughness}\nillum 3\n", rgb(*reflectance))
        }
        Surface::Pane(transmittance) => format!("Kd 0 0 0\nTf {}\nNi 1.5\nillum 4\n", rgb(*transmittance)),
        Surface::Glass(transmittance) => format!("Kd 0 0 0\nTf {}\nNi 1.5\nillum 7\n", rgb(*transmittance)),
        Surface::Lamp(radiance) => format!("Kd 0 0 0\nKe {}\nillum 1\n", rgb(*radiance)),
    }
}

fn png(picture: &RgbImage) -> Vec<u8> {
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::Adaptive)
        .write_image(picture, picture.width(), picture.height(), image::ExtendedColorType::Rgb8)
        .expect("a picture in memory has a PNG form");
    bytes
}

/// A Catmull-Rom track for a property of the camera.
pub fn camera_track(property: &'static str, keys: &[(u32, [f64; 3])]) -> Track {
    let keys = keys.iter().map(|&(frame, value)| Key { frame, value: value.to_vec() }).collect();
    Track { target: "camera".into(), property, interpolation: "catmull_rom", keys }
}

/// A vector as three numbers, rounded like the coordinates in the file.
pub fn rounded(vector: DVec3) -> [f64; 3] {
    vector.to_array().map(|x| (x * STEPS_PER_UNIT).round() / STEPS_PER_UNIT)
}
