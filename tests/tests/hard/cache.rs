//! The irradiance cache: furnaces, leaks and gradients.

use forelight_scene::Surface;
use forelight_tests::case::case;
use forelight_tests::world::{View, World, grey, lambert, material, unsound, values};
use forelight_tracer::{CacheSettings, Image, Settings, Tracer};
use glam::DVec3;
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

/// A cache of this accuracy (thousandths) and number of rays, one bounce.
pub fn settings(size: u32, accuracy: u32, rays: u32) -> Settings {
    let cache = Some(CacheSettings { accuracy, rays });
    Settings {
        width: size,
        height: size,
        spp: 4,
        ambient_bounces: 1,
        ambient_divisions: 64,
        cache,
        ..Settings::default()
    }
}

pub fn image(tracer: &Tracer) -> Image {
    tracer.render(None, &|_| {}, &AtomicBool::new(false)).expect("nobody cancels")
}

/// Lambert reflection without emission.
pub fn wall(albedo: f32) -> forelight_scene::Material {
    material(lambert(albedo), 0.0)
}

pub fn records(tracer: &Tracer) -> u64 {
    tracer.cache().map_or(0, |cache| cache.records().iter().sum())
}

/// Calls `visit` with position, normal, irradiance and both gradients (first channel) of every record of the
/// first level.
fn each_record(tracer: &Tracer, mut visit: impl FnMut(DVec3, DVec3, f64, DVec3, DVec3)) -> u64 {
    let cache = tracer.cache().expect("a cache was called for");
    let mut count = 0;
    for (index, planned) in cache.planned(0).iter().enumerate() {
        let Some(record) = cache.record(0, index).filter(|record| !record.rejected) else { continue };
        let (place, normal) = (planned.site.position.as_dvec3(), planned.site.normal.as_dvec3());
        let (turn, shift) = (record.rotation[0].as_dvec3(), record.translation[0].as_dvec3());
        visit(place, normal, f64::from(record.irradiance.x), turn, shift);
        count += 1;
    }
    count
}

#[test]
fn under_an_even_sky_every_record_holds_pi_and_no_gradient() {
    // Flat sides: with smooth normals on flat triangles, rays would hit the body itself.
    let world = World::under(1.0).cuboid(DVec3::splat(-1.0), DVec3::ONE, false, wall(0.5));
    let view = View::new(DVec3::new(1.5, 2.0, 3.0), DVec3::ZERO, 0.45);
    let (mut off, mut slope, mut count, mut pixels) = (0.0f64, 0.0f64, 0, 0.0f64);
    for accuracy in [50, 200, 1000] {
        let tracer = Tracer::new(&world.frame(view), &settings(24, accuracy, 192));
        let image = image(&tracer);
        assert_eq!(unsound(&image), 0);
        // Pixels at the outline also show the sky.
        let body = image.pixels.iter().filter(|p| p.stratum == 0 && p.color[0] < 0.6);
        pixels = body.map(|p| (f64::from(p.color[0]) - 0.5).abs()).fold(pixels, f64::max);
        count += each_record(&tracer, |_, _, value, turn, shift| {
            off = off.max((value / PI - 1.0).abs());
            slope = slope.max(shift.length()).max(turn.length());
        });
    }
    assert!(count > 50, "{count} records");
    // Sums of 192 equal f32.
    case(2, "records on a convex body under an even sky: E against π, relative").worst(off, 1e-5);
    // All differences are exactly 0. Contributions of the rotation cancel over the azimuth.
    case(2, "records on a convex body under an even sky: length of both gradients").worst(slope, 1e-4);
    case(2, "pixels of a convex body under an even sky, whatever the accuracy, against its albedo")
        .worst(pixels, 1e-5);
}

#[test]
fn a_closed_glowing_room_sums_the_truncated_series_whatever_the_accuracy() {
    // Albedo ρ and emission 1 everywhere: emission, direct light ρ, and a factor ρ for each bounce.
    let rho = 0.6f64;
    let world =
        World::default().cuboid(DVec3::splat(-1.0), DVec3::ONE, true, material(lambert(rho as f32), 1.0));
    let view = View::new(DVec3::new(0.1, 0.2, 0.3), DVec3::new(0.3, 0.1, -1.0), 0.9);
    let mut worst = 0.0f64;
    for bounces in [1, 2, 3, 4, 8] {
        let expected: f64 = (0..=bounces as i32 + 1).map(|i| rho.powi(i)).sum();
        for accuracy in [100, 300, 1000] {
            let settings = Settings { ambient_bounces: bounces, spp: 16, ..settings(16, accuracy, 768) };
            let tracer = Tracer::new(&world.frame(view), &settings);
            let image = image(&tracer);
            let mean = values(&image).iter().sum::<f64>() / 256.0;
            println!(
                "         {bounces} bounces, accuracy {accuracy}: {mean:.4} against {expected:.4}, {} records",
                records(&tracer)
            );
            worst = worst.max((mean / expected - 1.0).abs());
        }
    }
    // Tens of records with 768 samples of direct light, each with a deviation of a third: 0.2 % of the
    // bounce's share. At accuracy 1000 one record may serve a whole wall.
    case(2, "a closed glowing room with a cache, 1 to 8 bounces, relative error of the mean")
        .worst(worst, 0.01);
}

/// A yard without a roof, divided by a fin a millimetre thick. One half has a lamp that shines on the outer
/// wall. The other half sees nothing lit. Strata: 0 the lit floor, 1 the dark one.
fn yard() -> World {
    World::default()
        .floor(DVec3::new(1.0, 0.0, 0.0), 1.0, wall(0.7))
        .floor(DVec3::new(-1.0, 0.0, 0.0), 1.0, wall(0.7))
        .cuboid(DVec3::new(-5e-4, -0.1, -1.5), DVec3::new(5e-4, 1.0, 1.5), false, wall(0.7))
        .quad(DVec3::new(2.0, 0.0, -1.0), DVec3::new(0.0, 0.0, 2.0), DVec3::new(0.0, 1.0, 0.0), wall(0.7))
        .quad(
            DVec3::new(0.3, 0.2, -0.5),
            DVec3::new(0.0, 0.5, 0.0),
            DVec3::new(0.0, 0.0, 1.0),
            material(lambert(0.0), 8.0),
        )
}

#[test]
fn no_light_leaks_through_a_wall_of_a_millimetre() {
    let view = View::new(DVec3::new(0.0, 4.0, 0.01), DVec3::ZERO, 0.45);
    let (mut leak, mut dimmest) = (0.0f64, f64::INFINITY);
    for accuracy in [100, 200, 500, 1000] {
        let tracer = Tracer::new(&yard().frame(view), &settings(64, accuracy, 192));
        let image = image(&tracer);
        assert_eq!(unsound(&image), 0);
        let side = |stratum: u32| image.pixels.iter().filter(move |p| p.stratum == stratum);
        let lit = side(0).map(|p| f64::from(p.color[0])).sum::<f64>() / side(0).count() as f64;
        // Pixels at the foot of the fin show its sides, and those at the outer edge the other floor.
        let dark = side(1).map(|p| f64::from(p.color[0])).fold(0.0, f64::max);
        println!(
            "         accuracy {accuracy}: lit {lit:.4}, brightest dark pixel {dark:.6}, {} records",
            records(&tracer)
        );
        (leak, dimmest) = (leak.max(dark / lit), dimmest.min(lit));
    }
    assert!(dimmest > 0.01, "{dimmest}");
    // Limit of the table.
    case(18, "light behind a wall of 10⁻³ m, brightest pixel as a share of the lit side").worst(leak, 0.01);
}

/// Corners, the edge of a shelf, a contact of sphere and floor, a wire, a small hole in a lid, and a mirror
/// that faces all.
pub fn nook() -> World {
    let mirror = material(Surface::Metal { f0: grey(0.9), alpha: 0.0 }, 0.0);
    World::default()
        .floor(DVec3::ZERO, 1.5, wall(0.6))
        .quad(DVec3::new(-1.5, 0.0, -1.5), DVec3::X * 3.0, DVec3::Y * 2.0, wall(0.7))
        .quad(DVec3::new(-1.5, 0.0, 1.5), DVec3::Z * -3.0, DVec3::Y * 2.0, wall(0.5))
        .quad(DVec3::new(1.5, 0.0, -1.5), DVec3::Z * 3.0, DVec3::Y * 2.0, mirror)
        .cuboid(DVec3::new(-1.5, 0.9, -1.5), DVec3::new(-0.3, 0.901, -1.0), false, wall(0.8))
        .sphere(DVec3::new(0.4, 0.35, -0.3), 0.35, 3, wall(0.6))
        .cuboid(DVec3::new(-0.602, 0.0, 0.198), DVec3::new(-0.598, 1.2, 0.202), false, wall(0.6))
        .cuboid(DVec3::new(-1.2, 0.0, -0.4), DVec3::new(-0.7, 0.4, 0.1), false, wall(0.4))
        .ceiling(DVec3::new(0.5, 1.9, 0.5), 0.3, material(lambert(0.0), 10.0))
}

/// The camera of the nook.
pub const AT_THE_NOOK: View =
    View { eye: DVec3::new(0.2, 1.2, 3.4), target: DVec3::new(0.0, 0.6, -0.5), tan_half: 0.45 };

#[test]
fn corners_contacts_wires_and_edges_stay_within_the_bound_and_the_cap_of_records() {
    let frame = nook().frame(AT_THE_NOOK);
    let size = 40;
    let reference = {
        let exact =
            Settings { cache: None, spp: 16, ambient_divisions: 192, seed: 9, ..settings(size, 200, 192) };
        let direct =
            Settings { cache: None, spp: 16, ambient_bounces: 0, seed: 9, ..settings(size, 200, 192) };
        let (all, direct) =
            (values(&image(&Tracer::new(&frame, &exact))), values(&image(&Tracer::new(&frame, &direct))));
        (all, direct)
    };
    let indirect: f64 =
        reference.0.iter().zip(&reference.1).map(|(a, d)| a - d).sum::<f64>() / f64::from(size * size);
    let (mut errors, mut most) = (Vec::new(), 0u64);
    for accuracy in [800, 400, 200, 100] {
        let settings = Settings { spp: 16, seed: 9, ..settings(size, accuracy, 768) };
        let tracer = Tracer::new(&frame, &settings);
        let found = image(&tracer);
        assert_eq!(unsound(&found), 0);
        let square: f64 = values(&found).iter().zip(&reference.0).map(|(a, b)| (a - b) * (a - b)).sum();
        let error = (square / f64::from(size * size)).sqrt() / indirect;
        println!(
            "         accuracy {accuracy}: {error:.4} of the indirect light, {} records",
            records(&tracer)
        );
        errors.push((f64::from(accuracy) / 1000.0, error));
        most = most.max(records(&tracer));
    }
    // Root mean square over the image relative to the mean indirect light, over the requested bound.
    let worst = errors.iter().map(|(allowed, error)| error / allowed).fold(0.0, f64::max);
    case(18, "corner, contact, wire, shelf, mirror: error of the image over the bound asked for")
        .worst(worst, 1.0);
    // A tenth of slack for the noise of gathers and reference.
    let rising = errors.windows(2).map(|w| w[1].1 / w[0].1).fold(0.0, f64::max);
    case(18, "corner, contact, wire, shelf, mirror: error at half the bound over that at the whole")
        .worst(rising, 1.1);
    case(18, "records of all bounces as a share of the pixels, corners and wires included")
        .worst(most as f64 / f64::from(size * size), 1.0);
}

/// ½ Σ γᵢ Γᵢ: vector irradiance of a polygon of radiance 1 that is wholly above the horizon. Its product with
/// a normal is the irradiance there (Lambert).
fn vector_irradiance(corners: &[DVec3], from: DVec3) -> DVec3 {
    let unit: Vec<DVec3> = corners.iter().map(|&c| (c - from).normalize()).collect();
    let sum: DVec3 = (0..unit.len())
        .map(|i| {
            let (a, b) = (unit[i], unit[(i + 1) % unit.len()]);
            let normal = a.cross(b);
            normal.length().atan2(a.dot(b)) * normal.normalize_or_zero()
        })
        .sum();
    let half = sum / 2.0;
    // The sign depends on the side of the polygon.
    if half.dot(unit.iter().copied().sum()) < 0.0 { -half } else { half }
}

#[test]
fn gradients_are_the_derivatives_of_closed_forms_in_sign_and_size() {
    // A floor under an even sky beside a black wall along z. The wall takes a polygon out of the sky.
    let (height, depth) = (1.0, 1.5);
    let corners = [
        DVec3::new(0.0, 0.0, -depth),
        DVec3::new(0.0, 0.0, depth),
        DVec3::new(0.0, height, depth),
        DVec3::new(0.0, height, -depth),
    ];
    let world = World::under(1.0).floor(DVec3::ZERO, 4.0, wall(0.5)).quad(
        corners[0],
        corners[1] - corners[0],
        corners[3] - corners[0],
        wall(0.0),
    );
    let view = View::new(DVec3::new(1.2, 3.0, 0.3), DVec3::new(1.0, 0.0, 0.3), 0.25);
    let tracer = Tracer::new(&world.frame(view), &settings(24, 300, 12_288));
    assert_eq!(unsound(&image(&tracer)), 0);
    let (mut value, mut shift_error, mut turn_error, mut largest) =
        (0.0f64, 0.0f64, 0.0f64, (0.0f64, 0.0f64));
    let count = each_record(&tracer, |place, normal, found, turn, shift| {
        let arriving = |p: DVec3| PI * DVec3::Y - vector_irradiance(&corners, p);
        let irradiance = |p: DVec3| arriving(p).dot(normal);
        value = value.max((found / irradiance(place) - 1.0).abs());
        for axis in [DVec3::X, DVec3::Z] {
            let step = 1e-4;
            let slope = (irradiance(place + step * axis) - irradiance(place - step * axis)) / (2.0 * step);
            shift_error = shift_error.max((shift.dot(axis) - slope).abs());
            // A normal that turns towards the axis turns about n × axis.
            let turning = arriving(place).dot(axis);
            turn_error = turn_error.max((turn.dot(normal.cross(axis)) - turning).abs());
            largest = (largest.0.max(slope.abs()), largest.1.max(turning.abs()));
        }
    });
    assert!(count > 5 && largest.0 > 0.2 && largest.1 > 0.2, "{count} records, slopes up to {largest:?}");
    // Of 12,288 strata, some 4 · 110 on the wall's outline are uncertain: √440 / 12,288 of π.
    case(19, "irradiance of records beside a wall against the closed form, relative").worst(value, 5e-3);
    // The outline again, divided by distances of half a metre and more. A wrong sign would give twice the
    // largest slope.
    case(19, "grad_t against the derivative of the closed form, as a share of the largest")
        .worst(shift_error / largest.0, 0.1);
    case(19, "grad_r against the derivative of the closed form, as a share of the largest")
        .worst(turn_error / largest.1, 0.02);
}
