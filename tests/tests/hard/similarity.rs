//! The same scene larger, smaller, turned and far away; and surfaces that nearly touch.

use crate::bundles::Files;
use forelight_scene::Surface;
use forelight_tests::case::case;
use forelight_tests::world::{
    Similarity, View, World, bits, grey, lambert, material, mean, render, unsound, values,
};
use forelight_tracer::{Image, Settings};
use glam::{DQuat, DVec3};

pub fn settings() -> Settings {
    Settings {
        width: 32,
        height: 32,
        spp: 8,
        ambient_bounces: 1,
        ambient_divisions: 8,
        ..Settings::default()
    }
}

/// A room of about 4 m with every kind of surface and light.
fn room() -> World {
    let plastic = Surface::Plastic { albedo: grey(0.5), ior: 1.5, alpha: 0.2 };
    let metal = Surface::Metal { f0: grey(0.7), alpha: 0.1 };
    let glass = Surface::Glass { ior: 1.5, transmittance: grey(0.95), alpha: 0.0, priority: None };
    let pane = Surface::ThinGlass { ior: 1.5, transmittance: grey(0.9) };
    let wall = |albedo| material(lambert(albedo), 0.0);
    let mut world = World::under(0.3)
        .floor(DVec3::ZERO, 2.0, wall(0.6))
        .quad(DVec3::new(-2.0, 0.0, -2.0), DVec3::X * 4.0, DVec3::Y * 2.5, wall(0.5))
        .cuboid(DVec3::new(-1.2, 0.0, -1.0), DVec3::new(-0.5, 0.9, -0.3), false, wall(0.4))
        .sphere(DVec3::new(0.5, 0.45, -0.4), 0.45, 3, material(plastic, 0.0))
        .sphere(DVec3::new(-0.1, 0.3, 0.6), 0.3, 3, material(glass, 0.0))
        .sphere(DVec3::new(1.2, 0.25, 0.5), 0.25, 3, material(metal, 0.0))
        .quad(DVec3::new(-1.5, 0.0, 0.8), DVec3::X * 0.9, DVec3::Y * 0.8, material(pane, 0.0))
        .ceiling(DVec3::new(0.3, 2.4, 0.2), 0.5, material(lambert(0.0), 6.0));
    world.points.push((DVec3::new(-1.5, 2.0, 1.0), 1.5));
    world.suns.push((DVec3::new(0.4, 1.0, 0.3), 0.8, 2.0));
    world
}

const VIEW: View = View { eye: DVec3::new(0.4, 1.3, 3.2), target: DVec3::new(0.0, 0.5, 0.0), tan_half: 0.6 };

fn at(place: &Similarity) -> Image {
    render(&room().frame_at(VIEW, place), &settings())
}

fn differing(a: &Image, b: &Image) -> u64 {
    bits(a).iter().zip(bits(b)).filter(|(a, b)| **a != *b).count() as u64
}

#[test]
fn scaled_by_powers_of_two_image_and_counters_have_the_same_bits() {
    let base = at(&Similarity::NONE);
    let powers = [-20, -10, -3, -1, 1, 3, 10, 20];
    let mut wrong = 0;
    for power in powers {
        let image = at(&Similarity::scaled(2f64.powi(power)));
        let here = differing(&base, &image);
        println!("         2^{power}: {here} of 1024 pixels differ");
        wrong += here;
    }
    // None: a power of two changes exponents alone, and nothing may depend on a length in metres.
    case(7, "pixels (colour, rays, work) that a scale of 2^-20 … 2^20 changes")
        .never(wrong, 1024 * powers.len() as u64);
}

/// Distances of two images: root mean square of pixels, difference of means in standard errors, and relative
/// difference of `cost`.
fn distance(a: &Image, b: &Image, cost: fn(&Image) -> f64) -> (f64, f64, f64) {
    let (va, vb) = (values(a), values(b));
    let n = va.len() as f64;
    let differences: Vec<f64> = va.iter().zip(&vb).map(|(x, y)| x - y).collect();
    let square = differences.iter().map(|d| d * d).sum::<f64>() / n;
    let bias = differences.iter().sum::<f64>() / n;
    let error = (square / n).sqrt().max(1e-6 * mean(a));
    (square.sqrt(), bias.abs() / error, (cost(b) / cost(a) - 1.0).abs())
}

pub fn work(image: &Image) -> f64 {
    image.totals().work as f64
}

fn rays(image: &Image) -> f64 {
    image.totals().rays.iter().sum::<u64>() as f64
}

/// The worst over images of: pixel difference relative to that of another seed, bias in standard errors,
/// cost.
pub fn compare(
    base: &Image,
    reseeded: &Image,
    images: impl IntoIterator<Item = (String, Image)>,
    count: fn(&Image) -> f64,
) -> (f64, f64, f64) {
    let noise = distance(base, reseeded, count).0;
    let mut worst = (0.0f64, 0.0f64, 0.0f64);
    for (name, image) in images {
        let (difference, bias, cost) = distance(base, &image, count);
        let broken = if unsound(&image) > 0 { f64::INFINITY } else { difference / noise };
        println!(
            "         {name}: {broken:.2} of the noise, bias {bias:.1} standard errors, cost off by {:.2} %",
            cost * 100.0
        );
        worst = (worst.0.max(broken), worst.1.max(bias), worst.2.max(cost));
    }
    worst
}

/// The room in these places.
fn rooms(places: &[(String, Similarity)], count: fn(&Image) -> f64) -> (f64, f64, f64) {
    let reseeded = render(&room().frame(VIEW), &Settings { seed: 1, ..settings() });
    let images = places.iter().map(|(name, place)| (name.clone(), at(place)));
    compare(&at(&Similarity::NONE), &reseeded, images, count)
}

pub fn judge(what: &str, (difference, bias, cost): (f64, f64, f64)) {
    // Another seed changes pixels by 1, and other rounding can do no more. A quarter of slack for the ratio
    // of two root mean squares over 1024 pixels with bright outliers.
    case(7, format!("{what}: pixels' difference in units of another seed's")).worst(difference, 1.25);
    case(7, format!("{what}: difference of the image means in standard errors")).worst(bias, 5.0);
    // The table allows 1 %.
    case(7, format!("{what}: relative difference of cost")).worst(cost, 0.01);
}

fn scales(list: &[f64]) -> Vec<(String, Similarity)> {
    list.iter().map(|&s| (format!("scale {s:e}"), Similarity::scaled(s))).collect()
}

#[test]
fn larger_scenes_look_and_cost_the_same() {
    judge("a room scaled by 10 to 10⁶", rooms(&scales(&[10.0, 1e3, 1e6]), work));
}

#[test]
fn smaller_scenes_look_and_cost_the_same() {
    judge("a room scaled by 0.1 to 10⁻⁶", rooms(&scales(&[0.1, 1e-3, 1e-6]), work));
}

#[test]
fn turned_scenes_look_and_cost_the_same() {
    let turns: Vec<(String, Similarity)> = [0.1, 1.0, 2.5]
        .into_iter()
        .map(|angle| {
            let rotation = DQuat::from_axis_angle(DVec3::new(0.3, 0.8, -0.5).normalize(), angle);
            (format!("turned by {angle}"), Similarity { rotation, ..Similarity::NONE })
        })
        .collect();
    // Boxes of a tree fit a turned room worse, so its work grows; its rays do not.
    judge("a room turned by odd angles (rays)", rooms(&turns, rays));
}

fn moved(distance: f64) -> (String, Similarity) {
    let translation = DVec3::new(0.6, -0.5, 0.6244998).normalize() * distance;
    (format!("moved by {distance:e}"), Similarity { translation, ..Similarity::NONE })
}

#[test]
fn scenes_moved_by_a_hundred_times_their_size_look_and_cost_the_same() {
    judge("a room of 4 m moved by 40 and 400 m", rooms(&[moved(40.0), moved(400.0)], work));
}

/// A closed room of side 1, far from the origin, with millimetre steps along a wall. Everything glows, so
/// without a bounce every point shows its emission and its reflection of the rest.
fn far_room(distance: f64) -> Files {
    let mut obj = String::from("mtllib scene.mtl\no room\nusemtl glow\n");
    let mut faces = String::new();
    let mut count = 0;
    let mut solid = |low: DVec3, high: DVec3, inward: bool| {
        let (positions, triangles) = forelight_tests::world::cuboid(low, high, inward);
        for p in &positions {
            let p = *p + DVec3::splat(distance);
            obj += &format!("v {} {} {}\n", p.x, p.y, p.z);
        }
        for t in &triangles {
            faces += &format!("f {} {} {}\n", count + t[0] + 1, count + t[1] + 1, count + t[2] + 1);
        }
        count += 8;
    };
    solid(DVec3::splat(-0.5), DVec3::splat(0.5), true);
    for i in 0..20 {
        let y = -0.3 + 0.02 * f64::from(i);
        solid(DVec3::new(-0.2, y, -0.499), DVec3::new(0.2, y + 0.001, -0.498), false);
    }
    let eye = distance;
    Files::default()
        .with("scene.obj", obj + &faces)
        .with("scene.mtl", "newmtl glow\nKd 0.5 0.5 0.5\nillum 1\nKe 1 1 1\n")
        .with(
            "scene.json",
            format!(
                r#"{{"version":1,"name":"far","geometry":["scene.obj"],"camera":{{"origin":[{eye},{eye},{eye}],
                "target":[{eye},{eye},{}],"up":[0,1,0],"fov_deg":90,"fov_axis":"x","width":24,"height":24}}}}"#,
                eye - 10.0
            ),
        )
}

#[test]
fn scenes_scaled_down_to_a_hundredth_look_and_cost_the_same() {
    judge("a room scaled by 0.1 and 0.01", rooms(&scales(&[0.1, 0.01]), work));
}

/// The worst error of a pixel, or `None` if the bundle is refused with a reason.
fn far(distance: f64) -> Option<f64> {
    let scene = match far_room(distance).load() {
        Ok(scene) => scene,
        Err(error) => {
            println!("         at {distance:e}: refused: {error}");
            return None;
        }
    };
    let settings = Settings { width: 24, height: 24, spp: 64, ambient_bounces: 0, ..Settings::default() };
    let image = render(&scene.frame(0).expect("there is a frame"), &settings);
    let worst = values(&image).into_iter().map(|v| (v / 1.5 - 1.0).abs()).fold(0.0, f64::max);
    println!("         at {distance:e}: worst pixel off by {worst:.4}");
    Some(if unsound(&image) > 0 { f64::INFINITY } else { worst })
}

#[test]
fn details_of_a_millimetre_are_right_up_to_ten_metres_from_the_origin() {
    let worst = [0.0, 1.0, 10.0].into_iter().filter_map(far).fold(0.0, f64::max);
    // Direct light of the room on itself: 64 samples of both kinds, with at most 3 % noise per pixel. Acne or
    // a leak is 33 %.
    case(8, "a glowing room with millimetre steps 0 to 10 m away, worst pixel").worst(worst, 0.2);
}

#[test]
fn details_of_a_millimetre_far_from_the_origin_are_right_or_refused() {
    let worst = [1e2, 1e3, 1e4, 1e5, 1e6, 1e7].into_iter().filter_map(far).fold(0.0, f64::max);
    case(8, "a glowing room with millimetre steps 100 m to 10,000 km away, worst pixel or refusal")
        .worst(worst, 0.2);
}

/// True if a glowing plate at height `height` is visible through a clear pane `gap` above it.
fn seen_through_gap(height: f64, gap: f64) -> bool {
    let pane = Surface::ThinGlass { ior: 1.0, transmittance: grey(1.0) };
    let world = World::default().floor(DVec3::new(0.0, height, 0.0), 1.0, material(lambert(0.0), 1.0)).floor(
        DVec3::new(0.0, height + gap, 0.0),
        1.0,
        material(pane, 0.0),
    );
    let frame = world.frame(View::new(DVec3::new(0.2, height + 1.5, 0.3), DVec3::new(0.0, height, 0.0), 0.2));
    let settings = Settings { width: 8, height: 8, spp: 1, ambient_bounces: 0, ..Settings::default() };
    values(&render(&frame, &settings)).iter().all(|&v| v == 1.0)
}

/// The numbers of gaps that hide the plate, and of all.
fn blind(gaps: &[f64], heights: &[f64]) -> (u64, u64) {
    let (mut wrong, mut tried) = (0, 0);
    for &height in heights {
        for &gap in gaps {
            // A gap below the resolution of positions does not exist.
            if ((height + gap) as f32) <= height as f32 {
                continue;
            }
            tried += 1;
            if !seen_through_gap(height, gap) {
                println!("         at height {height}, a gap of {gap:e} is not seen");
                wrong += 1;
            }
        }
    }
    (wrong, tried)
}

#[test]
fn a_plate_a_ten_thousandth_behind_another_is_seen() {
    let (wrong, tried) = blind(&[1e-3, 1e-4], &[0.0, 0.5, 1.0]);
    case(9, "gaps of 10⁻³ and 10⁻⁴ between plates of size 1 that are jumped over").never(wrong, tried);
}

#[test]
fn a_plate_a_hundred_thousandth_behind_another_is_seen() {
    let (wrong, tried) = blind(&[1e-5], &[0.0, 0.5, 1.0]);
    case(9, "gaps of 10⁻⁵ between plates of size 1 that are jumped over").never(wrong, tried);
}

#[test]
fn a_plate_a_ten_millionth_behind_another_is_seen() {
    let (wrong, tried) = blind(&[1e-6, 1e-7], &[0.0, 0.5, 1.0]);
    case(9, "gaps of 10⁻⁶ and 10⁻⁷ between plates of size 1 that are jumped over").never(wrong, tried);
}

#[test]
fn a_lamp_a_hair_above_a_floor_lights_it() {
    // A lamp as wide as the floor, so close that all its light falls on the floor: E = π L, whatever the gap.
    let mut worst = 0.0f64;
    for gap in [1e-2, 1e-3] {
        let world = World::default().floor(DVec3::ZERO, 1.0, material(lambert(0.5), 0.0)).ceiling(
            DVec3::new(0.0, gap, 0.0),
            1.0,
            material(lambert(0.0), 2.0),
        );
        let eye = DVec3::new(0.0, gap / 2.0, 0.0);
        let frame = world.frame(View::new(eye, eye + DVec3::new(0.1, -1.0, 0.05), 0.2));
        let settings = Settings { width: 8, height: 8, spp: 64, ambient_bounces: 0, ..Settings::default() };
        worst = worst.max((mean(&render(&frame, &settings)) - 1.0).abs());
    }
    // A share of (gap)² / 2 of the rays leaves between floor and lamp.
    case(9, "a lamp 10⁻² and 10⁻³ above a floor gives π L, relative error").worst(worst, 1e-3);
}
