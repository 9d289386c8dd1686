//! Compressed glTF files: what they mean, and that damaged ones are refused with one line.
//! `tests/peers/gltf.sh` compares files that other programs compressed.

use crate::made::{Files, encoded, gltf, triangle_bin, triangle_gltf, triangle_with};
use draco_core::{DataType, EncoderBuffer, EncoderOptions, GeometryAttributeType, Mesh, MeshEncoder};
use draco_core::{FaceIndex, PointAttribute, PointIndex};
use forelight_random::Random;
use forelight_scene::{Limits, Texels};
use glam::Vec3;
use serde_json::{Value, json};

/// Three positions in a meshopt stream of version 0, written by hand: the tail holds the first vertex, and all
/// differences are stored as whole bytes.
fn meshopt_positions() -> Vec<u8> {
    let vertices = triangle_bin()[..36].to_vec();
    let mut stream = vec![0xa0];
    for channel in 0..12 {
        let mut last = vertices[channel];
        // One group of 16 values, each of eight bits.
        stream.push(3);
        for i in 0..16 {
            let value = vertices.get(i * 12 + channel).copied().unwrap_or(last);
            let difference = value.wrapping_sub(last) as i8;
            stream.push(((difference << 1) ^ (difference >> 7)) as u8);
            last = value;
        }
    }
    stream.extend([0; 20]);
    stream.extend(&vertices[..12]);
    stream
}

/// The triangle scene with its positions in a compressed buffer view, which stands in a placeholder buffer.
fn meshopt_triangle() -> (Value, Vec<u8>) {
    let mut bin = triangle_bin();
    let (offset, stream) = (bin.len(), meshopt_positions());
    bin.extend(&stream);
    let mut document = triangle_gltf();
    document["extensionsUsed"] = json!(["EXT_meshopt_compression"]);
    document["extensionsRequired"] = json!(["EXT_meshopt_compression"]);
    document["buffers"] = json!([
        {"uri": "tri.bin", "byteLength": bin.len()},
        {"byteLength": 36, "extensions": {"EXT_meshopt_compression": {"fallback": true}}}
    ]);
    document["bufferViews"][0] = json!({
        "buffer": 1, "byteLength": 36, "byteStride": 12,
        "extensions": {"EXT_meshopt_compression": {
            "buffer": 0, "byteOffset": offset, "byteLength": stream.len(),
            "byteStride": 12, "count": 3, "mode": "ATTRIBUTES"
        }}
    });
    (document, bin)
}

/// A Draco stream of the triangle scene, by the encoder of `draco-core`.
fn draco_stream() -> Vec<u8> {
    let mut positions = PointAttribute::new();
    positions.init(GeometryAttributeType::Position, 3, DataType::Float32, false, 3);
    positions.buffer_mut().write(0, &triangle_bin()[..36]);
    let mut mesh = Mesh::new();
    mesh.set_num_points(3);
    mesh.add_attribute(positions);
    mesh.set_num_faces(1);
    mesh.set_face(FaceIndex(0), [PointIndex(0), PointIndex(1), PointIndex(2)]);
    let mut encoder = MeshEncoder::new();
    encoder.set_mesh(mesh);
    let mut out = EncoderBuffer::new();
    encoder.encode(&EncoderOptions::new(), &mut out).unwrap();
    out.data().to_vec()
}

/// The triangle scene as a Draco mesh.
fn draco_triangle() -> (Value, Vec<u8>) {
    let bin = draco_stream();
    let mut document = triangle_gltf();
    document["extensionsUsed"] = json!(["KHR_draco_mesh_compression"]);
    document["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    document["buffers"] = json!([{"uri": "tri.bin", "byteLength": bin.len()}]);
    document["bufferViews"] = json!([{"buffer": 0, "byteLength": bin.len()}]);
    for accessor in document["accessors"].as_array_mut().unwrap() {
        accessor.as_object_mut().unwrap().remove("bufferView");
    }
    document["meshes"][0]["primitives"][0]["extensions"] =
        json!({"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}});
    (document, bin)
}

/// Whether a bundle's only triangle is that of the triangle scene, whatever its first corner.
fn is_the_triangle(files: &Files) {
    let frame = files.scene().frame(0).unwrap();
    assert_eq!(frame.geometry.triangles.len(), 1);
    let corners = frame.geometry.corners(0);
    let first = corners.iter().position(|&corner| corner == Vec3::ZERO).unwrap();
    assert_eq!([corners[(first + 1) % 3], corners[(first + 2) % 3]], [Vec3::X, Vec3::Y]);
}

/// The error of a scene with another value at a JSON pointer.
fn error_with((mut document, bin): (Value, Vec<u8>), pointer: &str, value: Value) -> String {
    *document.pointer_mut(pointer).unwrap() = value;
    gltf(&document, &bin).error()
}

#[test]
fn a_newer_minor_version_loads_unless_the_file_needs_a_newer_reader() {
    is_the_triangle(&triangle_with("/asset", json!({"version": "2.1"})));
    is_the_triangle(&triangle_with("/asset", json!({"version": "2.7", "minVersion": "2.0"})));
    for (asset, expected) in [
        (
            json!({"version": "2.1", "minVersion": "2.1"}),
            "/asset/minVersion: needs a reader of glTF version 2.1; this program reads version 2.0",
        ),
        (
            json!({"version": "3.0"}),
            "/asset/version: glTF version 3.0 is not supported; this program reads version 2.0",
        ),
        (
            json!({"version": "two"}),
            "/asset/version: glTF version two is not supported; this program reads version 2.0",
        ),
    ] {
        assert_eq!(triangle_with("/asset", asset).error(), format!("tri.gltf: {expected}"));
    }
}

#[test]
fn a_texture_may_be_a_webp_image_beside_or_instead_of_another() {
    let colours = [[200, 10, 60, 255], [0, 255, 0, 128]];
    let mut pixels = image::RgbaImage::new(2, 1);
    (0..2).for_each(|x| pixels.put_pixel(x, 0, image::Rgba(colours[x as usize])));
    let webp = encoded(&pixels.into(), image::ImageFormat::WebP);
    for fallback in [false, true] {
        let mut document = triangle_gltf();
        document["extensionsUsed"] = json!(["EXT_texture_webp"]);
        document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0});
        document["textures"] = json!([{"extensions": {"EXT_texture_webp": {"source": 1}}}]);
        if fallback {
            document["textures"][0]["source"] = json!(0);
        }
        document["images"] = json!([{"uri": "missing.png"}, {"uri": "colours.webp"}]);
        let files = gltf(&document, &triangle_bin()).with("colours.webp", &webp);
        let frame = files.scene().frame(0).unwrap();
        assert!(matches!(&frame.textures[0].texels, Texels::Srgb8(texels) if texels == &colours));
        let cut = files.with("colours.webp", &webp[..webp.len() - 4]).error();
        assert!(
            cut.starts_with("tri.gltf: /images/1: the image: colours.webp: is not a readable image"),
            "{cut}"
        );
    }
    let mut document = triangle_gltf();
    document["extensionsUsed"] = json!(["EXT_texture_webp"]);
    document["textures"] = json!([{"extensions": {"EXT_texture_webp": {"source": 4}}}]);
    let error = gltf(&document, &triangle_bin()).error();
    assert_eq!(error, "tri.gltf: /textures/0/source: Index out of bounds");
}

#[test]
fn a_buffer_view_may_be_compressed() {
    let (document, bin) = meshopt_triangle();
    is_the_triangle(&gltf(&document, &bin));
    let khr = document.to_string().replace("EXT_meshopt", "KHR_meshopt");
    is_the_triangle(&gltf(&serde_json::from_str(&khr).unwrap(), &bin));
}

#[test]
fn a_compressed_buffer_view_that_does_not_fit() {
    let at = "/bufferViews/0/extensions/EXT_meshopt_compression";
    for (key, value, expected) in [
        (
            "count",
            json!(4),
            "/bufferViews/0/extensions: `count` × `byteStride` is not the length of the buffer view",
        ),
        (
            "count",
            json!(u64::MAX),
            "/bufferViews/0/extensions: `count` × `byteStride` is not the length of the buffer view",
        ),
        (
            "byteLength",
            json!(9999),
            "/bufferViews/0/extensions: the compressed stream reaches beyond the end of its buffer",
        ),
        ("byteLength", json!(200), "/bufferViews/0/extensions: the compressed stream is truncated"),
        (
            "buffer",
            json!(1),
            "/bufferViews/0/extensions: the compressed stream reaches beyond the end of its buffer",
        ),
        ("mode", json!("TRIANGLES"), "/bufferViews/0/extensions: `byteStride` is not allowed in this mode"),
        (
            "mode",
            json!("LINES"),
            "unknown variant `LINES`, expected one of `ATTRIBUTES`, `TRIANGLES`, `INDICES`",
        ),
    ] {
        let error = error_with(meshopt_triangle(), &format!("{at}/{key}"), value);
        assert!(
            error.starts_with("tri.gltf: /bufferViews/0/extensions") && error.contains(expected),
            "{error}"
        );
    }
    let error = error_with(meshopt_triangle(), "/bufferViews/0/extensions", json!({}));
    assert_eq!(error, "tri.gltf: /bufferViews/0: reaches beyond the end of its buffer");
}

#[test]
fn what_buffer_views_decode_to_counts_as_bytes_of_the_bundle() {
    let (document, bin) = meshopt_triangle();
    let files = gltf(&document, &bin);
    let read = (document.to_string().len() + bin.len()) as u64;
    assert!(files.load_within(&Limits { total_bytes: read + 36, ..Limits::default() }).is_ok());
    let error = files.load_within(&Limits { total_bytes: read + 35, ..Limits::default() }).unwrap_err();
    assert!(error.to_string().contains("bytes read from the bundle"), "{error}");
}

#[test]
fn a_mesh_may_be_a_draco_mesh() {
    let (mut document, bin) = draco_triangle();
    is_the_triangle(&gltf(&document, &bin));
    // An attribute may be zeros, which need no place.
    let zeros = json!({"componentType": 5123, "count": 3, "type": "VEC4"});
    document["accessors"].as_array_mut().unwrap().push(zeros);
    document["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = json!(2);
    is_the_triangle(&gltf(&document, &bin));
}

#[test]
fn a_draco_mesh_that_does_not_fit() {
    let primitive = "/meshes/0/primitives/0";
    let at = format!("{primitive}/extensions/KHR_draco_mesh_compression");
    for (pointer, value, expected) in [
        (
            format!("{at}/attributes/POSITION"),
            json!(7),
            "/attributes/POSITION: the Draco stream has no attribute 7",
        ),
        (format!("{at}/bufferView"), json!(7), "/bufferViews/7: there is no such buffer view"),
        (format!("{at}/attributes"), json!({}), "/accessors/0/bufferView: Missing data"),
        ("/accessors/1/count".into(), json!(2), "over the caller's ceiling of 0"),
        ("/accessors/1/count".into(), json!(1u64 << 40), "elements of accessors"),
        ("/bufferViews/0/byteLength".into(), json!(30), "the Draco stream cannot be decoded: "),
    ] {
        let error = error_with(draco_triangle(), &pointer, value);
        assert!(error.starts_with("tri.gltf: ") && error.contains(expected), "{pointer}: {error}");
    }
    let (mut document, bin) = draco_triangle();
    document["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("indices");
    document["accessors"][1]["bufferView"] = json!(0);
    let error = gltf(&document, &bin).error();
    assert!(error.contains("a compressed mesh must have an accessor for its indices"), "{error}");
}

#[test]
fn damaged_compressed_files_never_end_the_program() {
    for (document, bin) in [meshopt_triangle(), draco_triangle()] {
        for seed in 0..1500 {
            let mut random = Random::new(seed);
            let mut bin = bin.clone();
            for _ in 0..=random.index(3) {
                let at = random.index(bin.len());
                bin[at] = random.index(256) as u8;
            }
            if let Err(error) = gltf(&document, &bin).load() {
                assert!(!error.to_string().contains('\n'), "{error:?}");
            }
        }
    }
}
