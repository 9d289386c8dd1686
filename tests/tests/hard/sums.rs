//! Sums and variances that lose digits.

use forelight_forecast::{Calibration, Cost, Observation, Stratum, estimate};
use forelight_tests::case::case;
use forelight_tests::world::{View, World, lambert, material, render};
use forelight_tracer::Settings;
use glam::DVec3;
use proptest::prelude::*;

fn strata(count: u32) -> Vec<Stratum> {
    (0..count).map(|i| Stratum { object: i, material: i, prior_cost: 1.0, apart: false }).collect()
}

fn observe(stratum: u32, work: u64) -> Observation {
    Observation { stratum, cost: Cost { work, cpu_nanos: work, rays: [0; 7] } }
}

#[test]
fn a_tiny_variance_on_a_huge_offset_is_found() {
    // Costs of 10⁹ … 10¹⁷ that differ by one unit. The textbook E[x²] − E[x]² has lost everything at 10⁹.
    let mut worst = 0.0f64;
    for offset in [1_000_000_000u64, 1_000_000_000_000, 1_000_000_000_000_000] {
        let n = 1000u64;
        let observations: Vec<Observation> = (0..n).map(|i| observe(0, offset + i % 2)).collect();
        let found =
            estimate(&strata(1), &[1_000_000], &observations, Calibration::NONE).expect("an estimate");
        // N² (1 − n/N) s²/n with s² = n / (4 (n − 1)). The tail allowance is the squared influence of one
        // pixel half a unit above the mean: (N (1 − n/N) · 0.5 / n)².
        let (n, size) = (n as f64, 1e6);
        let unseen = 1.0 - n / size;
        let sampling = size * size * unseen * (n / (4.0 * (n - 1.0))) / n;
        let allowance = (size * unseen * 0.5 / n).powi(2);
        worst = worst.max((found.total.work.variance / (sampling + allowance) - 1.0).abs());
    }
    // The mean of 10¹⁵ is rounded to 0.125, an eighth of the deviations, so Welford's sum of squares errs by
    // 2⁻⁶ at most.
    case(26, "variance of costs 10⁹ … 10¹⁵ that differ by one unit, relative error").worst(worst, 0.016);
}

#[test]
fn totals_of_whole_frames_are_exact_whatever_their_size() {
    // Complete samples of strata with costs over nineteen orders of magnitude. The total is the exact sum,
    // rounded once for each stratum and each addition, with compensation.
    let costs = [1u64, 3, 1_000_003, 999_999_999_989, 900_000_000_000_000_007, 5, 7];
    let mut exact = 0u128;
    let (mut observations, mut counts) = (Vec::new(), Vec::new());
    for (i, &cost) in costs.iter().enumerate() {
        counts.push(1000 + i as u32);
        for k in 0..1000 + i as u64 {
            observations.push(observe(i as u32, cost + k % 3));
            exact += u128::from(cost + k % 3);
        }
    }
    let found = estimate(&strata(7), &counts, &observations, Calibration::NONE).expect("an estimate");
    case(26, "total of a complete sample over 19 orders of magnitude, relative error")
        .worst((found.total.work.mean / exact as f64 - 1.0).abs(), f64::EPSILON);
    case(26, "variance of a complete sample").worst(found.total.work.variance, 0.0);
}

#[test]
fn a_billion_pixels_of_one_cost_add_up_exactly() {
    // Four strata of 2²⁸ pixels, a billion together. Products of cost and count fit 53 bits.
    let observations: Vec<Observation> = (0..16).map(|i| observe(i % 4, 1_000_003)).collect();
    let found = estimate(&strata(4), &[1 << 28; 4], &observations, Calibration::NONE).expect("an estimate");
    let exact = (1u64 << 30) as f64 * 1_000_003.0;
    case(26, "a billion pixels of one cost, absolute error")
        .worst((found.total.work.mean - exact).abs(), 0.0);
    case(26, "a billion pixels of one cost, width of the interval")
        .worst(found.total.work.p95 - found.total.work.mean, 0.0);
}

#[test]
fn a_pixels_mean_does_not_drift_with_the_number_of_samples() {
    // 65,536 samples of exactly 0.1f32 (a plate that emits). A running sum in f32 would be off by 1e-4.
    let world = World::under(0.0).floor(DVec3::ZERO, 8.0, material(lambert(0.0), 0.1));
    let view = View::new(DVec3::new(0.0, 1.0, 0.0), DVec3::ZERO, 0.1);
    let settings = Settings { width: 1, height: 1, spp: 65_536, ambient_bounces: 0, ..Settings::default() };
    let value = render(&world.frame(view), &settings).pixels[0].color[0];
    case(26, "mean of 65,536 samples of 0.1, ulps").worst((f64::from(value) - f64::from(0.1f32)).abs(), 0.0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn a_complete_sample_of_anything_is_exact(
        works in prop::collection::vec(prop::collection::vec(0u64..=u64::MAX / 4096, 1..40), 1..12),
    ) {
        let counts: Vec<u32> = works.iter().map(|w| w.len() as u32).collect();
        let observations: Vec<Observation> =
            works.iter().zip(0..).flat_map(|(w, i)| w.iter().map(move |&work| observe(i, work))).collect();
        let exact: u128 = works.iter().flatten().map(|&w| u128::from(w)).sum();
        let found = estimate(&strata(works.len() as u32), &counts, &observations, Calibration::NONE).expect("an estimate");
        let error = (found.total.work.mean - exact as f64).abs();
        prop_assert!(error <= 2.0 * f64::EPSILON * exact as f64, "{} against {}", found.total.work.mean, exact);
        prop_assert_eq!(found.total.work.variance, 0.0);
    }
}
