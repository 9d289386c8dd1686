//! Quantiles from past jobs: they hold what they promise, whatever residuals are like.

mod common;

use common::Stream;
use forelight_forecast::{Correction, LEAST_JOBS, Measure, Past, Quantity, residual};
use proptest::prelude::*;

/// Share of many new jobs, and of their frames, that stay below the quantile that `jobs` past ones teach.
fn covered(jobs: usize, p: f64, draw: impl Fn(&mut Stream) -> Vec<f64>) -> f64 {
    let mut stream = Stream::new(jobs as u64);
    let (mut hits, trials) = (0.0, 4000);
    for _ in 0..trials {
        let mut past = Past::default();
        (0..jobs).for_each(|_| past.push(draw(&mut stream)));
        let next = draw(&mut stream);
        let below = |limit: f64| next.iter().filter(|&&z| z <= limit).count() as f64 / next.len() as f64;
        hits += past.quantile(p).map_or(1.0, below);
    }
    hits / f64::from(trials)
}

/// At least as often as promised, and at most 1 / (n + 1) more often; up to four standard errors.
fn holds(jobs: usize, p: f64, draw: impl Fn(&mut Stream) -> Vec<f64>) {
    let found = covered(jobs, p, draw);
    let noise = 4.0 * (p * (1.0 - p) / 4000.0).sqrt();
    assert!(found >= p - noise, "{jobs} jobs, {p}: {found}");
    assert!(found <= p + 1.0 / (jobs + 1) as f64 + noise, "{jobs} jobs, {p}: {found}");
}

#[test]
fn one_residual_a_job_holds_for_light_and_heavy_tails_and_for_biased_forecasts() {
    for jobs in [19, 20, 50] {
        for p in [0.5, 0.8, 0.95] {
            holds(jobs, p, |s| vec![s.normal()]);
            holds(jobs, p, |s| vec![3.0 + 0.1 * s.normal()]);
            holds(jobs, p, |s| vec![s.uniform().powf(-0.7)]);
        }
    }
}

#[test]
fn frames_that_share_their_jobs_error_do_not_make_the_quantile_surer_than_it_is() {
    let job = |s: &mut Stream| -> Vec<f64> {
        let (shared, frames) = (2.0 * s.normal(), 1 + (s.uniform() * 20.0) as usize);
        (0..frames).map(|_| shared + 0.3 * s.normal()).collect()
    };
    for p in [0.5, 0.8] {
        holds(20, p, job);
    }
    // If frames counted as jobs, five jobs would seem to be fifty, and their frames too certain.
    let mut stream = Stream::new(7);
    let mut hits = [0.0; 2];
    for _ in 0..4000 {
        let (mut by_job, mut by_frame) = (Past::default(), Past::default());
        for _ in 0..5 {
            let residuals = job(&mut stream);
            residuals.iter().for_each(|&z| by_frame.push(vec![z]));
            by_job.push(residuals);
        }
        let next = job(&mut stream)[0];
        for (hits, past) in hits.iter_mut().zip([by_job, by_frame]) {
            *hits += f64::from(u8::from(past.quantile(0.8).is_none_or(|limit| next <= limit))) / 4000.0;
        }
    }
    assert!(hits[0] > 0.78 && hits[1] < 0.75, "{hits:?}");
}

#[test]
fn too_few_jobs_say_nothing_of_high_quantiles() {
    let mut past = Past::default();
    for jobs in 1..=LEAST_JOBS {
        past.push(vec![f64::from(jobs as u32), 0.5]);
        assert_eq!(past.correction().is_some(), jobs >= LEAST_JOBS, "{jobs} jobs");
        assert!(past.quantile(0.5).is_some());
    }
    assert_eq!(past.quantile(0.95), Some(19.0));
    past.push(Vec::new());
    past.push(vec![f64::NAN]);
    assert_eq!(past.jobs(), LEAST_JOBS);
}

#[test]
fn what_costs_nothing_teaches_nothing_and_an_endless_error_is_the_worst_of_all() {
    assert_eq!(residual(100.0, 0.1, 100.0), Some(0.0));
    assert!((residual(100.0, 0.1, 110.0).expect("a residual") - 0.953).abs() < 1e-3);
    let none = [(0.0, 0.1, 3.0), (3.0, 0.1, 0.0), (3.0, f64::NAN, 4.0), (3.0, 0.0, 4.0)];
    assert!(none.iter().all(|&(mean, spread, actual)| residual(mean, spread, actual).is_none()));
    let mut past = Past::default();
    (0..30).for_each(|i| past.push(vec![if i < 3 { f64::INFINITY } else { 0.0 }]));
    assert_eq!((past.quantile(0.8), past.quantile(0.95)), (Some(0.0), None));
}

#[test]
fn a_quote_that_was_very_sure_and_a_little_off_does_not_stretch_the_next_one_beyond_reason() {
    // Clocks are off by a fifth, of which the formulas know nothing.
    let sure = quantity(1.0, 0.001, 1e3);
    let z = residual(1.0, sure.spread(Measure::CpuTime), 1.2).expect("a residual");
    let unsure = Correction { p50: 0.0, p80: z, p95: z }.apply(&quantity(1.0, 0.2, 1e3), Measure::CpuTime);
    assert!(unsure.p95 < 2.5, "{}", unsure.p95);
}

fn quantity(mean: f64, deviation: f64, degrees_of_freedom: f64) -> Quantity {
    Quantity {
        mean,
        p50: mean,
        p80: mean,
        p95: mean,
        variance: (mean * deviation).powi(2),
        degrees_of_freedom,
    }
}

proptest! {
    #[test]
    fn corrected_quantiles_are_in_order_and_means_stay(
        mean in 1e-3f64..1e15, deviation in 0.0f64..3.0, freedom in 1.0f64..1e3,
        zs in prop::collection::vec(prop::collection::vec(-30.0f64..30.0, 1..5), LEAST_JOBS..60),
    ) {
        let mut past = Past::default();
        zs.into_iter().for_each(|job| past.push(job));
        let correction = past.correction().expect("enough jobs");
        for measure in [Measure::Work, Measure::CpuTime] {
            let found = correction.apply(&quantity(mean, deviation, freedom), measure);
            prop_assert!(found.p50 > 0.0 && found.p50 <= found.p80 && found.p80 <= found.p95);
            prop_assert_eq!(found.mean, mean);
            prop_assert!(found.p95.is_finite());
        }
    }

    #[test]
    fn a_quantity_moved_by_its_own_residual_is_the_actual(
        mean in 1e-3f64..1e12, deviation in 0.001f64..1.0, freedom in 1.0f64..1e3, factor in 0.5f64..2.0,
    ) {
        let forecast = quantity(mean, deviation, freedom);
        let z = residual(mean, forecast.spread(Measure::Work), mean * factor).expect("a residual");
        let moved = Correction { p50: z, p80: z, p95: z }.apply(&forecast, Measure::Work);
        prop_assert!((moved.p80 / (mean * factor) - 1.0).abs() < 1e-9);
    }
}
