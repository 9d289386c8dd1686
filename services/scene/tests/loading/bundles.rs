//! The shared bundles load, and hold what their authors say they hold.

use forelight_scene::{Environment, Frame, Limits, MaterialClass, Scene, Surface};
use forelight_test_needs::shared;
use glam::Vec3;
use std::sync::Arc;

fn load(path: &str) -> Option<Scene> {
    let path = shared(&format!("scenes/{path}"))?;
    Some(Scene::load(&path, &Limits::default()).unwrap_or_else(|e| panic!("{e}")))
}

/// What preview and tracer take for granted.
fn check(frame: &Frame) {
    let g = &frame.geometry;
    assert_eq!(g.positions.len(), g.normals.len());
    assert_eq!(g.positions.len(), g.uvs.len());
    assert_eq!(g.triangles.len(), g.triangle_stratum.len());
    assert!(g.positions.iter().all(|p| p.is_finite()));
    assert!(g.normals.iter().all(|n| *n == Vec3::ZERO || n.is_normalized()));
    assert!(g.triangles.iter().flatten().all(|&v| (v as usize) < g.positions.len()));
    assert!((0..g.triangles.len() as u32).all(|t| g.geometric_normal(t).is_normalized()));
    assert!(g.triangle_stratum.iter().all(|&s| (s as usize) < g.strata.len()));
    for &(object, material) in &g.strata.pairs {
        assert!((object as usize) < g.strata.objects.len() && (material as usize) < frame.materials.len());
    }
    let camera = &frame.camera;
    assert!(camera.right.dot(camera.up).abs() < 1e-6 && camera.right.dot(camera.forward).abs() < 1e-6);
    assert!(camera.tan_half_x > 0.0 && camera.tan_half_y > 0.0);
}

fn surface<'a>(frame: &'a Frame, name: &str) -> &'a Surface {
    &frame.materials.iter().find(|m| m.name == name).unwrap_or_else(|| panic!("no material {name}")).surface
}

#[test]
fn the_cornell_box_has_36_triangles_in_8_objects_and_one_light() {
    let Some(scene) = load("cornell-box") else { return };
    assert_eq!((scene.name(), scene.frame_count(), scene.fps()), ("cornell-box", 1, 24.0));
    let frame = scene.frame(0).unwrap();
    check(&frame);
    assert_eq!((frame.geometry.triangles.len(), scene.strata().objects.len()), (36, 8));
    let light = frame.materials.iter().find(|m| m.is_emissive()).unwrap();
    assert_eq!(light.emission.factor, Vec3::new(17.0, 12.0, 4.0));
    assert_eq!(frame.camera.origin, Vec3::new(0.0, 1.0, 6.8));
    assert_eq!(frame.environment, Environment::Black);
    // The emitting side of the ceiling lamp looks down.
    let emits = |t: &u32| frame.materials[frame.geometry.material(*t) as usize].is_emissive();
    let lamp: Vec<u32> = (0..36).filter(emits).collect();
    assert!(!lamp.is_empty() && lamp.iter().all(|&t| frame.geometry.geometric_normal(t).y < -0.99));
}

#[test]
fn the_country_kitchen_has_a_quad_light_a_camera_move_and_shared_geometry() {
    let Some(scene) = load("country-kitchen") else { return };
    assert_eq!((scene.frame_count(), scene.fps()), (48, 24.0));
    assert_eq!(scene.strata().objects.len(), 287);
    let (first, middle, last) = (scene.frame(0).unwrap(), scene.frame(24).unwrap(), scene.frame(47).unwrap());
    check(&first);
    assert!(Arc::ptr_eq(&first.geometry, &last.geometry));
    assert!(Arc::ptr_eq(&first.materials, &last.materials));
    assert_eq!(first.camera.origin, Vec3::new(1.211, 1.80475, 3.85239));
    assert_eq!(middle.camera.origin, Vec3::new(1.35, 1.72, 3.2));
    assert_eq!(last.camera.origin, Vec3::new(1.0, 1.65, 2.7));
    // Catmull-Rom half way along the first segment: (p0 + p1)/2 + (m0 - m1) · 24/8.
    let (p0, p1, p2) = (1.211, 1.35, 1.0);
    let x = (p0 + p1) / 2.0 + ((p1 - p0) / 24.0 - (p2 - p0) / 47.0) * 3.0;
    assert!((f64::from(scene.camera(12).unwrap().origin.x) - x).abs() < 1e-6);
    let light = scene.strata().objects.iter().position(|o| o == "light:0").unwrap() as u32;
    let quad: Vec<u32> =
        (0..first.geometry.triangles.len() as u32).filter(|&t| first.geometry.object(t) == light).collect();
    assert_eq!(quad.len(), 2);
    // edge_u × edge_v of (1.2, 0, 0) and (0, 0, 1.2) looks down.
    assert!(quad.iter().all(|&t| first.geometry.geometric_normal(t) == Vec3::NEG_Y));
    assert_eq!(first.environment, Environment::Constant(Vec3::ONE));
    assert_eq!(first.textures.len(), 11);
    let Surface::Plastic { albedo, ior, alpha } = surface(&first, "BookPages") else { panic!() };
    assert!(albedo.texture.is_some() && albedo.factor == Vec3::ONE && *ior == 1.5);
    assert!((alpha - 0.2236 * 0.2236).abs() < 1e-7);
}

#[test]
fn the_modern_hall_moves_its_camera_along_a_line() {
    let Some(scene) = load("modern-hall") else { return };
    check(&scene.frame(0).unwrap());
    let x = 6.91182 + (4.6 - 6.91182) * 10.0 / 47.0;
    assert!((scene.camera(10).unwrap().origin.x - x).abs() < 1e-6);
    let frame = scene.frame(0).unwrap();
    assert!(matches!(surface(&frame, "GlassBSDF"), Surface::Glass { ior: 1.5, alpha: 0.0, .. }));
}

#[test]
fn the_living_room_and_veach_ajar_load_with_their_materials() {
    if let Some(scene) = load("living-room") {
        let frame = scene.frame(0).unwrap();
        check(&frame);
        let Surface::Metal { f0, alpha: 0.0 } = surface(&frame, "Mirror") else { panic!() };
        assert_eq!(f0.factor, Vec3::ONE);
        assert_eq!(frame.geometry.strata.objects.len(), 66);
    }
    if let Some(scene) = load("veach-ajar") {
        let frame = scene.frame(0).unwrap();
        check(&frame);
        assert_eq!(
            frame.materials.iter().find(|m| m.is_emissive()).unwrap().emission.factor,
            Vec3::splat(1000.0)
        );
        let glass = frame.materials.iter().find(|m| m.name == "MaterialBSDF").unwrap();
        assert_eq!(glass.class(), MaterialClass::Transparent);
    }
}

#[test]
fn frames_outside_the_shot_are_refused_and_sizes_can_be_changed() {
    let Some(scene) = load("cornell-box") else { return };
    let error = scene.frame(1).unwrap_err().to_string();
    assert_eq!(error, "frame 1 is outside the shot, which has frames 0 to 0");
    let camera = scene.frame_with(0, Some((200, 100))).unwrap().camera;
    assert_eq!((camera.width, camera.height), (200, 100));
    assert_eq!(camera.tan_half_x, scene.camera(0).unwrap().tan_half_x);
    assert_eq!(camera.tan_half_y, camera.tan_half_x / 2.0);
    assert!(scene.frame_with(0, Some((0, 100))).is_err());
}

#[test]
fn a_scene_has_the_same_digest_every_time() {
    let (Some(a), Some(b)) = (load("cornell-box"), load("cornell-box")) else { return };
    assert_eq!(a.digest(), b.digest());
}

#[test]
fn the_glass_table_is_a_scene_by_itself_with_a_default_view_and_a_white_environment() {
    let Some(scene) = load("pc-glass-table/glass-table.glb") else { return };
    assert_eq!((scene.name(), scene.frame_count(), scene.fps()), ("glass-table", 1, 24.0));
    let frame = scene.frame(0).unwrap();
    check(&frame);
    assert_eq!(frame.environment, Environment::Constant(Vec3::ONE));
    assert!(scene.warnings().iter().any(|w| w.contains("no light")));
    assert!(scene.warnings().iter().any(|w| w.contains("no camera")));
    let Surface::ThinGlass { ior: 1.5, .. } = surface(&frame, "Glass") else { panic!() };
    let glass = frame.materials.iter().find(|m| m.name == "Glass").unwrap();
    assert_eq!((glass.opacity, glass.emits_both_sides), (0.25, true));
    let Surface::Metal { f0, alpha } = surface(&frame, "Pillars") else { panic!() };
    assert_eq!(f0.factor, Vec3::splat(0.8));
    assert!((alpha - 0.220_596_28_f32.powi(2)).abs() < 1e-7);
    assert!(matches!(surface(&frame, "Legs"), Surface::Plastic { .. }));
    // The whole table is in view.
    for &position in &frame.geometry.positions {
        let d = position - frame.camera.origin;
        let depth = d.dot(frame.camera.forward);
        assert!(depth > 0.0 && d.dot(frame.camera.up).abs() <= depth * frame.camera.tan_half_y);
    }
}

#[test]
fn in_the_animated_veach_scene_the_door_the_pot_and_the_camera_move() {
    let Some(scene) = load("veach-ajar-animated/veach-ajar-animated.glb") else { return };
    assert_eq!((scene.frame_count(), scene.fps()), (97, 24.0));
    // The door and the pot come back to where they were, so the middle of the shot is what differs.
    let (first, last) = (scene.frame(0).unwrap(), scene.frame(48).unwrap());
    check(&first);
    check(&last);
    assert_eq!(last.camera.origin, Vec3::new(2.2, 1.5, -1.6));
    assert_eq!(first.geometry.strata, last.geometry.strata);
    assert_ne!(first.camera.origin, last.camera.origin);
    assert!((first.camera.tan_half_y - (0.628_028_8_f32 / 2.0).tan()).abs() < 1e-6);
    assert_eq!((first.camera.width, first.camera.height), (1280, 720));
    // The still bundle has the same camera: 60 degrees along x.
    assert!((first.camera.tan_half_x - 30f32.to_radians().tan()).abs() < 1e-4);
    let moved = |name: &str| {
        let object = scene.strata().objects.iter().position(|o| o == name).unwrap() as u32;
        let t =
            (0..first.geometry.triangles.len() as u32).find(|&t| first.geometry.object(t) == object).unwrap();
        first.geometry.corners(t) != last.geometry.corners(t)
    };
    assert!(moved("Mesh006") && moved("Mesh015"), "the door");
    assert!(moved("Mesh000") && moved("Mesh009.002"), "the pot");
    assert!(!moved("rectangle0") && !moved("Mesh014"), "the rest");
    // A second look at the same frame shares its geometry.
    assert!(Arc::ptr_eq(&last.geometry, &scene.frame(48).unwrap().geometry));
    // The door turned about its hinge by the rotation of key 48.
    let (pivot, turn) =
        (Vec3::new(-2.8, 0.0, -4.67), glam::Quat::from_xyzw(0.0, 0.043_619_4, 0.0, 0.999_048_23));
    let expected = pivot + turn * (corner(&scene, "Mesh006", 0) - pivot);
    assert!((corner(&scene, "Mesh006", 48) - expected).length() < 1e-5);
    let light = first.materials.iter().find(|m| m.is_emissive()).unwrap();
    assert_eq!(light.emission.factor, Vec3::splat(1000.0));
    assert!(matches!(surface(&first, "DiffuseBSDF"), Surface::Lambert { .. }));
    assert!(matches!(surface(&first, "Pot2BSDF"), Surface::Metal { .. }));
    assert!(matches!(surface(&first, "MaterialBSDF"), Surface::ThinGlass { .. }));
    assert_eq!(first.textures.len(), 3);
    assert!(first.points.is_empty() && first.suns.is_empty());
}

#[test]
fn the_animated_veach_scene_at_frame_zero_is_the_still_one() {
    let (Some(still), Some(animated)) =
        (load("veach-ajar"), load("veach-ajar-animated/veach-ajar-animated.glb"))
    else {
        return;
    };
    let (still, animated) = (still.frame(0).unwrap(), animated.frame(0).unwrap());
    let bounds = |f: &Frame| {
        let fold = |start, op: fn(Vec3, Vec3) -> Vec3| f.geometry.positions.iter().copied().fold(start, op);
        (fold(Vec3::INFINITY, Vec3::min), fold(Vec3::NEG_INFINITY, Vec3::max))
    };
    let (a, b) = (bounds(&still), bounds(&animated));
    assert!((a.0 - b.0).abs().max_element() < 1e-3 && (a.1 - b.1).abs().max_element() < 1e-3, "{a:?} {b:?}");
    assert!((still.camera.forward - animated.camera.forward).length() < 1e-3);
    assert!((still.camera.up - animated.camera.up).length() < 1e-3);
    let same = still.geometry.triangles.len().abs_diff(animated.geometry.triangles.len());
    assert!(same * 100 < still.geometry.triangles.len());
}

#[test]
fn every_gltf_animation_test_loads_in_every_frame() {
    for name in [
        "02_node_hierarchy",
        "03_all_animations",
        "03_animated_cube",
        "06_parent-inverse-anim",
        "15_transmission",
    ] {
        let Some(scene) = load(&format!("gltf-anim-tests/{name}.gltf")) else { return };
        for frame in 0..scene.frame_count() {
            check(&scene.frame(frame).unwrap());
        }
        println!("{name}: {} frames, {:?}", scene.frame_count(), scene.warnings());
    }
}

/// Where vertex 0 of an object is in a frame.
fn corner(scene: &Scene, object: &str, frame: u32) -> Vec3 {
    let id = scene.strata().objects.iter().position(|o| o == object).unwrap() as u32;
    let g = scene.frame(frame).unwrap().geometry;
    let t = (0..g.triangles.len() as u32).find(|&t| g.object(t) == id).unwrap();
    g.corners(t)[0]
}

#[test]
fn the_animated_cube_turns_half_a_turn_a_second_about_y() {
    let Some(scene) = load("gltf-anim-tests/03_animated_cube.gltf") else { return };
    assert_eq!(scene.frame_count(), 49);
    let from = corner(&scene, "Cube", 0);
    for frame in 0..49u8 {
        let turned = glam::Quat::from_rotation_y(std::f32::consts::PI * f32::from(frame) / 24.0) * from;
        let at = corner(&scene, "Cube", frame.into());
        // The third key is the first rotation again, so the shortest way back may go either way round.
        let mirrored = glam::Quat::from_rotation_y(-std::f32::consts::PI * f32::from(frame) / 24.0) * from;
        assert!((at - turned).length() < 1e-4 || (at - mirrored).length() < 1e-4, "frame {frame}: {at}");
    }
}

#[test]
fn cubic_keys_of_a_gltf_file_pass_their_values_and_ease_in_between() {
    let Some(scene) = load("gltf-anim-tests/06_parent-inverse-anim.gltf") else { return };
    assert_eq!(scene.frame_count(), 10);
    // ChildLocation: two cubic keys at frames 0 and 9 with zero tangents, under a parent that stands still.
    let at = |frame| corner(&scene, "ChildLocation", frame);
    let (first, last) = (at(0), at(9));
    for frame in 0..10u8 {
        let s = f32::from(frame) / 9.0;
        let eased = first + (last - first) * (3.0 * s * s - 2.0 * s * s * s);
        assert!((at(frame.into()) - eased).length() < 1e-5, "frame {frame}");
    }
    assert!((last - first).length() > 0.5);
}
