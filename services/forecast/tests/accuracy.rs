//! Error, bias and coverage on synthetic pictures whose true cost is known.

mod common;

use common::{Errors, INTERIOR, LIGHT, Picture, Recipe, Stream, TAILED, errors};
use forelight_forecast::{Calibration, FrameDesign, estimate};

const TRIALS: u64 = 240;
const SAMPLES: u32 = 256;

struct Outcome {
    errors: Errors,
    /// Share of trials whose truth is at most the P80 and the P95.
    hits: [f64; 2],
}

fn run(recipe: Recipe, calibration: Calibration) -> Outcome {
    let mut relative = Vec::new();
    let mut hits = [0.0; 2];
    for trial in 0..TRIALS {
        let picture = Picture::new(recipe, trial / 4, trial, 0.0);
        let (_, observations) = picture.profile(SAMPLES, 1000 + trial, 0);
        let estimate =
            estimate(&picture.strata, &picture.counts, &observations, calibration).expect("an estimate");
        let (work, truth) = (estimate.total.work, picture.truth());
        relative.push(work.mean / truth - 1.0);
        hits[0] += f64::from(u8::from(truth <= work.p80)) / TRIALS as f64;
        hits[1] += f64::from(u8::from(truth <= work.p95)) / TRIALS as f64;
    }
    Outcome { errors: errors(&relative), hits }
}

/// Four standard errors of a share of `TRIALS` trials: fails once in ten thousand runs of other seeds.
fn slack(share: f64) -> f64 {
    4.0 * (share * (1.0 - share) / TRIALS as f64).sqrt()
}

fn small(recipe: Recipe) -> Recipe {
    Recipe { side: 64, ..recipe }
}

#[test]
fn an_interior_is_forecast_within_four_percent_and_its_quantiles_hold() {
    let outcome = run(small(INTERIOR), Calibration { inflation: 1.0, calibrated: false });
    println!("interior: {:?}, hits {:?}", outcome.errors, outcome.hits);
    assert!(outcome.errors.mean_absolute < 0.03);
    assert!(outcome.errors.bias.abs() < 0.01);
    for (found, promised) in outcome.hits.into_iter().zip([0.80, 0.95]) {
        assert!((found - promised).abs() < slack(promised), "{found} of P{:.0}", promised * 100.0);
    }
}

#[test]
fn light_tailed_noise_is_forecast_within_four_percent_and_uncalibrated_quantiles_hold_at_least_what_they_promise()
 {
    let outcome = run(small(LIGHT), Calibration::NONE);
    println!("light: {:?}, hits {:?}", outcome.errors, outcome.hits);
    assert!(outcome.errors.mean_absolute < 0.04);
    assert!(outcome.errors.bias.abs() < 0.015, "the bias of adaptive allocation is small");
    for (found, promised) in outcome.hits.into_iter().zip([0.80, 0.95]) {
        assert!(found > promised - slack(promised), "{found} of P{:.0}", promised * 100.0);
    }
    assert!(outcome.hits[0] < 0.97, "an interval that always holds says nothing");
}

#[test]
fn heavy_tails_are_reported_and_bounded() {
    let outcome = run(small(TAILED), Calibration::NONE);
    println!("tailed: {:?}, hits {:?}", outcome.errors, outcome.hits);
    // Pixels of 10 to 40 times the cost, 1 to 5 % of some materials: no interval from 256 samples is honest
    // here, which is why such pixels must be made strata of their own.
    assert!(outcome.errors.mean_absolute < 0.15);
    assert!(outcome.hits[1] > 0.6);
}

#[test]
fn strata_beat_scattered_samples() {
    let recipe = small(INTERIOR);
    let stratified = run(recipe, Calibration::NONE).errors.root_mean_square;
    let scattered: Vec<f64> = (0..TRIALS)
        .map(|trial| {
            let picture = Picture::new(recipe, trial / 4, trial, 0.0);
            let mut stream = Stream::new(trial + 5000);
            let pixels = picture.costs.len() as f64;
            let sum: u64 =
                (0..SAMPLES).map(|_| picture.costs[(stream.uniform() * pixels) as usize].work).sum();
            sum as f64 / f64::from(SAMPLES) * pixels / picture.truth() - 1.0
        })
        .collect();
    let scattered = errors(&scattered).root_mean_square;
    assert!(stratified < 0.7 * scattered, "{stratified} against {scattered}");
}

#[test]
fn picks_that_are_not_placed_by_cost_are_unbiased() {
    // Few objects, so that every stratum is a group whatever the number of samples.
    let recipe = Recipe { objects: 6, ..small(LIGHT) };
    let picture = Picture::new(recipe, 3, 3, 0.0);
    let relative: Vec<f64> = (0..600)
        .map(|seed| {
            let design = FrameDesign::new(&picture.strata, &picture.ids, picture.side, 40, seed, 0);
            let first = picture.observe(&design.expect("a good image").first_phase());
            let found =
                estimate(&picture.strata, &picture.counts, &first, Calibration::NONE).expect("an estimate");
            found.total.cpu_nanos.mean / picture.truth() / 3.0 - 1.0
        })
        .collect();
    let errors = errors(&relative);
    assert!(errors.bias.abs() < 4.0 * errors.bias_error, "{errors:?}");
}
