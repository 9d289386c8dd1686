//! Own and shared irradiance caches, quoted and then rendered.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use forelight_forecast::{Corrections, LEAST_JOBS};
use forelight_protocol::{
    ArtifactHash, CACHE_BYTES, CacheMode, CachePlanResult, CacheSharing, Explanation, RenderSettings,
    RenderSettingsRequest, RenderStats,
};
use forelight_quote::{
    Measured, MeasuredProfile, SharedCache, SharedCacheToBuild, is_shared_cache_worth_planning, quote,
};
use forelight_renderer_own::{
    Given, OwnRenderer, OwnShot, Quote, QuoteOptions, fill_part, plan_shared, profile_shared, render_frame,
};
use forelight_tracer::Cache;

use super::room::Nobody;

/// A shot of a shipped scene, and the measurements behind its quotes.
struct Case {
    shot: OwnShot,
    frames: Vec<u32>,
    settings: RenderSettings,
    quoted: Quote,
    /// Measured with the shared cache too.
    profiles: Vec<MeasuredProfile>,
    plan: Option<CachePlanResult>,
    cache: Cache,
}

impl Case {
    fn new(scene: &str, frames: &[u32], bounces: u32) -> Self {
        Self::with_samples(scene, frames, bounces, 1)
    }

    fn with_samples(scene: &str, frames: &[u32], bounces: u32, spp: u32) -> Self {
        let bundle = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../deploy/scenes").join(scene);
        let shot = OwnRenderer::new(forelight_preview::Choice::Cpu).open(&bundle).unwrap();
        let settings = RenderSettingsRequest {
            spp: Some(spp),
            ambient_bounces: Some(bounces),
            cache: Some(CacheMode::On),
            cache_rays: Some(48),
            ..Default::default()
        };
        let settings = settings.complete((48, 27));
        let options =
            QuoteOptions { samples: 200, profile_frames: Some(3), seed: 3, ..QuoteOptions::default() };
        let quoted = forelight_renderer_own::quote(&shot, frames, &settings, &options, &Nobody).unwrap();
        let never = AtomicBool::new(false);
        let plan = plan_shared(&shot, frames, &settings, &|_| (), &never).unwrap().expect("a cache");
        let mut profiles = quoted.measured().profiles.to_vec();
        for (profile, profiled) in profiles.iter_mut().zip(&quoted.profiled) {
            let beside = profile_shared(&shot, profiled, &settings, &options, plan.cache.clone());
            beside.unwrap().add_to(&mut profile.result);
        }
        let cache = plan.cache.clone();
        let plan = Some(plan.result(|_| ArtifactHash([1; 32])));
        Self { shot, frames: frames.to_vec(), settings, quoted, profiles, plan, cache }
    }

    fn measured(&self) -> Measured<'_> {
        let shared = self.plan.as_ref().map(|plan| SharedCache { plan, node_speed: 1.0 });
        Measured { profiles: &self.profiles, shared, ..self.quoted.measured() }
    }

    fn quote(&self, asked: CacheSharing) -> forelight_quote::Quote {
        self.corrected(asked, None)
    }

    fn corrected(&self, asked: CacheSharing, corrections: Option<&Corrections>) -> forelight_quote::Quote {
        quote(asked, &self.settings, &self.measured(), corrections).unwrap()
    }

    /// The measurements with the shared cache, or without it.
    fn way(&self, shared: bool) -> Measured<'_> {
        let measured = self.measured();
        measured.with_cache(measured.shared.filter(|_| shared))
    }

    /// Compares the explanation of indirect light, and of its plan, with the frames' true costs.
    fn compare_explanation(&self, shared: bool, actual: &[RenderStats]) {
        let explained = |frame| self.way(shared).explain(&self.settings, frame).expect("an explanation");
        let compare = |explanation: Explanation, stats: &[RenderStats], most: f64| {
            let ambient =
                explanation.rays.iter().find(|ray| ray.category == "ambient").and_then(|ray| ray.work);
            let planning = explanation.parts.iter().find(|part| part.part.starts_with("planning"));
            let taken: u64 = stats.iter().map(|stats| stats.work_by_ray.unwrap().ambient).sum();
            let planned: u64 = stats.iter().map(|stats| stats.cache.unwrap().plan_work).sum();
            let error = off(ambient.unwrap(), taken);
            println!(
                "ambient {:+.1} %, planning {:?} {planned}",
                100.0 * error,
                planning.map(|part| part.work)
            );
            assert!(error.abs() < most, "{taken} for ambient rays: {error}");
            assert!((planning.map_or(0.0, |part| part.work) - planned as f64).abs() < 0.1 * taken as f64);
        };
        compare(explained(None), actual, 0.1);
        for stats in actual {
            compare(explained(Some(stats.frame)), std::slice::from_ref(stats), 0.25);
        }
    }

    fn filled(&self) -> (Cache, u64) {
        let never = AtomicBool::new(false);
        let filled = fill_part(&self.shot, self.cache.clone(), &self.settings, (0, 1), &|_, _| (), &never);
        let filled = filled.unwrap().unwrap();
        (filled.cache, filled.spent.work)
    }

    fn render(&self, cache: Option<&Cache>) -> Vec<RenderStats> {
        let render = |&frame| {
            let given = Given { cache: cache.cloned(), ..Given::default() };
            let never = AtomicBool::new(false);
            render_frame(&self.shot, frame, &self.settings, given, &|_| (), &never).unwrap().unwrap().stats
        };
        self.frames.iter().map(render).collect()
    }
}

fn off(forecast: f64, actual: u64) -> f64 {
    forecast / actual as f64 - 1.0
}

#[test]
fn what_is_quoted_for_either_way_is_what_it_takes_and_the_way_that_takes_less_is_taken() {
    // Only the camera moves in the corridor, objects move in the kitchen. Each bounce has a level of records.
    for (scene, frames, bounces) in [("corridor", [0, 8, 16, 24], 2), ("kitchen", [0, 12, 24, 40], 1)] {
        let case = Case::new(scene, &frames, bounces);
        let (cache, fill_work) = case.filled();
        let mut taken = [0u64; 2];
        for asked in [CacheSharing::Private, CacheSharing::Shared] {
            let quoted = case.quote(asked);
            let said = quoted.job.cache.as_ref().unwrap();
            assert_eq!(
                (said.shared, said.reason.as_str()),
                (asked == CacheSharing::Shared, "the job asks for it")
            );
            let given = said.shared.then_some(&cache);
            assert_eq!(
                (quoted.shared_cache.is_some(), said.shared_cache.is_some()),
                (said.shared, said.shared)
            );
            let actual = case.render(given);
            for (forecast, stats) in quoted.frames.iter().zip(&actual) {
                let error = off(forecast.work.mean, stats.work);
                println!(
                    "{scene} {asked:?} frame {}: {:+.1} %, {:?}",
                    stats.frame,
                    100.0 * error,
                    stats.cache
                );
                assert!(error.abs() < 0.2, "{scene}, {asked:?}, frame {}: {error}", stats.frame);
                let known: Vec<f64> = forecast.cache_records.iter().map(|level| level.mean).collect();
                let found: Vec<f64> = stats.cache_records.iter().map(|&count| count as f64).collect();
                assert_eq!(known, found, "{scene}, {asked:?}, frame {}", stats.frame);
            }
            let frames_work: u64 = actual.iter().map(|stats| stats.work).sum();
            let error = off(quoted.job.total.work.mean, frames_work);
            assert!(error.abs() < 0.08, "{scene}, {asked:?}, all frames: {error}");
            case.compare_explanation(said.shared, &actual);
            let price = if said.shared { said.shared_price.unwrap() } else { said.private_price };
            taken[usize::from(said.shared)] = frames_work;
            if let (Some(cache), Some(plan)) = (&said.shared_cache, &case.plan) {
                let error = off(cache.work.mean, fill_work);
                println!("{scene} cache: {:+.1} %", 100.0 * error);
                assert!(error.abs() < 0.12, "{scene}, the shared cache: {error}");
                assert!(cache.work.p80 > cache.work.mean && cache.cpu_seconds.mean > 0.0);
                taken[1] += fill_work;
                for (planned, stats) in plan.frames.iter().zip(&actual) {
                    let found = stats.cache.unwrap();
                    assert_eq!(
                        planned.plan.work, found.plan_work,
                        "planned with records that are not filled"
                    );
                    let own = sum(&planned.own);
                    assert_eq!((own, planned.dropped), (found.own_records, found.dropped_records));
                }
                assert_eq!(price.records, sum(&plan.records) + sum(plan.frames.iter().flat_map(|f| &f.own)));
            } else {
                let records: u64 = actual.iter().flat_map(|stats| &stats.cache_records).sum();
                assert_eq!(price.records, records);
            }
            let error = off(price.work, taken[usize::from(said.shared)]);
            assert!(error.abs() < 0.08, "{scene}, {asked:?}, the price: {error}");
        }
        let chosen = case.quote(CacheSharing::Auto);
        let said = chosen.job.cache.unwrap();
        println!("{scene}: {taken:?}, {}", said.reason);
        assert_eq!(said.shared, taken[1] < taken[0], "{scene}: {taken:?}, {}", said.reason);
        assert!(said.reason.contains("% less work"), "{}", said.reason);
    }
}

#[test]
fn other_camera_samples_are_priced_beside_the_shared_cache_where_there_is_one() {
    let case = Case::with_samples("corridor", &[0, 8, 16], 1, 4);
    let finer = Case::with_samples("corridor", &[0, 8, 16], 1, 16);
    for asked in [CacheSharing::Private, CacheSharing::Shared] {
        let shared = asked == CacheSharing::Shared;
        let ladder = case.way(shared).qualities(&case.settings).unwrap();
        let of = |spp: u32| ladder.rungs.iter().find(|rung| rung.settings.spp == spp).unwrap();
        assert_eq!((of(4).asked_for, of(4).work), (true, case.quote(asked).job.total.work));
        let (cache, _) = finer.filled();
        let taken: u64 = finer.render(shared.then_some(&cache)).iter().map(|stats| stats.work).sum();
        let error = off(of(16).work.mean, taken);
        println!("{asked:?}: {:+.1} %", 100.0 * error);
        assert!(error.abs() < 0.08, "{asked:?}: {error}");
    }
}

#[test]
fn without_a_plan_or_with_one_that_is_too_large_frames_build_their_own_and_the_quote_says_why() {
    let mut case = Case::new("corridor", &[0], 1);
    assert!(
        !is_shared_cache_worth_planning(CacheSharing::Auto, case.quoted.preview()),
        "one frame shares with none"
    );
    assert!(is_shared_cache_worth_planning(CacheSharing::Shared, case.quoted.preview()));
    case.plan = None;
    let quoted = case.quote(CacheSharing::Auto);
    assert_eq!(quoted.job.cache.unwrap().reason, "there is only one frame");
    case.plan = Some(CachePlanResult {
        cache: None,
        bytes: CACHE_BYTES + 1,
        records: vec![1],
        frames: Vec::new(),
        spent: Default::default(),
    });
    let quoted = case.quote(CacheSharing::Auto).job.cache.unwrap();
    assert!(!quoted.shared && quoted.reason.contains(&(CACHE_BYTES + 1).to_string()), "{}", quoted.reason);
    let forced = quote(CacheSharing::Shared, &case.settings, &case.measured(), None);
    assert!(forced.unwrap_err().to_string().contains("asks for a shared irradiance cache"));
    let off = RenderSettings { cache: CacheMode::Off, ..case.settings.clone() };
    let quoted = quote(CacheSharing::Auto, &off, &case.measured(), None).unwrap();
    assert_eq!(quoted.job.cache, None);
}

#[test]
fn a_cache_has_a_part_for_each_node_as_long_as_parts_are_worth_it() {
    let plan = |records, bytes| SharedCacheToBuild { cache: ArtifactHash([0; 32]), bytes, records };
    assert_eq!(plan(10_000, 10 << 20).parts(4), 4);
    assert_eq!(plan(10_000, 10 << 20).parts(0), 1, "a node may join a farm without nodes");
    assert_eq!(plan(600, 1 << 20).parts(9), 2, "few records need few parts");
    assert_eq!(plan(3, 1 << 10).parts(9), 1);
    assert_eq!(plan(1 << 30, 1 << 30).parts(1000), 4, "a merge holds all parts in memory");
    assert_eq!(plan(1 << 30, 1 << 20).parts(1000), 64);
}

#[test]
fn past_jobs_move_the_quantiles_of_a_shared_cache_too() {
    let case = Case::new("corridor", &[0, 8], 1);
    let mut experience = forelight_forecast::Experience::default();
    for job in 0..LEAST_JOBS + 1 {
        let residual = 1.0 + 0.01 * job as f64;
        for past in [
            &mut experience.frame_work,
            &mut experience.frame_cpu,
            &mut experience.job_work,
            &mut experience.job_cpu,
        ] {
            past.push(vec![residual]);
        }
    }
    let corrections = experience.corrections().unwrap();
    let plain = case.quote(CacheSharing::Shared);
    let taught = case.corrected(CacheSharing::Shared, Some(&corrections));
    let shared =
        |forecast: &forelight_quote::Quote| forecast.job.cache.clone().unwrap().shared_cache.unwrap();
    assert_eq!(shared(&plain).work.mean, shared(&taught).work.mean);
    assert!(shared(&taught).work.p50 > shared(&plain).work.p50, "past jobs took more than they were quoted");
}

fn sum<'a>(records: impl IntoIterator<Item = &'a u32>) -> u64 {
    records.into_iter().copied().map(u64::from).sum()
}
