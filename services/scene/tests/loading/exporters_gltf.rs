//! What other programs write into glTF files is read, as far as it can be, and told.

use crate::made::{Files, encoded, gltf, png, triangle_bin, triangle_gltf, triangle_with};
use forelight_scene::{Limits, Material, Scene, Surface};
use glam::{Vec2, Vec3};
use image::{ImageFormat, Rgb, RgbImage};
use serde_json::{Value, json};

fn first_material(files: &Files) -> Material {
    files.scene().frame(0).unwrap().materials[0].clone()
}

/// What the file's warning says is not fully supported.
fn simplified(scene: &Scene) -> Option<String> {
    let told = |warning: &String| warning.strip_prefix("tri.gltf: not fully supported: ").map(str::to_owned);
    scene.warnings().iter().find_map(told)
}

#[test]
fn channels_that_move_no_node_are_left_out() {
    let channels = |channels: Value| {
        let times: Vec<u8> = [0f32, 1.0].iter().flat_map(|t| t.to_le_bytes()).collect();
        let mut document = triangle_gltf();
        document["buffers"][0]["byteLength"] = json!(52);
        document["bufferViews"]
            .as_array_mut()
            .unwrap()
            .push(json!({"buffer": 0, "byteOffset": 44, "byteLength": 8}));
        let accessors = document["accessors"].as_array_mut().unwrap();
        accessors.push(json!({"bufferView": 2, "componentType": 5126, "count": 2, "type": "SCALAR"}));
        accessors.push(json!({"bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3"}));
        document["animations"] = json!([{"samplers": [{"input": 2, "output": 3}], "channels": channels}]);
        gltf(&document, &[triangle_bin(), times].concat()).scene()
    };
    let moving = json!({"sampler": 0, "target": {"node": 0, "path": "translation"}});
    let nodeless = json!({"sampler": 0, "target": {"path": "translation"}});
    let pointer = json!({"sampler": 0, "target": {"path": "pointer", "extensions":
        {"KHR_animation_pointer": {"pointer": "/nodes/0/translation"}}}});
    assert_eq!(simplified(&channels(json!([moving]))), None);
    let scene = channels(json!([nodeless, moving, pointer]));
    assert_eq!(simplified(&scene).unwrap(), "animation channels that move no node");
    assert_eq!(scene.frame_count(), 25);
    assert_eq!(scene.frame(24).unwrap().geometry.positions[0], Vec3::X);
    let scene = channels(json!([nodeless, pointer]));
    assert_eq!(simplified(&scene).unwrap(), "animation channels that move no node");
    assert_eq!(scene.frame_count(), 1);
}

#[test]
fn a_spot_may_have_a_sharp_edge() {
    let mut document = triangle_gltf();
    document["extensions"] = json!({"KHR_lights_punctual": {"lights": [
        {"type": "spot", "spot": {"innerConeAngle": 0.5, "outerConeAngle": 0.5}}
    ]}});
    document["nodes"][1]["extensions"] = json!({"KHR_lights_punctual": {"light": 0}});
    let frame = gltf(&document, &triangle_bin()).scene().frame(0).unwrap();
    let (_, inner, outer) = frame.points[0].cone.unwrap();
    assert_eq!(inner, outer);
}

#[test]
fn values_may_be_off_by_a_rounding() {
    let matrix = json!([1, 0, 0, 1e-7, 0, 1, 0, 0, 0, 0, 1, 0, 2, 3, 4, 1.0000001]);
    let frame = triangle_with("/nodes/0/matrix", matrix).scene().frame(0).unwrap();
    assert_eq!(frame.geometry.positions[1], Vec3::new(3.0, 3.0, 4.0));
    let factors = json!({"baseColorFactor": [1.0000001, 0.5, -1e-7, 1.000002], "metallicFactor": 0,
        "roughnessFactor": 1.000001});
    let files = triangle_with("/materials/0", json!({"pbrMetallicRoughness": factors, "alphaMode": "BLEND"}));
    let material = first_material(&files);
    let Surface::Plastic { albedo, alpha, .. } = material.surface else { panic!() };
    assert_eq!((albedo.factor, alpha, material.opacity), (Vec3::new(1.0, 0.5, 0.0), 1.0, 1.0));
    let factors = json!({"baseColorFactor": [1.0001, 0.5, 0, 1]});
    let error = triangle_with("/materials/0/pbrMetallicRoughness", factors).error();
    assert!(error.contains("not in the range 0 to 1"), "{error}");
}

#[test]
fn a_texture_without_an_image_counts_as_absent() {
    let mut document = triangle_gltf();
    document["materials"][0] = json!({"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0},
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0}});
    document["textures"] = json!([{"sampler": 0}]);
    document["samplers"] = json!([{}]);
    let scene = gltf(&document, &triangle_bin()).scene();
    let material = &scene.frame(0).unwrap().materials[0];
    let Surface::Plastic { albedo, .. } = &material.surface else { panic!() };
    assert_eq!((albedo.texture, material.emission.texture), (None, None));
    assert_eq!(simplified(&scene).unwrap(), "textures without an image (left out)");
}

#[test]
fn objects_of_one_name_are_told_in_one_warning() {
    let many = |count: usize| {
        let mut document = triangle_gltf();
        document["nodes"] = (0..=count).map(|_| json!({"name": "Cube", "mesh": 0})).collect();
        document["scenes"][0]["nodes"] = (0..=count).collect();
        gltf(&document, &triangle_bin()).scene().warnings()[0].clone()
    };
    assert_eq!(many(1), "tri.gltf: an object has the name of another; it is renamed to `Cube (2)`");
    assert_eq!(
        many(2000),
        "tri.gltf: 2000 objects have names of others; they are renamed to `Cube (2)`, `Cube (3)`, `Cube (4)`, …"
    );
}

#[test]
fn a_track_moves_the_node_with_geometry_among_those_of_its_name() {
    let mut document = triangle_gltf();
    document["nodes"][1] = json!({"name": "tri", "children": [0], "scale": [2, 2, 2]});
    document["scenes"][0]["nodes"] = json!([1]);
    let track = json!({"target": "object:tri", "property": "translation", "interpolation": "step", "keys": [
        {"frame": 0, "value": [1, 0, 0]}]});
    let mut files =
        Files::good().set("/geometry", json!(["tri.gltf"])).set("/animation", json!({"tracks": [track]}));
    files.0.extend(gltf(&document, &triangle_bin()).0);
    assert_eq!(files.scene().frame(0).unwrap().geometry.positions[0], Vec3::new(2.0, 0.0, 0.0));
}

/// The triangle with an image of 2 × 1 texels that gives metalness (blue) and roughness (green).
fn metallic_roughness(pbr: Value, image: Option<&[u8]>) -> Files {
    let mut document = triangle_gltf();
    document["materials"][0] = json!({"pbrMetallicRoughness": pbr});
    document["materials"][0]["pbrMetallicRoughness"]["metallicRoughnessTexture"] = json!({"index": 0});
    document["textures"] = json!([{"source": 0}]);
    document["images"] = json!([{"uri": "mr.png"}]);
    let files = gltf(&document, &triangle_bin());
    image.map_or(files.clone(), |image| files.with("mr.png", image))
}

#[test]
fn metalness_and_roughness_are_the_means_of_their_texture() {
    let image = |a: [u8; 3], b: [u8; 3]| {
        let image = RgbImage::from_fn(2, 1, |x, _| Rgb(if x == 0 { a } else { b }));
        encoded(&image.into(), ImageFormat::Png)
    };
    let wall = image([255, 51, 0], [255, 153, 51]);
    let Surface::Plastic { alpha, .. } = first_material(&metallic_roughness(json!({}), Some(&wall))).surface
    else {
        panic!("a texture without metal")
    };
    assert!((alpha - 0.4 * 0.4).abs() < 1e-6, "102 of 255, not decoded as sRGB: {alpha}");
    let metal = image([0, 255, 255], [0, 255, 153]);
    let with = |factor: f32| {
        let factors = json!({"metallicFactor": factor, "roughnessFactor": 0.5});
        first_material(&metallic_roughness(factors, Some(&metal))).surface
    };
    assert!(matches!(with(0.7), Surface::Metal { alpha: 0.25, .. }), "0.7 × 0.8");
    assert!(matches!(with(0.6), Surface::Plastic { .. }), "0.6 × 0.8");
    let scene = metallic_roughness(json!({}), Some(&metal)).scene();
    assert_eq!(simplified(&scene).unwrap(), "metallic-roughness textures (their means are used)");
    assert!(scene.frame(0).unwrap().textures.is_empty());
}

#[test]
fn a_texture_of_metalness_that_cannot_be_read_is_left_out() {
    let large = png(20, 20, [0, 255, 0, 255]);
    let limits = Limits { texture_pixels: 399, ..Limits::default() };
    for (image, limits) in
        [(None, Limits::default()), (Some(b"KTX".as_slice()), Limits::default()), (Some(&large), limits)]
    {
        let scene = metallic_roughness(json!({}), image).load_within(&limits).unwrap();
        assert!(matches!(scene.frame(0).unwrap().materials[0].surface, Surface::Metal { alpha: 1.0, .. }));
        assert_eq!(simplified(&scene).unwrap(), "metallic-roughness textures that cannot be read (left out)");
    }
}

#[test]
fn specular_glossiness_gives_colour_and_roughness() {
    let old = json!({"diffuseFactor": [0.8, 0.1, 0.2, 0.5], "glossinessFactor": 0.25,
        "diffuseTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"offset": [0.5, 0]}}}});
    let mut document = triangle_gltf();
    document["materials"][0] =
        json!({"alphaMode": "BLEND", "extensions": {"KHR_materials_pbrSpecularGlossiness": old}});
    document["textures"] = json!([{"source": 0}]);
    document["images"] = json!([{"uri": "a.png"}]);
    document["extensionsRequired"] = json!(["KHR_materials_pbrSpecularGlossiness"]);
    document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(2);
    document["accessors"]
        .as_array_mut()
        .unwrap()
        .push(json!({"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC2"}));
    let with =
        |document: &Value| gltf(document, &triangle_bin()).with("a.png", png(1, 1, [9, 9, 9, 255])).scene();
    let scene = with(&document);
    let frame = scene.frame(0).unwrap();
    let Surface::Plastic { albedo, alpha, .. } = frame.materials[0].surface else { panic!() };
    assert_eq!((albedo.factor, alpha), (Vec3::new(0.8, 0.1, 0.2), 0.75 * 0.75));
    assert!(albedo.texture.is_some());
    assert_eq!(frame.materials[0].opacity, 0.5);
    assert_eq!(frame.geometry.uvs[0], Vec2::new(0.5, 1.0));
    assert_eq!(
        simplified(&scene).unwrap(),
        "specular-glossiness (its diffuse colour and glossiness factor are used)"
    );
    // What a file gives for programs that do not know the extension has more of the material.
    document["materials"][0]["pbrMetallicRoughness"] =
        json!({"baseColorFactor": [0.9, 0.7, 0.3, 1], "roughnessFactor": 0.5});
    let scene = with(&document);
    let Surface::Metal { f0, .. } = scene.frame(0).unwrap().materials[0].surface else { panic!() };
    assert_eq!((f0.factor, f0.texture), (Vec3::new(0.9, 0.7, 0.3), None));
}

#[test]
fn a_camera_without_an_aspect_ratio_keeps_its_height() {
    let view = |document: &Value| {
        let scene = gltf(document, &triangle_bin()).scene();
        let camera = scene.frame_with(0, Some((500, 500))).unwrap().camera;
        assert_eq!(scene.camera_with(0, (500, 500)).unwrap(), camera);
        assert_eq!(camera.tan_half_x, camera.tan_half_y);
        camera.tan_half_y
    };
    let mut document = triangle_gltf();
    assert!((view(&document) - 1.5 * 0.5f32.tan()).abs() < 1e-6, "the width is kept");
    document["cameras"][0]["perspective"].as_object_mut().unwrap().remove("aspectRatio");
    assert!((view(&document) - 0.5f32.tan()).abs() < 1e-6);
}
