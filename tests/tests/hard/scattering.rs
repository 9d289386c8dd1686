//! Scattering functions alone: symmetry under an exchange of directions, energy from any direction, Fresnel's
//! equations to the last ulps.

use forelight_tests::case::case;
use forelight_tracer::bsdf::Bsdf;
use forelight_tracer::fresnel;
use glam::{DVec3, Vec2, Vec3};
use proptest::prelude::*;

/// The unit vector of this height and azimuth.
fn direction(height: f64, azimuth: f64) -> Vec3 {
    let r = ((1.0 - height) * (1.0 + height)).max(0.0).sqrt();
    DVec3::new(r * azimuth.cos(), r * azimuth.sin(), height).as_vec3()
}

/// Heights down to grazing ones.
const HEIGHTS: [f64; 7] = [1.0, 0.7, 0.3, 0.05, 1e-3, 1e-5, 1e-7];

/// BSDF without the cosine.
fn value(bsdf: &Bsdf, wi: Vec3, wo: Vec3) -> f64 {
    f64::from(bsdf.evaluate(wi, wo).x) / f64::from(wo.z.abs())
}

#[test]
fn reflection_is_symmetric_down_to_a_cosine_of_1e_minus_7() {
    let half = Vec3::splat(0.5);
    let bsdfs = [
        Bsdf::lambert(half),
        Bsdf::plastic(half, 1.5, 0.0),
        Bsdf::plastic(half, 1.5, 0.2),
        Bsdf::metal(half, 0.05),
        Bsdf::metal(half, 1.0),
        Bsdf::glass(1.5, half, 0.3),
        Bsdf::glass(1.0 / 1.5, half, 0.3),
    ];
    let (mut worst, mut pairs) = (0.0f64, 0);
    for bsdf in &bsdfs {
        for a in HEIGHTS {
            for b in HEIGHTS {
                for turn in [0.0, 1.0, 3.0] {
                    let (wi, wo) = (direction(a, 0.2), direction(b, 0.2 + turn));
                    let (there, back) = (value(bsdf, wi, wo), value(bsdf, wo, wi));
                    if there.max(back) > 1e-20 {
                        worst = worst.max((there / back - 1.0).abs());
                        pairs += 1;
                    }
                }
            }
        }
    }
    assert!(pairs > 500, "{pairs} pairs reflect anything");
    // f32: some forty roundings of 6e-8, times four.
    case(4, "BSDFs by themselves: f(wi, wo) = f(wo, wi) down to a cosine of 1e-7").worst(worst, 1e-5);
}

#[test]
fn transmission_is_symmetric_but_for_the_squared_index() {
    let (mut worst, mut pairs) = (0.0f64, 0);
    for ior in [1.1f32, 1.5, 2.4] {
        for alpha in [0.1f32, 0.4, 1.0] {
            // The same interface from both sides. The other side's frame is mirrored in the plane.
            let (outside, inside) =
                (Bsdf::glass(ior, Vec3::ONE, alpha), Bsdf::glass(1.0 / ior, Vec3::ONE, alpha));
            let flipped = |w: Vec3| Vec3::new(w.x, w.y, -w.z);
            for a in &HEIGHTS[..5] {
                for b in &HEIGHTS[..5] {
                    for turn in [3.1, 2.5, 1.0] {
                        let (wi, wo) = (direction(*a, 0.0), flipped(direction(*b, turn)));
                        let there = value(&outside, wi, wo) * f64::from(ior * ior);
                        let back = value(&inside, flipped(wo), flipped(wi));
                        if there.max(back) > 1e-6 {
                            worst = worst.max((there / back - 1.0).abs());
                            pairs += 1;
                        }
                    }
                }
            }
        }
    }
    assert!(pairs > 100, "{pairs} pairs transmit anything");
    // The half vector wi + η wo shrinks to η − 1 of their length. At an index of 1.1 its rounding is ten
    // times larger, and the facet distribution uses its fourth power.
    case(4, "BSDFs by themselves: transmission there = transmission back · η²").worst(worst, 1e-4);
}

#[test]
fn fresnel_is_exact_at_its_edges() {
    let at = |cos: f32, eta: f32| f64::from(fresnel::dielectric(cos, eta).reflectance);
    let exact = |cos: f64, eta: f64| {
        let sin2_t = (1.0 - cos) * (1.0 + cos) / (eta * eta);
        if sin2_t >= 1.0 {
            return 1.0;
        }
        let cos_t = (1.0 - sin2_t).sqrt();
        let (s, p) = ((cos - eta * cos_t) / (cos + eta * cos_t), (eta * cos - cos_t) / (eta * cos + cos_t));
        (s * s + p * p) / 2.0
    };
    let mut worst = 0.0f64;
    for eta in [1.0f32 + f32::EPSILON, 1.0001, 1.33, 1.5, 2.4, 10.0, 0.75, 1.0 / 1.5] {
        for i in 0..=1000 {
            let cos = i as f32 / 1000.0;
            let expected = exact(f64::from(cos), f64::from(eta));
            // The slope is unbounded close to the critical angle; see below.
            let near = ((1.0 - f64::from(cos).powi(2)) / f64::from(eta).powi(2) - 1.0).abs() < 1e-3;
            if !near {
                worst = worst.max((at(cos, eta) - expected).abs());
            }
        }
    }
    // 1 − sin² loses at most ten bits at 1e-3 from the edge.
    case(6, "Fresnel's reflectance against f64, index 0.67 to 10, a thousandth from the edge")
        .worst(worst, 2e-5);
    // Ulp by ulp at the critical angle: never above 1, and within the effect of a few ulps of the cosine.
    let (mut wrong, mut tried) = (0, 0);
    for eta in [1.0f32 / 1.1, 1.0 / 1.5, 1.0 / 2.4, 0.1] {
        let critical = ((1.0 - f64::from(eta)) * (1.0 + f64::from(eta))).sqrt() as f32;
        for step in -100..=100 {
            let cos = |step: i32| f32::from_bits(critical.to_bits().wrapping_add_signed(step));
            let found = at(cos(step), eta);
            // Nine ulps of the cosine cover the rounding of sin²; that of the square root is 1e-6.
            let (highest, lowest) =
                (exact(cos(step - 9).into(), eta.into()), exact(cos(step + 9).into(), eta.into()));
            wrong += u64::from(!(found <= highest.min(1.0) + 1e-6 && found >= lowest - 1e-6 && found <= 1.0));
            tried += 1;
        }
    }
    case(6, "Fresnel's reflectance ulp by ulp over the critical angle, values that cannot be")
        .never(wrong, tried);
    let none = [0.0f32, 1e-7, 0.3, 1.0].iter().filter(|&&cos| at(cos, 1.0) != 0.0).count() as u64;
    case(6, "an interface of index 1 that reflects").never(none, 4);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn a_chosen_direction_has_its_density_and_never_weighs_more_than_it_may(
        height in prop_oneof![4 => 0.0f64..1.0, 1 => 1e-7f64..1e-3],
        alpha in prop_oneof![3 => 0.0f32..1.0, 1 => Just(0.001f32)],
        ior in 1.0f32..3.0,
        kind in 0u32..5,
        u in (0.0f32..1.0, 0.0f32..1.0, 0.0f32..1.0),
    ) {
        let one = Vec3::ONE;
        let bsdf = match kind {
            0 => Bsdf::lambert(one),
            1 => Bsdf::plastic(one, ior, alpha),
            2 => Bsdf::metal(one, alpha),
            3 => Bsdf::pane(ior, one),
            _ => Bsdf::glass(if u.2 < 0.5 { ior } else { 1.0 / ior }, one, alpha),
        };
        let wi = direction(height.max(1e-7), 0.7);
        if let Some(chosen) = bsdf.sample(wi, Vec2::new(u.0, u.1), u.2) {
            prop_assert!((chosen.direction.length() - 1.0).abs() < 1e-5, "{:?}", chosen);
            prop_assert!(chosen.weight.is_finite() && chosen.weight.min_element() >= 0.0, "{:?}", chosen);
            if let Some(density) = chosen.density {
                prop_assert!(density.is_finite() && density > 0.0, "{:?}", chosen);
            }
            // White surfaces: a weight is a share of light over the probability of its lobe. Refraction into
            // a thinner medium compresses light by the squared index. Mixtures of two lobes weigh at most one
            // over the rarer lobe's least share.
            if matches!(kind, 0 | 2 | 3) {
                prop_assert!(chosen.weight.max_element() <= 1.0 + 1e-5, "{:?}", chosen);
            }
            if kind == 4 {
                prop_assert!(chosen.weight.max_element() <= ior * ior * (1.0 + 1e-5), "{:?}", chosen);
            }
        }
        // Other directions: never NaN, never negative.
        for (other, turn) in [(1e-7, 0.0), (0.5, 3.0), (1.0, 0.0)] {
            for side in [1.0, -1.0] {
                let wo = direction(other, turn) * Vec3::new(1.0, 1.0, side);
                let (value, density) = bsdf.light(wi, wo);
                prop_assert!(value.is_finite() && value.min_element() >= 0.0 && density >= 0.0 && !density.is_nan(), "{} {}", value, density);
            }
        }
    }
}
