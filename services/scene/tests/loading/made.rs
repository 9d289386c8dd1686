//! Small bundles, made by the test that needs them.

use forelight_scene::{Limits, Scene, SceneError};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use tempfile::TempDir;
use zip::write::SimpleFileOptions;

/// A quad in the plane z = 0 that faces +z, of two triangles, with normals and texture coordinates.
pub const OBJ: &str = "mtllib scene.mtl\no wall\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
                       vn 0 0 1\nusemtl white\nf 1/1/1 2/2/1 3/3/1 4/4/1\n";
/// The material of `OBJ`.
pub const MTL: &str = "newmtl white\nKd 0.8 0.8 0.8\nillum 1\n";

/// The files of a bundle.
#[derive(Clone)]
pub struct Files(pub BTreeMap<String, Vec<u8>>);

impl Files {
    /// A bundle that loads: a wall, a camera and a white sky.
    pub fn good() -> Self {
        let scene = json!({
            "version": 1,
            "name": "made",
            "geometry": ["scene.obj"],
            "camera": {
                "origin": [0.5, 0.5, 3], "target": [0.5, 0.5, 0], "up": [0, 1, 0],
                "fov_deg": 40, "fov_axis": "x", "width": 32, "height": 24
            },
            "environment": {"type": "constant", "radiance": [1, 1, 1]},
            "lights": []
        });
        Self(BTreeMap::new())
            .with("scene.obj", OBJ)
            .with("scene.mtl", MTL)
            .with("scene.json", scene.to_string())
    }

    /// The same bundle with a file added or replaced.
    pub fn with(mut self, path: &str, contents: impl AsRef<[u8]>) -> Self {
        self.0.insert(path.to_owned(), contents.as_ref().to_vec());
        self
    }

    /// The same bundle without a file.
    pub fn without(mut self, path: &str) -> Self {
        self.0.remove(path);
        self
    }

    /// The same bundle with another value at a JSON pointer of `scene.json`, whose last part may be new.
    pub fn set(self, pointer: &str, value: Value) -> Self {
        let mut scene: Value = serde_json::from_slice(&self.0["scene.json"]).unwrap();
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        match scene.pointer_mut(parent).unwrap() {
            Value::Object(object) => {
                object.insert(key.to_owned(), value);
            }
            Value::Array(array) => array[key.parse::<usize>().unwrap()] = value,
            other => panic!("{pointer}: nothing can be set in {other}"),
        }
        self.with("scene.json", scene.to_string())
    }

    pub fn write_to(&self, folder: &Path) {
        for (path, contents) in &self.0 {
            let path = folder.join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, contents).unwrap();
        }
    }

    pub fn folder(&self) -> TempDir {
        let folder = TempDir::new().unwrap();
        self.write_to(folder.path());
        folder
    }

    pub fn load(&self) -> Result<Scene, SceneError> {
        self.load_within(&Limits::default())
    }

    pub fn load_within(&self, limits: &Limits) -> Result<Scene, SceneError> {
        Scene::load(self.folder().path(), limits)
    }

    /// The scene of a bundle that must load.
    pub fn scene(&self) -> Scene {
        self.load().unwrap_or_else(|e| panic!("{e}"))
    }

    /// The one line that says why the bundle does not load.
    pub fn error(&self) -> String {
        line(self.load())
    }
}

/// The one line of an error.
pub fn line(result: Result<Scene, SceneError>) -> String {
    let line = result.expect_err("the bundle was accepted").to_string();
    assert!(!line.contains('\n'), "more than one line: {line}");
    line
}

/// A zip archive of named entries.
pub fn zip(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
    for (path, contents) in entries {
        writer.start_file(*path, options).unwrap();
        writer.write_all(contents).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Loads the bytes of an archive.
pub fn load_zip(bytes: &[u8], limits: &Limits) -> Result<Scene, SceneError> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("bundle.zip");
    std::fs::write(&path, bytes).unwrap();
    Scene::load(&path, limits)
}

/// A PNG of one colour.
pub fn png(width: u32, height: u32, rgba: [u8; 4]) -> Vec<u8> {
    let image = image::RgbaImage::from_pixel(width, height, image::Rgba(rgba));
    encoded(&image.into(), image::ImageFormat::Png)
}

pub fn encoded(image: &image::DynamicImage, format: image::ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// A glTF scene of one triangle (0 0 0), (1 0 0), (0 1 0) on the node `tri`, with a camera at z = 3. Its
/// buffer `tri.bin` has 36 bytes of positions, 6 of 16-bit indices and 2 of padding.
pub fn triangle_gltf() -> Value {
    json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [
            {"name": "tri", "mesh": 0},
            {"name": "view", "camera": 0, "translation": [0, 0, 3]}
        ],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1.0, "aspectRatio": 1.5, "znear": 0.1}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"name": "white", "pbrMetallicRoughness": {"metallicFactor": 0}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"}
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 6}
        ],
        "buffers": [{"uri": "tri.bin", "byteLength": 44}]
    })
}

/// The buffer of `triangle_gltf`.
pub fn triangle_bin() -> Vec<u8> {
    let positions = [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut bytes: Vec<u8> = positions.iter().flat_map(|p| p.to_le_bytes()).collect();
    bytes.extend([0u16, 1, 2, 0].iter().flat_map(|i| i.to_le_bytes()));
    bytes
}

/// A bundle of one glTF file and its buffer.
pub fn gltf(document: &Value, bin: &[u8]) -> Files {
    Files(BTreeMap::new()).with("tri.gltf", document.to_string()).with("tri.bin", bin)
}

/// The triangle scene with another value at a JSON pointer.
pub fn triangle_with(pointer: &str, value: Value) -> Files {
    let mut document = triangle_gltf();
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    match document.pointer_mut(parent).unwrap() {
        Value::Object(object) => {
            object.insert(key.to_owned(), value);
        }
        Value::Array(array) => array[key.parse::<usize>().unwrap()] = value,
        other => panic!("{pointer}: nothing can be set in {other}"),
    }
    gltf(&document, &triangle_bin())
}

/// A binary glTF file.
pub fn glb(document: &Value, bin: &[u8]) -> Vec<u8> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend(((12 + 8 + json.len() + 8 + bin.len()) as u32).to_le_bytes());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes.extend((bin.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(bin);
    bytes
}

/// The triangle scene as a binary file.
pub fn triangle_glb() -> Vec<u8> {
    let mut document = triangle_gltf();
    document["buffers"][0].as_object_mut().unwrap().remove("uri");
    glb(&document, &triangle_bin())
}
