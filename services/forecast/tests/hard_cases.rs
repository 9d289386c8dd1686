//! Cases in which a careless forecast divides by zero, invents numbers, or says more than it knows.

mod common;

use common::{INTERIOR, LIGHT, Picture, Recipe, cost_of, profile_of};
use forelight_forecast::{
    Calibration, Cost, Costs, ForecastError, FrameDesign, FramePopulation, Observation, ProfiledFrame,
    Quantity, Stratum, choose_frames, estimate, forecast_shot,
};
use proptest::prelude::*;

fn strata(n: u32) -> Vec<Stratum> {
    (0..n).map(|i| Stratum { object: i, material: i % 3, prior_cost: 1.0, apart: false }).collect()
}

fn observe(stratum: u32, work: u64) -> Observation {
    Observation { stratum, cost: cost_of(work as f64) }
}

fn all(costs: &Costs<Quantity>) -> Vec<Quantity> {
    let mut list = vec![costs.work, costs.cpu_nanos, costs.all_rays];
    list.extend(costs.rays);
    list
}

fn assert_sound(costs: &Costs<Quantity>) {
    for q in all(costs) {
        for value in [q.mean, q.p50, q.p80, q.p95, q.variance] {
            assert!(value.is_finite() && value >= 0.0, "{q:?}");
        }
        assert!(q.p50 <= q.p80 && q.p80 <= q.p95, "{q:?}");
        assert!(q.degrees_of_freedom >= 1.0, "{q:?}");
    }
}

fn assert_exact(q: &Quantity, truth: f64) {
    assert_eq!([q.mean, q.p50, q.p80, q.p95, q.variance], [truth, truth, truth, truth, 0.0]);
}

#[test]
fn a_scene_of_constant_cost_is_forecast_exactly() {
    let counts = [1000, 30, 1];
    let observations: Vec<Observation> = [0, 0, 0, 0, 0, 0, 0, 1, 1].map(|h| observe(h, 700)).to_vec();
    let found = estimate(&strata(3), &counts, &observations, Calibration::NONE).expect("an estimate");
    assert_exact(&found.total.work, 700.0 * 1031.0);
}

#[test]
fn rays_that_every_pixel_has_are_known_of_frames_that_were_not_profiled() {
    // One camera ray a pixel; other rays are as many as there is work.
    let strata = strata(2);
    let frame = |number| {
        let counts = vec![400 + 20 * number as u32, 600 - 20 * number as u32];
        FramePopulation { number, counts, lights: 0, shining: 0, triangles: 0 }
    };
    let frames: Vec<FramePopulation> = (0..6).map(frame).collect();
    let observations: Vec<Vec<Observation>> = [0u64, 2, 5]
        .map(|t| (0..40).map(|i| observe((i % 2) as u32, 1000 + 50 * t + 37 * (i % 7))).collect())
        .to_vec();
    let profiled: Vec<ProfiledFrame> = [0, 2, 5]
        .into_iter()
        .zip(&observations)
        .map(|(frame, observations)| profile_of(frame, observations))
        .collect();
    let found = forecast_shot(&strata, &frames, &profiled, Calibration::NONE).unwrap();
    for frame in &found.frames {
        assert_exact(&frame.total.rays[0], 1000.0);
        assert!(frame.total.rays[1].p95 > frame.total.rays[1].p50, "{:?}", frame.total.rays[1]);
    }
    assert_exact(&found.total.rays[0], 6000.0);
}

#[test]
fn a_complete_sample_gives_the_exact_total_with_no_interval() {
    let picture = Picture::new(Recipe { side: 32, ..INTERIOR }, 1, 1, 0.0);
    let (picks, observations) = picture.profile(5000, 9, 0);
    let mut pixels: Vec<u32> = picks.iter().map(|p| p.pixel).collect();
    pixels.sort_unstable();
    assert!(pixels.into_iter().eq(0..32 * 32), "every pixel once");
    let found =
        estimate(&picture.strata, &picture.counts, &observations, Calibration::NONE).expect("an estimate");
    assert_exact(&found.total.work, picture.truth());
    assert_exact(&found.total.rays[0], 1024.0);
    assert_eq!(found.borrowed, 0);
}

#[test]
fn a_stratum_that_is_sampled_completely_adds_its_sum_and_no_variance() {
    let counts = [3, 100_000];
    let mut observations: Vec<Observation> = [5, 90_000, 17].map(|work| observe(0, work)).to_vec();
    // Enough samples that the three pixels are a group of their own.
    observations.extend((0..20_000).map(|_| observe(1, 10)));
    let strata = [
        Stratum { object: 0, material: 0, prior_cost: 1.0, apart: false },
        Stratum { object: 1, material: 1, prior_cost: 1.0, apart: false },
    ];
    let found = estimate(&strata, &counts, &observations, Calibration::NONE).expect("an estimate");
    assert_exact(&found.total.work, 90_022.0 + 1_000_000.0);
}

#[test]
fn nothing_measured_is_an_error_and_not_a_number() {
    let found = estimate(&strata(2), &[10, 10], &[], Calibration::NONE);
    assert_eq!(found, Err(ForecastError::NoSamples));
}

#[test]
fn an_empty_frame_costs_nothing() {
    let found = estimate(&strata(2), &[0, 0], &[], Calibration::NONE).expect("nothing is known exactly");
    assert_exact(&found.total.work, 0.0);
}

#[test]
fn one_sample_gives_a_wide_interval_that_says_it_is_borrowed() {
    let found = estimate(&strata(1), &[1000], &[observe(0, 50)], Calibration::NONE).expect("an estimate");
    assert_eq!(found.total.work.mean, 50_000.0);
    assert_eq!(found.borrowed, 1);
    assert!(found.total.work.p95 > 3.0 * found.total.work.mean);
    assert_sound(&found.total);
}

#[test]
fn unsampled_strata_borrow_from_their_material_first() {
    let strata = [0, 0, 1, 1].map(|material| Stratum { object: 0, material, prior_cost: 1.0, apart: false });
    let mut observations: Vec<Observation> = (0..40).map(|_| observe(0, 100)).collect();
    observations.extend((0..40).map(|_| observe(2, 9000)));
    let found =
        estimate(&strata, &[500, 500, 500, 500], &observations, Calibration::NONE).expect("an estimate");
    assert_eq!(found.borrowed, 2);
    assert!((found.strata[1].mean.work - 100.0).abs() < 1e-9);
    assert!((found.strata[3].mean.work - 9000.0).abs() < 1e-9);
    assert!(found.strata[1].borrowed && !found.strata[0].borrowed);
    assert!(found.total.work.p80 > found.total.work.mean, "what is borrowed is not certain");
}

#[test]
fn strata_add_up_to_the_frame() {
    let picture = Picture::new(Recipe { side: 64, ..LIGHT }, 2, 2, 0.0);
    let (_, observations) = picture.profile(100, 4, 0);
    let found =
        estimate(&picture.strata, &picture.counts, &observations, Calibration::NONE).expect("an estimate");
    let by_stratum: f64 = found.strata.iter().map(|s| f64::from(s.pixels) * s.mean.work).sum();
    assert!((by_stratum / found.total.work.mean - 1.0).abs() < 1e-12);
    assert_eq!(found.strata.iter().map(|s| s.samples).sum::<u32>(), 100);
}

#[test]
fn wrong_input_is_named() {
    let strata = strata(2);
    let twice = [observe(0, 1), observe(0, 1)];
    let calibration = Calibration::NONE;
    assert_eq!(
        estimate(&strata, &[1, 5], &twice, calibration),
        Err(ForecastError::MoreSamplesThanPixels { stratum: 0, samples: 2, pixels: 1 })
    );
    assert_eq!(
        estimate(&strata, &[1, 5], &[observe(7, 1)], calibration),
        Err(ForecastError::UnknownStratum { stratum: 7, strata: 2 })
    );
    assert_eq!(
        estimate(&strata, &[1], &[], calibration),
        Err(ForecastError::CountsLength { frame: 0, counts: 1, strata: 2 })
    );
    let bad = [Stratum { object: 0, material: 0, prior_cost: f64::NAN, apart: false }];
    assert_eq!(estimate(&bad, &[1], &[], calibration), Err(ForecastError::BadPriorCost { stratum: 0 }));
    assert!(matches!(
        FrameDesign::new(&strata, &[0, 1, 0], 2, 2, 0, 0),
        Err(ForecastError::ImageShape { pixels: 3, width: 2 })
    ));
    assert!(matches!(FrameDesign::new(&strata, &[0], 0, 2, 0, 0), Err(ForecastError::ImageShape { .. })));
    assert!(matches!(FrameDesign::new(&strata, &[9], 1, 2, 0, 0), Err(ForecastError::UnknownStratum { .. })));
    let frame = |number| FramePopulation { number, counts: vec![1, 1], lights: 0, shining: 0, triangles: 0 };
    assert_eq!(choose_frames(&strata, &[frame(4), frame(4)], 1), Err(ForecastError::FrameOrder { frame: 4 }));
    let profiled = |frame| profile_of(frame, &twice[..1]);
    assert_eq!(
        forecast_shot(&strata, &[frame(1)], &[profiled(0), profiled(0)], calibration),
        Err(ForecastError::ProfiledFrame { index: 0 })
    );
    assert_eq!(forecast_shot(&strata, &[frame(1)], &[], calibration), Err(ForecastError::NoSamples));
}

#[test]
fn a_design_repeats_itself_and_another_seed_or_frame_gives_another() {
    let picture = Picture::new(Recipe { side: 64, ..LIGHT }, 2, 2, 0.0);
    let picks = |seed, frame| picture.profile(64, seed, frame).0;
    assert_eq!(picks(1, 0), picks(1, 0));
    assert_ne!(picks(1, 0), picks(2, 0));
    assert_ne!(picks(1, 0), picks(1, 1));
}

#[test]
fn the_order_of_observations_does_not_matter_to_the_second_phase() {
    let picture = Picture::new(Recipe { side: 64, ..LIGHT }, 2, 2, 0.0);
    let design = FrameDesign::new(&picture.strata, &picture.ids, 64, 200, 5, 0).expect("a good image");
    let mut first = picture.observe(&design.first_phase());
    let second = design.second_phase(&first).expect("picks");
    first.reverse();
    assert_eq!(design.second_phase(&first).expect("picks"), second);
}

proptest! {
    #[test]
    fn no_input_gives_a_number_that_is_none(
        pixels in prop::collection::vec(0u32..12, 1..300),
        samples in 0u32..400,
        works in prop::collection::vec(prop_oneof![Just(0u64), 1u64..1000, Just(u64::MAX)], 300),
        seed in any::<u64>(),
    ) {
        let strata = strata(12);
        let width = pixels.len() as u32;
        let design = FrameDesign::new(&strata, &pixels, width, samples, seed, i64::MIN).expect("a good image");
        let observe = |picks: &[forelight_forecast::Pick]| -> Vec<Observation> {
            picks.iter().map(|p| {
                let work = works[p.pixel as usize];
                Observation { stratum: p.stratum, cost: Cost { work, cpu_nanos: work, rays: [work; 7] } }
            }).collect()
        };
        let mut picks = design.first_phase();
        picks.extend(design.second_phase(&observe(&picks)).expect("picks"));
        let mut places: Vec<u32> = picks.iter().map(|p| p.pixel).collect();
        places.sort_unstable();
        places.dedup();
        prop_assert_eq!(places.len(), samples.min(width) as usize, "no pixel twice, and as many as asked for");
        match estimate(&strata, design.counts(), &observe(&picks), Calibration::NONE) {
            Ok(found) => assert_sound(&found.total),
            Err(error) => prop_assert_eq!((error, samples), (ForecastError::NoSamples, 0)),
        }
    }
}
