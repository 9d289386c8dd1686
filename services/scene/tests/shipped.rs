//! The scenes that ship with the project are what their generator writes, and are sound.

#[path = "../examples/ship_scenes/generate/mod.rs"]
mod generate;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use forelight_scene::{Limits, MaterialClass, Scene};
use generate::bundle;

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenes").join(name)
}

fn generated(name: &str) -> bundle::Scene {
    let scene = generate::scenes().into_iter().find(|scene| scene.name == name);
    scene.unwrap_or_else(|| panic!("no scene {name}"))
}

fn load(name: &str) -> Scene {
    Scene::load(&shipped(name), &Limits::default()).unwrap_or_else(|error| panic!("{error}"))
}

/// Relative paths of all files below a folder.
fn files_below(folder: &Path, prefix: &str) -> BTreeSet<String> {
    let mut paths = BTreeSet::new();
    for entry in fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let path = format!("{prefix}{}", entry.file_name().to_str().unwrap());
        if entry.file_type().unwrap().is_dir() {
            paths.extend(files_below(&entry.path(), &format!("{path}/")));
        } else {
            paths.insert(path);
        }
    }
    paths
}

#[test]
fn the_committed_bundles_are_what_the_generator_writes() {
    for scene in generate::scenes() {
        let files = scene.files();
        let expected: BTreeSet<String> = files.iter().map(|file| file.path.clone()).collect();
        assert_eq!(files_below(&shipped(scene.name), ""), expected, "files of {}", scene.name);
        for file in files {
            let committed = fs::read(shipped(scene.name).join(&file.path)).unwrap();
            let same = if file.path.ends_with(".png") {
                // Pixels, not bytes: another version of the encoder may pack them otherwise.
                let pixels = |bytes: &[u8]| image::load_from_memory(bytes).unwrap().to_rgb8();
                pixels(&committed) == pixels(&file.contents)
            } else {
                committed == file.contents
            };
            assert!(same, "{}/{} differs: run the example ship_scenes and commit", scene.name, file.path);
        }
    }
}

#[test]
fn the_kitchen_has_many_objects_and_the_corridor_few() {
    for (name, objects, materials) in [("kitchen", 132, 60), ("corridor", 31, 23)] {
        let scene = generated(name);
        let names: BTreeSet<&str> = scene.objects.iter().map(|object| object.name.as_str()).collect();
        assert_eq!(names.len(), objects, "{name}");
        assert_eq!(scene.materials.len(), materials, "{name}");
        let used: BTreeSet<&str> =
            scene.objects.iter().flat_map(|object| &object.parts).map(|part| part.0).collect();
        for (material, _) in &scene.materials {
            assert!(used.contains(material), "{name}: nothing is made of {material}");
        }
        let triangles = scene.triangle_count();
        assert!((15_000..=60_000).contains(&triangles), "{name}: {triangles} triangles");
    }
}

/// Positions in tenths of a millimetre, as they are written.
fn steps(position: glam::DVec3) -> [i64; 3] {
    position.to_array().map(|x| (x * 1e4).round() as i64)
}

#[test]
fn every_triangle_faces_the_way_of_its_normals_and_none_is_a_sliver_without_area() {
    for scene in generate::scenes() {
        for object in &scene.objects {
            for (material, mesh) in &object.parts {
                for triangle in &mesh.triangles {
                    let corners = triangle.map(|i| mesh.vertices[i]);
                    let written = corners.map(|c| steps(c.position));
                    if written[0] == written[1] || written[1] == written[2] || written[2] == written[0] {
                        continue; // The writer leaves it out.
                    }
                    let [a, b, c] = written.map(|p| glam::DVec3::from_array(p.map(|x| x as f64 * 1e-4)));
                    let facing = (b - a).cross(c - a);
                    let place = format!("{}: {} ({material}) at {a}", scene.name, object.name);
                    assert!(facing.length() > 1e-9, "{place} has no area");
                    let normals = corners[0].normal + corners[1].normal + corners[2].normal;
                    assert!(facing.normalize().dot(normals) > 0.3, "{place} faces away from its normals");
                    assert!(corners.iter().all(|corner| corner.normal.is_normalized()), "{place}");
                }
            }
        }
    }
}

#[test]
fn solid_glass_is_closed() {
    for scene in generate::scenes() {
        let glass: BTreeSet<&str> = scene
            .materials
            .iter()
            .filter(|(_, surface)| matches!(surface, bundle::Surface::Glass(_)))
            .map(|(name, _)| *name)
            .collect();
        let mut found = 0;
        for object in &scene.objects {
            for (_, mesh) in object.parts.iter().filter(|(material, _)| glass.contains(material)) {
                found += 1;
                // Every edge is passed as often one way as the other.
                let mut balance: BTreeMap<([i64; 3], [i64; 3]), i32> = BTreeMap::new();
                for triangle in &mesh.triangles {
                    for (from, to) in [(0, 1), (1, 2), (2, 0)] {
                        let [from, to] =
                            [from, to].map(|i: usize| steps(mesh.vertices[triangle[i]].position));
                        *balance.entry((from.min(to), from.max(to))).or_default() +=
                            if from < to { 1 } else { -1 };
                    }
                }
                let open = balance.iter().filter(|((from, to), count)| from != to && **count != 0).count();
                assert_eq!(open, 0, "{}: {} has open edges", scene.name, object.name);
            }
        }
        assert!(found > 0, "{} has no glass", scene.name);
    }
}

#[test]
fn the_shipped_bundles_load_without_a_warning() {
    for (name, lights) in [("kitchen", 2), ("corridor", 4)] {
        let scene = load(name);
        assert_eq!(scene.warnings(), &[] as &[String], "{name}");
        assert_eq!((scene.name(), scene.frame_count(), scene.fps()), (name, 48, 24.0));
        let frame = scene.frame(0).unwrap();
        assert_eq!(frame.geometry.triangles.len(), generated(name).triangle_count() + 2 * lights, "{name}");
        let classes: Vec<MaterialClass> = frame.materials.iter().map(|material| material.class()).collect();
        assert!(classes.contains(&MaterialClass::Transparent), "{name}");
        assert!(frame.materials.iter().any(|material| material.is_emissive()), "{name}");
        assert!(scene.camera(0).unwrap().origin != scene.camera(47).unwrap().origin, "{name}");
    }
}

/// Lowest and middle point of an object, and one of its corners, at a frame.
fn bounds(scene: &Scene, name: &str, number: u32) -> (f32, glam::Vec3, glam::Vec3) {
    let frame = scene.frame(number).unwrap();
    let geometry = &frame.geometry;
    let object = geometry.strata.objects.iter().position(|o| o == name).unwrap() as u32;
    let corners: Vec<glam::Vec3> = (0..geometry.triangles.len() as u32)
        .filter(|&triangle| geometry.object(triangle) == object)
        .flat_map(|triangle| geometry.corners(triangle))
        .collect();
    let low = corners.iter().copied().reduce(glam::Vec3::min).unwrap();
    let high = corners.iter().copied().reduce(glam::Vec3::max).unwrap();
    (low.y, (low + high) / 2.0, corners[corners.len() / 2])
}

#[test]
fn the_apple_rolls_over_the_cloth_and_nothing_else_moves() {
    let scene = load("kitchen");
    let cloth_top = 0.752;
    let first = bounds(&scene, "rolling_apple", 0);
    for number in [0, 11, 24, 47] {
        let (low, _, _) = bounds(&scene, "rolling_apple", number);
        let gap = low - cloth_top;
        assert!((0.0005..0.0025).contains(&gap), "frame {number}: {gap} m above the cloth");
    }
    let last = bounds(&scene, "rolling_apple", 47);
    assert!((first.1.x - last.1.x - 0.27).abs() < 0.01, "it moves by 27 cm");
    assert!((first.2 - first.1).distance(last.2 - last.1) > 0.01, "it turns");
    assert_eq!(bounds(&scene, "apple_1", 0), bounds(&scene, "apple_1", 47));
}
