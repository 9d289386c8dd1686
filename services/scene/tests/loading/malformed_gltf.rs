//! Malformed glTF files get one clear line, too, and none of them ends the program.

use crate::made::{Files, glb, gltf, triangle_bin, triangle_glb, triangle_gltf, triangle_with};
use serde_json::json;
use std::collections::BTreeMap;

fn binary(bytes: &[u8]) -> Files {
    Files(BTreeMap::new()).with("tri.glb", bytes)
}

#[test]
fn a_binary_file_that_is_cut_off() {
    let whole = triangle_glb();
    assert!(binary(&whole).load().is_ok());
    for length in [4, 8, 11, 12, 16, 19, 20, 100, whole.len() - 45, whole.len() - 1] {
        let error = binary(&whole[..length]).error();
        assert!(error.starts_with("tri.glb: "), "{error}");
    }
    let error = binary(&whole[..100]).error();
    assert_eq!(
        error,
        format!("tri.glb: the file is truncated: its header says {} bytes, but it has 100", whole.len())
    );
    assert_eq!(binary(&whole[..7]).error(), "tri.glb: the header of the binary glTF is truncated");
}

#[test]
fn a_binary_file_of_another_version() {
    let mut bytes = triangle_glb();
    bytes[4] = 1;
    assert_eq!(
        binary(&bytes).error(),
        "tri.glb: binary glTF version 1 is not supported; this program reads version 2"
    );
}

#[test]
fn a_binary_file_with_wrong_chunks() {
    let mut bytes = triangle_glb();
    bytes[16] = b'X';
    assert_eq!(binary(&bytes).error(), "tri.glb: the binary glTF does not begin with a JSON chunk");
    let mut bytes = triangle_glb();
    bytes[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
    assert_eq!(binary(&bytes).error(), "tri.glb: a chunk of the binary glTF reaches beyond its end");
    let mut bytes = triangle_glb();
    bytes[8..12].copy_from_slice(&3u32.to_le_bytes());
    assert_eq!(binary(&bytes).error(), "tri.glb: a chunk of the binary glTF reaches beyond its end");
}

#[test]
fn a_document_that_is_no_json_or_of_the_wrong_shape() {
    let error = Files(BTreeMap::new()).with("tri.gltf", "{\"asset\":").error();
    assert!(error.starts_with("tri.gltf: ") && error.contains("EOF"), "{error}");
    let error = triangle_with("/nodes/0/mesh", json!("zero")).error();
    assert!(error.starts_with("tri.gltf: /nodes/0/mesh: invalid type: string \"zero\""), "{error}");
}

#[test]
fn a_document_of_another_version() {
    assert_eq!(
        triangle_with("/asset/version", json!("1.0")).error(),
        "tri.gltf: /asset/version: glTF version 1.0 is not supported; this program reads version 2.0"
    );
}

#[test]
fn an_extension_that_is_required_and_not_understood() {
    assert_eq!(
        triangle_with("/extensionsRequired", json!(["KHR_texture_basisu"])).error(),
        "tri.gltf: /extensionsRequired/0: `KHR_texture_basisu` is required but not supported"
    );
}

#[test]
fn indices_into_the_document_that_lead_nowhere() {
    for (pointer, expected) in [
        ("/scene", "/scene: Index out of bounds"),
        ("/scenes/0/nodes/0", "/scenes/0/nodes/0: Index out of bounds"),
        ("/nodes/0/mesh", "/nodes/0/mesh: Index out of bounds"),
        ("/nodes/1/camera", "/nodes/1/camera: Index out of bounds"),
        (
            "/meshes/0/primitives/0/attributes/POSITION",
            "/meshes/0/primitives/0/attributes/POSITION: there is no such accessor",
        ),
        ("/meshes/0/primitives/0/indices", "/meshes/0/primitives/0/indices: Index out of bounds"),
        ("/meshes/0/primitives/0/material", "/meshes/0/primitives/0/material: Index out of bounds"),
        ("/accessors/0/bufferView", "/accessors/0/bufferView: Index out of bounds"),
        ("/bufferViews/0/buffer", "/bufferViews/0/buffer: Index out of bounds"),
    ] {
        assert_eq!(triangle_with(pointer, json!(99)).error(), format!("tri.gltf: {expected}"));
    }
}

#[test]
fn a_node_that_is_its_own_ancestor_or_has_two_parents() {
    let expected = "tri.gltf: /nodes/0: the node is its own ancestor, or has two parents";
    assert_eq!(triangle_with("/nodes/0/children", json!([0])).error(), expected);
    assert_eq!(triangle_with("/nodes/1/children", json!([0])).error(), expected);
}

#[test]
fn a_document_without_a_scene() {
    let mut document = triangle_gltf();
    document.as_object_mut().unwrap().remove("scene");
    document["scenes"] = json!([]);
    assert_eq!(gltf(&document, &triangle_bin()).error(), "tri.gltf: /scenes: there is no scene");
}

#[test]
fn a_document_without_geometry() {
    let mut document = triangle_gltf();
    document["nodes"][0].as_object_mut().unwrap().remove("mesh");
    assert_eq!(gltf(&document, &triangle_bin()).error(), "tri.gltf: the scene has no triangle with an area");
}

#[test]
fn a_buffer_that_is_missing_short_or_outside() {
    let missing = gltf(&triangle_gltf(), &triangle_bin()).without("tri.bin").error();
    assert!(missing.starts_with("tri.gltf: /buffers/0: `uri`: tri.bin: cannot be read: "), "{missing}");
    assert_eq!(
        gltf(&triangle_gltf(), &triangle_bin()[..40]).error(),
        "tri.gltf: /buffers/0: is 40 bytes long, not 44"
    );
    assert_eq!(
        triangle_with("/buffers/0/uri", json!("../tri.bin")).error(),
        "tri.gltf: /buffers/0: `../tri.bin` leaves the bundle"
    );
    assert_eq!(
        triangle_with("/buffers/0/uri", json!("file:///etc/passwd")).error(),
        "tri.gltf: /buffers/0: `file:///etc/passwd`: a path in a bundle is relative"
    );
    assert_eq!(
        triangle_with("/buffers/0/uri", json!("http://example.org/tri.bin")).error(),
        "tri.gltf: /buffers/0: `http://example.org/tri.bin`: a path in a bundle is relative"
    );
    let damaged = triangle_with("/buffers/0/uri", json!("data:application/octet-stream;base64,@@")).error();
    assert!(damaged.starts_with("tri.gltf: /buffers/0: the data URI is damaged: "), "{damaged}");
}

#[test]
fn a_buffer_without_contents() {
    let mut document = triangle_gltf();
    document["buffers"][0].as_object_mut().unwrap().remove("uri");
    assert_eq!(gltf(&document, &[]).error(), "tri.gltf: /buffers/0: has neither a `uri` nor a binary chunk");
    let mut document = triangle_gltf();
    document["buffers"] = json!([{"byteLength": 44}, {"byteLength": 44}]);
    let error = binary(&glb(&document, &triangle_bin())).error();
    assert_eq!(error, "tri.glb: /buffers/1: has neither a `uri` nor a binary chunk");
}

#[test]
fn accessors_that_reach_beyond_their_data() {
    let beyond = |at: &str| format!("tri.gltf: {at}: reaches beyond the end of its buffer");
    for (pointer, value, expected) in [
        ("/bufferViews/0/byteOffset", json!(20), "/bufferViews/0"),
        ("/bufferViews/0/byteLength", json!(1_u64 << 40), "/bufferViews/0"),
        ("/bufferViews/0/byteOffset", json!(u64::MAX), "/bufferViews/0"),
    ] {
        assert_eq!(triangle_with(pointer, value).error(), beyond(expected));
    }
    for (pointer, value) in [
        ("/accessors/0/count", json!(4)),
        ("/accessors/0/byteOffset", json!(4)),
        ("/accessors/0/byteOffset", json!(u64::MAX)),
        ("/bufferViews/0/byteStride", json!(8)),
        ("/bufferViews/0/byteStride", json!(252)),
    ] {
        assert_eq!(triangle_with(pointer, value).error(), beyond("/accessors/0") + " view");
    }
}

#[test]
fn accessors_that_claim_more_than_any_memory_holds() {
    for count in [4_000_000_000_u64, u64::MAX] {
        let error = triangle_with("/accessors/0/count", json!(count)).error();
        assert!(error.starts_with("tri.gltf: /accessors/0: elements: "), "{error}");
    }
    // Sparse accessors need no data.
    for count in [200_000_000_u64, 4_000_000_000] {
        let mut document = triangle_gltf();
        document["accessors"][0] = json!({"componentType": 5126, "count": count, "type": "VEC3",
            "min": [0, 0, 0], "max": [1, 1, 0], "sparse": {"count": 1,
            "indices": {"bufferView": 1, "componentType": 5123}, "values": {"bufferView": 0}}});
        let error = gltf(&document, &triangle_bin()).error();
        let found = format!("tri.gltf: /accessors/0: elements: {count} is more than");
        assert!(error.starts_with(&found), "{error}");
    }
}

#[test]
fn accessors_without_elements_or_of_the_wrong_type() {
    assert_eq!(
        triangle_with("/accessors/0/count", json!(0)).error(),
        "tri.gltf: /accessors/0: has no element"
    );
    assert_eq!(
        triangle_with("/accessors/0/type", json!("VEC2")).error(),
        "tri.gltf: /accessors/0: is of type Vec2 where 3 components are needed"
    );
    assert_eq!(
        triangle_with("/accessors/1/componentType", json!(5126)).error(),
        "tri.gltf: /accessors/1: indices must be unsigned integer scalars"
    );
    assert_eq!(
        triangle_with("/accessors/0/componentType", json!(7)).error(),
        "tri.gltf: /accessors/0/componentType: Invalid value"
    );
}

#[test]
fn sparse_values_for_elements_that_are_not_there() {
    let mut document = triangle_gltf();
    document["accessors"][0]["sparse"] = json!({"count": 1,
        "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 0}});
    document["bufferViews"] = json!([{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6}, {"buffer": 0, "byteLength": 2, "byteOffset": 42}]);
    let mut bin = triangle_bin();
    bin[42] = 9;
    assert_eq!(gltf(&document, &bin).error(), "tri.gltf: /accessors/0/sparse: there is no element 9");
}

#[test]
fn a_vertex_that_is_not_finite() {
    let mut bin = triangle_bin();
    bin[12..16].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_eq!(gltf(&triangle_gltf(), &bin).error(), "tri.gltf: /accessors/0: element 1 is not finite");
}

#[test]
fn a_vertex_index_that_is_too_large() {
    let mut bin = triangle_bin();
    bin[40..42].copy_from_slice(&65535u16.to_le_bytes());
    assert_eq!(
        gltf(&triangle_gltf(), &bin).error(),
        "tri.gltf: /meshes/0/primitives/0/indices: there is no vertex 65535; there are 3"
    );
}

#[test]
fn a_primitive_without_positions() {
    assert_eq!(
        triangle_with("/meshes/0/primitives/0/attributes", json!({})).error(),
        "tri.gltf: /meshes/0/primitives/0/attributes/POSITION: Missing data"
    );
}

#[test]
fn attributes_of_different_lengths() {
    let mut document = triangle_gltf();
    document["accessors"]
        .as_array_mut()
        .unwrap()
        .push(json!({"bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3"}));
    document["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(2);
    assert_eq!(
        gltf(&document, &triangle_bin()).error(),
        "tri.gltf: /meshes/0/primitives/0: all attributes must have the same number of elements"
    );
}

#[test]
fn transforms_that_are_none() {
    assert_eq!(
        triangle_with("/nodes/0/rotation", json!([0, 0, 0, 0])).error(),
        "tri.gltf: /nodes/0/rotation: a rotation must be a unit quaternion"
    );
    let matrix = json!([1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    assert_eq!(
        triangle_with("/nodes/0/matrix", matrix).error(),
        "tri.gltf: /nodes/0/matrix: the last row must be 0 0 0 1"
    );
    assert_eq!(
        triangle_with("/nodes/0/translation", json!([1e39, 0, 0])).error(),
        "tri.gltf: /nodes/0: a number of its transform is not finite or too large"
    );
}

#[test]
fn cameras_that_see_nothing() {
    assert_eq!(
        triangle_with("/cameras/0/perspective/yfov", json!(4)).error(),
        "tri.gltf: /cameras/0/perspective/yfov: must be between 0 and pi"
    );
    assert_eq!(
        triangle_with("/cameras/0/perspective/aspectRatio", json!(1e30)).error(),
        "tri.gltf: /cameras/0/perspective/aspectRatio: an aspect ratio of 1000000015047466200000000000000 gives an image that is empty or too large"
    );
    assert_eq!(
        triangle_with("/nodes/1/scale", json!([0, 0, 0])).error(),
        "tri.gltf: the camera's node has no orientation (its scale is zero) at frame 0"
    );
}

#[test]
fn materials_out_of_range() {
    assert_eq!(
        triangle_with("/materials/0/pbrMetallicRoughness/roughnessFactor", json!(2)).error(),
        "tri.gltf: /materials/0: a base colour, roughness, metallic or glossiness factor is not in the range 0 to 1"
    );
    assert_eq!(
        triangle_with("/materials/0/emissiveFactor", json!([-1, 0, 0])).error(),
        "tri.gltf: /materials/0: the emission is not in the range 0 to 1e12"
    );
    assert_eq!(
        triangle_with("/materials/0/extensions", json!({"KHR_materials_ior": {"ior": 0.5}})).error(),
        "tri.gltf: /materials/0: an index of refraction of 0.5 is not in the range 1 to 10"
    );
}

#[test]
fn a_texture_without_an_image() {
    let mut document = triangle_gltf();
    document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0});
    document["textures"] = json!([{"source": 0}]);
    document["images"] = json!([{}]);
    let error = gltf(&document, &triangle_bin()).error();
    assert_eq!(error, "tri.gltf: /images/0: has neither a `uri` nor a `bufferView`");
    document["images"] = json!([{"bufferView": 0}]);
    let error = gltf(&document, &triangle_bin()).error();
    assert_eq!(
        error,
        "tri.gltf: /images/0: the image: tri.gltf#image0: is not a supported image (PNG, JPEG, WebP, Radiance HDR, OpenEXR)"
    );
    document["images"] = json!([{"uri": "wood.png"}]);
    let error = gltf(&document, &triangle_bin()).error();
    assert!(error.starts_with("tri.gltf: /images/0: the image: wood.png: cannot be read: "), "{error}");
}

#[test]
fn lights_that_are_none() {
    let with = |light: serde_json::Value| {
        let mut document = triangle_gltf();
        document["extensions"] = json!({"KHR_lights_punctual": {"lights": [light]}});
        document["nodes"][1]["extensions"] = json!({"KHR_lights_punctual": {"light": 0}});
        gltf(&document, &triangle_bin()).error()
    };
    let at = "tri.gltf: /extensions/KHR_lights_punctual/lights/0";
    assert_eq!(
        with(json!({"type": "point", "intensity": -5})),
        format!("{at}: colour × intensity is negative, not finite or too large")
    );
    assert_eq!(
        with(json!({"type": "spot", "spot": {"innerConeAngle": 1, "outerConeAngle": 0.5}})),
        format!("{at}/spot: the cone angles must satisfy 0 ≤ inner ≤ outer ≤ pi/2, and 0 < outer")
    );
    assert!(with(json!({"type": "spot", "spot": {"outerConeAngle": 0}})).contains("the cone angles"));
    let error = triangle_with("/nodes/1/extensions", json!({"KHR_lights_punctual": {"light": 0}})).error();
    assert!(error.starts_with("tri.gltf: /nodes/1/extensions"), "{error}");
    assert!(
        with(json!({"type": "spot"})).ends_with("spot: Missing data"),
        "{}",
        with(json!({"type": "spot"}))
    );
}

#[test]
fn animations_with_keys_that_do_not_fit() {
    let with = |times: [f32; 2], outputs: usize| {
        let mut bin = triangle_bin();
        bin.extend(times.iter().flat_map(|t| t.to_le_bytes()));
        let mut document = triangle_gltf();
        document["buffers"][0]["byteLength"] = json!(52);
        document["bufferViews"]
            .as_array_mut()
            .unwrap()
            .push(json!({"buffer": 0, "byteOffset": 44, "byteLength": 8}));
        let accessors = document["accessors"].as_array_mut().unwrap();
        accessors.push(json!({"bufferView": 2, "componentType": 5126, "count": 2, "type": "SCALAR"}));
        accessors.push(json!({"bufferView": 0, "componentType": 5126, "count": outputs, "type": "VEC3"}));
        document["animations"] = json!([{"samplers": [{"input": 2, "output": 3}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]}]);
        gltf(&document, &bin)
    };
    assert!(with([0.0, 1.0], 2).load().is_ok());
    let at = "tri.gltf: /animations/0/channels/0";
    assert_eq!(with([1.0, 0.5], 2).error(), format!("{at}: the key times are negative or not ascending"));
    assert_eq!(with([-1.0, 0.5], 2).error(), format!("{at}: the key times are negative or not ascending"));
    assert_eq!(with([0.0, f32::INFINITY], 2).error(), "tri.gltf: /accessors/2: element 1 is not finite");
    assert_eq!(with([0.0, 1.0], 3).error(), format!("{at}: 2 keys need 2 values, not 3"));
    assert_eq!(with([0.0, 1e6], 2).error(), "tri.gltf: frames: 24000001 is more than the limit of 100000");
}

#[test]
fn an_animation_of_no_node_or_of_no_property() {
    let with = |target: serde_json::Value| {
        triangle_with(
            "/animations",
            json!([{
                "samplers": [{"input": 0, "output": 0}],
                "channels": [{"sampler": 0, "target": target}]
            }]),
        )
    };
    assert_eq!(
        with(json!({"node": 2, "path": "scale"})).error(),
        "tri.gltf: /animations/0/channels/0/target/node: there is no such node"
    );
    assert_eq!(
        with(json!({"node": 0, "path": "colour"})).error(),
        "tri.gltf: /animations/0/channels/0/target/path: is not one of `translation`, `rotation`, `scale`, `weights`"
    );
}
