//! The strategies side by side: what holds for every one of them, and what each promises.

mod common;

use common::{INTERIOR, LIGHT, Picture, Recipe, cost_of, errors};
use forelight_forecast::{
    Calibration, Cost, Expansion, ForecastError, FramePopulation, Pick, ProfiledFrame, Quantity,
    RecordStrata, Strategy, Stratum, forecast_shot,
};
use proptest::prelude::{Just, any, prop, prop_assert, prop_assert_eq, prop_oneof, proptest};

fn strata(n: u32) -> Vec<Stratum> {
    (0..n).map(|i| Stratum { object: i, material: i % 3, prior_cost: 1.0, apart: false }).collect()
}

/// Estimate of the work of an image by a strategy; none if it took no samples.
fn work(
    strategy: Strategy,
    ids: &[u32],
    width: u32,
    samples: u32,
    seed: u64,
    cost: impl Fn(u32) -> Cost,
) -> Option<(Quantity, Vec<Pick>)> {
    let strata = strata(ids.iter().max().map_or(1, |&most| most + 1));
    let design = strategy.design(&strata, ids, width, samples, seed, 0).expect("a good image");
    let (picks, observations) = design.profile(cost).expect("observations of this design");
    match design.estimate(&observations, Calibration::NONE) {
        Ok(found) => Some((found.total.work, picks)),
        Err(error) => {
            assert_eq!((error, picks.len()), (ForecastError::NoSamples, 0));
            None
        }
    }
}

#[test]
fn a_picture_of_one_object_and_constant_cost_is_exact_for_any_number_of_samples() {
    for strategy in Strategy::ALL {
        for samples in [1, 2, 3, 7, 64, 255] {
            let found = work(strategy, &[0; 256], 16, samples, 5, |_| cost_of(700.0));
            let (found, _) = found.expect("an estimate");
            let error = (found.mean / (256.0 * 700.0) - 1.0).abs();
            assert!(error < 1e-12, "{strategy:?} with {samples}: {found:?}");
            if samples > 1 {
                assert_eq!((found.variance, found.p95), (0.0, found.mean), "{strategy:?} with {samples}");
            }
        }
    }
}

#[test]
fn objects_of_one_pixel_and_more_objects_than_samples_are_no_trouble() {
    let ids: Vec<u32> = (0..144).collect();
    for strategy in Strategy::ALL {
        for samples in [1, 2, 16, 100, 143] {
            let cost = |pixel: u32| cost_of(f64::from(100 + pixel % 12));
            let (found, picks) = work(strategy, &ids, 12, samples, 3, cost).expect("an estimate");
            assert!(picks.len() <= samples as usize && !picks.is_empty());
            assert!((found.mean / (144.0 * 105.5) - 1.0).abs() < 0.06, "{strategy:?}, {samples}: {found:?}");
        }
    }
}

#[test]
fn a_black_picture_costs_nothing_for_certain() {
    for strategy in Strategy::ALL {
        let (found, _) = work(strategy, &[0; 64], 8, 16, 1, |_| Cost::default()).expect("an estimate");
        assert_eq!([found.mean, found.p95, found.variance], [0.0; 3], "{strategy:?}");
    }
}

#[test]
fn an_image_of_no_rows_has_no_picks_and_costs_nothing() {
    for strategy in Strategy::ALL {
        let design = strategy.design(&strata(2), &[], 8, 16, 1, 0).expect("an image, if a small one");
        let (picks, observations) = design.profile(|_| Cost::default()).expect("none");
        assert!(picks.is_empty() && observations.is_empty());
        let found = design.estimate(&[], Calibration::NONE).expect("nothing is known exactly");
        assert_eq!(found.total.work.mean, 0.0, "{strategy:?}");
    }
}

#[test]
fn a_wrong_image_is_refused_by_every_strategy_alike() {
    for strategy in Strategy::ALL {
        let design = |ids: &[u32], width| strategy.design(&strata(2), ids, width, 4, 0, 0).err();
        assert_eq!(design(&[0, 1, 0], 2), Some(ForecastError::ImageShape { pixels: 3, width: 2 }));
        assert_eq!(design(&[0], 0), Some(ForecastError::ImageShape { pixels: 1, width: 0 }));
        assert_eq!(design(&[9], 1), Some(ForecastError::UnknownStratum { stratum: 9, strata: 2 }));
    }
}

#[test]
fn areas_that_are_not_those_of_the_observations_are_refused() {
    let design = Strategy::RandomArea.design(&strata(1), &[0; 64], 8, 5, 0, 0).expect("a good image");
    let (_, mut observations) = design.profile(|_| cost_of(9.0)).expect("costs");
    observations.pop();
    let refused = design.estimate(&observations, Calibration::NONE);
    assert_eq!(refused, Err(ForecastError::Areas { areas: 5, covered: 64, observations: 4, pixels: 64 }));
}

#[test]
fn random_pixels_are_the_same_with_and_without_areas() {
    let picks = |strategy: Strategy| {
        strategy.design(&strata(1), &[0; 4096], 64, 50, 8, 3).expect("a good image").first_phase()
    };
    assert_eq!(picks(Strategy::Random), picks(Strategy::RandomArea));
}

#[test]
fn a_pixel_counts_for_the_area_that_is_nearest_to_it() {
    // A plain slope: areas mostly correct for where random pixels happen to be.
    let cost = |pixel: u32| cost_of(1000.0 + 100.0 * f64::from(pixel % 64));
    let truth: f64 = (0..4096).map(|pixel| cost(pixel).work as f64).sum();
    let error = |strategy| {
        let square = |seed| {
            let (found, _) = work(strategy, &[0; 4096], 64, 64, seed, cost).expect("an estimate");
            (found.mean / truth - 1.0).powi(2)
        };
        ((0..200).map(square).sum::<f64>() / 200.0).sqrt()
    };
    let (flat, by_area) = (error(Strategy::Random), error(Strategy::RandomArea));
    assert!(by_area < 0.5 * flat, "{by_area} against {flat}");
}

#[test]
fn only_seed_zero_leaves_the_papers_points_where_they_are() {
    let design = |strategy: Strategy, seed| {
        strategy.design(&strata(1), &[0; 65_536], 256, 256, seed, 7).expect("a good image").first_phase()
    };
    for strategy in [Strategy::RegularGrid, Strategy::Halton, Strategy::Hammersley] {
        assert_ne!(design(strategy, 1), design(strategy, 2));
        assert_eq!(design(strategy, 1), design(strategy, 1));
    }
    let x = |pick: &Pick| pick.pixel % 256;
    assert!(design(Strategy::RegularGrid, 0).iter().all(|pick| x(pick) % 16 == 8));
    assert_eq!(design(Strategy::Halton, 0)[1], Pick { pixel: 256 / 7 * 256 + 128, stratum: 0 });
    assert_eq!(x(&design(Strategy::Hammersley, 0)[3]), 3);
}

#[test]
fn the_papers_snapshot_is_pixels_of_an_object_times_its_mean_cost() {
    let ids: Vec<u32> = (0..1000).map(|pixel| u32::from(pixel >= 900)).collect();
    let design = Strategy::PaperSnapshot.design(&strata(2), &ids, 100, 20, 1, 0).expect("a good image");
    let (picks, observations) = design.profile(|pixel| cost_of(f64::from(pixel))).expect("costs");
    let mean = |stratum| {
        let own = || picks.iter().filter(|pick| pick.stratum == stratum);
        own().map(|pick| f64::from(pick.pixel.max(1))).sum::<f64>() / own().count() as f64
    };
    let found = design.estimate(&observations, Calibration::NONE).expect("an estimate");
    let expected = 900.0 * mean(0) + 100.0 * mean(1);
    assert!((found.total.work.mean / expected - 1.0).abs() < 1e-12);
}

/// Relative errors over many seeds of one recipe, and the mean of the estimated variances.
fn trials(strategy: Strategy, recipe: Recipe, picture: u64, trials: u64) -> (Vec<f64>, f64) {
    let picture = Picture::new(recipe, picture, picture, 0.0);
    let truth = picture.truth();
    let mut variances = 0.0;
    let relative = (1..=trials)
        .map(|seed| {
            let design = strategy
                .design(&picture.strata, &picture.ids, picture.side, 256, seed, 0)
                .expect("a picture");
            let (_, observations) = design.profile(|pixel| picture.costs[pixel as usize]).expect("costs");
            let found = design.estimate(&observations, Calibration::NONE).expect("an estimate").total.work;
            variances += found.variance / truth / truth / trials as f64;
            found.mean / truth - 1.0
        })
        .collect();
    (relative, variances)
}

#[test]
fn no_strategy_but_ours_and_the_area_weights_is_biased_at_all_and_these_are_hardly() {
    let recipe = Recipe { side: 64, ..INTERIOR };
    for strategy in Strategy::ALL {
        let found = errors(&trials(strategy, recipe, 4, 400).0);
        println!("{strategy:?}: {found:?}");
        let allowed = match strategy {
            Strategy::Snapshot | Strategy::RandomArea => 0.01,
            _ => 0.0,
        };
        assert!(found.bias.abs() < allowed + 4.0 * found.bias_error, "{strategy:?}: {found:?}");
    }
}

#[test]
fn variances_are_those_that_are_seen_and_stand_ins_are_too_large() {
    let recipe = Recipe { side: 64, ..INTERIOR };
    for strategy in Strategy::ALL {
        let (relative, estimated) = trials(strategy, recipe, 6, 400);
        let seen = errors(&relative).root_mean_square;
        let ratio = estimated.sqrt() / seen;
        println!("{strategy:?}: estimated / seen {ratio:.2}");
        match strategy {
            Strategy::Random | Strategy::Jittered => {
                assert!((0.85..1.3).contains(&ratio), "{strategy:?}: {ratio}")
            }
            // Two samples and more in most strata, one in some.
            Strategy::PaperSnapshot => assert!((0.75..1.6).contains(&ratio), "{strategy:?}: {ratio}"),
            _ => assert!(ratio > 0.85, "{strategy:?}: {ratio}"),
        }
    }
}

#[test]
fn on_a_picture_of_objects_the_preview_is_ahead_of_every_blind_strategy() {
    let recipe = Recipe { side: 64, ..LIGHT };
    let error = |strategy| {
        let all: Vec<f64> = (1..5).flat_map(|picture| trials(strategy, recipe, picture, 60).0).collect();
        errors(&all).root_mean_square
    };
    let ours = error(Strategy::Snapshot);
    for strategy in Strategy::ALL.into_iter().filter(|strategy| strategy.is_blind()) {
        let blind = error(strategy);
        assert!(ours < 0.95 * blind, "{strategy:?}: {blind}, ours {ours}");
    }
}

#[test]
fn a_shot_is_quoted_by_any_strategy_and_records_stand_apart_from_all() {
    let picture = Picture::new(Recipe { side: 32, ..INTERIOR }, 2, 2, 0.0);
    for strategy in Strategy::ALL {
        let design = strategy.design(&picture.strata, &picture.ids, 32, 100, 3, 0).expect("a picture");
        let (_, mut observations) = design.profile(|pixel| picture.costs[pixel as usize]).expect("costs");
        let of_pixels = design.estimate(&observations, Calibration::NONE).expect("an estimate").total.work;
        let mut strata = design.strata().to_vec();
        let mut frames = [0, 5].map(|number| FramePopulation {
            number,
            counts: design.counts().to_vec(),
            lights: 0,
            shining: 0,
            triangles: 0,
        });
        let records = RecordStrata::add(&mut strata, &mut frames, &[&[40], &[80]], 48.0);
        observations.extend([1000, 1000].map(|work| records.observation(0, cost_of(f64::from(work)))));
        let profiled = [ProfiledFrame {
            frame: 0,
            observations: &observations,
            expansion: design.expansion(),
            fixed: Cost { work: 7, ..Cost::default() },
            build: Cost::default(),
        }];
        let found = forecast_shot(&strata, &frames, &profiled, Calibration::NONE).expect("a forecast");
        let [first, second] = [0, 1].map(|frame| found.frames[frame].total.work.mean);
        assert!((first - (of_pixels.mean + 40_007.0)).abs() < 1e-3, "{strategy:?}");
        assert!((second - (of_pixels.mean + 80_007.0)).abs() < 1e-3, "{strategy:?}");
    }
}

proptest! {
    #[test]
    fn no_strategy_makes_a_number_that_is_none_from_any_input(
        ids in prop::collection::vec(0u32..12, 1..300),
        rows in 1usize..6,
        samples in 0u32..400,
        works in prop::collection::vec(prop_oneof![Just(0u64), 1u64..1000, Just(u64::MAX)], 300),
        seed in any::<u64>(),
    ) {
        let ids = &ids[..ids.len() - ids.len() % rows.min(ids.len())];
        let width = (ids.len() / rows.min(ids.len())) as u32;
        let truth: u128 = works[..ids.len()].iter().map(|&work| u128::from(work)).sum();
        for strategy in Strategy::ALL {
            let cost = |pixel: u32| {
                let work = works[pixel as usize];
                Cost { work, cpu_nanos: work, rays: [work; 7] }
            };
            let Some((found, picks)) = work(strategy, ids, width, samples, seed, cost) else {
                prop_assert_eq!(samples, 0);
                continue;
            };
            let mut places: Vec<u32> = picks.iter().map(|pick| pick.pixel).collect();
            places.sort_unstable();
            places.dedup();
            prop_assert_eq!(places.len(), picks.len(), "{:?}: no pixel twice", strategy);
            prop_assert!(picks.len() <= samples as usize);
            for value in [found.mean, found.p50, found.p80, found.p95, found.variance] {
                prop_assert!(value.is_finite() && value >= 0.0, "{:?}: {:?}", strategy, found);
            }
            if samples as usize >= ids.len() {
                prop_assert_eq!(picks.len(), ids.len());
                // Groups are summed as floats: exact but for the last digits.
                let rounding = 1e-14 * truth as f64;
                prop_assert!((found.mean - truth as f64).abs() <= rounding, "{:?}: {:?}", strategy, found);
                prop_assert_eq!([found.p95, found.variance], [found.mean, 0.0]);
            }
        }
    }
}

#[test]
fn an_expansion_comes_back_from_its_document() {
    for expansion in [Expansion::Groups, Expansion::Neighbours, Expansion::Areas(vec![3, 4])] {
        let written = serde_json::to_string(&expansion).expect("a document");
        assert_eq!(serde_json::from_str::<Expansion>(&written).expect("the same"), expansion);
    }
}
