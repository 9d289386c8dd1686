//! Energy balance, closed forms, lights in difficult places, extreme radiance.

use forelight_scene::{Environment, Surface};
use forelight_tests::case::case;
use forelight_tests::statistics::Moments;
use forelight_tests::world::{
    View, World, grey, icosphere, lambert, material, mean, render, unsound, values,
};
use forelight_tracer::{Pixel, Settings};
use glam::DVec3;
use std::f64::consts::PI;

fn settings(size: u32, spp: u32) -> Settings {
    Settings { width: size, height: size, spp, ambient_bounces: 0, ..Settings::default() }
}

/// Albedo of the floor where irradiance is measured.
const ALBEDO: f32 = 0.5;

/// Irradiance at the origin of a horizontal plane that faces up, and its standard error. The camera looks
/// straight at the point.
fn irradiance(world: &World, eye: DVec3, settings: &Settings) -> (f64, f64) {
    let world = world.clone().floor(DVec3::ZERO, 50.0, material(lambert(ALBEDO), 0.0));
    let image = render(&world.frame(View::new(eye, DVec3::ZERO, 0.0)), settings);
    assert_eq!(unsound(&image), 0);
    let mut moments = Moments::default();
    values(&image).into_iter().for_each(|v| moments.add(v * PI / f64::from(ALBEDO)));
    let sample = moments.sample();
    (sample.mean, sample.variance.sqrt())
}

/// Deviation beyond five standard errors.
fn beyond(deviation: f64, error: f64) -> f64 {
    (deviation.abs() - 5.0 * error).max(0.0)
}

/// Lambert's formula: irradiance at the origin with normal y from a polygon of radiance 1 that is wholly
/// above the plane, ½ |Σ γᵢ Γᵢ · n| over its edges.
fn lambert_polygon(corners: &[DVec3]) -> f64 {
    let unit: Vec<DVec3> = corners.iter().map(|c| c.normalize()).collect();
    let sum: f64 = (0..unit.len())
        .map(|i| {
            let (a, b) = (unit[i], unit[(i + 1) % unit.len()]);
            let normal = a.cross(b);
            // atan2 keeps the digits of small angles that acos would lose.
            normal.length().atan2(a.dot(b)) * normal.normalize_or_zero().y
        })
        .sum();
    sum.abs() / 2.0
}

/// The polygon as a light that faces the origin.
fn polygon_light(world: World, corners: &[DVec3], radiance: f32) -> World {
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    let flip = normal.dot(corners[0]) > 0.0;
    let fan = (1..corners.len() as u32 - 1).map(|i| if flip { [0, i + 1, i] } else { [0, i, i + 1] });
    world.mesh(corners, &fan.collect::<Vec<_>>(), material(lambert(0.0), radiance))
}

const ASIDE: DVec3 = DVec3::new(0.6, 0.5, -0.4);

#[test]
fn polygon_lights_give_lamberts_irradiance() {
    let disc = |centre: DVec3, radius: f64, n: u32| -> Vec<DVec3> {
        let corner = |i: u32| {
            let (s, c) = (f64::from(i) / f64::from(n) * 2.0 * PI).sin_cos();
            centre + radius * DVec3::new(c, 0.0, s)
        };
        (0..n).map(corner).collect()
    };
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let turned = [DVec3::new(0.1, 2.0, -1.0), DVec3::new(1.3, 1.1, -2.0), DVec3::new(-0.7, 3.0, 0.9)];
    let lights: [(&str, Vec<DVec3>); 5] = [
        ("a disc of 256 corners overhead", disc(2.0 * y, 1.0, 256)),
        ("a disc of 64 corners aside", disc(2.0 * y + 3.0 * x, 1.5, 64)),
        ("a wall from the floor up", vec![x - z, x + z, x + z + 1.5 * y, x - z + 1.5 * y]),
        ("a leaning triangle", turned.to_vec()),
        (
            "a rectangle at a grazing angle",
            vec![5.0 * x + 0.1 * y, 9.0 * x + 0.1 * y, 9.0 * x + 0.1 * y + z, 5.0 * x + 0.1 * y + z],
        ),
    ];
    let mut worst = 0.0f64;
    for (name, corners) in lights {
        let expected = 7.0 * lambert_polygon(&corners);
        let (value, error) =
            irradiance(&polygon_light(World::default(), &corners, 7.0), ASIDE, &settings(8, 1024));
        println!("         {name}: {value:.6} ± {error:.6} against {expected:.6}");
        // Positions and products are f32: 1e-6 of the value is rounding.
        worst = worst.max((value - expected).abs() / error.max(1e-6 * expected));
    }
    // In 99.9997 % of runs none of five values is off by 5 standard errors. With 64 pixels, Student's tails
    // are close to normal.
    case(6, "polygon lights give Lambert's irradiance, in standard errors").worst(worst, 5.0);
}

#[test]
fn parallel_discs_and_perpendicular_rectangles_have_their_form_factors() {
    // From a point of the floor to a coaxial disc of radius r at height h: r² / (r² + h²). The polygon of 512
    // corners is smaller than the disc by 1 − sin(2π/n) n/2π = 2.5e-5.
    let disc: Vec<DVec3> = (0..512)
        .map(|i| {
            let (s, c) = (f64::from(i) / 512.0 * 2.0 * PI).sin_cos();
            DVec3::new(1.2 * c, 2.0, 1.2 * s)
        })
        .collect();
    let by_formula = PI * 1.44 / (1.44 + 4.0);
    case(6, "Lambert's formula over 512 corners against a disc's closed form, relative")
        .worst((lambert_polygon(&disc) / by_formula - 1.0).abs(), 5e-5);
    let (value, error) = irradiance(&polygon_light(World::default(), &disc, 1.0), ASIDE, &settings(8, 1024));
    case(6, "point to coaxial disc, F = r²/(r²+h²), relative error beyond 5 standard errors")
        .worst(beyond(value / by_formula - 1.0, error / by_formula), 5e-5);
    // From a point at distance c before the middle of a rectangle, a high and b wide, that stands on its
    // plane (Howell B-4, twice a corner). With X = a/(b/2) and Y = c/(b/2): E = L
    // [atan(1/Y) − Y/√(X²+Y²) atan(1/√(X²+Y²))].
    let (a, b, c) = (1.5, 2.0, 1.0);
    let (px, py) = (a / (b / 2.0), c / (b / 2.0));
    let r = f64::hypot(px, py);
    let by_formula = (1.0 / py).atan() - py / r * (1.0 / r).atan();
    let wall = [
        DVec3::new(c, 0.0, -b / 2.0),
        DVec3::new(c, 0.0, b / 2.0),
        DVec3::new(c, a, b / 2.0),
        DVec3::new(c, a, -b / 2.0),
    ];
    case(6, "Lambert's formula against the closed form of a perpendicular rectangle, relative")
        .worst((lambert_polygon(&wall) / by_formula - 1.0).abs(), 1e-10);
    let (value, error) = irradiance(&polygon_light(World::default(), &wall, 1.0), ASIDE, &settings(8, 1024));
    case(6, "point to perpendicular rectangle, relative error beyond 5 standard errors")
        .worst(beyond(value / by_formula - 1.0, error / by_formula), 1e-6);
}

#[test]
fn a_sphere_light_gives_the_irradiance_of_its_disc() {
    // E = π L (R/d)² cos θ while the whole sphere is above the plane.
    let mut worst = 0.0f64;
    let spheres = [
        (DVec3::new(0.0, 3.0, 0.0), 1.0),
        (DVec3::new(4.0, 2.0, 1.0), 0.5),
        (DVec3::new(1.0, 0.6, 0.0), 0.3),
    ];
    for (centre, radius) in spheres {
        let (directions, triangles) = icosphere(4);
        let positions: Vec<DVec3> = directions.iter().map(|&d| centre + radius * d).collect();
        let world = World::default().mesh(&positions, &triangles, material(lambert(0.0), 5.0));
        let (value, error) = irradiance(&world, ASIDE, &settings(8, 1024));
        let expected = PI * 5.0 * (radius / centre.length()).powi(2) * centre.y / centre.length();
        worst = worst.max(beyond(value / expected - 1.0, error / expected));
    }
    // 5120 triangles with corners on the sphere. Edges of 0.07 R lie 0.07²/8 = 6e-4 inside at most, so the
    // silhouette is smaller by less than twice that.
    case(6, "sphere lights give π L (R/d)² cos θ, relative error beyond 5 standard errors")
        .worst(worst, 1.2e-3);
}

#[test]
fn a_constant_and_a_sampled_sky_light_a_plane_alike() {
    use forelight_scene::{Texels, Texture, TextureId};
    // Radiance 1 + y/2 on the upper half: E = π (1 + ½ · 2/3).
    let (width, height) = (256u32, 128u32);
    let texel = |i: u32| {
        let theta = (f64::from(i / width) + 0.5) / f64::from(height) * PI;
        [(1.0 + theta.cos().max(-1.0) / 2.0) as f32; 3]
    };
    let texels = Texels::Linear((0..width * height).map(texel).collect());
    let mut world = World::default();
    world.textures.push(Texture { name: "sky".into(), width, height, texels });
    world.environment = Environment::Image { texture: TextureId(0), scale: 1.0, rotation_deg: 33.0 };
    let (value, error) = irradiance(&world, ASIDE, &settings(8, 1024));
    let expected = PI * (1.0 + 1.0 / 3.0);
    // Bilinear lookup over rows of 1.4°: an eighth of the second difference of cos θ / 2, which is 3e-4.
    case(6, "a sky of radiance 1 + y/2 gives 4π/3, relative error beyond 5 standard errors")
        .worst(beyond(value / expected - 1.0, error / expected), 1e-4);
    let (value, _) = irradiance(&World::under(1.0), ASIDE, &settings(4, 64));
    case(6, "a constant sky gives π, relative error").worst((value / PI - 1.0).abs(), 1e-6);
}

/// Half the width of the lamp of the room below.
const LAMP: f64 = 0.25 * 0.999;

/// Power that arrives on the six walls of a room −1 … 1, and on the lamp below its ceiling. Each is seen
/// squarely from the middle, so that all pixels see equal areas. `walls` are the albedos: −x, +x, −y, +y, −z,
/// +z.
fn arriving(walls: [f32; 6], bounces: u32, seed: u64) -> [f64; 7] {
    let lamp_albedo = 0.5f32;
    let mut world = World::default();
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    for (i, &albedo) in walls.iter().enumerate() {
        let normal = axes[i / 2] * if i % 2 == 0 { 1.0 } else { -1.0 };
        let u = axes[(i / 2 + 1) % 3];
        let v = normal.cross(u);
        world = world.quad(-normal - u - v, 2.0 * u, 2.0 * v, material(lambert(albedo), 0.0));
    }
    // Its edges lie on edges of pixels, so no pixel shows both lamp and ceiling.
    let world = world.ceiling(DVec3::new(0.0, 0.999, 0.0), LAMP, material(lambert(lamp_albedo), 3.0));
    let mut power = [0.0; 7];
    for wall in 0..6 {
        let outward = axes[wall / 2] * if wall % 2 == 0 { -1.0 } else { 1.0 };
        let mut frame = world.frame(View::new(DVec3::ZERO, outward, 1.0));
        // The image's edges along the wall's.
        let right = axes[(wall / 2 + 1) % 3];
        frame.camera.right = right.as_vec3();
        frame.camera.up = right.cross(outward).as_vec3();
        let settings = Settings { ambient_bounces: bounces, ambient_divisions: 16, seed, ..settings(16, 16) };
        let image = render(&frame, &settings);
        assert_eq!(unsound(&image), 0);
        let area = 4.0 / image.pixels.len() as f64;
        for Pixel { color, stratum, .. } in &image.pixels {
            // The lamp is nearer by a thousandth, and appears larger by that.
            let (index, albedo, own, nearer) =
                if *stratum == 6 { (6, lamp_albedo, 3.0, 0.999f64) } else { (wall, walls[wall], 0.0, 1.0) };
            power[index] += (f64::from(color[0]) - own) * PI / f64::from(albedo) * area * nearer * nearer;
        }
    }
    power
}

#[test]
fn in_a_closed_room_what_arrives_is_what_is_emitted_and_reflected() {
    let emitted = PI * 3.0 * (2.0 * LAMP).powi(2);
    // The wall of albedo 0.001 acts as an opening.
    for (name, walls) in [("grey", [0.5f32; 6]), ("with an opening", [0.001, 0.2, 0.8, 0.4, 0.6, 0.7])] {
        let mut worst = 0.0f64;
        for bounces in 0..3 {
            // Arriving power after b bounces is emission plus reflection of what arrives after b − 1.
            let mut moments = Moments::default();
            for seed in 0..6 {
                let arrived: f64 = arriving(walls, bounces, seed).iter().sum();
                let reflected: f64 = if bounces == 0 {
                    0.0
                } else {
                    let before = arriving(walls, bounces - 1, seed + 100);
                    before.iter().zip(walls.iter().chain([&0.5])).map(|(p, &a)| p * f64::from(a)).sum()
                };
                moments.add((arrived - reflected) / emitted - 1.0);
            }
            let sample = moments.sample();
            println!(
                "         {name}, {bounces} bounces: {:+.5} ± {:.5}",
                sample.mean,
                sample.variance.sqrt()
            );
            // Student's t of 5 degrees at 1e-4 is 9.7. The slit behind the lamp absorbs a thousandth.
            worst = worst.max(sample.mean.abs() - 9.7 * sample.variance.sqrt());
        }
        case(3, format!("a room {name}: arriving = emitted + reflected, relative, beyond t(1e-4)"))
            .worst(worst, 1e-3);
    }
}

#[test]
fn lights_without_area_emit_nothing_and_are_not_sampled() {
    let scene = |dead: bool| {
        let world = World::default().floor(DVec3::ZERO, 2.0, material(lambert(0.5), 0.0)).ceiling(
            DVec3::new(0.0, 1.0, 0.0),
            0.2,
            material(lambert(0.0), 5.0),
        );
        if !dead {
            return world;
        }
        // Halves and eighths, so that the midpoint is on the line in f32 as well.
        let (a, b) = (DVec3::new(0.125, 0.5, 0.125), DVec3::new(0.375, 0.5, 0.25));
        let flat = [[0, 1, 2], [0, 0, 1], [2, 1, 0]];
        world
            .mesh(&[a, b, a.midpoint(b)], &flat, material(lambert(0.0), 1e6))
            .mesh(&[a, a, a], &[[0, 1, 2]], material(lambert(0.0), 1e12))
            // An area of 1e-60 m² is zero in f32.
            .quad(DVec3::new(0.0, 0.5, 0.0), DVec3::X * 1e-30, DVec3::Z * 1e-30, material(lambert(0.0), 1e12))
    };
    let view = View::new(DVec3::new(0.0, 0.8, 1.5), DVec3::ZERO, 0.6);
    let (alive, dead) = (
        render(&scene(false).frame(view), &settings(16, 4)),
        render(&scene(true).frame(view), &settings(16, 4)),
    );
    let same = |(a, b): (&Pixel, &Pixel)| a.color == b.color && a.rays == b.rays;
    let differing = alive.pixels.iter().zip(&dead.pixels).filter(|&pair| !same(pair)).count() as u64;
    case(16, "pixels that a light without area changes, in colour or rays").never(differing, 256);
}

#[test]
fn a_tiny_light_of_enormous_radiance_is_a_point_light() {
    // 10⁻⁶ m wide and 10¹² W/(sr m²): an intensity of 1 W/sr.
    let mut worst = 0.0f64;
    for (size, radiance) in [(1e-2f64, 1e4f32), (1e-4, 1e8), (1e-6, 1e12)] {
        let world =
            World::default().ceiling(DVec3::new(0.0, 2.0, 0.0), size / 2.0, material(lambert(0.0), radiance));
        let (value, _) = irradiance(&world, ASIDE, &settings(4, 16));
        let expected = f64::from(radiance) * size * size / 4.0;
        worst = worst.max((value / expected - 1.0).abs());
    }
    // The largest light (1 : 200) deviates from a point by (size/d)² = 2.5e-5. At 2 m, f32 places corners of
    // a micrometre to 6 %, so the light is at (0, 2, 0), where x and z are exact.
    case(16, "tiny lights of up to 10¹² radiance give I cos θ / d², relative error").worst(worst, 1e-4);
}

#[test]
fn a_hundred_thousand_lights_give_the_sum_of_all_and_none_gives_all() {
    // Lamps of very different power in a ring of one radius and height. Each contributes in proportion to its
    // power.
    let lights = 100_000u32;
    let mut world = World::default();
    let mut total = 0.0f64;
    for i in 0..lights {
        let (s, c) = (f64::from(i) * 2.399_963).sin_cos();
        let radiance = if i % 1000 == 7 { 300.0f32 } else { 1.0 + (i % 7) as f32 };
        let centre = DVec3::new(3.0 * c, 2.0, 3.0 * s);
        world = world.ceiling(centre, 5e-4, material(lambert(0.0), radiance));
        total += f64::from(radiance);
    }
    let expected = total * 1e-6 * 4.0 / 13.0 / 13.0;
    let (value, error) = irradiance(&world, ASIDE, &settings(4, 64));
    // Lamps are chosen by power, so every choice has the same weight. Shares of 1e-6 are differences of f32
    // near 1, good to 6 %, but drawing and weighting use the same ones. The square's extent adds 1e-7.
    case(16, "100,000 lights give the sum of all, relative error beyond 5 standard errors")
        .worst(beyond(value / expected - 1.0, error / expected), 1e-3);
}

#[test]
fn a_black_light_is_never_chosen() {
    // Nine lamps, so that they are drawn by power, with a thousand black ones between them.
    let scene = |black: bool| {
        let mut world = World::default().floor(DVec3::ZERO, 2.0, material(lambert(0.5), 0.0));
        for i in 0..9 {
            let x = f64::from(i) * 0.3 - 1.2;
            world = world.ceiling(DVec3::new(x, 1.0, 0.0), 0.1, material(lambert(0.0), 5.0));
        }
        if black {
            for i in 0..1000 {
                let place = DVec3::new(f64::from(i) * 0.01 - 5.0, 40.0, 0.0);
                world = world.ceiling(place, 0.004, material(lambert(0.0), 0.0));
            }
        }
        world
    };
    let view = View::new(DVec3::new(0.0, 0.8, 1.5), DVec3::ZERO, 0.6);
    let image = |black| render(&scene(black).frame(view), &settings(16, 4));
    let (without, with) = (image(false), image(true));
    let pairs = without.pixels.iter().zip(&with.pixels);
    let differing = pairs.filter(|(a, b)| a.color != b.color || a.rays != b.rays).count() as u64;
    case(16, "pixels that a thousand black lights change").never(differing, 256);
}

#[test]
fn lights_that_touch_a_surface_or_stand_behind_it_stay_finite() {
    let white = || material(lambert(0.8), 0.0);
    let floor = |world: World| world.floor(DVec3::ZERO, 2.0, white());
    let lamp = || material(lambert(0.0), 10.0);
    let touching = floor(World::default())
        // Standing on the floor, lying in it, crossing it, and below it.
        .quad(DVec3::new(-0.5, 0.0, 0.0), DVec3::X, DVec3::Y * 0.5, lamp())
        .floor(DVec3::new(0.0, 0.0, 0.5), 0.1, lamp())
        .quad(DVec3::new(-0.5, -0.3, -0.4), DVec3::X, DVec3::Y * 0.5, lamp())
        .floor(DVec3::new(0.0, -1.0, 0.0), 0.5, lamp());
    let mut close = floor(World::default());
    for height in [0.0, 1e-30, 1e-15, 1e-6, 1e-3] {
        close.points.push((DVec3::new(0.3 * height, height, 0.2), 1.0));
    }
    let view = View::new(DVec3::new(0.2, 1.0, 1.5), DVec3::ZERO, 0.7);
    let shiny = Surface::Plastic { albedo: grey(0.8), ior: 1.5, alpha: 0.05 };
    let glossy = touching.clone().floor(DVec3::new(0.0, 1e-4, 0.0), 0.4, material(shiny, 0.0));
    let (mut wrong, mut pixels) = (0, 0);
    for world in [&touching, &close, &glossy] {
        for bounces in [0, 1] {
            let image =
                render(&world.frame(view), &Settings { ambient_bounces: bounces, ..settings(48, 16) });
            wrong += unsound(&image);
            pixels += 48 * 48;
        }
    }
    case(16, "pixels near lights in, on, across and under a surface that are no finite number")
        .never(wrong, pixels);
    // A light of radiance 10 above a white floor: E ≤ π L, times albedo / π.
    let image = render(&touching.frame(view), &settings(48, 64));
    let brightest = values(&image).into_iter().fold(0.0, f64::max);
    case(16, "brightest pixel beside lights of radiance 10 that touch a floor of albedo 0.8")
        .worst(brightest, 10.0 * 1.05);
    let behind = floor(World::default()).floor(DVec3::new(0.0, -1.0, 0.0), 0.5, lamp());
    let lit =
        values(&render(&behind.frame(view), &settings(16, 16))).iter().filter(|&&v| v > 0.0).count() as u64;
    case(16, "pixels lit by a light behind the floor").never(lit, 256);
}

/// A room with everything in it and its lights times `factor`.
fn lit(factor: f32) -> World {
    let mut world = World::under(0.1 * factor)
        .floor(DVec3::ZERO, 3.0, material(lambert(0.6), 0.0))
        .cuboid(DVec3::new(-1.0, 0.0, -1.0), DVec3::new(-0.4, 0.8, -0.2), false, material(lambert(0.3), 0.0))
        .sphere(
            DVec3::new(0.4, 0.4, 0.0),
            0.4,
            4,
            material(Surface::Metal { f0: grey(0.8), alpha: 0.2 }, 0.0),
        )
        .sphere(
            DVec3::new(-0.2, 0.3, 0.7),
            0.3,
            4,
            material(Surface::Glass { ior: 1.5, transmittance: grey(0.9), alpha: 0.0, priority: None }, 0.0),
        )
        .ceiling(DVec3::new(0.0, 2.5, 0.0), 0.5, material(lambert(0.0), 4.0 * factor));
    world.points.push((DVec3::new(1.5, 1.5, 1.0), 2.0 * factor));
    world.suns.push((DVec3::new(0.3, 1.0, 0.2), factor, 1.0));
    world
}

const AT_THE_ROOM: View =
    View { eye: DVec3::new(0.3, 1.2, 3.0), target: DVec3::new(0.0, 0.4, 0.0), tan_half: 0.5 };

#[test]
fn an_image_is_linear_in_its_lights_to_the_bit_from_1e_minus_30_to_1e30() {
    let settings = Settings { ambient_bounces: 1, ambient_divisions: 8, ..settings(24, 4) };
    let base = render(&lit(1.0).frame(AT_THE_ROOM), &settings);
    let (mut wrong, mut pixels) = (0, 0);
    // Powers of two near 1e-30, 1e-10, 1e10 and 1e30.
    for power in [-100, -33, 33, 100] {
        let factor = 2f32.powi(power);
        let image = render(&lit(factor).frame(AT_THE_ROOM), &settings);
        for (a, b) in base.pixels.iter().zip(&image.pixels) {
            // Exact without underflow. At 2⁻¹⁰⁰, contributions below 2⁻²⁶ of a pixel of 1 are denormal.
            let same = a.color.map(|c| c * factor) == b.color && a.rays == b.rays && a.work == b.work;
            wrong += u64::from(!same);
            pixels += 1;
        }
    }
    case(17, "pixels that are not linear in light, 2⁻¹⁰⁰ to 2¹⁰⁰, to the bit").never(wrong, pixels);
}

#[test]
fn black_empty_and_absorbing_scenes_are_black() {
    let unlit = lit(0.0);
    let absorbing = World::default()
        .cuboid(DVec3::splat(-1.0), DVec3::ONE, true, material(lambert(0.0), 0.0))
        .ceiling(DVec3::new(0.0, 0.9, 0.0), 0.3, material(lambert(0.0), 5.0));
    let settings = Settings { ambient_bounces: 2, ambient_divisions: 8, ..settings(16, 4) };
    let dark = |world: &World, view| {
        let image = render(&world.frame(view), &settings);
        image.pixels.iter().filter(|p| p.color != [0.0; 3]).count() as u64
    };
    let below = View::new(DVec3::ZERO, DVec3::new(0.1, -1.0, 0.2), 0.5);
    let lost = dark(&unlit, AT_THE_ROOM) + dark(&World::default(), AT_THE_ROOM) + dark(&absorbing, below);
    case(17, "pixels of an unlit, an empty and an absorbing scene that are not exactly black")
        .never(lost, 768);
    // An empty scene shows the sky.
    let image = render(&World::under(0.25).frame(AT_THE_ROOM), &settings);
    case(17, "an empty scene under a sky of 0.25").worst((mean(&image) - 0.25).abs(), 0.0);
}

#[test]
fn radiance_near_the_largest_number_stays_finite_or_clips_to_infinity_but_is_never_nan() {
    let (mut nan, mut pixels) = (0, 0);
    for factor in [1e-38f32, 1e-44, 1e36, 5e37] {
        let image = render(&lit(factor).frame(AT_THE_ROOM), &settings(24, 4));
        nan += image.pixels.iter().filter(|p| p.color.iter().any(|c| c.is_nan() || *c < 0.0)).count() as u64;
        pixels += 24 * 24;
    }
    case(17, "pixels that are NaN or negative under lights of 1e-44 to 5e37").never(nan, pixels);
}
