//! Images have the same bits with and without what is left out, which costs nothing.

mod support;

use forelight_protocol::Integrator;
use forelight_scene::{Color, Environment, Frame, PointLight, Sun, Surface};
use forelight_tracer::{CacheSettings, Image, Settings, Tracer};
use glam::Vec3;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use support::{Builder, lambert, material};

fn settings() -> Settings {
    Settings {
        width: 48,
        height: 36,
        spp: 2,
        ambient_bounces: 2,
        ambient_divisions: 8,
        ..Settings::default()
    }
}

fn path() -> Settings {
    Settings { integrator: Integrator::Path, spp: 8, ..settings() }
}

fn cached() -> Settings {
    Settings { cache: Some(CacheSettings { accuracy: 400, rays: 48 }), ..settings() }
}

fn render(tracer: &Tracer) -> Image {
    tracer.render(None, &|_| {}, &AtomicBool::new(false)).expect("nobody cancels")
}

fn bits(image: &Image) -> Vec<([u32; 3], u32)> {
    image.pixels.iter().map(|p| (p.color.map(f32::to_bits), p.stratum)).collect()
}

const CLEAR: Surface =
    Surface::Glass { ior: 1.5, transmittance: Color::plain(Vec3::ONE), alpha: 0.0, priority: None };

/// A closed room with a table, a mirror, a hovering glass ball, a hanging lamp and a point light. Beyond its
/// walls: another room with lamps and a pane, a sun, a sky, a street lamp.
fn rooms(camera: Vec3) -> Frame {
    let mirror = Surface::Metal { f0: Color::plain(Vec3::splat(0.9)), alpha: 0.0 };
    let brushed = Surface::Metal { f0: Color::plain(Vec3::splat(0.7)), alpha: 0.2 };
    let pane = Surface::ThinGlass { ior: 1.5, transmittance: Color::plain(Vec3::ONE) };
    let mut frame = Builder::default()
        .quad(Vec3::new(3.0, 2.9, -0.5), Vec3::X, Vec3::Z, material("next lamp", lambert(0.0), 90.0))
        .cuboid(
            Vec3::new(-2.0, 0.0, -2.0),
            Vec3::new(2.0, 3.0, 2.0),
            true,
            material("room", lambert(0.7), 0.0),
        )
        .cuboid(Vec3::new(-0.5, 0.0, -1.5), Vec3::new(0.5, 0.7, -0.7), false, material("table", brushed, 0.0))
        .quad(Vec3::new(-1.0, 0.5, -1.9), Vec3::X * 2.0, Vec3::Y, material("mirror", mirror, 0.0))
        .sphere(Vec3::new(0.1, 1.2, -1.0), 0.25, material("ball", CLEAR, 0.0))
        .quad(Vec3::new(-0.5, 2.9, -0.5), Vec3::X, Vec3::Z, material("lamp", lambert(0.0), 9.0))
        .cuboid(
            Vec3::new(2.2, 0.0, -2.0),
            Vec3::new(6.0, 3.0, 2.0),
            true,
            material("next", lambert(0.7), 0.0),
        )
        .quad(Vec3::new(4.0, 0.5, -1.0), Vec3::Z, Vec3::Y, material("next pane", pane, 0.0))
        .frame(camera, Vec3::new(0.0, 1.0, -1.0), 48, Environment::Constant(Vec3::new(0.3, 0.6, 1.0)));
    let intensity = Vec3::splat(5.0);
    for position in [Vec3::new(-1.0, 2.0, 1.0), Vec3::new(0.0, 6.0, 0.0)] {
        frame.points.push(PointLight { position, intensity, cone: None });
    }
    let irradiance = Vec3::new(30.0, 25.0, 20.0);
    let direction = Vec3::new(0.6, 0.64, 0.48);
    frame.suns.push(Sun { direction, irradiance, angle_deg: 0.5 });
    frame
}

/// A lamp in a closed box and one above it, on a floor under a sky.
fn housing() -> Frame {
    Builder::default()
        .quad(Vec3::new(-3.0, 0.0, 3.0), Vec3::X * 6.0, Vec3::Z * -6.0, material("floor", lambert(0.5), 0.0))
        .sphere(Vec3::splat(0.5), 0.3, material("bulb", CLEAR, 50.0))
        .cuboid(Vec3::ZERO, Vec3::ONE, false, material("housing", lambert(0.5), 0.0))
        .quad(Vec3::new(-1.0, 2.0, -1.0), Vec3::X, Vec3::Z, material("lamp", lambert(0.0), 9.0))
        .frame(Vec3::new(0.5, 1.5, 4.0), Vec3::splat(0.5), 48, Environment::Constant(Vec3::splat(0.2)))
}

#[test]
fn images_have_the_same_bits_without_what_cannot_matter() {
    let frames = [
        ("a room, from inside", rooms(Vec3::new(0.3, 1.6, 1.5)), 7),
        ("a room, from outside", rooms(Vec3::new(0.3, 1.6, 9.0)), 8),
        ("a housing", housing(), 2),
    ];
    for (name, frame, left_out) in frames {
        for settings in [settings(), path(), cached()] {
            let plain = Tracer::new(&frame, &settings);
            let complete = Tracer::complete(&frame, &settings);
            let everything = Tracer::complete(&frame, &settings).with_kernel_for(plain.effects().with_all());
            assert_eq!(plain.left_out().len(), left_out, "{name}: {:?}", plain.left_out());
            let image = render(&plain);
            assert!(image.pixels.iter().any(|p| p.color[0] > 0.0));
            for other in [complete, everything] {
                assert!(bits(&image) == bits(&render(&other)), "{name}, {settings:?}");
            }
        }
    }
}

#[test]
fn what_is_left_out_takes_no_rays_no_code_and_no_memory() {
    let frame = rooms(Vec3::new(0.3, 1.6, 1.5));
    let (plain, complete) = (Tracer::new(&frame, &settings()), Tracer::complete(&frame, &settings()));
    let names = |tracer: &Tracer| tracer.effects().names().collect::<Vec<_>>();
    let gone = ["thin glass", "transparent shadows", "sun", "environment"];
    let expected: Vec<&str> = names(&complete).into_iter().filter(|name| !gone.contains(name)).collect();
    assert_eq!(names(&plain), expected);
    assert!(names(&complete).len() == expected.len() + gone.len());
    let (shadow, all_shadow) = (render(&plain).totals().rays[1], render(&complete).totals().rays[1]);
    assert!(shadow < all_shadow, "{shadow} and {all_shadow} shadow rays");
    let housing = housing();
    let bytes = |tracer: Tracer| tracer.bvh().bytes();
    let (without, with) =
        (bytes(Tracer::new(&housing, &settings())), bytes(Tracer::complete(&housing, &settings())));
    assert!(without * 10 < with, "{without} and {with} bytes");
}

#[test]
fn a_tree_is_shared_by_frames_that_see_the_same_of_the_scene_and_by_no_others() {
    let inside = rooms(Vec3::new(0.3, 1.6, 1.5));
    let first = Tracer::new(&inside, &settings());
    let at = |camera: Vec3| {
        let mut frame = inside.clone();
        frame.camera.origin = camera;
        let shared = Tracer::with_bvh(&frame, &settings(), first.bvh().clone());
        let same = Arc::ptr_eq(shared.bvh(), first.bvh());
        assert_eq!(same, shared.tree_cost().build == Default::default());
        assert!(bits(&render(&shared)) == bits(&render(&Tracer::new(&frame, &settings()))));
        same
    };
    assert!(at(Vec3::new(0.5, 1.5, 1.0)), "another place in the room");
    assert!(!at(Vec3::new(4.0, 1.5, 1.0)), "the other room");
    assert!(!at(Vec3::new(0.3, 1.6, 9.0)), "outside");
}

#[test]
fn lights_that_cannot_reach_are_not_among_those_chosen_of_many() {
    // Hundreds of lamps beyond the wall do not change the picture of a room with one lamp.
    let scene = |lamps: i32| {
        let mut builder = Builder::default()
            .cuboid(
                Vec3::new(-2.0, 0.0, -2.0),
                Vec3::new(2.0, 3.0, 2.0),
                true,
                material("room", lambert(0.7), 0.0),
            )
            .quad(Vec3::new(-0.5, 2.9, -0.5), Vec3::X, Vec3::Z, material("lamp", lambert(0.0), 9.0));
        for i in 0..lamps {
            let corner = Vec3::new(3.0 + (i % 20) as f32, 2.0, (i / 20) as f32);
            let lamp = material(&format!("street lamp {i}"), lambert(0.0), 100.0);
            builder = builder.quad(corner, 0.5 * Vec3::X, 0.5 * Vec3::Z, lamp);
        }
        builder.frame(Vec3::new(0.3, 1.6, 1.5), Vec3::new(0.0, 1.0, -1.0), 48, Environment::Black)
    };
    for settings in [settings(), path()] {
        let (one, many) = (scene(0), scene(400));
        let tracer = Tracer::new(&many, &settings);
        assert_eq!(tracer.left_out().len(), 800);
        assert!(tracer.effects().names().all(|name| name != "choice of lights"));
        assert!(bits(&render(&tracer)) == bits(&render(&Tracer::new(&one, &settings))));
        assert!(bits(&render(&tracer)) == bits(&render(&Tracer::complete(&many, &settings))));
    }
}
