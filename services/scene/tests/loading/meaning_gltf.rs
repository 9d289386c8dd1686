//! What the parts of a glTF file come to mean.

use crate::made::{Files, glb, gltf, load_zip, png, triangle_bin, triangle_gltf, triangle_with, zip};
use forelight_scene::{AlphaMask, Environment, Frame, Limits, Material, Scene, Surface, TextureId};
use glam::{Vec2, Vec3};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;

fn frame(files: &Files) -> Frame {
    files.scene().frame(0).unwrap()
}

fn material(material: Value) -> Material {
    frame(&triangle_with("/materials/0", material)).materials[0].clone()
}

#[test]
fn a_file_by_itself_is_a_scene_with_its_camera() {
    let scene = gltf(&triangle_gltf(), &triangle_bin()).scene();
    assert_eq!((scene.name(), scene.frame_count(), scene.fps()), ("tri", 1, 24.0));
    assert_eq!(scene.strata().objects, ["tri"]);
    let frame = scene.frame(0).unwrap();
    assert_eq!(frame.geometry.positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    assert_eq!((frame.camera.origin, frame.camera.forward), (Vec3::new(0.0, 0.0, 3.0), Vec3::NEG_Z));
    assert_eq!((frame.camera.width, frame.camera.height), (1080, 720));
    assert!((frame.camera.tan_half_y - 0.5f32.tan()).abs() < 1e-6);
    assert_eq!(frame.environment, Environment::Constant(Vec3::ONE));
}

#[test]
fn binary_files_and_data_uris_hold_the_same_scene() {
    let plain = frame(&gltf(&triangle_gltf(), &triangle_bin()));
    let mut document = triangle_gltf();
    document["buffers"][0].as_object_mut().unwrap().remove("uri");
    let binary = Files(BTreeMap::new()).with("tri.glb", glb(&document, &triangle_bin()));
    assert_eq!(*plain.geometry, *frame(&binary).geometry);
    // 44 bytes in base 64, written out by hand of their structure: zeros are As.
    let encoded = {
        const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        let mut text = String::new();
        for chunk in triangle_bin().chunks(3) {
            let word = chunk.iter().fold(0u32, |w, &b| w << 8 | u32::from(b)) << (8 * (3 - chunk.len()));
            for i in 0..4 {
                let digit = (word >> (18 - 6 * i) & 63) as usize;
                text.push(if i <= chunk.len() { char::from(DIGITS[digit]) } else { '=' });
            }
        }
        format!("data:application/octet-stream;base64,{text}")
    };
    let inline = triangle_with("/buffers/0/uri", json!(encoded)).without("tri.bin");
    assert_eq!(*plain.geometry, *frame(&inline).geometry);
}

#[test]
fn a_file_under_a_description_takes_its_camera_and_fps_from_there() {
    let description = Files::good().set("/geometry", json!(["models/tri.gltf"]));
    let files = description
        .with("models/tri.gltf", triangle_gltf().to_string())
        .with("models/tri.bin", triangle_bin());
    let frame = frame(&files);
    assert_eq!(frame.camera.width, 32);
    assert_eq!(frame.geometry.strata.objects, ["tri"]);
    // Without a camera of its own, the description leaves the view to the file.
    let mut scene: Value = serde_json::from_slice(&files.0["scene.json"]).unwrap();
    scene.as_object_mut().unwrap().remove("camera");
    assert_eq!(self::frame(&files.with("scene.json", scene.to_string())).camera.width, 1080);
}

#[test]
fn nodes_stand_in_their_parents() {
    let mut document = triangle_gltf();
    document["nodes"] = json!([
        {"name": "tri", "mesh": 0, "scale": [2, 2, 2]},
        {"name": "view", "camera": 0, "translation": [0, 0, 3]},
        {"name": "arm", "children": [0], "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]}
    ]);
    document["scenes"] = json!([{"nodes": [2, 1]}]);
    let g = frame(&gltf(&document, &triangle_bin())).geometry;
    // Scaled to (2, 0, 0), turned a quarter about z to (0, 2, 0), moved to (5, 2, 0).
    assert_eq!(g.positions, [Vec3::new(5.0, 0.0, 0.0), Vec3::new(5.0, 2.0, 0.0), Vec3::new(3.0, 0.0, 0.0)]);
}

#[test]
fn a_mesh_on_two_nodes_is_two_objects() {
    let mut document = triangle_gltf();
    document["nodes"]
        .as_array_mut()
        .unwrap()
        .push(json!({"name": "tri", "mesh": 0, "translation": [0, 0, -1]}));
    document["scenes"][0]["nodes"] = json!([0, 1, 2]);
    let scene = gltf(&document, &triangle_bin()).scene();
    assert_eq!(scene.strata().objects, ["tri", "tri (2)"]);
    assert_eq!(scene.strata().pairs, [(0, 0), (1, 0)]);
    assert_eq!(scene.frame(0).unwrap().geometry.triangles, [[0, 1, 2], [3, 4, 5]]);
}

#[test]
fn every_row_of_the_material_table_has_its_surface() {
    let pbr = |metallic: f64| json!({"baseColorFactor": [0.2, 0.4, 0.6, 1], "metallicFactor": metallic, "roughnessFactor": 0.5});
    let colour = Vec3::new(0.2, 0.4, 0.6);
    let of = |metallic, extensions: Value| {
        material(json!({"pbrMetallicRoughness": pbr(metallic), "extensions": extensions})).surface
    };
    let Surface::Metal { f0, alpha } = of(0.5, json!({})) else { panic!() };
    assert_eq!((f0.factor, alpha), (colour, 0.25));
    let Surface::Plastic { albedo, ior, alpha } = of(0.4, json!({"KHR_materials_ior": {"ior": 1.3}})) else {
        panic!()
    };
    assert_eq!((albedo.factor, ior, alpha), (colour, 1.3, 0.25));
    for flat in [
        json!({"KHR_materials_specular": {"specularFactor": 0}}),
        json!({"KHR_materials_specular": {"specularColorFactor": [0, 0, 0]}}),
        json!({"KHR_materials_ior": {"ior": 1}}),
    ] {
        assert!(matches!(of(0.0, flat), Surface::Lambert { .. }));
    }
    let Surface::ThinGlass { ior, transmittance } =
        of(1.0, json!({"KHR_materials_transmission": {"transmissionFactor": 0.5}}))
    else {
        panic!()
    };
    assert_eq!((ior, transmittance.factor), (1.5, colour * 0.5));
    let solid = json!({"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": {"thicknessFactor": 0.1}});
    let Surface::Glass { alpha, transmittance, .. } = of(0.0, solid) else { panic!() };
    assert_eq!((alpha, transmittance.factor), (0.25, colour));
    assert!(matches!(
        of(0.0, json!({"KHR_materials_transmission": {"transmissionFactor": 0.4}})),
        Surface::Plastic { .. }
    ));
}

#[test]
fn a_solid_may_have_a_priority_among_its_extras() {
    let solid = |extras: serde_json::Value| {
        json!({"extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": {"thicknessFactor": 0.1}},
            "extras": extras})
    };
    let priority = |extras| material(solid(extras)).surface.priority().map_or(0, |priority| priority.get());
    assert_eq!(priority(json!({"priority": 7, "author": "somebody"})), 7);
    for without in [json!({}), json!({"author": 1}), json!("priority"), json!([1])] {
        assert_eq!(priority(without), 0);
    }
    for wrong in [json!(0), json!(-1), json!(256), json!(1.5), json!("1"), json!(null)] {
        let files = triangle_with("/materials", json!([solid(json!({"priority": wrong}))]));
        let error = files.error();
        assert!(error.contains("/materials/0/extras/priority") && error.contains("1 to 255"), "{error}");
    }
}

#[test]
fn emission_has_a_strength_and_may_have_two_sides() {
    let lamp = material(json!({"emissiveFactor": [1, 0.5, 0], "doubleSided": true,
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 10}}}));
    assert_eq!((lamp.emission.factor, lamp.emits_both_sides), (Vec3::new(10.0, 5.0, 0.0), true));
    assert!(lamp.is_emissive());
}

#[test]
fn alpha_modes_cut_out_or_thin() {
    let base = |mode: &str, alpha: f64, texture: bool| {
        let mut document = triangle_gltf();
        document["materials"][0] = json!({"alphaMode": mode, "pbrMetallicRoughness": {"metallicFactor": 0, "baseColorFactor": [1, 1, 1, alpha]}});
        if texture {
            document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0});
            document["textures"] = json!([{"source": 0}]);
            document["images"] = json!([{"uri": "leaf%20a.png"}]);
        }
        let files = gltf(&document, &triangle_bin()).with("leaf a.png", png(2, 2, [0, 255, 0, 100]));
        let material = frame(&files).materials[0].clone();
        (material.opacity, material.mask)
    };
    let mask = |cutoff| Some(AlphaMask { texture: TextureId(0), cutoff });
    assert_eq!(base("OPAQUE", 0.3, true), (1.0, None));
    assert_eq!(base("BLEND", 0.3, false), (0.3, None));
    assert_eq!(base("BLEND", 1.0, true), (1.0, mask(0.5)));
    assert_eq!(base("MASK", 0.3, false), (0.0, None));
    assert_eq!(base("MASK", 0.7, false), (1.0, None));
    assert_eq!(base("MASK", 1.0, true), (1.0, mask(0.5)));
    assert_eq!(base("MASK", 0.8, true), (1.0, mask(0.5 / 0.8)));
}

/// The triangle with texture coordinates (0, 0), (1, 0), (0, 1) as bytes, and a texture with a transform.
fn textured(transform: Value) -> Vec<Vec2> {
    let mut bin = triangle_bin();
    bin.extend([0u8, 0, 255, 0, 0, 255, 0, 0]);
    let mut document = triangle_gltf();
    document["buffers"][0]["byteLength"] = json!(52);
    document["bufferViews"]
        .as_array_mut()
        .unwrap()
        .push(json!({"buffer": 0, "byteOffset": 44, "byteLength": 6}));
    document["accessors"].as_array_mut().unwrap().push(
        json!({"bufferView": 2, "componentType": 5121, "normalized": true, "count": 3, "type": "VEC2"}),
    );
    document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(2);
    document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] =
        json!({"index": 0, "extensions": {"KHR_texture_transform": transform}});
    document["textures"] = json!([{"source": 0}]);
    document["images"] = json!([{"uri": "a.png"}]);
    let files = gltf(&document, &bin).with("a.png", png(2, 2, [0, 255, 0, 255]));
    frame(&files).geometry.uvs.clone()
}

#[test]
fn texture_coordinates_point_up_and_follow_the_transform() {
    assert_eq!(textured(json!({})), [Vec2::new(0.0, 1.0), Vec2::new(1.0, 1.0), Vec2::new(0.0, 0.0)]);
    // A quarter turn and offset (0, 1) map the unit square to itself: (0 0) (1 0) (0 1) to (0 1) (0 0) (1 1).
    let turned = textured(json!({"offset": [0, 1], "rotation": std::f64::consts::FRAC_PI_2}));
    for (uv, expected) in turned.iter().zip([Vec2::new(0.0, 0.0), Vec2::new(0.0, 1.0), Vec2::new(1.0, 0.0)]) {
        assert!((*uv - expected).length() < 1e-6, "{turned:?}");
    }
    let scaled = textured(json!({"offset": [0.5, 0], "scale": [2, 4]}));
    assert_eq!(scaled, [Vec2::new(0.5, 1.0), Vec2::new(2.5, 1.0), Vec2::new(0.5, -3.0)]);
}

#[test]
fn quantised_and_sparse_accessors_are_read() {
    let mut bin: Vec<u8> =
        [0i16, 0, 0, 0, 32767, 0, 0, 0, 0, 32767, 0, 0].iter().flat_map(|v| v.to_le_bytes()).collect();
    bin.resize(36, 0);
    bin.extend([0u16, 1, 2, 0].iter().flat_map(|i| i.to_le_bytes()));
    let mut document = triangle_gltf();
    document["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    document["accessors"][0] = json!({"bufferView": 0, "componentType": 5122, "normalized": true, "count": 3, "type": "VEC3",
        "min": [0, 0, 0], "max": [1, 1, 0]});
    document["bufferViews"][0] = json!({"buffer": 0, "byteLength": 24, "byteStride": 8});
    assert_eq!(frame(&gltf(&document, &bin)).geometry.positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);

    let mut document = triangle_gltf();
    document["accessors"][0] = json!({"componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0],
        "sparse": {"count": 2, "indices": {"bufferView": 1, "byteOffset": 2, "componentType": 5123},
        "values": {"bufferView": 0, "byteOffset": 12}}});
    let positions = frame(&gltf(&document, &triangle_bin())).geometry.positions.clone();
    assert_eq!(positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
}

#[test]
fn lights_are_radiometric_and_follow_their_nodes() {
    let mut document = triangle_gltf();
    document["extensions"] = json!({"KHR_lights_punctual": {"lights": [
        {"type": "point", "intensity": 683, "color": [1, 0.5, 0.25]},
        {"type": "directional", "intensity": 1366},
        {"type": "spot", "intensity": 683, "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.5}}
    ]}});
    // A quarter turn about x takes −z, along which lights shine, to +y.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let nodes = document["nodes"].as_array_mut().unwrap();
    for i in 0..3 {
        nodes.push(json!({"translation": [i, 2, 3], "rotation": [half, 0, 0, half], "scale": [5, 5, 5],
            "extensions": {"KHR_lights_punctual": {"light": i}}}));
    }
    document["scenes"][0]["nodes"] = json!([0, 1, 2, 3, 4]);
    let frame = frame(&gltf(&document, &triangle_bin()));
    assert_eq!(frame.environment, Environment::Black);
    assert_eq!(frame.points[0].position, Vec3::new(0.0, 2.0, 3.0));
    assert!((frame.points[0].intensity - Vec3::new(1.0, 0.5, 0.25)).length() < 1e-6);
    assert_eq!(frame.points[0].cone, None);
    assert!((frame.suns[0].irradiance - Vec3::splat(2.0)).length() < 1e-6);
    assert!((frame.suns[0].direction - Vec3::NEG_Y).length() < 1e-6, "towards the sun");
    let (axis, inner, outer) = frame.points[1].cone.unwrap();
    assert!((axis - Vec3::Y).length() < 1e-6);
    assert!((inner - 0.1f32.cos()).abs() < 1e-6 && (outer - 0.5f32.cos()).abs() < 1e-6);
}

/// The triangle on an arm that a file's animation moves: translation of node 0, with keys (seconds, value).
fn moving(interpolation: &str, times: &[f32], values: &[[f32; 3]]) -> Files {
    let mut bin = triangle_bin();
    bin.extend(times.iter().chain(values.iter().flatten()).flat_map(|v| v.to_le_bytes()));
    let mut document = triangle_gltf();
    document["buffers"][0]["byteLength"] = json!(bin.len());
    let split = 44 + 4 * times.len();
    let views = document["bufferViews"].as_array_mut().unwrap();
    views.push(json!({"buffer": 0, "byteOffset": 44, "byteLength": 4 * times.len()}));
    views.push(json!({"buffer": 0, "byteOffset": split, "byteLength": 12 * values.len()}));
    let accessors = document["accessors"].as_array_mut().unwrap();
    accessors.push(json!({"bufferView": 2, "componentType": 5126, "count": times.len(), "type": "SCALAR"}));
    accessors.push(json!({"bufferView": 3, "componentType": 5126, "count": values.len(), "type": "VEC3"}));
    document["animations"] = json!([{"samplers": [{"input": 2, "output": 3, "interpolation": interpolation}],
        "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]}]);
    gltf(&document, &bin)
}

fn x_at(scene: &Scene, frame: u32) -> f32 {
    scene.frame(frame).unwrap().geometry.positions[0].x
}

#[test]
fn linear_and_step_animations_pass_hand_computed_values() {
    let scene = moving("LINEAR", &[0.0, 0.5], &[[0.0; 3], [6.0, 0.0, 0.0]]).scene();
    assert_eq!(scene.frame_count(), 13);
    assert_eq!((x_at(&scene, 0), x_at(&scene, 5), x_at(&scene, 12)), (0.0, 2.5, 6.0));
    // Frame 5 is at 5/24 s, which 32 bits store a hair too late.
    let scene = moving("STEP", &[0.0, 5.0 / 24.0], &[[0.0; 3], [6.0, 0.0, 0.0]]).scene();
    assert_eq!((x_at(&scene, 4), x_at(&scene, 5)), (0.0, 6.0));
}

#[test]
fn cubic_animations_pass_hand_computed_values() {
    // In-tangent, value, out-tangent for each key; tangents per second over a segment of half a second.
    let values = [[0.0; 3], [1.0, 0.0, 0.0], [4.0, 0.0, 0.0], [-2.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0; 3]];
    let scene = moving("CUBICSPLINE", &[0.0, 0.5], &values).scene();
    // Half way: (p0 + p1)/2 + (m0 − m1)·Δ/8 = 2 + (4 + 2)·0.5/8.
    assert!((x_at(&scene, 6) - 2.375).abs() < 1e-6);
    assert_eq!((x_at(&scene, 0), x_at(&scene, 12)), (1.0, 3.0));
}

#[test]
fn a_shot_begins_with_the_first_key_of_the_file() {
    let scene = moving("LINEAR", &[1.0 / 24.0, 3.0 / 24.0], &[[1.0, 0.0, 0.0], [3.0, 0.0, 0.0]]).scene();
    assert_eq!(scene.frame_count(), 3);
    assert_eq!((x_at(&scene, 0), x_at(&scene, 1), x_at(&scene, 2)), (1.0, 2.0, 3.0));
}

#[test]
fn under_a_description_frame_zero_is_the_file_s_time_zero() {
    let files = moving("LINEAR", &[1.0, 2.0], &[[1.0, 0.0, 0.0], [3.0, 0.0, 0.0]]);
    let mut all = Files::good().set("/geometry", json!(["tri.gltf"])).set("/animation", json!({"fps": 10}));
    all.0.extend(files.0);
    let scene = all.scene();
    assert_eq!((scene.frame_count(), scene.fps()), (21, 10.0));
    assert_eq!((x_at(&scene, 0), x_at(&scene, 15), x_at(&scene, 20)), (1.0, 2.0, 3.0));
}

#[test]
fn a_track_replaces_one_local_property_of_a_node() {
    let mut files = moving("LINEAR", &[0.0, 0.5], &[[0.0; 3], [6.0, 0.0, 0.0]]);
    files.0.remove("tri.gltf").map(|document| {
        let mut document: Value = serde_json::from_slice(&document).unwrap();
        document["nodes"][0]["scale"] = json!([2, 2, 2]);
        files.0.insert("tri.gltf".into(), document.to_string().into_bytes())
    });
    let track = json!({"target": "object:tri", "property": "translation", "interpolation": "linear", "keys": [
        {"frame": 0, "value": [0, 0, 0]}, {"frame": 12, "value": [0, 0, -12]}]});
    let mut all =
        Files::good().set("/geometry", json!(["tri.gltf"])).set("/animation", json!({"tracks": [track]}));
    all.0.extend(files.0);
    let scene = all.scene();
    let g = scene.frame(3).unwrap().geometry;
    assert_eq!(
        g.positions,
        [Vec3::new(0.0, 0.0, -3.0), Vec3::new(2.0, 0.0, -3.0), Vec3::new(0.0, 2.0, -3.0)]
    );
}

#[test]
fn still_parts_and_unmoved_frames_share_geometry() {
    let scene = moving("LINEAR", &[0.0, 0.5], &[[6.0, 0.0, 0.0], [6.0, 0.0, 0.0]]).scene();
    assert!(Arc::ptr_eq(&scene.frame(0).unwrap().geometry, &scene.frame(12).unwrap().geometry));
    let scene = moving("STEP", &[0.0, 0.25, 0.5], &[[1.0; 3], [2.0; 3], [2.0; 3]]).scene();
    let (a, b, c) = (scene.frame(0).unwrap(), scene.frame(7).unwrap(), scene.frame(9).unwrap());
    assert!(!Arc::ptr_eq(&a.geometry, &b.geometry));
    assert!(Arc::ptr_eq(&b.geometry, &c.geometry));
    assert_eq!(a.geometry.strata, c.geometry.strata);
}

#[test]
fn what_is_not_shown_is_told_in_one_warning() {
    let mut document = triangle_gltf();
    document["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": 0}]);
    document["meshes"][0]["primitives"]
        .as_array_mut()
        .unwrap()
        .push(json!({"attributes": {"POSITION": 0}, "mode": 0}));
    document["nodes"][0]["skin"] = json!(0);
    document["skins"] = json!([{"joints": [1]}]);
    document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(0);
    document["extensionsUsed"] =
        json!(["KHR_materials_ior", "EXT_mesh_gpu_instancing", "KHR_texture_transform", "a\u{1b}[31m"]);
    let scene = gltf(&document, &triangle_bin()).scene();
    assert_eq!(
        scene.warnings()[0],
        "tri.gltf: not fully supported: colours of vertices; morph targets; points and lines; skins; \
         the extension `EXT_mesh_gpu_instancing`"
    );
}

#[test]
fn a_single_file_next_to_others_is_loaded_by_its_name() {
    let folder = gltf(&triangle_gltf(), &triangle_bin()).with("other.gltf", "{}").folder();
    assert!(Scene::load(&folder.path().join("tri.gltf"), &Limits::default()).is_ok());
    assert!(Scene::load(folder.path(), &Limits::default()).is_err());
}

#[test]
fn a_zip_may_hold_a_gltf_scene_alone() {
    let (document, bin) = (triangle_gltf().to_string(), triangle_bin());
    let archive = zip(&[("tri.gltf", document.as_bytes()), ("tri.bin", &bin)]);
    assert_eq!(load_zip(&archive, &Limits::default()).unwrap().strata().objects, ["tri"]);
}

#[test]
fn a_track_of_a_name_that_two_nodes_share_is_refused() {
    let mut document = triangle_gltf();
    document["nodes"].as_array_mut().unwrap().extend([json!({"name": "arm"}), json!({"name": "arm"})]);
    document["scenes"][0]["nodes"] = json!([0, 1, 2, 3]);
    let track = json!({"target": "object:arm", "property": "scale", "interpolation": "step", "keys": [
        {"frame": 0, "value": [1, 1, 1]}]});
    let mut all =
        Files::good().set("/geometry", json!(["tri.gltf"])).set("/animation", json!({"tracks": [track]}));
    all.0.extend(gltf(&document, &triangle_bin()).0);
    assert_eq!(all.error(), "scene.json: /animation/tracks/0/target: more than one object is named `arm`");
}

#[test]
fn a_camera_or_light_that_its_parents_carry_out_of_the_world_is_refused() {
    let mut document = triangle_gltf();
    document["nodes"][1]["translation"] = json!([0, 0, 1e8]);
    document["nodes"].as_array_mut().unwrap().push(json!({"children": [1], "scale": [1e8, 1e8, 1e8]}));
    document["scenes"][0]["nodes"] = json!([0, 2]);
    assert_eq!(
        gltf(&document, &triangle_bin()).error(),
        "tri.gltf: the camera's node is too far from the origin at frame 0"
    );
    document["nodes"][1] = json!({"name": "lamp", "translation": [0, 0, 1e8], "extensions": {"KHR_lights_punctual": {"light": 0}}});
    document["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "point"}]}});
    assert_eq!(
        gltf(&document, &triangle_bin()).error(),
        "tri.gltf: the light `lamp` is too far from the origin"
    );
}
