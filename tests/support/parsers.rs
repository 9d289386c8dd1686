//! All parsers of outside input, as functions of bytes. None may panic. Each ends with a one-line error or a
//! valid result. Tests mutate good input; the fuzz targets of `tests/fuzz` go further.

use forelight_protocol::{
    ClaimRequest, FrameSet, JobRequest, NodeChange, NodeRegistration, Problem, ReleaseRequest, RenderStats,
    RenewRequest, ResultRequest, TaskSpec, Timestamp,
};
use forelight_scene::{Limits, Scene, SceneError};
use forelight_tracer::{Cache, CacheSettings, Passes, Profile, SampleCounts, Settings, Tracer, Unfinished};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;
use std::cell::RefCell;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// A parser with its name.
#[derive(Debug, Clone, Copy)]
pub struct Parser {
    /// Name of the fuzz target and of the folder with its inputs.
    pub name: &'static str,
    /// Reads the bytes. Panics only on a bug.
    pub read: fn(&[u8]),
    /// Good input to start from.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All parsers, with those of [`crate::foreign`] and the routes of a service.
pub fn all() -> impl Iterator<Item = Parser> {
    PARSERS.into_iter().chain(crate::foreign::PARSERS).chain([crate::routes::ROUTES])
}

/// Parsers of scenes, artefacts and messages.
const PARSERS: [Parser; 12] = [
    Parser { name: "description", read: description, seeds: description_seeds },
    Parser { name: "obj", read: obj, seeds: || vec![OBJ.into()] },
    Parser { name: "mtl", read: mtl, seeds: || vec![MTL.into()] },
    Parser { name: "gltf", read: gltf, seeds: || vec![GLTF.into()] },
    Parser { name: "glb", read: glb, seeds: || vec![glb_seed()] },
    Parser { name: "image", read: image, seeds: image_seeds },
    Parser { name: "archive", read: archive, seeds: || vec![archive_seed()] },
    Parser { name: "profile", read: profile, seeds: || vec![profile_seed(), profile_with_cache_seed()] },
    Parser { name: "unfinished", read: unfinished, seeds: || vec![unfinished_seed()] },
    Parser { name: "cache", read: cache, seeds: || vec![cache_seed()] },
    Parser { name: "protocol", read: protocol, seeds: protocol_seeds },
    Parser { name: "quantities", read: quantities, seeds: quantity_seeds },
];

/// Bounds that keep a single run small.
fn limits() -> Limits {
    Limits {
        entries: 64,
        total_bytes: 1 << 22,
        file_bytes: 1 << 21,
        texture_pixels: 1 << 16,
        triangles: 10_000,
        frames: 1000,
        image_pixels: 1 << 20,
        ..Limits::default()
    }
}

const DESCRIPTION: &str = r#"{"version":1,"name":"n","geometry":["scene.obj"],
"camera":{"origin":[0.5,0.5,3],"target":[0.5,0.5,0],"up":[0,1,0],"fov_deg":40,"fov_axis":"x","width":32,"height":24,"aperture_radius":0.1,"focus_distance":3},
"environment":{"type":"image","path":"sky","scale":1,"rotation_deg":3},
"lights":[{"type":"quad","corner":[0,0,1],"edge_u":[1,0,0],"edge_v":[0,1,0],"radiance":[1,2,3]},{"type":"point","position":[0,1,0],"intensity":[1,1,1]},{"type":"sun","direction":[0,1,0],"irradiance":[1,1,1],"angle_deg":0.5}],
"animation":{"fps":24,"frames":5,"tracks":[{"target":"object:wall","property":"translation","interpolation":"catmull_rom","keys":[{"frame":0,"value":[0,0,0]},{"frame":4,"value":[1,0,0]}]},
{"target":"camera","property":"fov_deg","interpolation":"linear","keys":[{"frame":0,"value":[40]},{"frame":2,"value":[50]}]},
{"target":"light:1","property":"intensity","interpolation":"step","keys":[{"frame":1,"value":[2,2,2]}]},
{"target":"object:wall","property":"rotation","interpolation":"linear","keys":[{"frame":0,"value":[0,0,0,1]},{"frame":3,"value":[0,1,0,0]}]}]}}"#;

const OBJ: &str = "mtllib scene.mtl\no wall\nv 0 0 0\nv 1 0 0 1\nv 1 1 0 1 0.5 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0\nvn 0 0 1\ns off\n\
                   usemtl a\nf 1/1/1 2/2/1 3/3/1 4/4/1\ng b\nusemtl b\nf -4 -3 -2\nf 1//1 2//1 3//1\n# end\n";

const MTL: &str = "newmtl a\nKd 0.8 0.8 0.8\nmap_Kd sky\nillum 1\nnewmtl b\nKs 0.1 0.2 0.3\nNi 1.5\nPr 0.3\nillum 2\nKe 1 2 3\nTf 1 1 1\nd 0.5\n";

const GLTF: &str = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0,1,2]}],"extensionsUsed":["KHR_lights_punctual","KHR_materials_transmission","KHR_materials_ior","KHR_materials_volume","KHR_materials_specular","KHR_texture_transform"],
"nodes":[{"name":"tri","mesh":0,"scale":[1,-1,1]},{"name":"view","camera":0,"translation":[0,0,3]},{"skin":0,"name":"p","rotation":[0,0,0,1],"children":[3],"extensions":{"KHR_lights_punctual":{"light":0}}},{"mesh":0,"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,1,0,0,1]}],
"cameras":[{"type":"perspective","perspective":{"yfov":1.0,"aspectRatio":1.5,"znear":0.1}}],
"extensions":{"KHR_lights_punctual":{"lights":[{"type":"spot","intensity":3,"spot":{"innerConeAngle":0.1,"outerConeAngle":0.4}}]}},
"meshes":[{"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":2},"indices":1,"material":0}]}],
"materials":[{"name":"m","alphaMode":"MASK","alphaCutoff":0.4,"doubleSided":true,"emissiveFactor":[0.1,0,0],"pbrMetallicRoughness":{"metallicFactor":0.5,"roughnessFactor":0.3,"baseColorTexture":{"index":0}},"normalTexture":{"index":0},"emissiveTexture":{"index":0,"extensions":{"KHR_texture_transform":{"offset":[0,1],"texCoord":0}}},"extensions":{"KHR_materials_transmission":{"transmissionFactor":0.5,"transmissionTexture":{"index":0}},"KHR_materials_volume":{"thicknessFactor":1,"thicknessTexture":{"index":0}},"KHR_materials_specular":{"specularTexture":{"index":0},"specularColorTexture":{"index":0}},"KHR_materials_ior":{"ior":1.4}}}],
"textures":[{"source":0,"sampler":0}],"samplers":[{"wrapS":10497,"magFilter":9729}],"images":[{"uri":"sky"},{"bufferView":0,"mimeType":"image/png"}],
"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]},{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"},{"bufferView":0,"componentType":5126,"count":3,"type":"VEC2"},{"bufferView":2,"componentType":5126,"count":2,"type":"SCALAR","min":[0],"max":[1]},{"bufferView":0,"componentType":5126,"count":2,"type":"VEC3"}],
"bufferViews":[{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":6},{"buffer":0,"byteOffset":8,"byteLength":8}],
"skins":[{"joints":[0,1],"skeleton":0,"inverseBindMatrices":1}],
"animations":[{"samplers":[{"input":3,"output":4,"interpolation":"LINEAR"}],"channels":[{"sampler":0,"target":{"node":0,"path":"translation"}}]}],
"buffers":[{"uri":"data.bin","byteLength":44}]}"#;

/// The buffer of `GLTF`: three positions, three 16-bit indices, padding.
fn buffer() -> Vec<u8> {
    let mut bytes: Vec<u8> =
        [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|p| p.to_le_bytes()).collect();
    bytes.extend([0u16, 1, 2, 0].iter().flat_map(|i| i.to_le_bytes()));
    bytes
}

/// An image of two by two pixels in this format.
fn encoded(format: image::ImageFormat) -> Vec<u8> {
    let image = image::RgbImage::from_fn(2, 2, |x, y| image::Rgb([90 * x as u8, 90 * y as u8, 30]));
    let image = image::DynamicImage::from(image);
    let image = match format {
        image::ImageFormat::Hdr | image::ImageFormat::OpenExr => image.into_rgb32f().into(),
        _ => image,
    };
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).expect("memory can be written to");
    bytes.into_inner()
}

fn image_seeds() -> Vec<Vec<u8>> {
    use image::ImageFormat::{Hdr, Jpeg, OpenExr, Png};
    [Png, Jpeg, Hdr, OpenExr].map(encoded).to_vec()
}

fn description_seeds() -> Vec<Vec<u8>> {
    vec![DESCRIPTION.into()]
}

/// Adds `bytes` to a good bundle under this name, and loads it.
fn in_bundle(description: &str, name: &str, bytes: &[u8]) {
    thread_local! {
        static FOLDER: RefCell<Option<tempfile::TempDir>> = const { RefCell::new(None) };
    }
    FOLDER.with_borrow_mut(|folder| {
        let folder =
            folder.get_or_insert_with(|| tempfile::tempdir().expect("a temporary folder can be made"));
        fill(folder.path(), description);
        std::fs::write(folder.path().join(name), bytes).expect("a temporary file can be written");
        survives(Scene::load(folder.path(), &limits()));
    });
}

/// Writes a good bundle with this description.
fn fill(folder: &Path, description: &str) {
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.join(name), bytes).expect("a temporary file can be written");
    };
    write("scene.obj", OBJ.as_bytes());
    write("scene.mtl", MTL.as_bytes());
    write("scene.gltf", GLTF.as_bytes());
    write("data.bin", &buffer());
    write("sky", &encoded(image::ImageFormat::Png));
    write("scene.json", description.as_bytes());
}

/// A loaded scene must have frames, and an error one line.
fn survives(result: Result<Scene, SceneError>) {
    match result {
        Ok(scene) => {
            assert!(scene.frame_count() > 0);
            for frame in [0, scene.frame_count() / 2, scene.frame_count() - 1] {
                match scene.frame(frame) {
                    Ok(frame) => {
                        let geometry = &frame.geometry;
                        assert!(geometry.positions.iter().all(|p| p.is_finite()));
                        let vertices = geometry.positions.len() as u32;
                        assert!(geometry.triangles.iter().flatten().all(|&v| v < vertices));
                        assert!(frame.camera.origin.is_finite() && frame.camera.forward.is_finite());
                    }
                    Err(error) => one_line(&error.to_string()),
                }
            }
        }
        Err(error) => one_line(&error.to_string()),
    }
}

pub(crate) fn one_line(message: &str) {
    assert!(!message.is_empty() && !message.contains(['\n', '\r']), "more than one line: {message:?}");
}

/// `scene.json`.
pub fn description(bytes: &[u8]) {
    in_bundle(DESCRIPTION, "scene.json", bytes);
}

/// An OBJ file.
pub fn obj(bytes: &[u8]) {
    in_bundle(DESCRIPTION, "scene.obj", bytes);
}

/// An MTL file.
pub fn mtl(bytes: &[u8]) {
    in_bundle(DESCRIPTION, "scene.mtl", bytes);
}

/// A text glTF file.
pub fn gltf(bytes: &[u8]) {
    in_bundle(r#"{"version":1,"geometry":["scene.gltf"]}"#, "scene.gltf", bytes);
}

/// A binary glTF file.
pub fn glb(bytes: &[u8]) {
    in_bundle(r#"{"version":1,"geometry":["scene.glb"]}"#, "scene.glb", bytes);
}

fn glb_seed() -> Vec<u8> {
    let mut json = GLTF.replace(r#""uri":"data.bin","#, "").into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let bin = buffer();
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

/// A texture, and the environment.
pub fn image(bytes: &[u8]) {
    in_bundle(DESCRIPTION, "sky", bytes);
}

/// A zipped bundle.
pub fn archive(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("bundle.zip");
    std::fs::write(&path, bytes).expect("a temporary file can be written");
    survives(Scene::load(Path::new(&path), &limits()));
}

fn archive_seed() -> Vec<u8> {
    use std::io::Write as _;
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let sky = encoded(image::ImageFormat::Png);
    let files: [(&str, &[u8]); 4] = [
        ("a/scene.json", DESCRIPTION.as_bytes()),
        ("a/scene.obj", OBJ.as_bytes()),
        ("a/scene.mtl", MTL.as_bytes()),
        ("a/sky", &sky),
    ];
    for (name, content) in files {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).expect("a file can be started");
        zip.write_all(content).expect("memory can be written to");
    }
    zip.finish().expect("memory can be written to").into_inner()
}

/// An artefact with a checksum, both as it is and with a corrected checksum. The latter reaches the code
/// behind the check.
fn sealed(bytes: &[u8], read: impl Fn(&[u8])) {
    read(bytes);
    if bytes.len() >= 32 {
        let mut whole = bytes[..bytes.len() - 32].to_vec();
        let checksum = blake3::hash(&whole);
        whole.extend_from_slice(checksum.as_bytes());
        read(&whole);
    }
}

/// Profiled pixels.
pub fn profile(bytes: &[u8]) {
    sealed(bytes, |bytes| match Profile::from_bytes(bytes) {
        // Reading and writing must give back every byte.
        Ok(profile) => assert_eq!(profile.to_bytes(), bytes),
        Err(error) => one_line(&error.to_string()),
    });
}

/// Pixels between two passes.
pub fn unfinished(bytes: &[u8]) {
    sealed(bytes, |bytes| match Unfinished::from_bytes(bytes) {
        Ok(file) => assert_eq!(file.to_bytes(), bytes),
        Err(error) => one_line(&error.to_string()),
    });
}

/// The good bundle, ready to be traced with an irradiance cache.
fn traced() -> Tracer {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    fill(folder.path(), DESCRIPTION);
    let scene = Scene::load(folder.path(), &limits()).expect("the bundle is good");
    let cache = Some(CacheSettings { accuracy: 1000, rays: 48 });
    let settings = Settings { width: 2, height: 2, spp: 1, ambient_bounces: 2, cache, ..Settings::default() };
    Tracer::new(&scene.frame(0).expect("a shot has a frame"), &settings)
}

fn profile_seed() -> Vec<u8> {
    let tracer = traced();
    let pixels = (0..3).zip(tracer.profile(&[0, 1, 2])).collect();
    Profile { origin: tracer.origin(), fingerprint: tracer.fingerprint(), pixels, cache: None }.to_bytes()
}

fn unfinished_seed() -> Vec<u8> {
    let tracer = traced();
    tracer.plan();
    assert!(tracer.fill(&|_, _| (), &AtomicBool::new(false)));
    let mut passes = Passes::of(&tracer, &[0, 2, 3]);
    let two = SampleCounts::new(vec![2; 4]).expect("every pixel has samples");
    passes.go_on(&tracer, &two, &|| false, &|_| ()).expect("the image has four pixels");
    passes.unfinished(&tracer).to_bytes()
}

fn profile_with_cache_seed() -> Vec<u8> {
    let tracer = traced();
    tracer.plan();
    let cache = tracer.cache().expect("a cache was called for").to_bytes();
    Profile {
        origin: tracer.origin(),
        fingerprint: tracer.fingerprint(),
        pixels: Vec::new(),
        cache: Some(cache),
    }
    .to_bytes()
}

/// An irradiance cache.
pub fn cache(bytes: &[u8]) {
    sealed(bytes, |bytes| match Cache::from_bytes(bytes) {
        Ok(cache) => {
            let again = Cache::from_bytes(&cache.to_bytes()).expect("what was written can be read");
            assert_eq!(again.records(), cache.records());
            assert_eq!(again.totals(), cache.totals());
        }
        Err(error) => one_line(&error.to_string()),
    });
}

fn cache_seed() -> Vec<u8> {
    let tracer = traced();
    assert!(tracer.fill(&|_, _| {}, &AtomicBool::new(false)));
    tracer.cache().expect("a cache was called for").to_bytes()
}

/// JSON bodies of requests and responses.
pub fn protocol(bytes: &[u8]) {
    same_again::<JobRequest>(bytes);
    same_again::<NodeRegistration>(bytes);
    same_again::<NodeChange>(bytes);
    same_again::<ClaimRequest>(bytes);
    same_again::<RenewRequest>(bytes);
    same_again::<ReleaseRequest>(bytes);
    same_again::<ResultRequest>(bytes);
    same_again::<TaskSpec>(bytes);
    same_again::<RenderStats>(bytes);
    same_again::<Problem>(bytes);
}

/// A parsed value must survive writing and reading.
fn same_again<T: Serialize + DeserializeOwned>(bytes: &[u8]) {
    if let Ok(value) = serde_json::from_slice::<T>(bytes) {
        let said = serde_json::to_value(&value).expect("what was read can be written");
        let text = said.to_string();
        let again: T = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"));
        let again = serde_json::to_value(&again).expect("what was read can be written");
        assert!(alike(&said, &again), "{said} against {again}");
    }
}

/// Equality, except for the last digit of fractions, which the JSON reader may round differently.
fn alike(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Array(a), Value::Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| alike(a, b)),
        (Value::Object(a), Value::Object(b)) => {
            a.len() == b.len() && a.iter().all(|(key, a)| b.get(key).is_some_and(|b| alike(a, b)))
        }
        (Value::Number(a), Value::Number(b)) if a.is_f64() => {
            let (a, b) = (a.as_f64().unwrap_or_default(), b.as_f64().unwrap_or_default());
            a == b || ((a - b) / a).abs() < 1e-15 || a.abs() < f64::MIN_POSITIVE
        }
        (a, b) => a == b,
    }
}

fn protocol_seeds() -> Vec<Vec<u8>> {
    let id = "0190b6a8-2f4e-7c3d-9a51-0123456789ab";
    [
        format!(
            r#"{{"name":"n","project":"p","bundle":{{"id":"{id}"}},"frames":"0-3,9","settings":{{"width":64,"height":36,"spp":4}},"samples":64,"profile_frames":2,"deadline":"2026-03-01T18:00:00.000000Z","budget":1000000,"confidence":"p80","priority":-3}}"#
        ),
        r#"{"name":"n","speed":1000,"price_per_hour":1000000,"calendar":[]}"#.into(),
        r#"{"wait_seconds":1,"kinds":["render"]}"#.into(),
        format!(r#"{{"fence":3,"progress":0.5,"lease":"{id}"}}"#),
        r#"{"type":"about:blank","title":"t","status":404,"detail":"d"}"#.into(),
        r#"{"frame":3,"width":4,"height":4,"spp":1,"effects":["sun"],"rays":{"primary":1,"shadow":2,"transparent":0,"reflected":0,"refracted":0,"ambient":0,"specular":0},"cache_records":[],"work":5,"cpu_seconds":0.1,"wall_seconds":0.2,"peak_rss_bytes":9}"#.into(),
    ]
    .map(String::into_bytes)
    .to_vec()
}

/// Sets of frames and instants, as people write them.
pub fn quantities(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match text.parse::<FrameSet>() {
        Ok(set) => {
            assert!(set.count() > 0 && set.contains(set.last()));
            assert_eq!(set.to_string().parse::<FrameSet>().as_ref(), Ok(&set), "{text:?}");
        }
        Err(error) => one_line(&error.to_string()),
    }
    match text.parse::<Timestamp>() {
        Ok(instant) => {
            assert_eq!(instant.to_string().parse::<Timestamp>().as_ref(), Ok(&instant), "{text:?}")
        }
        Err(error) => one_line(&error.to_string()),
    }
}

fn quantity_seeds() -> Vec<Vec<u8>> {
    ["0-47", "0,5,9-12", "2026-03-01T18:00:00Z", "2026-03-01T20:00:00.000000999+02:00", "4294967295"]
        .map(|text| text.as_bytes().to_vec())
        .to_vec()
}
