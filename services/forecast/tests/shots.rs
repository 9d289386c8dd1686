//! Whole shots: 48 frames forecast from five.

mod common;

use common::{INTERIOR, LIGHT, Picture, Recipe, cost_of, errors, profile_of};
use forelight_forecast::{
    Calibration, Cost, Expansion, FramePopulation, Observation, ProfiledFrame, RecordStrata, ShotForecast,
    Stratum, choose_frames, forecast_shot,
};

struct Shot {
    pictures: Vec<Picture>,
    frames: Vec<FramePopulation>,
}

impl Shot {
    /// A fifth of the objects move by half the image's width.
    fn new(recipe: Recipe, scene: u64) -> Self {
        let pictures: Vec<Picture> = (0..48u32)
            .map(|t| Picture::new(recipe, scene, scene * 100 + u64::from(t), f64::from(t) / 96.0))
            .collect();
        let frames = (0..)
            .zip(&pictures)
            .map(|(number, p)| FramePopulation {
                number,
                counts: p.counts.clone(),
                lights: 0,
                shining: 0,
                triangles: 0,
            })
            .collect();
        Shot { pictures, frames }
    }

    fn truth(&self) -> f64 {
        self.pictures.iter().map(Picture::truth).sum()
    }

    fn forecast(&self, at_most: usize, samples: u32, seed: u64) -> ShotForecast {
        let strata = &self.pictures[0].strata;
        let chosen = choose_frames(strata, &self.frames, at_most).expect("good frames");
        assert_eq!(chosen.len(), at_most.min(48));
        let observed: Vec<Vec<Observation>> =
            chosen.iter().map(|&t| self.pictures[t].profile(samples, seed, t as i64).1).collect();
        let profiled: Vec<ProfiledFrame<'_>> = chosen
            .iter()
            .zip(&observed)
            .map(|(&frame, observations)| profile_of(frame, observations))
            .collect();
        forecast_shot(strata, &self.frames, &profiled, Calibration::NONE).expect("a forecast")
    }
}

#[test]
fn shots_are_forecast_within_five_percent_and_their_quantiles_hold() {
    let recipe = Recipe { side: 48, objects: 40, ..INTERIOR };
    let (mut totals, mut singles, mut hits) = (Vec::new(), Vec::new(), [0; 2]);
    let scenes = 24;
    for scene in 0..scenes {
        let shot = Shot::new(recipe, scene);
        let forecast = shot.forecast(5, 256, scene);
        let (work, truth) = (forecast.total.work, shot.truth());
        totals.push(work.mean / truth - 1.0);
        hits[0] += u32::from(truth <= work.p80);
        hits[1] += u32::from(truth <= work.p95);
        for (frame, picture) in forecast.frames.iter().zip(&shot.pictures) {
            singles.push(frame.total.work.mean / picture.truth() - 1.0);
        }
        assert!(forecast.job_sigma > 0.001 && forecast.job_sigma < 0.1, "{}", forecast.job_sigma);
        assert!(!forecast.calibrated);
    }
    let (totals, singles) = (errors(&totals), errors(&singles));
    println!("totals {totals:?}, frames {singles:?}, hits {hits:?} of {scenes}");
    assert!(totals.mean_absolute < 0.02);
    assert!(singles.mean_absolute < 0.05);
    // Binomial limits at four standard errors: 24 · 0.8 − 7.8 and 24 · 0.95 − 4.3.
    assert!(hits[0] >= 12 && hits[1] >= 19);
}

#[test]
fn a_shot_that_is_sampled_completely_is_known_exactly() {
    let shot = Shot::new(Recipe { side: 16, objects: 9, ..LIGHT }, 1);
    let forecast = shot.forecast(48, 256, 1);
    let work = forecast.total.work;
    assert_eq!([work.mean, work.p50, work.p80, work.p95, work.variance], {
        let truth = shot.truth();
        [truth, truth, truth, truth, 0.0]
    });
    assert!(forecast.frames.iter().all(|frame| frame.profiled));
    assert_eq!(forecast.job_sigma, 0.0);
}

#[test]
fn more_profiling_narrows_the_quote() {
    let shot = Shot::new(Recipe { side: 48, objects: 20, ..INTERIOR }, 2);
    let width = |frames, samples| {
        let work = shot.forecast(frames, samples, 3).total.work;
        work.p95 / work.mean - 1.0
    };
    assert!(width(10, 256) < width(5, 256));
    assert!(width(5, 512) < width(5, 64));
    assert!(
        width(1, 256) > width(5, 256),
        "one profiled frame cannot show drift, so the prior counts in full"
    );
}

#[test]
fn the_common_error_of_a_job_does_not_average_out() {
    let shot = Shot::new(Recipe { side: 48, objects: 20, ..INTERIOR }, 2);
    let forecast = shot.forecast(5, 64, 3);
    let independent: f64 = forecast.frames.iter().map(|frame| frame.total.work.variance).sum();
    assert!(forecast.total.work.variance > 4.0 * independent);
    let sum_of_p95: f64 = forecast.frames.iter().map(|frame| frame.total.work.p95).sum();
    assert!(forecast.total.work.p95 < sum_of_p95, "nor do all frames reach their P95 at once");
}

fn one_stratum_each(counts: &[[u32; 3]]) -> (Vec<Stratum>, Vec<FramePopulation>) {
    let strata = (0..3).map(|i| Stratum { object: i, material: i, prior_cost: 1.0, apart: false }).collect();
    let frames = (0..)
        .zip(counts)
        .map(|(number, counts)| FramePopulation {
            number,
            counts: counts.to_vec(),
            lights: 0,
            shining: 0,
            triangles: 0,
        })
        .collect();
    (strata, frames)
}

#[test]
fn frames_are_chosen_all_over_the_shot() {
    let (strata, frames) = one_stratum_each(&[[100, 50, 10]; 48]);
    let chosen = choose_frames(&strata, &frames, 5).expect("good frames");
    assert_eq!(chosen.len(), 5);
    assert!(chosen[0] <= 9 && chosen[4] >= 38, "{chosen:?}");
    assert!(chosen.windows(2).all(|pair| (4..=15).contains(&(pair[1] - pair[0]))), "{chosen:?}");
}

#[test]
fn an_object_that_appears_briefly_is_profiled_while_it_is_there() {
    let mut counts = [[1000, 50, 0]; 48];
    (20..23).for_each(|t| counts[t] = [200, 50, 800]);
    let (strata, frames) = one_stratum_each(&counts);
    let chosen = choose_frames(&strata, &frames, 3).expect("good frames");
    assert!(chosen.iter().any(|t| (20..23).contains(t)), "{chosen:?}");
}

#[test]
fn long_shots_and_generous_limits_are_no_trouble() {
    let (strata, frames) = one_stratum_each(&[[10, 5, 1]; 1000]);
    assert_eq!(choose_frames(&strata, &frames, 4).expect("good frames").len(), 4);
    assert_eq!(choose_frames(&strata, &frames[..3], 5).expect("good frames"), [0, 1, 2]);
    assert!(choose_frames(&strata, &frames, 0).expect("good frames").is_empty());
    assert!(choose_frames(&strata, &[], 5).expect("no frames").is_empty());
}

#[test]
fn an_object_that_vanishes_takes_its_cost_with_it() {
    let (strata, frames) = one_stratum_each(&[[900, 100, 0], [1000, 0, 0], [1000, 0, 0]]);
    let observed: Vec<Observation> = (0..40)
        .map(|i| Observation {
            stratum: u32::from(i >= 20),
            cost: cost_of(if i >= 20 { 5000.0 } else { 10.0 }),
        })
        .collect();
    let profiled = [ProfiledFrame {
        frame: 0,
        observations: &observed,
        expansion: &Expansion::Groups,
        fixed: Cost { work: 7, ..Cost::default() },
        build: Cost::default(),
    }];
    let found = forecast_shot(&strata, &frames, &profiled, Calibration::NONE).expect("a forecast");
    assert_eq!(found.frames[0].total.work.mean, 900.0 * 10.0 + 100.0 * 5000.0 + 7.0);
    assert!((found.frames[2].total.work.mean - 10_007.0).abs() < 1e-6);
    assert_eq!(found.borrowed, 0);
}

#[test]
fn an_object_that_no_profiled_frame_shows_borrows_and_widens_the_quote() {
    let (mut strata, frames) = one_stratum_each(&[[1000, 0, 0], [500, 0, 500]]);
    strata[2].material = 0;
    let observed: Vec<Observation> =
        (0..40).map(|_| Observation { stratum: 0, cost: cost_of(10.0) }).collect();
    let profiled = [profile_of(0, &observed)];
    let found = forecast_shot(&strata, &frames, &profiled, Calibration::NONE).expect("a forecast");
    assert_eq!(found.borrowed, 1);
    assert!((found.frames[1].total.work.mean - 10_000.0).abs() < 1e-6);
    assert!(found.frames[1].strata[2].borrowed);
    assert!(found.frames[1].total.work.p80 > 11_000.0);
}

#[test]
fn unit_costs_follow_a_trend_between_profiled_frames() {
    let (strata, frames) = one_stratum_each(&[[100_000, 0, 0]; 11]);
    let observed = |work: f64| -> Vec<Observation> {
        (0..4000).map(|_| Observation { stratum: 0, cost: cost_of(work) }).collect()
    };
    let (early, late) = (observed(1000.0), observed(2000.0));
    let profiled = [profile_of(10, &late), profile_of(0, &early)];
    let found = forecast_shot(&strata, &frames, &profiled, Calibration::NONE).expect("a forecast");
    let unit = |t: usize| found.frames[t].total.work.mean / 100_000.0;
    assert_eq!((unit(0), unit(10)), (1000.0, 2000.0));
    assert!((unit(5) - 1500.0).abs() < 1.0);
    assert!((unit(2) - 1200.0).abs() < 25.0, "{}", unit(2));
    assert!(found.frames[5].total.work.variance > found.frames[1].total.work.variance);
}

/// Forecast of a shot with `records` of a cache, some gathered at the works given by level.
fn with_records(shot: &Shot, records: &[&[u32]], works: &[&[f64]]) -> ShotForecast {
    let (mut strata, mut frames) = (shot.pictures[0].strata.clone(), shot.frames.clone());
    let apart = RecordStrata::add(&mut strata, &mut frames, records, 20.0);
    let observed: Vec<Vec<Observation>> = [8, 40]
        .map(|t: usize| {
            let pixels = shot.pictures[t].profile(256, 3, t as i64).1;
            let gathered = works.iter().zip(0..).flat_map(|(works, level)| {
                works.iter().map(move |work| apart.observation(level, cost_of(*work)))
            });
            pixels.into_iter().chain(gathered).collect()
        })
        .to_vec();
    let profiled =
        [(8, &observed[0]), (40, &observed[1])].map(|(frame, observations)| profile_of(frame, observations));
    forecast_shot(&strata, &frames, &profiled, Calibration::NONE).expect("a forecast")
}

#[test]
fn a_known_number_of_records_times_what_one_takes_is_added_and_pixels_are_forecast_as_without() {
    let shot = Shot::new(Recipe { side: 32, objects: 30, ..INTERIOR }, 4);
    let mut counts = vec![[1000, 200]; 48];
    counts[8] = [5000, 100];
    counts[9] = [4000, 0];
    let records: Vec<&[u32]> = counts.iter().map(|frame| &frame[..]).collect();
    let without = with_records(&shot, &[], &[]);
    let same = with_records(&shot, &records, &[&[3e5; 48], &[1e5; 48]]);
    for (t, (without, with)) in without.frames.iter().zip(&same.frames).enumerate() {
        let expected =
            without.total.work.mean + 3e5 * f64::from(counts[t][0]) + 1e5 * f64::from(counts[t][1]);
        let found = with.total.work.mean;
        assert!((found / expected - 1.0).abs() < 1e-9, "frame {t}: {found} for {expected}");
        assert_eq!(with.strata[..without.strata.len()], without.strata[..], "frame {t}");
        assert!(with.total.work.p95 > found);
    }
    let spread: Vec<f64> = (0..48).map(|i| 3e5 + 4e4 * f64::from(i % 7 - 3)).collect();
    let noisy = with_records(&shot, &records, &[&spread, &[1e5; 48]]);
    assert!(noisy.frames[8].total.work.variance > 10.0 * same.frames[8].total.work.variance);
}

#[test]
fn records_of_a_level_that_was_not_sampled_borrow_from_another_level_and_never_from_pixels() {
    let shot = Shot::new(Recipe { side: 32, objects: 30, ..INTERIOR }, 4);
    let records: Vec<&[u32]> =
        (0..48).map(|t| if t == 20 { &[100, 50][..] } else { &[100, 0][..] }).collect();
    let found = with_records(&shot, &records, &[&[3e5; 48], &[]]);
    let level_one = found.frames[20].strata.last().expect("strata");
    assert!(level_one.borrowed && (level_one.mean.work / 3e5 - 1.0).abs() < 1e-9, "{level_one:?}");
    assert!(found.frames[20].total.work.p95 > found.frames[20].total.work.mean + 50.0 * 1e5);
}

#[test]
fn records_of_which_none_was_gathered_are_an_error_and_not_a_guess() {
    let (mut strata, mut frames) = one_stratum_each(&[[1000, 0, 0]]);
    RecordStrata::add(&mut strata, &mut frames, &[&[50]], 20.0);
    let observed = [Observation { stratum: 0, cost: cost_of(10.0) }];
    let profiled = [profile_of(0, &observed)];
    let refused = forecast_shot(&strata, &frames, &profiled, Calibration::NONE);
    assert_eq!(refused, Err(forelight_forecast::ForecastError::NoSamples));
}

#[test]
fn a_tree_costs_by_the_triangles_of_its_frame_whoever_was_profiled() {
    let strata = [Stratum::background(1.0)];
    let triangles = [100, 100, 9000, 50, 100];
    let frames: Vec<FramePopulation> = (0..)
        .zip(triangles)
        .map(|(number, triangles)| FramePopulation {
            number,
            counts: vec![4],
            lights: 0,
            shining: 0,
            triangles,
        })
        .collect();
    let observations = [1.0; 4].map(|work| Observation { stratum: 0, cost: cost_of(work) });
    let profiled = [0, 4].map(|frame| ProfiledFrame {
        frame,
        observations: &observations,
        expansion: &Expansion::Groups,
        fixed: Cost { work: 7, ..Cost::default() },
        build: Cost { work: 3000, ..Cost::default() },
    });
    let forecast = forecast_shot(&strata, &frames, &profiled, Calibration::NONE).expect("a forecast");
    let work = forecast.frames.iter().map(|frame| frame.total.work.mean);
    for (work, truth) in work.zip([3011.0, 3011.0, 270_011.0, 1511.0, 3011.0]) {
        assert!((work / truth - 1.0).abs() < 1e-12, "{work} in place of {truth}");
    }
}

#[test]
fn a_frame_under_lights_that_were_never_profiled_costs_like_one_under_others_not_like_a_dark_one() {
    let strata = [Stratum::background(1.0)];
    // A lamp of its own in every second frame: 10 a pixel, 1 in the dark.
    let frames: Vec<FramePopulation> = (0..12)
        .map(|number| {
            let is_lit = number % 2 == 1;
            let (lights, shining) = if is_lit { (number as u32, 1) } else { (0, 0) };
            FramePopulation { number, counts: vec![100], lights, shining, triangles: 0 }
        })
        .collect();
    let chosen = choose_frames(&strata, &frames, 2).expect("frames");
    assert_eq!(chosen.iter().map(|frame| frame % 2).sum::<usize>(), 1, "{chosen:?}");
    let of = |work: f64| [1.0; 100].map(|_| Observation { stratum: 0, cost: cost_of(work) });
    let observations = [of(1.0), of(10.0)];
    let profiled = chosen.iter().map(|&frame| profile_of(frame, &observations[frame % 2]));
    let profiled: Vec<ProfiledFrame<'_>> = profiled.collect();
    let forecast = forecast_shot(&strata, &frames, &profiled, Calibration::NONE).expect("a forecast");
    for frame in &forecast.frames {
        let truth = if frame.number % 2 == 1 { 1000.0 } else { 100.0 };
        let work = frame.total.work;
        assert!((work.mean / truth - 1.0).abs() < 1e-9, "frame {}: {work:?}", frame.number);
        // Another lamp may well bring a third more.
        let is_unknown = frame.number % 2 == 1 && !frame.profiled;
        assert!(!is_unknown || work.p95 > 1.33 * truth, "frame {}: {work:?}", frame.number);
    }
    let total = forecast.total.work;
    assert!((total.mean / 6600.0 - 1.0).abs() < 1e-9 && total.p95 > 1.2 * 6600.0, "{total:?}");
}
