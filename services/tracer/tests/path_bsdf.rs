//! BSDFs: what is chosen is what is evaluated.

use forelight_tracer::bsdf::{Bsdf, Lobe};
use glam::{Vec2, Vec3};
use std::f64::consts::TAU;

const COLOR: Vec3 = Vec3::new(0.9, 0.5, 0.2);

/// Surfaces that spread light, by name.
fn surfaces() -> Vec<(&'static str, Bsdf)> {
    vec![
        ("lambert", Bsdf::lambert(COLOR)),
        ("smooth plastic", Bsdf::plastic(COLOR, 1.5, 0.0)),
        ("rough plastic", Bsdf::plastic(COLOR, 1.5, 0.3)),
        ("black rough plastic", Bsdf::plastic(Vec3::ZERO, 1.5, 0.4)),
        ("rough metal", Bsdf::metal(COLOR, 0.35)),
        ("rough glass from outside", Bsdf::glass(1.5, COLOR, 0.35)),
        ("rough glass from inside", Bsdf::glass(1.0 / 1.5, COLOR, 0.35)),
    ]
}

fn viewers() -> impl Iterator<Item = Vec3> {
    [0.98f32, 0.7, 0.3, 0.05].into_iter().map(|z| Vec3::new((1.0 - z * z).sqrt(), 0.0, z))
}

/// Evenly spread points of the unit cube (Roberts 2018, plastic number in three dimensions).
fn cube(count: u32) -> impl Iterator<Item = (Vec2, f32)> {
    let g = 1.220_744_084_605_759_5_f64;
    let at = move |i: u32, power: i32| ((f64::from(i) + 0.5) / g.powi(power)).fract() as f32;
    (0..count).map(move |i| (Vec2::new(at(i, 1), at(i, 2)), at(i, 3)))
}

/// Calls `visit` with directions over the whole sphere and their solid angles.
fn sphere(mut visit: impl FnMut(Vec3, f64)) {
    const N: u32 = 700;
    for i in 0..N {
        let z = (f64::from(i) + 0.5) / f64::from(N) * 2.0 - 1.0;
        for j in 0..2 * N {
            let phi = (f64::from(j) + 0.5) / f64::from(2 * N) * TAU;
            let r = (1.0 - z * z).sqrt();
            let direction = Vec3::new((r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32);
            visit(direction, 2.0 * TAU / f64::from(2 * N * N));
        }
    }
}

#[test]
fn the_mean_weight_is_the_integral_of_the_bsdf_and_the_density_that_of_the_choices() {
    const COUNT: u32 = 200_000;
    for (name, bsdf) in surfaces() {
        for wi in viewers() {
            let (mut reflected, mut density) = ([0.0f64; 3], 0.0f64);
            sphere(|wo, solid_angle| {
                let value = bsdf.evaluate(wi, wo).as_dvec3() * solid_angle;
                reflected.iter_mut().zip(value.to_array()).for_each(|(sum, v)| *sum += v);
                density += f64::from(bsdf.density(wi, wo)) * solid_angle;
            });
            let (mut weights, mut spread) = ([0.0f64; 3], 0u32);
            for s in cube(COUNT).filter_map(|(u, choice)| bsdf.sample(wi, u, choice)) {
                if s.density.is_some() {
                    let weight = (s.weight / COUNT as f32).as_dvec3();
                    weights.iter_mut().zip(weight.to_array()).for_each(|(sum, w)| *sum += w);
                    spread += 1;
                }
            }
            for c in 0..3 {
                let (a, b) = (weights[c], reflected[c]);
                assert!((a - b).abs() < 2e-3 + 0.01 * b, "{name} from {wi}: {a} chosen, {b} evaluated");
            }
            // Choices that end below the horizon have a density but no weight.
            let chosen = f64::from(spread) / f64::from(COUNT);
            assert!((chosen - density).abs() < 0.01, "{name} from {wi}: {chosen} chosen, density {density}");
        }
    }
}

#[test]
fn a_choice_has_the_weight_and_the_density_that_are_evaluated() {
    for (name, bsdf) in surfaces() {
        for wi in viewers() {
            for (u, choice) in cube(2000) {
                let Some(s) = bsdf.sample(wi, u, choice) else { continue };
                assert!((s.direction.length() - 1.0).abs() < 1e-5, "{name}: {s:?}");
                let Some(density) = s.density else { continue };
                let (value, again) = (bsdf.evaluate(wi, s.direction), bsdf.density(wi, s.direction));
                assert!((density / again - 1.0).abs() < 1e-2, "{name} from {wi}: {density} and {again}");
                let error = (value / density - s.weight).abs().max_element();
                assert!(
                    error < 1e-2 * s.weight.max_element(),
                    "{name} from {wi}: {value} / {density}, {s:?}"
                );
            }
        }
    }
}

#[test]
fn light_goes_both_ways_alike() {
    let directions: Vec<Vec3> = viewers()
        .chain(viewers().map(|w| Vec3::new(-0.6 * w.x, 0.8 * w.x, w.z)))
        .map(Vec3::normalize)
        .collect();
    for (name, bsdf) in surfaces() {
        for &a in &directions {
            for &b in &directions {
                let (ab, ba) = (bsdf.evaluate(a, b) / b.z, bsdf.evaluate(b, a) / a.z);
                let error = (ab - ba).abs().max_element();
                assert!(error <= 1e-4 * ab.max_element(), "{name}: {ab} and {ba} for {a}, {b}");
            }
        }
    }
    // Through an interface: ρ η² is symmetric, seen from either side. The frame turns over with the viewer.
    let (outside, inside) = (Bsdf::glass(1.5, COLOR, 0.35), Bsdf::glass(1.0 / 1.5, COLOR, 0.35));
    let over = |w: Vec3| Vec3::new(w.x, -w.y, -w.z);
    for &a in &directions {
        for b in directions.iter().map(|b| -*b) {
            let from_outside = outside.evaluate(a, b) / -b.z * (1.5f32 * 1.5);
            let from_inside = inside.evaluate(over(b), over(a)) / a.z;
            let error = (from_outside - from_inside).abs().max_element();
            assert!(
                error <= 1e-3 * from_inside.max_element(),
                "{from_outside} and {from_inside} for {a}, {b}"
            );
        }
    }
}

#[test]
fn no_surface_gives_more_light_than_it_gets() {
    let white = Vec3::ONE;
    let surfaces = [
        Bsdf::lambert(white),
        Bsdf::plastic(white, 1.5, 0.0),
        Bsdf::plastic(white, 1.5, 0.05),
        Bsdf::plastic(white, 1.5, 1.0),
        Bsdf::metal(white, 0.0),
        Bsdf::metal(white, 0.5),
        Bsdf::pane(1.5, white),
    ];
    for bsdf in surfaces {
        for wi in viewers() {
            let weights = cube(20_000).filter_map(|(u, c)| bsdf.sample(wi, u, c)).map(|s| s.weight.x);
            let mean = weights.map(f64::from).sum::<f64>() / 20_000.0;
            assert!(mean <= 1.003, "{bsdf:?} from {wi}: {mean}");
        }
    }
    // Glass: what is refracted is less or more by η² as radiance, not as light.
    for eta in [1.5f32, 1.0 / 1.5, 1.0] {
        for alpha in [0.0, 0.2] {
            let glass = Bsdf::glass(eta, white, alpha);
            for wi in viewers() {
                let light = |s: forelight_tracer::bsdf::Scattering| {
                    f64::from(s.weight.x * if s.lobe == Lobe::Refraction { eta * eta } else { 1.0 })
                };
                let mean = cube(20_000).filter_map(|(u, c)| glass.sample(wi, u, c)).map(light).sum::<f64>();
                let mean = mean / 20_000.0;
                let enough = if alpha == 0.0 { 0.999 } else { 0.6 };
                assert!((enough..1.003).contains(&mean), "η {eta}, alpha {alpha}, from {wi}: {mean}");
            }
        }
    }
}

#[test]
fn grazing_and_nearly_smooth_surfaces_stay_finite() {
    let alphas = [1e-3, 1e-2, 1.0];
    for alpha in alphas {
        let surfaces = [
            Bsdf::plastic(COLOR, 1.5, alpha),
            Bsdf::metal(COLOR, alpha),
            Bsdf::glass(1.5, COLOR, alpha),
            Bsdf::glass(1.0 / 1.5, COLOR, alpha),
            Bsdf::glass(1.0 + 2e-3, COLOR, alpha),
        ];
        for bsdf in surfaces {
            for z in [1e-6f32, 1e-4, 0.5, 1.0] {
                let wi = Vec3::new((1.0 - z * z).sqrt(), 0.0, z);
                for (u, choice) in cube(500) {
                    if let Some(s) = bsdf.sample(wi, u, choice) {
                        let finite = s.weight.is_finite() && s.density.is_none_or(f32::is_finite);
                        assert!(finite && s.weight.min_element() >= 0.0, "{bsdf:?} from {wi}: {s:?}");
                    }
                }
            }
        }
    }
}
