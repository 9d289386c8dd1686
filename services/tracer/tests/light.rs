//! Light transport against closed forms.

mod support;

use forelight_protocol::Integrator;
use forelight_scene::{Color, Environment, Frame, PointLight, Sun, Surface, Texels, Texture, TextureId};
use forelight_tracer::{Image, Settings, Tracer};
use glam::Vec3;
use std::sync::atomic::AtomicBool;
use support::{Builder, lambert, material};

fn settings(spp: u32, ambient_bounces: u32) -> Settings {
    Settings { width: 16, height: 16, spp, ambient_bounces, ambient_divisions: 16, ..Settings::default() }
}

fn render(frame: &Frame, settings: &Settings) -> Image {
    Tracer::new(frame, settings).render(None, &|_| {}, &AtomicBool::new(false)).expect("nobody cancels")
}

fn mean(image: &Image) -> f64 {
    image.pixels.iter().map(|p| f64::from(p.color[0])).sum::<f64>() / image.pixels.len() as f64
}

const WHITE_SKY: Environment = Environment::Constant(Vec3::ONE);

/// Fills the view with a sphere, in a furnace: constant light from everywhere.
fn furnace(surface: Surface, depth: u32) -> f64 {
    let frame = Builder::default().sphere(Vec3::ZERO, 1.0, material("ball", surface, 0.0)).frame(
        Vec3::new(0.0, 0.0, 3.0),
        Vec3::ZERO,
        16,
        WHITE_SKY,
    );
    mean(&render(&frame, &Settings { max_depth: depth, ..settings(64, 0) }))
}

#[test]
fn a_white_lambert_sphere_in_a_furnace_disappears() {
    let value = furnace(lambert(1.0), 4);
    assert!((value - 1.0).abs() < 2e-3, "{value}");
}

#[test]
fn a_perfect_mirror_in_a_furnace_disappears() {
    // A flat light: on a tessellated smooth sphere, a few rays at the silhouette are mirrored into it.
    let mirror = Surface::Metal { f0: Color::plain(Vec3::ONE), alpha: 0.0 };
    let frame = Builder::default()
        .cuboid(Vec3::splat(-1.0), Vec3::ONE, false, material("mirror", mirror, 0.0))
        .frame(Vec3::new(1.0, 2.0, 4.0), Vec3::ZERO, 16, WHITE_SKY);
    let value = mean(&render(&frame, &settings(64, 0)));
    assert!((value - 1.0).abs() < 1e-6, "{value}");
}

#[test]
fn clear_glass_in_a_furnace_disappears() {
    let glass =
        Surface::Glass { ior: 1.5, transmittance: Color::plain(Vec3::ONE), alpha: 0.0, priority: None };
    let value = furnace(glass, 64);
    assert!((value - 1.0).abs() < 5e-3, "{value}");
}

#[test]
fn a_pane_in_a_furnace_disappears() {
    let pane = Surface::ThinGlass { ior: 1.5, transmittance: Color::plain(Vec3::ONE) };
    let value = furnace(pane, 64);
    assert!((value - 1.0).abs() < 1e-4, "{value}");
}

#[test]
fn rough_metal_in_a_furnace_loses_only_what_single_scattering_loses() {
    // White conductor, alpha 0.5: it reflects 0.7004 ± 0.001 of the light on a sphere, by Monte Carlo
    // quadrature of D G₂ / (4 μᵢ μₒ) in another program. The sphere's silhouette of radius 1/√8 covers π/8 of
    // the image of side 1.
    let value = furnace(Surface::Metal { f0: Color::plain(Vec3::ONE), alpha: 0.5 }, 4);
    let on_sphere = 1.0 - (1.0 - value) / (std::f64::consts::PI / 8.0);
    assert!((on_sphere - 0.7004).abs() < 0.01, "{on_sphere}");
    let smoother = furnace(Surface::Metal { f0: Color::plain(Vec3::ONE), alpha: 0.1 }, 4);
    assert!(smoother <= 1.0 + 1e-3 && smoother > value, "{smoother}");
}

#[test]
fn plastic_never_reflects_more_than_arrives() {
    for alpha in [0.0, 0.1, 0.5] {
        let albedo = Color::plain(Vec3::ONE);
        let value = furnace(Surface::Plastic { albedo, ior: 1.5, alpha }, 4);
        assert!(value < 1.01 && value > 0.9, "alpha {alpha}: {value}");
    }
}

#[test]
fn a_closed_emitting_room_sums_the_truncated_series() {
    // Albedo ρ, emission 1, everywhere: the camera sees 1, direct light adds ρ, each bounce another factor ρ.
    let rho = 0.6f64;
    for bounces in 0..3 {
        let frame = Builder::default()
            .cuboid(Vec3::splat(-1.0), Vec3::ONE, true, material("room", lambert(0.6), 1.0))
            .frame(Vec3::new(0.1, 0.2, 0.3), Vec3::ZERO, 16, Environment::Black);
        let image = render(&frame, &Settings { ambient_divisions: 64, ..settings(64, bounces) });
        let expected: f64 = (0..=bounces as i32 + 1).map(|i| rho.powi(i)).sum();
        let value = mean(&image);
        assert!((value / expected - 1.0).abs() < 5e-3, "{bounces} bounces: {value} against {expected}");
    }
}

/// A floor seen from above, so that every pixel sees nearly the same point.
fn floor_under(frame: impl FnOnce(Builder) -> Builder) -> Frame {
    let floor = Builder::default().quad(
        Vec3::new(-50.0, 0.0, 50.0),
        Vec3::new(100.0, 0.0, 0.0),
        Vec3::new(0.0, 0.0, -100.0),
        material("floor", lambert(0.5), 0.0),
    );
    let mut frame =
        frame(floor).frame(Vec3::new(0.0, 2.0, 0.0), Vec3::new(0.0, 0.0, -1e-3), 16, Environment::Black);
    frame.camera.tan_half_x = 1e-3;
    frame.camera.tan_half_y = 1e-3;
    frame
}

#[test]
fn a_disc_like_quad_light_gives_the_form_factor_of_parallel_rectangles() {
    // Irradiance at a point from a parallel rectangle a × b centred at distance c over the point, radiance L:
    // 4 × the corner formula (Howell, configuration B-3): E = 4 L/2 [A/√(1+A²) atan(B/√(1+A²)) + B/√(1+B²)
    // atan(A/√(1+B²))].
    let (a, b, c) = (1.5f64, 0.8f64, 3.0f64);
    let frame = floor_under(|s| {
        s.quad(
            Vec3::new(-a as f32 / 2.0, c as f32, -b as f32 / 2.0),
            Vec3::new(a as f32, 0.0, 0.0),
            Vec3::new(0.0, 0.0, b as f32),
            material("light", lambert(0.0), 10.0),
        )
    });
    let (x, y) = (a / 2.0 / c, b / 2.0 / c);
    let part = |x: f64, y: f64| x / (1.0 + x * x).sqrt() * (y / (1.0 + x * x).sqrt()).atan();
    let irradiance = 4.0 * 10.0 / 2.0 * (part(x, y) + part(y, x));
    let expected = 0.5 / std::f64::consts::PI * irradiance;
    let value = mean(&render(&frame, &settings(256, 0)));
    assert!((value / expected - 1.0).abs() < 1e-3, "{value} against {expected}");
}

#[test]
fn the_back_of_a_one_sided_light_is_dark() {
    let frame = floor_under(|s| {
        let (u, v) = (Vec3::new(0.0, 0.0, 1.0), Vec3::new(1.0, 0.0, 0.0));
        s.quad(Vec3::new(-0.5, 1.0, -0.5), u, v, material("light", lambert(0.0), 10.0))
    });
    let up = frame.geometry.geometric_normal(2).y;
    assert!(up > 0.0, "the light must face away from the floor: {up}");
    let below = Frame {
        camera: forelight_scene::Camera { origin: Vec3::new(0.0, 0.5, 0.0), ..frame.camera },
        ..frame
    };
    assert_eq!(mean(&render(&below, &settings(16, 0))), 0.0);
}

#[test]
fn point_light_and_sun_follow_their_definitions() {
    let mut frame = floor_under(|s| s);
    frame.points.push(PointLight {
        position: Vec3::new(3.0, 4.0, 0.0),
        intensity: Vec3::splat(50.0),
        cone: None,
    });
    let expected = 0.5 / std::f64::consts::PI * 50.0 / 25.0 * 0.8;
    let value = mean(&render(&frame, &settings(4, 0)));
    assert!((value / expected - 1.0).abs() < 1e-3, "{value} against {expected}");

    for angle_deg in [0.0, 0.5, 20.0, 60.0] {
        let direction = Vec3::new(0.6, 0.8, 0.0);
        let mut frame = floor_under(|s| s);
        frame.suns.push(Sun { direction, irradiance: Vec3::splat(3.0), angle_deg });
        let expected = 0.5 / std::f64::consts::PI * 3.0 * 0.8;
        let value = mean(&render(&frame, &settings(64, 0)));
        // Irradiance is a vector: a disc wholly above the horizon counts by its centre's cosine.
        assert!((value / expected - 1.0).abs() < 2e-3, "{angle_deg}°: {value} against {expected}");
    }
}

#[test]
fn the_poles_of_a_sky_do_not_shine_into_each_other() {
    let (width, height) = (16u32, 8u32);
    for (row, lit) in [(0, 1.0), (height - 1, 0.0)] {
        let texel = |i: u32| if i / width == row { [100.0; 3] } else { [0.0; 3] };
        let texels = Texels::Linear((0..width * height).map(texel).collect());
        let mut frame = floor_under(|s| s);
        frame.textures = vec![Texture { name: "sky".into(), width, height, texels }].into();
        frame.environment = Environment::Image { texture: TextureId(0), scale: 1.0, rotation_deg: 0.0 };
        let path = Settings { integrator: Integrator::Path, ..settings(64, 0) };
        for settings in [settings(64, 1), path] {
            let value = mean(&render(&frame, &settings));
            assert_eq!(value > 0.0, lit > 0.0, "row {row}, {:?}: {value}", settings.integrator);
        }
    }
}

#[test]
fn a_pane_darkens_a_shadow_ray_by_what_it_reflects() {
    let pane = Surface::ThinGlass { ior: 1.5, transmittance: Color::plain(Vec3::splat(0.5)) };
    let mut frame = floor_under(|s| {
        let (u, v) = (Vec3::new(0.0, 0.0, 4.0), Vec3::new(4.0, 0.0, 0.0));
        s.quad(Vec3::new(-2.0, 3.0, -2.0), u, v, material("pane", pane, 0.0))
    });
    frame.points.push(PointLight {
        position: Vec3::new(0.0, 4.0, 0.0),
        intensity: Vec3::splat(16.0),
        cone: None,
    });
    // R = 0.04 at each face, all inter-reflections: 2·0.04/1.04; half of the rest is absorbed.
    let expected = 0.5 / std::f64::consts::PI * (1.0 - 2.0 * 0.04 / 1.04) * 0.5;
    let image = render(&frame, &settings(4, 0));
    let value = mean(&image);
    assert!((value / expected - 1.0).abs() < 1e-3, "{value} against {expected}");
    let rays = image.totals().rays;
    assert_eq!(rays[1], rays[2], "every shadow ray passes one pane: {rays:?}");
}

#[test]
fn partial_opacity_lets_its_share_of_light_pass_on_both_ways() {
    let mut frame = floor_under(|s| {
        let (u, v) = (Vec3::new(0.0, 0.0, 4.0), Vec3::new(4.0, 0.0, 0.0));
        s.quad(Vec3::new(-2.0, 1.0, -2.0), u, v, material("veil", lambert(0.0), 0.0))
    });
    let mut materials = frame.materials.to_vec();
    materials[1].opacity = 0.25;
    frame.materials = materials.into();
    frame.points.push(PointLight {
        position: Vec3::new(0.0, 4.0, 0.0),
        intensity: Vec3::splat(16.0),
        cone: None,
    });
    let expected = 0.5 / std::f64::consts::PI * 0.75 * 0.75;
    let value = mean(&render(&frame, &settings(256, 0)));
    assert!((value / expected - 1.0).abs() < 1e-2, "{value} against {expected}");
}
