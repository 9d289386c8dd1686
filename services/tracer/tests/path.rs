//! The `path` integrator against closed forms and against the other integrator.

mod support;

use forelight_protocol::Integrator;
use forelight_scene::{Color, Environment, Frame, PointLight, Sun, Surface, Texels, Texture, TextureId};
use forelight_tracer::{Image, Settings, Tracer};
use glam::Vec3;
use std::sync::atomic::AtomicBool;
use support::{Builder, lambert, material};

/// Edge of the test images, pixels.
const SIZE: u32 = 16;

fn settings(integrator: Integrator, spp: u32, ambient_bounces: u32) -> Settings {
    let size = Settings { width: SIZE, height: SIZE, ambient_divisions: 16, ..Settings::default() };
    Settings { integrator, spp, ambient_bounces, ..size }
}

fn render(frame: &Frame, settings: &Settings) -> Image {
    Tracer::new(frame, settings).render(None, &|_| {}, &AtomicBool::new(false)).expect("nobody cancels")
}

fn mean(image: &Image) -> f64 {
    image.pixels.iter().map(|p| f64::from(p.color[0])).sum::<f64>() / image.pixels.len() as f64
}

/// Means of the image's 16 blocks, and of the image, with their standard errors, from independent renders.
fn blocks(frame: &Frame, settings: &Settings, renders: u32) -> Vec<(f64, f64)> {
    let mut sums = vec![(0.0, 0.0); 17];
    for seed in 0..renders {
        let image = render(frame, &Settings { seed: u64::from(seed), ..settings.clone() });
        let mut values = vec![0.0; 17];
        for (i, pixel) in image.pixels.iter().enumerate() {
            let (x, y) = (i as u32 % SIZE / 4, i as u32 / SIZE / 4);
            let value = f64::from(pixel.color[0] + pixel.color[1] + pixel.color[2]);
            values[(y * 4 + x) as usize] += value / 16.0;
            values[16] += value / 256.0;
        }
        for (sum, value) in sums.iter_mut().zip(values) {
            sum.0 += value;
            sum.1 += value * value;
        }
    }
    let n = f64::from(renders);
    let moments = |(sum, squares): (f64, f64)| {
        let mean = sum / n;
        (mean, ((squares / n - mean * mean).max(0.0) / (n - 1.0)).sqrt())
    };
    sums.into_iter().map(moments).collect()
}

/// Compares two images by blocks: 16 renders each, so Student's t passes 5 in one of 40,000 comparisons.
#[track_caller]
fn agree(a: &[(f64, f64)], b: &[(f64, f64)]) {
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        let error = a.1.hypot(b.1).hypot(1e-6 * a.0);
        let t = (a.0 - b.0) / error;
        println!("block {i}: {:.6} ± {:.6} and {:.6} ± {:.6}: {t:.2}", a.0, a.1, b.0, b.1);
        assert!(t.abs() < 5.0, "block {i}: {} ± {} and {} ± {}", a.0, a.1, b.0, b.1);
    }
    let last = a.len() - 1;
    assert!(a[last].1 < 0.02 * a[last].0, "too noisy to tell: {:?}", a[last]);
}

/// Both integrators on a frame, the other one without any bounce more.
#[track_caller]
fn as_ambient(frame: &Frame, bounces: u32, spp: u32) {
    let ours = blocks(frame, &settings(Integrator::Path, spp, bounces), 16);
    let theirs = blocks(frame, &settings(Integrator::Ambient, spp.div_ceil(4), bounces), 16);
    agree(&ours, &theirs);
}

/// A room open to the viewer with two blocks in it.
fn room() -> Builder {
    let white = || material("white", lambert(0.7), 0.0);
    let quad = |s: Builder, corner, u, v, m| s.quad(corner, u, v, m);
    let tint = |r, g, b| material("tint", Surface::Lambert { albedo: Color::plain(Vec3::new(r, g, b)) }, 0.0);
    let (x, y, z) = (2.0 * Vec3::X, 2.0 * Vec3::Y, 2.0 * Vec3::Z);
    let mut s = Builder::default();
    s = quad(s, Vec3::new(-1.0, -1.0, -1.0), z, x, white());
    s = quad(s, Vec3::new(-1.0, 1.0, -1.0), x, z, white());
    s = quad(s, Vec3::new(-1.0, -1.0, -1.0), x, y, white());
    s = quad(s, Vec3::new(-1.0, -1.0, -1.0), y, z, tint(0.7, 0.1, 0.1));
    s = quad(s, Vec3::new(1.0, -1.0, -1.0), z, y, tint(0.1, 0.6, 0.1));
    s.cuboid(Vec3::new(-0.7, -1.0, -0.6), Vec3::new(-0.1, 0.2, 0.0), false, white()).cuboid(
        Vec3::new(0.1, -1.0, -0.1),
        Vec3::new(0.6, -0.4, 0.5),
        false,
        white(),
    )
}

fn view(scene: Builder) -> Frame {
    scene.frame(Vec3::new(0.0, 0.0, 2.9), Vec3::ZERO, SIZE, Environment::Black)
}

/// A light under the room's ceiling, in so many strips either way.
fn lamp(scene: Builder, strips: u32, radiance: f32) -> Builder {
    let edge = 0.5 / strips as f32;
    (0..strips * strips).fold(scene, |s, i| {
        let corner = Vec3::new(-0.25 + edge * (i % strips) as f32, 0.98, -0.25 + edge * (i / strips) as f32);
        s.quad(corner, edge * Vec3::X, edge * Vec3::Z, material("lamp", lambert(0.3), radiance))
    })
}

#[test]
fn a_lambert_room_looks_as_by_the_other_integrator_for_every_number_of_bounces() {
    let frame = view(lamp(room(), 1, 12.0));
    for bounces in 0..3 {
        as_ambient(&frame, bounces, 32);
    }
}

#[test]
fn lights_of_every_kind_look_as_by_the_other_integrator() {
    let mut frame = view(lamp(room(), 1, 2.0));
    frame.points.push(PointLight { position: Vec3::new(0.5, 0.5, 0.7), intensity: Vec3::ONE, cone: None });
    let cone = Some((Vec3::NEG_Y, 0.95, 0.8));
    let position = Vec3::new(-0.5, 0.9, 0.7);
    frame.points.push(PointLight { position, intensity: Vec3::splat(3.0), cone });
    let direction = Vec3::new(0.2, 0.3, 1.0).normalize();
    frame.suns.push(Sun { direction, irradiance: Vec3::new(0.5, 0.4, 0.3), angle_deg: 5.0 });
    frame.suns.push(Sun { direction: Vec3::Z, irradiance: Vec3::splat(0.2), angle_deg: 0.0 });
    as_ambient(&frame, 1, 32);
}

/// A sky with a bright spot low over the horizon on the viewer's side.
fn sky(frame: &mut Frame) {
    let (width, height) = (32usize, 16usize);
    let texel = |i: usize| {
        let (x, y) = (i % width, i / width);
        // The image's centre looks along −z, its edges to the viewer's side.
        if (x < 2 || x >= width - 2) && (6..8).contains(&y) { [40.0, 30.0, 20.0] } else { [0.2, 0.3, 0.5] }
    };
    let texels = Texels::Linear((0..width * height).map(texel).collect());
    let (width, height) = (width as u32, height as u32);
    frame.textures = vec![Texture { name: "sky".into(), width, height, texels }].into();
    frame.environment = Environment::Image { texture: TextureId(0), scale: 1.0, rotation_deg: 20.0 };
}

#[test]
fn an_image_of_the_sky_lights_a_room_as_by_the_other_integrator() {
    let mut frame = view(room());
    sky(&mut frame);
    as_ambient(&frame, 1, 64);
}

#[test]
fn light_through_panes_and_veils_is_counted_once() {
    // Between lamp and floor: a pane that colours, and a cloth that lets some light pass; both close to the
    // lamp, so that it is found by directions as often as by light sampling.
    let color = Color::plain(Vec3::new(0.9, 0.6, 0.3));
    let pane = Surface::ThinGlass { ior: 1.5, transmittance: color };
    let scene = lamp(room(), 1, 20.0)
        .quad(Vec3::new(-0.6, 0.8, -0.6), 1.2 * Vec3::X, 1.2 * Vec3::Z, material("pane", pane, 0.0))
        .quad(Vec3::new(-0.9, 0.9, -0.9), 1.8 * Vec3::X, 1.8 * Vec3::Z, material("veil", lambert(0.4), 0.0));
    let mut frame = view(scene);
    let mut materials = frame.materials.to_vec();
    materials.last_mut().expect("the veil").opacity = 0.4;
    frame.materials = materials.into();
    // The pane mirrors the lamp onto the ceiling, a caustic that `ambient` leaves out. Only the floor is
    // compared.
    frame.camera.forward = Vec3::new(0.0, -0.8, -0.6);
    frame.camera.up = Vec3::new(0.0, 0.6, -0.8);
    frame.camera.origin = Vec3::new(0.0, 0.5, 1.5);
    as_ambient(&frame, 0, 64);
}

#[test]
fn rough_metal_and_rough_glass_show_a_light_as_by_the_other_integrator() {
    let metal = Surface::Metal { f0: Color::plain(Vec3::new(0.9, 0.7, 0.5)), alpha: 0.2 };
    let glass =
        Surface::Glass { ior: 1.5, transmittance: Color::plain(Vec3::ONE), alpha: 0.3, priority: None };
    for surface in [metal, glass] {
        let up = 1.5 * Vec3::Y;
        let frame = Builder::default()
            .quad(Vec3::new(-1.0, -0.2, 1.0), 2.0 * Vec3::X, -2.0 * Vec3::Z, material("plate", surface, 0.0))
            .quad(Vec3::new(-0.8, 0.0, -1.0), 1.6 * Vec3::X, up, material("front", lambert(0.0), 5.0))
            .quad(Vec3::new(-0.8, -2.0, -1.0), 1.6 * Vec3::X, up, material("under", lambert(0.0), 5.0))
            .frame(Vec3::new(0.0, 1.0, 2.0), Vec3::ZERO, SIZE, Environment::Black);
        as_ambient(&frame, 4, 64);
    }
}

#[test]
fn a_light_in_ten_thousand_pieces_is_the_same_light() {
    let whole = blocks(&view(lamp(room(), 1, 12.0)), &settings(Integrator::Path, 32, 2), 16);
    let pieces = blocks(&view(lamp(room(), 100, 12.0)), &settings(Integrator::Path, 32, 2), 16);
    agree(&whole, &pieces);
    let noise = |blocks: &[(f64, f64)]| blocks.iter().map(|b| b.1 / b.0).sum::<f64>();
    assert!(noise(&pieces) < 1.5 * noise(&whole), "{} and {}", noise(&pieces), noise(&whole));
}

#[test]
fn the_other_integrator_finds_many_lights_by_the_tree_with_the_same_mean() {
    // Glossy surfaces too: their lobes share the lights with light sampling, by the tree's densities.
    let gloss = Surface::Plastic { albedo: Color::plain(Vec3::splat(0.5)), ior: 1.5, alpha: 0.15 };
    let plate = || material("gloss", gloss, 0.0);
    let scene = |strips, height| {
        let room = room().quad(Vec3::new(-0.9, height, 0.9), 1.8 * Vec3::X, -1.4 * Vec3::Z, plate());
        let mut frame = view(lamp(room, strips, 12.0));
        for i in 0..strips {
            // The same light in more points.
            let position = Vec3::new(-0.8, 0.9, 0.9);
            let intensity = Vec3::splat(0.3 / strips as f32);
            frame.points.push(PointLight {
                position: position + i as f32 * 1e-6 * Vec3::X,
                intensity,
                cone: None,
            });
        }
        frame
    };
    for (bounces, height) in [(0, -0.9), (1, 0.97)] {
        let settings = settings(Integrator::Ambient, 16, bounces);
        let whole = blocks(&scene(1, height), &settings, 16);
        for strips in [3, 40] {
            let names: Vec<_> = Tracer::new(&scene(strips, height), &settings).effects().names().collect();
            assert!(names.contains(&"choice of lights"), "{names:?}");
            agree(&whole, &blocks(&scene(strips, height), &settings, 16));
        }
    }
}

const WHITE_SKY: Environment = Environment::Constant(Vec3::ONE);

/// Mean of an image that a body of this surface fills in part, in constant light from everywhere.
fn furnace(surface: Surface, round: bool, bounces: u32, max_depth: u32) -> f64 {
    let body = material("body", surface, 0.0);
    let scene = match round {
        true => Builder::default().sphere(Vec3::ZERO, 1.0, body),
        false => Builder::default().cuboid(Vec3::splat(-0.6), Vec3::splat(0.6), false, body),
    };
    let frame = scene.frame(Vec3::new(1.0, 1.5, 2.2), Vec3::ZERO, SIZE, WHITE_SKY);
    mean(&render(&frame, &Settings { max_depth, ..settings(Integrator::Path, 256, bounces) }))
}

#[test]
fn white_bodies_in_a_furnace_disappear() {
    let white = Color::plain(Vec3::ONE);
    let clear = |alpha| Surface::Glass { ior: 1.5, transmittance: white, alpha, priority: None };
    let cases = [
        ("lambert", lambert(1.0), true, 0, 1e-4),
        ("mirror", Surface::Metal { f0: white, alpha: 0.0 }, false, 0, 1e-4),
        ("pane", Surface::ThinGlass { ior: 1.5, transmittance: white }, true, 0, 2e-3),
        ("glass ball", clear(0.0), true, 0, 5e-3),
        ("glass box", clear(0.0), false, 0, 5e-3),
        ("nearly smooth glass box", clear(2e-3), false, 1000, 1e-2),
    ];
    for (name, surface, round, bounces, error) in cases {
        let value = furnace(surface, round, bounces, 64);
        assert!((value - 1.0).abs() < error, "{name}: {value}");
    }
}

#[test]
fn a_closed_emitting_room_sums_the_series_truncated_or_not() {
    // Albedo ρ, emission 1, everywhere: the camera sees 1, direct light adds ρ, each bounce another factor ρ.
    let rho = 0.6f64;
    let frame = Builder::default()
        .cuboid(Vec3::splat(-1.0), Vec3::ONE, true, material("room", lambert(0.6), 1.0))
        .frame(Vec3::new(0.1, 0.2, 0.3), Vec3::ZERO, SIZE, Environment::Black);
    for bounces in [0, 1, 2, 65_536] {
        let image = render(&frame, &settings(Integrator::Path, 256, bounces));
        let terms = bounces.min(200) as i32 + 1;
        let expected: f64 = (0..=terms).map(|i| rho.powi(i)).sum();
        let value = mean(&image);
        assert!((value / expected - 1.0).abs() < 5e-3, "{bounces} bounces: {value} against {expected}");
    }
}

#[test]
fn a_mirror_lights_the_floor_as_a_second_lamp_behind_it_would() {
    // A caustic (lamp, mirror, diffuse floor) equals the lamp's mirror image behind a hole of the mirror's
    // size.
    let floor = || {
        let (u, v) = (4.0 * Vec3::X, -4.0 * Vec3::Z);
        Builder::default().quad(Vec3::new(-2.0, 0.0, 2.0), u, v, material("floor", lambert(0.5), 0.0))
    };
    let lamp = |s: Builder, x: f32| {
        let (corner, edge) = (Vec3::new(x - 0.4, 1.0, -0.4), 0.8);
        s.quad(corner, edge * Vec3::X, edge * Vec3::Z, material("lamp", lambert(0.0), 10.0))
    };
    let shade = || material("shade", lambert(0.0), 0.0);
    let look =
        |s: Builder| s.frame(Vec3::new(-0.5, 2.5, 3.5), Vec3::new(-0.8, 0.0, 0.0), SIZE, Environment::Black);
    // The plane x = 1: a mirror below and beside the lamp, as large as the hole in the shade.
    let mirror = Surface::Metal { f0: Color::plain(Vec3::ONE), alpha: 0.0 };
    let (corner, u, v) = (Vec3::new(1.0, 0.0, -1.5), 1.5 * Vec3::Y, 3.0 * Vec3::Z);
    let with_mirror = look(lamp(floor(), 0.0).quad(corner, u, v, material("mirror", mirror, 0.0)));
    // Behind the hole: the lamp's image at x = 2. The floor beyond x = 1 is not compared.
    let frame_of_hole = |s: Builder| {
        s.quad(Vec3::new(1.0, 1.5, -3.0), 2.0 * Vec3::Y, 6.0 * Vec3::Z, shade())
            .quad(Vec3::new(1.0, 0.0, -4.5), 1.5 * Vec3::Y, 3.0 * Vec3::Z, shade())
            .quad(Vec3::new(1.0, 0.0, 1.5), 1.5 * Vec3::Y, 3.0 * Vec3::Z, shade())
    };
    let with_image = look(frame_of_hole(lamp(lamp(floor(), 0.0), 2.0)));
    let settings = settings(Integrator::Path, 256, 0);
    let (a, b) = (blocks(&with_mirror, &settings, 16), blocks(&with_image, &settings, 16));
    // The left half of the image: the floor on the lamp's side, away from mirror and hole. Its blocks
    // together, because a caustic is found too rarely for the error of a single one to be known.
    let left = |blocks: &[(f64, f64)]| -> Vec<(f64, f64)> {
        let left = || blocks[..16].iter().enumerate().filter(|(i, _)| i % 4 < 2).map(|(_, b)| *b);
        vec![(left().map(|b| b.0).sum(), left().map(|b| b.1 * b.1).sum::<f64>().sqrt())]
    };
    agree(&left(&a), &left(&b));
    let without = left(&blocks(&look(lamp(floor(), 0.0)), &settings, 4));
    assert!(left(&a)[0].0 > 1.05 * without[0].0, "the caustic has to matter: {a:?} and {without:?}");
}

#[test]
fn an_emitter_that_is_partly_there_shines_in_part() {
    // Opacity 0.25 on an otherwise black light: a quarter of its light, seen directly and indirectly.
    let part = view(lamp(room(), 1, 12.0));
    let mut materials = part.materials.to_vec();
    let lamp_material = materials.last_mut().expect("the lamp");
    lamp_material.opacity = 0.25;
    lamp_material.surface = lambert(0.0);
    let part = Frame { materials: materials.into(), ..part };
    let mut dim = view(lamp(room(), 1, 3.0));
    let mut materials = dim.materials.to_vec();
    materials.last_mut().expect("the lamp").surface = lambert(0.0);
    dim.materials = materials.into();
    // The ceiling behind the lamp is seen through it: look elsewhere.
    let settings = settings(Integrator::Path, 64, 0);
    let (a, b) = (blocks(&part, &settings, 16), blocks(&dim, &settings, 16));
    agree(&a[8..16], &b[8..16]);
}

#[test]
fn extreme_lights_and_lights_without_area_leave_no_trace_of_infinity() {
    for radiance in [1e-30f32, 1e-20, 1.0, 1e20, 1e30] {
        let mut frame = view(lamp(room(), 1, radiance));
        let intensity = Vec3::splat(radiance);
        frame.points.push(PointLight { position: Vec3::new(0.3, 0.3, 0.3), intensity, cone: None });
        frame.points.push(PointLight { position: Vec3::ZERO, intensity: Vec3::ZERO, cone: None });
        let image = render(&frame, &settings(Integrator::Path, 16, 2));
        let finite = image.pixels.iter().flat_map(|p| p.color).all(|c| c.is_finite() && c >= 0.0);
        assert!(finite, "radiance {radiance}");
        let relative = mean(&image) / f64::from(radiance);
        assert!((0.05..5.0).contains(&relative), "radiance {radiance}: {relative} times as much");
    }
    // Emitting slivers, points and denormal specks contribute only light of the order of their size.
    let speck = |s: Builder, u: Vec3, v: Vec3| {
        s.quad(Vec3::new(0.2, 0.1, 0.3), u, v, material("speck", lambert(0.5), 1e12))
    };
    let mut scene = lamp(room(), 1, 1.0);
    for (u, v) in [
        (Vec3::ZERO, Vec3::ZERO),
        (Vec3::X, 2.0 * Vec3::X),
        (1e-30 * Vec3::X, 1e-30 * Vec3::Y),
        (1e-22 * Vec3::X, 1e-22 * Vec3::Y),
    ] {
        scene = speck(scene, u, v);
    }
    let image = render(&view(scene), &settings(Integrator::Path, 16, 2));
    let plain = render(&view(lamp(room(), 1, 1.0)), &settings(Integrator::Path, 16, 2));
    assert!(image.pixels.iter().flat_map(|p| p.color).all(f32::is_finite));
    let (a, b) = (mean(&image), mean(&plain));
    assert!((a / b - 1.0).abs() < 0.05, "{a} with the specks, {b} without");
}

#[test]
fn a_million_lights_without_area_cost_nothing() {
    let plain = view(lamp(room(), 1, 1.0));
    let mut geometry = (*plain.geometry).clone();
    let (lamp, stratum) =
        (*geometry.triangles.last().expect("the lamp"), geometry.triangle_stratum.len() - 1);
    let stratum = geometry.triangle_stratum[stratum];
    let frame_of = |geometry| Frame { geometry: std::sync::Arc::new(geometry), ..plain.clone() };
    let settings = settings(Integrator::Path, 4, 1);
    let before = render(&frame_of(geometry.clone()), &settings);
    for _ in 0..1_000_000 {
        geometry.triangles.push([lamp[0]; 3]);
        geometry.triangle_stratum.push(stratum);
    }
    // The same tree over the surfaces, so that only the lights could differ.
    let bvh = Tracer::new(&plain, &settings).bvh().clone();
    let tracer = Tracer::with_bvh(&frame_of(geometry), &settings, bvh);
    let after = tracer.render(None, &|_| {}, &AtomicBool::new(false)).expect("nobody cancels");
    let bits = |image: &Image| -> Vec<_> { image.pixels.iter().map(|p| (p.color, p.rays, p.work)).collect() };
    assert_eq!(bits(&before), bits(&after));
}

/// Everything at once.
fn everything() -> Frame {
    let color = Color::plain(Vec3::new(0.9, 0.8, 0.7));
    let scene = lamp(room(), 3, 8.0)
        .sphere(
            Vec3::new(-0.4, 0.5, -0.3),
            0.3,
            material("plastic", Surface::Plastic { albedo: color, ior: 1.5, alpha: 0.1 }, 0.0),
        )
        .sphere(
            Vec3::new(0.35, 0.0, 0.2),
            0.3,
            material(
                "glass",
                Surface::Glass { ior: 1.5, transmittance: color, alpha: 0.0, priority: None },
                0.0,
            ),
        )
        .quad(
            Vec3::new(-0.2, -1.0, 0.8),
            Vec3::X,
            Vec3::Y,
            material("pane", Surface::ThinGlass { ior: 1.5, transmittance: color }, 0.0),
        );
    let mut frame = view(scene);
    sky(&mut frame);
    frame.suns.push(Sun { direction: Vec3::Z, irradiance: Vec3::ONE, angle_deg: 1.0 });
    frame
}

#[test]
fn threads_and_larger_kernels_leave_the_bits_as_they_are() {
    let settings = settings(Integrator::Path, 8, 3);
    let bits = |image: Image| -> Vec<_> {
        image.pixels.iter().map(|p| (p.color.map(f32::to_bits), p.rays, p.work)).collect()
    };
    let with_threads = |threads, all: bool, frame: &Frame| {
        let tracer = Tracer::new(frame, &settings);
        let effects = tracer.effects().with_all();
        let tracer = if all { tracer.with_kernel_for(effects) } else { tracer };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        bits(pool.install(|| tracer.render(None, &|_| {}, &AtomicBool::new(false))).expect("nobody cancels"))
    };
    let one = with_threads(1, false, &everything());
    let rays: Vec<u32> = (0..7).map(|c| one.iter().map(|p| p.1[c]).sum()).collect();
    assert!(rays.iter().all(|&r| r > 0), "every kind of ray must be exercised: {rays:?}");
    assert_eq!(one, with_threads(3, false, &everything()));
    assert_eq!(one, with_threads(2, true, &everything()));
    let plain = view(lamp(room(), 1, 12.0));
    assert_eq!(with_threads(1, false, &plain), with_threads(1, true, &plain));
}
