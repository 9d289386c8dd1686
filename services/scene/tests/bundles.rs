//! The shared bundles load, and hold what their authors say they hold.

mod common;

use common::shared;
use forelight_scene::{Environment, Frame, Limits, MaterialClass, Scene, Surface};
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
