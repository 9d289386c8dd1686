//! Solid dielectrics with priorities: overlap, coincident faces, a camera inside, equal priorities.

use crate::media::{from, glass};
use forelight_protocol::Integrator;
use forelight_random::Random;
use forelight_scene::{Material, Surface};
use forelight_tests::case::case;
use forelight_tests::statistics::Moments;
use forelight_tests::world::{View, World, grey, lambert, material, render, unsound, values};
use forelight_tracer::Settings;
use glam::DVec3;
use std::num::NonZeroU8;

fn medium(ior: f32, priority: u8) -> Material {
    let priority = NonZeroU8::new(priority);
    material(Surface::Glass { ior, transmittance: grey(1.0), alpha: 0.0, priority }, 0.0)
}

fn settings(integrator: Integrator, spp: u32) -> Settings {
    Settings {
        width: 16,
        height: 16,
        spp,
        integrator,
        ambient_bounces: 0,
        max_depth: 64,
        ..Settings::default()
    }
}

fn cube(world: World, low: [f64; 3], high: [f64; 3], medium: Material) -> World {
    world.cuboid(DVec3::from_array(low), DVec3::from_array(high), false, medium)
}

fn slab(world: World, low: f64, high: f64, medium: Material) -> World {
    cube(world, [-8.0, low, -8.0], [8.0, high, 8.0], medium)
}

/// Distance of the mean from `truth` beyond five standard errors, the worse of both integrators. Then the
/// numbers of unsound and of all pixels.
fn off(world: &World, view: View, truth: f64) -> (f64, u64, u64) {
    let (mut worst, mut wrong, mut pixels) = (f64::NEG_INFINITY, 0, 0);
    for integrator in [Integrator::Ambient, Integrator::Path] {
        let image = render(&world.frame(view), &settings(integrator, 64));
        let mut moments = Moments::default();
        values(&image).into_iter().for_each(|v| moments.add(v));
        let sample = moments.sample();
        worst = worst.max((sample.mean - truth).abs() - 5.0 * sample.variance.sqrt());
        (wrong, pixels) = (wrong + unsound(&image), pixels + 256);
    }
    (worst, wrong, pixels)
}

#[test]
fn media_that_overlap_or_touch_vanish_in_a_furnace() {
    // Water on glass: it overlaps the glass, touches it, or has a gap that a ray's start steps over. Ice
    // overlaps both.
    let (glass, water, ice) = (medium(1.5, 3), medium(1.33, 1), medium(1.31, 2));
    let worlds = [0.05, 0.0, -1e-7].map(|reach| {
        let world = slab(World::under(1.0), -0.5, reach, glass.clone());
        let world = slab(world, 0.0, 0.5, water.clone());
        cube(world, [-1.0, -0.2, -1.0], [1.0, 0.5, 1.0], ice.clone())
    });
    let (mut worst, mut wrong, mut pixels) = (0.0f64, 0, 0);
    for world in &worlds {
        for eye in [from(0.0, 3.0, 0.1), from(2.0, 3.0, 1.0), from(0.0, -3.0, 0.1), from(2.0, -2.0, 1.0)] {
            let (off, unsound, of) = off(world, eye, 1.0);
            worst = worst.max(off);
            (wrong, pixels) = (wrong + unsound, pixels + of);
        }
    }
    // Light still inside after 64 hits is lost.
    case(15, "glass, water and ice with priorities, overlapping or touching, vanish in a furnace")
        .worst(worst, 1e-3);
    case(15, "pixels of media with priorities that are no finite number").never(wrong, pixels);
}

#[test]
fn faces_in_the_same_place_are_one_interface() {
    // A bright square under water on glass appears where Snell's law puts it. It does not matter whether
    // their common face exists twice, or once with the relative index.
    let lamp = |world: World| world.floor(DVec3::new(0.0, -1.0, 0.0), 0.5, material(lambert(0.0), 1.0));
    let twice = slab(slab(lamp(World::under(0.0)), -0.5, 0.0, medium(1.5, 2)), 0.0, 0.5, medium(1.33, 1));
    let face = |world: World, y: f64, ior: f32| world.floor(DVec3::new(0.0, y, 0.0), 50.0, glass(ior));
    let once = face(face(face(lamp(World::under(0.0)), 0.5, 1.33), 0.0, 1.5 / 1.33), -0.5, 1.0 / 1.5);
    let mut worst = 0.0f64;
    for eye in [from(0.0, 3.0, 0.1), from(1.5, 3.0, 1.0), from(3.0, 2.0, 0.0)] {
        let [a, b] = [&twice, &once]
            .map(|world| values(&render(&world.frame(eye), &settings(Integrator::Ambient, 256))));
        let lit = b.iter().filter(|&&value| value > 0.1).count();
        assert!((20..230).contains(&lit), "the square's edge must be in the picture: {lit} pixels are lit");
        let off: f64 = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).sum::<f64>() / b.iter().sum::<f64>();
        worst = worst.max(off);
    }
    // Camera samples are the same. Only the choice between reflection and refraction at the second and third
    // face differs.
    case(15, "a face that is there twice bends light as one does: mean difference relative to the mean")
        .worst(worst, 0.01);
}

#[test]
fn the_highest_priority_fills_the_place_that_the_camera_is_in() {
    let at = |y: f64| View::new(DVec3::new(0.013, y, 0.021), DVec3::new(0.02, y + 5.0, 0.03), 0.05);
    // Glass from -0.5 to 0.1, water from -0.1 to 0.5, seen straight up so that little is reflected.
    let world = |glass, water| {
        slab(slab(World::under(1.0), -0.5, 0.1, medium(1.5, glass)), -0.1, 0.5, medium(1.33, water))
    };
    let [glass, water] = [1.5f64, 1.33].map(|ior| ior * ior);
    let mut worst = 0.0f64;
    for (glass_priority, water_priority, both) in [(2, 1, glass), (1, 2, water), (7, 7, glass)] {
        let world = world(glass_priority, water_priority);
        for (y, truth) in [(-0.3, glass), (0.0, both), (0.3, water), (2.0, 1.0), (-0.8, 1.0)] {
            worst = worst.max(off(&world, at(y), truth).0);
        }
    }
    case(15, "a camera in glass, in water and in both sees the squared index of what fills the place")
        .worst(worst, 2e-3);
}

#[test]
fn what_is_inside_a_place_does_not_depend_on_the_way_there() {
    // Boxes on a grid that overlap, share faces, edges and corners, and contain each other. Light leaves as
    // it entered. A lost event would leave it compressed by some index.
    let mut random = Random::new(15);
    let (mut worst, mut wrong, mut pixels) = (0.0f64, 0, 0);
    for _ in 0..12 {
        let mut world = World::under(1.0);
        for _ in 0..6 {
            let mut edge = || {
                let (a, b) = (random.below(4) as f64, random.below(3) as f64);
                let low = a / 2.0 - 1.0;
                (low, low + (b + 1.0) / 2.0)
            };
            let [x, y, z] = [edge(), edge(), edge()];
            // Similar indices, so that total reflection traps no light for long.
            let ior = 1.05 + 0.05 * random.below(4) as f32;
            world = cube(world, [x.0, y.0, z.0], [x.1, y.1, z.1], medium(ior, 1 + random.below(3) as u8));
        }
        for eye in [from(3.0, 2.2, 2.7), from(-2.9, 1.3, 2.1), from(0.3, -3.1, 0.2)] {
            let (off, unsound, of) = off(&world, eye, 1.0);
            worst = worst.max(off);
            (wrong, pixels) = (wrong + unsound, pixels + of);
        }
    }
    case(15, "six boxes of media on a grid, with faces, edges and corners in common, vanish in a furnace")
        .worst(worst, 2e-3);
    case(15, "pixels of boxes of media on a grid that are no finite number").never(wrong, pixels);
}

#[test]
fn a_lost_event_cannot_take_a_medium_away_twice() {
    // A sheet that only faces down, as of an open solid: light leaves it but never enters.
    let world = World::under(1.0).ceiling(DVec3::ZERO, 50.0, medium(1.5, 1));
    let world = slab(world, 0.2, 0.4, medium(1.33, 2));
    let (mut most, mut wrong, mut pixels) = (0.0f64, 0, 0);
    for eye in [from(0.0, 3.0, 0.1), from(0.0, -3.0, 0.1), from(2.0, 3.0, 1.0), from(2.0, -2.0, 1.0)] {
        let image = render(&world.frame(eye), &settings(Integrator::Ambient, 16));
        most = values(&image).into_iter().fold(most, f64::max);
        (wrong, pixels) = (wrong + unsound(&image), pixels + 256);
    }
    case(15, "a solid that is not closed makes no more light than its index allows")
        .worst(most, 1.5f64.powi(2) * 1.01);
    case(15, "pixels of a solid that is not closed that are no finite number").never(wrong, pixels);
}
