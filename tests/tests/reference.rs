//! Our images against those of an independent path tracer, pixel by pixel, with both variances.

use forelight_protocol::{Integrator, MaterialMode};
use forelight_test_needs::shared;
use forelight_tests::reference::{self, Estimate};
use forelight_tests::statistics::welch;
use forelight_tracer::Settings;

/// Independent passes behind the reference's standard errors, at least.
const REFERENCE_PASSES: u32 = 16;
/// Our own passes: enough for the t-distribution to be close to normal.
const PASSES: u32 = 24;

/// A significant difference counts if it is above this share of the image's mean. Known below it: along the left edge of modern-hall,
/// where a wall gets 1 % of the mean, our direct light is 5 % darker (0.05 % of the mean).
const LEAST: f64 = 1e-3;

struct Case {
    scene: &'static str,
    integrator: Integrator,
    depth: u32,
    /// Relative tolerance of the image mean.
    mean: f64,
    spp: u32,
}

fn compare(case: &Case) -> Option<()> {
    let part =
        |suffix: &str| shared(&format!("reference/{}.lambert.depth{}{suffix}.exr", case.scene, case.depth));
    let theirs = reference::read(&part("")?, &part(".stderr")?, REFERENCE_PASSES);
    let bundle = shared(&format!("scenes/{}", case.scene))?;
    let settings = Settings {
        integrator: case.integrator,
        width: theirs.width,
        height: theirs.height,
        spp: case.spp,
        ambient_bounces: case.depth - 2,
        ambient_divisions: 4,
        materials: MaterialMode::Lambert,
        ..Settings::default()
    };
    let ours = reference::render(&bundle, 0, &settings, PASSES);
    let (a, b) = (ours.mean(), theirs.mean());
    let error = a / b - 1.0;
    let (scene, depth, error_percent) = (case.scene, case.depth, error * 100.0);
    println!(
        "{scene} depth {depth}, {:?}: mean {a:.6} against {b:.6} ({error_percent:+.3} %)",
        case.integrator
    );
    let pixels = significant("pixels", &ours.pooled(), &theirs.pooled(), LEAST * b);
    let blocks =
        significant("blocks of 8 × 8", &ours.pooled().blocks(8), &theirs.pooled().blocks(8), LEAST * b);
    assert!(error.abs() <= case.mean, "{}: image mean is off by {:.3} %", case.scene, error * 100.0);
    assert_eq!((pixels, blocks), (0, 0), "{}: values that differ significantly", case.scene);
    Some(())
}

/// Number of values that differ at a family-wise level of 1 %, each printed, and by more than `least`.
fn significant(what: &str, ours: &Estimate, theirs: &Estimate, least: f64) -> usize {
    let pairs = ours.values.iter().zip(&theirs.values);
    // Both are stored in f32, and theirs was summed in it over thousands of samples.
    let p: Vec<f64> = pairs.map(|(&o, &t)| welch(o, t, 1e-5 * t.mean + 1e-9)).collect();
    // Šidák's correction for the number of comparisons.
    let threshold = 1.0 - 0.99f64.powf(1.0 / p.len() as f64);
    let outliers: Vec<usize> = (0..p.len()).filter(|&i| p[i] < threshold).collect();
    let smallest = p.iter().copied().fold(1.0, f64::min);
    println!(
        "  {} of {} {what} below p = {threshold:.1e}; smallest p {smallest:.1e}",
        outliers.len(),
        p.len()
    );
    for &i in outliers.iter().take(20) {
        let (x, y, channel) = (i as u32 / 3 % ours.width, i as u32 / 3 / ours.width, i % 3);
        let (o, t) = (ours.values[i], theirs.values[i]);
        println!(
            "    ({x}, {y}) channel {channel}: ours {:.5} ± {:.5}, theirs {:.5} ± {:.5}",
            o.mean,
            o.variance.sqrt(),
            t.mean,
            t.variance.sqrt()
        );
    }
    let apart = |&&i: &&usize| (ours.values[i].mean - theirs.values[i].mean).abs() > least;
    outliers.iter().filter(apart).count()
}

macro_rules! cases {
    ($integrator:ident: $($name:ident: $scene:literal, $depth:literal, $mean:literal, $spp:literal;)*) => {
        $(#[test]
        fn $name() {
            let integrator = Integrator::$integrator;
            compare(&Case { scene: $scene, integrator, depth: $depth, mean: $mean, spp: $spp });
        })*
    };
}

cases! { Ambient:
    cornell_box_direct_light_is_the_references: "cornell-box", 2, 0.005, 4;
    cornell_box_with_one_bounce_is_the_references: "cornell-box", 3, 0.005, 4;
    country_kitchen_direct_light_is_the_references: "country-kitchen", 2, 0.01, 4;
    country_kitchen_with_one_bounce_is_the_references: "country-kitchen", 3, 0.01, 2;
    modern_hall_direct_light_is_the_references: "modern-hall", 2, 0.01, 4;
    modern_hall_with_one_bounce_is_the_references: "modern-hall", 3, 0.01, 2;
    living_room_direct_light_is_the_references: "living-room", 2, 0.01, 4;
    living_room_with_one_bounce_is_the_references: "living-room", 3, 0.01, 2;
    veach_ajar_with_one_bounce_is_the_references: "veach-ajar", 3, 0.01, 4;
}

cases! { Path:
    cornell_box_direct_light_by_paths_is_the_references: "cornell-box", 2, 0.005, 16;
    cornell_box_with_one_bounce_by_paths_is_the_references: "cornell-box", 3, 0.005, 16;
    country_kitchen_direct_light_by_paths_is_the_references: "country-kitchen", 2, 0.01, 8;
    country_kitchen_with_one_bounce_by_paths_is_the_references: "country-kitchen", 3, 0.01, 8;
    modern_hall_with_one_bounce_by_paths_is_the_references: "modern-hall", 3, 0.01, 8;
    living_room_with_one_bounce_by_paths_is_the_references: "living-room", 3, 0.01, 8;
    veach_ajar_with_one_bounce_by_paths_is_the_references: "veach-ajar", 3, 0.01, 16;
}

/// All materials, every kind of path, caustics included. Means alone: the reference's rough coat loses a quarter of its light at the
/// roughness of these floors and more at others, so that ours is brighter wherever one is seen or lights what is seen, and in
/// the reference mirrors and glass count as scattering events.
fn compare_full(scene: &str, lowest: f64, highest: f64) -> Option<()> {
    let part = |suffix: &str| shared(&format!("reference/{scene}.full.depth12{suffix}.exr"));
    let theirs = reference::read(&part("")?, &part(".stderr")?, REFERENCE_PASSES);
    let bundle = shared(&format!("scenes/{scene}"))?;
    let settings = Settings {
        integrator: Integrator::Path,
        width: theirs.width,
        height: theirs.height,
        spp: 16,
        ambient_bounces: 10,
        ..Settings::default()
    };
    let ours = reference::render(&bundle, 0, &settings, 2);
    let error = ours.mean() / theirs.mean() - 1.0;
    println!("{scene} full: mean {:.6} against {:.6} ({:+.3} %)", ours.mean(), theirs.mean(), error * 100.0);
    assert!((lowest..highest).contains(&error), "{scene}: image mean is off by {:.3} %", error * 100.0);
    Some(())
}

#[test]
fn interiors_with_all_materials_by_paths_are_as_bright_as_the_references_or_by_their_coats_losses_brighter() {
    // No coat at all; coats on few things; coats on furniture and floor.
    compare_full("cornell-box", -0.002, 0.002);
    compare_full("country-kitchen", -0.002, 0.015);
    compare_full("living-room", 0.0, 0.07);
}
