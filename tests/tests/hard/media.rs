//! Dielectrics in dielectrics without priorities. Every interface has one index, that of its inside relative
//! to its outside. Where two media touch, there is one interface. `nested` tests priorities.

use forelight_scene::Surface;
use forelight_tests::case::case;
use forelight_tests::statistics::Moments;
use forelight_tests::world::{View, World, grey, material, render, unsound, values};
use forelight_tracer::Settings;
use glam::DVec3;

pub fn glass(ior: f32) -> forelight_scene::Material {
    material(Surface::Glass { ior, transmittance: grey(1.0), alpha: 0.0, priority: None }, 0.0)
}

fn settings(spp: u32) -> Settings {
    Settings { width: 16, height: 16, spp, ambient_bounces: 0, max_depth: 64, ..Settings::default() }
}

/// Mean and standard error, and the number of unsound pixels.
fn seen(world: &World, view: View) -> (f64, f64, u64) {
    let image = render(&world.frame(view), &settings(64));
    let mut moments = Moments::default();
    values(&image).into_iter().for_each(|v| moments.add(v));
    (moments.sample().mean, moments.sample().variance.sqrt(), unsound(&image))
}

pub fn from(x: f64, y: f64, z: f64) -> View {
    View::new(DVec3::new(x, y, z), DVec3::ZERO, 0.3)
}

#[test]
fn media_within_media_vanish_in_a_furnace() {
    // Flat interfaces: smooth normals over flat triangles bend light into the surface at a silhouette, which
    // loses some.
    let slab = |world: World, half: f64, ior: f32| {
        let corner = DVec3::new(8.0 + half, half, 8.0 + half);
        world.cuboid(-corner, corner, false, glass(ior))
    };
    // Water in glass in air; air in water in glass; three deep.
    let stacks: [&[f32]; 4] =
        [&[1.5, 1.33 / 1.5], &[1.5, 1.33 / 1.5, 1.0 / 1.33], &[2.4, 1.5 / 2.4, 1.31 / 1.5], &[1.5, 1.0]];
    let (mut worst, mut wrong, mut pixels) = (0.0f64, 0, 0);
    for stack in stacks {
        let world = stack
            .iter()
            .enumerate()
            .fold(World::under(1.0), |world, (i, &ior)| slab(world, 0.5 / f64::from(1 << i), ior));
        for eye in [from(0.0, 3.0, 0.1), from(2.0, 3.0, 1.0), from(4.0, 2.0, 0.0)] {
            let (value, error, unsound) = seen(&world, eye);
            worst = worst.max((value - 1.0).abs() - 5.0 * error);
            (wrong, pixels) = (wrong + unsound, pixels + 256);
        }
    }
    // Light still inside after 64 hits, at most 85° from the normal: R² < 0.4 per round trip, so nothing is
    // left.
    case(15, "two and three media within each other vanish in a furnace, beyond 5 standard errors")
        .worst(worst, 1e-3);
    case(15, "pixels of media within media that are no finite number").never(wrong, pixels);
}

#[test]
fn a_shared_interface_that_is_modelled_once_vanishes_in_a_furnace() {
    // Water on glass: the faces between them are one interface, glass seen from the water.
    let (low, middle, high) = (-0.5, 0.0, 0.5);
    let face = |world: World, y: f64, ior: f32| world.floor(DVec3::new(0.0, y, 0.0), 50.0, glass(ior));
    // Fronts face up. Below the upper face is water (1.33), below the middle one glass (1.5 / 1.33), and
    // below the lower one air.
    let world = face(face(face(World::under(1.0), high, 1.33), middle, 1.5 / 1.33), low, 1.0 / 1.5);
    let mut worst = 0.0f64;
    for eye in [from(0.0, 3.0, 0.1), from(2.0, 3.0, 1.0), from(0.0, -3.0, 0.1), from(2.0, -2.0, 1.0)] {
        let (value, error, _) = seen(&world, eye);
        worst = worst.max((value - 1.0).abs() - 5.0 * error);
    }
    case(15, "water on glass, their interface modelled once, vanishes in a furnace").worst(worst, 1e-3);
}

#[test]
fn faces_in_the_same_place_bend_light_wrongly_but_make_none_beyond_their_indices() {
    // Two solids that touch: the format does not say which of the coincident faces counts. Radiance grows by
    // η² on leaving a medium that it did not enter, so the product of the squared indices is the maximum.
    let low = DVec3::new(-8.0, -0.5, -8.0);
    let world = World::under(1.0).cuboid(low, DVec3::new(8.0, 0.0, 8.0), false, glass(1.5)).cuboid(
        DVec3::new(-8.0, 0.0, -8.0),
        DVec3::new(8.0, 0.5, 8.0),
        false,
        glass(1.33),
    );
    let (mut most, mut least, mut wrong, mut pixels) = (0.0f64, 9.0f64, 0, 0);
    for eye in [from(0.0, 3.0, 0.1), from(2.0, 3.0, 1.0), from(0.0, -3.0, 0.1)] {
        let (value, _, unsound) = seen(&world, eye);
        (most, least) = (most.max(value), least.min(value));
        (wrong, pixels) = (wrong + unsound, pixels + 256);
    }
    case(15, "coincident faces of two media in a furnace").worst(most, 1.5f64.powi(2) * 1.33f64.powi(2));
    case(15, "coincident faces of two media in a furnace")
        .least(least, 1.0 / (1.5f64.powi(2) * 1.33f64.powi(2)));
    case(15, "pixels of coincident faces that are no finite number").never(wrong, pixels);
}

#[test]
fn a_camera_inside_a_medium_sees_radiance_times_the_squared_index() {
    let mut worst = 0.0f64;
    for ior in [1.0f32, 1.33, 1.5] {
        let world = World::under(1.0).sphere(DVec3::ZERO, 2.0, 6, glass(ior));
        let view = View::new(DVec3::ZERO, DVec3::new(0.3, 0.4, 1.0), 0.5);
        let (value, _, unsound) = seen(&world, view);
        assert_eq!(unsound, 0);
        worst = worst.max((value / f64::from(ior * ior) - 1.0).abs());
    }
    // From the centre, every ray meets the sphere along its normal. Reflected light returns and tries again.
    case(15, "a camera inside a glass sphere in a furnace sees η²").worst(worst, 1e-4);
}
