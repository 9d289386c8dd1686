//! Nested, mirrored and unevenly scaled nodes, compared with the same meshes placed in code.

use crate::bundles::Files;
use crate::similarity::{self, compare, judge, work};
use forelight_bvh::{Bvh, Ray, Traversal};
use forelight_scene::{Frame, Geometry};
use forelight_tests::case::case;
use forelight_tests::world::{render, unsound, values};
use forelight_tracer::Settings;
use glam::{DMat3, DMat4, DQuat, DVec3, Vec3};
use serde_json::{Value, json};
use std::sync::Arc;

/// A box with a corner cut off, so that no symmetry hides a mistake. Flat normals, three vertices per
/// triangle.
fn solid() -> (Vec<Vec3>, Vec<Vec3>) {
    let (positions, triangles) = forelight_tests::world::cuboid(DVec3::splat(-0.5), DVec3::splat(0.5), false);
    let mut corners: Vec<Vec3> = positions.iter().map(|p| p.as_vec3()).collect();
    corners[7] *= 0.6;
    let (mut out, mut normals) = (Vec::new(), Vec::new());
    for t in triangles {
        let [a, b, c] = t.map(|i| corners[i as usize]);
        out.extend([a, b, c]);
        normals.extend([(b - a).cross(c - a).normalize(); 3]);
    }
    (out, normals)
}

#[derive(Clone, Copy)]
struct Place {
    translation: [f64; 3],
    /// Axis and angle.
    rotation: ([f64; 3], f64),
    scale: [f64; 3],
}

impl Place {
    fn quaternion(&self) -> DQuat {
        DQuat::from_axis_angle(DVec3::from_array(self.rotation.0).normalize(), self.rotation.1)
    }

    fn json(&self) -> Value {
        json!({"translation": self.translation, "rotation": self.quaternion().to_array(), "scale": self.scale})
    }

    /// The matrix as in the file, with numbers rounded to `f32` as in glTF.
    fn matrix(&self) -> DMat4 {
        let round = |v: [f64; 3]| DVec3::from_array(v.map(|x| f64::from(x as f32)));
        let q = DQuat::from_array(self.quaternion().to_array().map(|x| f64::from(x as f32))).normalize();
        DMat4::from_scale_rotation_translation(round(self.scale), q, round(self.translation))
    }
}

/// Chains of placements, outermost first. Each ends in the solid.
fn chains() -> Vec<(&'static str, Vec<Place>)> {
    let still = ([0.0, 1.0, 0.0], 0.0);
    let place = |translation, rotation, scale| Place { translation, rotation, scale };
    let turn = ([0.3, 1.0, -0.4], 0.8);
    vec![
        ("plain", vec![place([-2.0, 0.0, 0.0], still, [1.0; 3])]),
        (
            "nested",
            vec![
                place([0.0, 1.0, 0.0], turn, [2.0; 3]),
                place([0.5, 0.0, 0.3], ([1.0, 0.0, 0.0], 1.1), [0.5; 3]),
                place([0.2, -0.7, 0.0], turn, [0.8; 3]),
            ],
        ),
        ("mirrored", vec![place([1.5, 0.3, 0.0], turn, [-1.0, 1.0, 1.0])]),
        (
            "mirrored twice",
            vec![
                place([0.0, -1.2, 0.0], turn, [1.0, -1.0, 1.0]),
                place([0.3, 0.0, 0.0], turn, [1.0, 1.0, -0.7]),
            ],
        ),
        (
            "mirrored in a mirror with a turn",
            vec![
                place([-1.0, 1.5, -0.5], ([1.0, 1.0, 0.0], 2.0), [-0.8, 0.8, 0.8]),
                place([0.1, 0.0, 0.0], turn, [-1.0, -1.0, -1.0]),
            ],
        ),
        ("uneven 1 : 10⁴", vec![place([2.0, -1.0, -1.0], ([0.0, 0.0, 1.0], 0.3), [2e-4, 2.0, 0.3])]),
        (
            "uneven, mirrored, sheared by its parent",
            vec![
                place([-1.0, -1.0, 0.0], turn, [1.5, 0.02, 1.0]),
                place([0.0, 10.0, 0.0], ([0.0, 0.0, 1.0], 0.9), [0.5, -8.0, 0.4]),
            ],
        ),
    ]
}

fn bundle() -> Files {
    bundle_at([0.0; 3])
}

/// All of it moved by a node around the others, as in georeferenced buildings.
fn bundle_at(offset: [f64; 3]) -> Files {
    let (positions, normals) = solid();
    let mut bin: Vec<u8> = Vec::new();
    for list in [&positions, &normals] {
        bin.extend(list.iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes));
    }
    let bytes = positions.len() * 12;
    let mut nodes = Vec::new();
    let mut roots = Vec::new();
    for (name, chain) in chains() {
        roots.push(nodes.len());
        for (i, place) in chain.iter().enumerate() {
            let mut node = place.json();
            if i + 1 == chain.len() {
                node["name"] = json!(name);
                node["mesh"] = json!(0);
            } else {
                node["children"] = json!([nodes.len() + 1]);
            }
            nodes.push(node);
        }
    }
    nodes.push(json!({"translation": offset, "children": roots}));
    let low = positions.iter().copied().fold(Vec3::INFINITY, Vec3::min).to_array();
    let high = positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max).to_array();
    let document = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [nodes.len() - 1]}], "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": positions.len(), "type": "VEC3", "min": low, "max": high},
            {"bufferView": 1, "componentType": 5126, "count": positions.len(), "type": "VEC3"}
        ],
        "bufferViews": [{"buffer": 0, "byteLength": bytes}, {"buffer": 0, "byteOffset": bytes, "byteLength": bytes}],
        "buffers": [{"uri": "solid.bin", "byteLength": bin.len()}]
    });
    let at = |x: f64, y: f64, z: f64| [x + offset[0], y + offset[1], z + offset[2]];
    let description = json!({
        "version": 1, "name": "instances", "geometry": ["solid.gltf"],
        "camera": {"origin": at(0.0, 1.0, 6.0), "target": at(0.0, 0.0, 0.0), "up": [0, 1, 0], "fov_deg": 60, "width": 48, "height": 48},
        "environment": {"type": "constant", "radiance": [0.3, 0.3, 0.3]},
        "lights": [{"type": "point", "position": at(2.0, 4.0, 5.0), "intensity": [20, 20, 20]}]
    });
    Files::default()
        .with("solid.bin", bin)
        .with("solid.gltf", document.to_string())
        .with("scene.json", description.to_string())
}

/// The loaded frame with its geometry replaced by one placed in code.
fn baked(frame: &Frame) -> Frame {
    let (positions, normals) = solid();
    let mut geometry = Geometry { strata: frame.geometry.strata.clone(), ..Geometry::default() };
    for (name, chain) in chains() {
        let object = geometry.strata.objects.iter().position(|o| o == name).expect("an object of this name");
        let stratum =
            geometry.strata.pairs.iter().position(|p| p.0 as usize == object).expect("a stratum of it");
        let world = chain.iter().fold(DMat4::IDENTITY, |world, place| world * place.matrix());
        let turn = DMat3::from_mat4(world).inverse().transpose();
        let mirrored = world.determinant() < 0.0;
        for (p, n) in positions.chunks(3).zip(normals.chunks(3)) {
            let first = geometry.positions.len() as u32;
            geometry.positions.extend(p.iter().map(|p| world.transform_point3(p.as_dvec3()).as_vec3()));
            geometry.normals.extend(n.iter().map(|n| (turn * n.as_dvec3()).normalize().as_vec3()));
            let [b, c] = if mirrored { [2, 1] } else { [1, 2] };
            geometry.triangles.push([first, first + b, first + c]);
            geometry.triangle_stratum.push(stratum as u32);
        }
    }
    geometry.uvs = vec![glam::Vec2::ZERO; geometry.positions.len()];
    Frame { geometry: Arc::new(geometry), ..frame.clone() }
}

#[test]
fn instances_are_where_the_same_meshes_are_when_baked() {
    let scene = bundle().load().expect("the bundle loads");
    let frame = scene.frame(0).expect("a frame");
    let reference = baked(&frame);
    let (a, b) = (&frame.geometry, &reference.geometry);
    assert_eq!(a.triangles.len(), b.triangles.len());

    // Triangle by triangle, whatever the order of objects in the file.
    let (mut furthest, mut turned, mut inside_out) = (0.0f64, 0.0f64, 0);
    let key = |g: &Geometry, t: usize| (g.triangle_stratum[t], t);
    let order = |g: &Geometry| {
        let mut list: Vec<usize> = (0..g.triangles.len()).collect();
        list.sort_by_key(|&t| key(g, t));
        list
    };
    for (s, t) in order(a).into_iter().zip(order(b)) {
        for (p, q) in a.corners(s as u32).into_iter().zip(b.corners(t as u32)) {
            furthest = furthest.max(f64::from(p.distance(q)));
        }
        turned = turned.max(f64::from(1.0 - a.geometric_normal(s as u32).dot(b.geometric_normal(t as u32))));
        // A mirror changes both the winding and the side of the normal, so the shading normal stays on the
        // front.
        let n = a.normals[a.triangles[s][0] as usize];
        inside_out += u64::from(n.dot(a.geometric_normal(s as u32)) < 0.999);
    }
    // Coordinates of at most 4 m are rounded once, to 2.4e-7.
    case(14, "positions of nested, mirrored and uneven instances against baked ones, m")
        .worst(furthest, 5e-7);
    // A sliver of 10⁻⁴ m whose corners move by 2.4e-7 turns by 2.4e-3 at most: 3e-6 off a cosine.
    case(14, "normals of instances against baked ones, 1 − cos").worst(turned, 3e-6);
    case(14, "triangles whose shading normal is not on their front")
        .never(inside_out, a.triangles.len() as u64);

    // The same surfaces at the same distances along the same rays.
    let (own, other) = (Bvh::build(&a.positions, &a.triangles), Bvh::build(&b.positions, &b.triangles));
    let (mut apart, mut differing, mut hits) = (0.0f64, 0, 0u64);
    let camera = frame.camera.resized(128, 128);
    for i in 0..128 * 128u32 {
        let pixel = glam::Vec2::new((i % 128) as f32 + 0.5, (i / 128) as f32 + 0.5);
        let ray = Ray::new(camera.origin, camera.direction(pixel).normalize());
        let hit = |bvh: &Bvh, g: &Geometry| {
            let hit = bvh.closest(&ray, |_| true, &mut Traversal::default())?;
            Some((hit.t, g.triangle_stratum[hit.primitive as usize]))
        };
        match (hit(&own, a), hit(&other, b)) {
            (Some((s, x)), Some((t, y))) if x == y => {
                hits += 1;
                apart = apart.max(f64::from((s / t - 1.0).abs()));
            }
            (None, None) => {}
            _ => differing += 1,
        }
    }
    assert!(hits > 2000, "{hits}");
    // Rays that graze an edge may hit either side: a handful of 16,384.
    case(14, "rays that meet another instance than when baked, of 16,384").worst(f64::from(differing), 8.0);
    case(14, "distance along a ray to an instance against baked, relative").worst(apart, 1e-4);

    let settings = Settings {
        width: 48,
        height: 48,
        spp: 16,
        ambient_bounces: 1,
        ambient_divisions: 4,
        ..Settings::default()
    };
    let (x, y) = (render(&frame, &settings), render(&reference, &settings));
    assert_eq!(unsound(&x), 0);
    let pairs: Vec<(f64, f64)> = values(&x).into_iter().zip(values(&y)).collect();
    let total: f64 = pairs.iter().map(|p| p.1).sum();
    let apart: f64 = pairs.iter().map(|p| (p.0 - p.1).abs()).sum();
    // Other rounding changes single paths. A normal on the wrong side would darken a tenth of the image.
    case(14, "mean absolute difference of an image of instances from the baked one, relative")
        .worst(apart / total, 0.01);
}

#[test]
fn scenes_moved_by_ten_million_times_their_size_look_and_cost_the_same() {
    let settings = similarity::settings();
    let at = |offset: [f64; 3], settings: &Settings| {
        let scene = bundle_at(offset).load().unwrap_or_else(|error| panic!("at {offset:?}: {error}"));
        render(&scene.frame(0).expect("a frame"), settings)
    };
    let base = at([0.0; 3], &settings);
    let reseeded = at([0.0; 3], &Settings { seed: 1, ..settings });
    // Six metres of solids. glTF has 24-bit numbers, so the offsets survive reading exactly.
    let places = [1e4, 1e5, 1e6, 1e7].map(|times| {
        let offset = [0.6, -0.5, 0.6244998].map(|x| f64::from((x * 6.0 * times) as f32));
        (format!("moved by {times:e} times its size"), at(offset, &settings))
    });
    judge("nested solids moved by 10⁴ to 10⁷ times their size", compare(&base, &reseeded, places, work));
}
