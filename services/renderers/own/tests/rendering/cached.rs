//! Profiles, renders and quotes of frames with an irradiance cache.

use crate::room::{Nobody, Rig};
use forelight_preview::Choice;
use forelight_protocol::{CacheMode, Quantiles, RenderSettings, RenderSettingsRequest, TaskResult, TaskSpec};
use forelight_renderer_own::{Given, OwnRenderer, QuoteOptions, quote, render_frame};
use std::path::Path;
use std::sync::atomic::AtomicBool;

#[test]
fn the_records_that_the_preview_counted_are_those_of_the_render() {
    for bounces in [1, 2] {
        let rig = Rig::cached(bounces);
        let shot = OwnRenderer::new(Choice::Cpu).open(&rig.bundle()).unwrap();
        let options =
            QuoteOptions { samples: 64, profile_frames: Some(1), seed: 2, ..QuoteOptions::default() };
        let quoted = quote(&shot, &[0, 1, 2], &rig.settings, &options, &Nobody).unwrap();
        let counted: Vec<&Vec<u32>> =
            quoted.preview().frames.iter().map(|frame| &frame.cache_records).collect();
        for (forecast, counted) in quoted.document.frames.iter().zip(&counted) {
            let cancel = AtomicBool::new(false);
            let frame = forecast.frame;
            let stats = render_frame(&shot, frame, &rig.settings, Given::default(), &|_| (), &cancel)
                .unwrap()
                .unwrap()
                .stats;
            assert_eq!(stats.cache_records.len(), bounces as usize);
            assert!(stats.cache_records.iter().all(|&count| count > 20), "{:?}", stats.cache_records);
            let known: Vec<u64> = counted.iter().map(|&count| u64::from(count)).collect();
            assert_eq!(stats.cache_records, known, "frame {frame}");
            for (forecast, &count) in forecast.cache_records.iter().zip(&known) {
                assert_eq!(*forecast, Quantiles::known(count as f64), "frame {frame}");
            }
            let cache = stats.cache.unwrap();
            assert!(
                cache.plan_work > 0 && cache.fill_work > 0 && stats.work > cache.plan_work + cache.fill_work
            );
            assert_eq!((cache.rejected, cache.reused_records), (0, 0));
            assert!(stats.effects.iter().any(|effect| effect == "irradiance cache"), "{:?}", stats.effects);
        }
        assert!(quoted.document.effects.iter().any(|effect| effect == "irradiance cache"));
        assert_ne!(counted[0], counted[2], "the camera moved");
    }
}

#[test]
fn a_profiled_cache_is_taken_over_with_its_plan_and_the_records_that_depend_on_no_others() {
    for bounces in [1, 2] {
        let rig = Rig::cached(bounces);
        let profiled = rig.run(rig.profile_spec(1), None).unwrap();
        let TaskResult::Profile(profile) = &profiled.result else { panic!() };
        let fixed = profile.fixed;
        assert!(fixed.plan.work > 0 && fixed.plan.cpu_nanos > 0 && fixed.plan_rays.iter().sum::<u64>() > 0);
        assert!(fixed.write.cpu_nanos > 10_000, "the files have their time though no pixel is kept");
        let of_level = |level: u32| profile.cache_samples.iter().filter(|s| s.level == level).count();
        for level in 0..bounces {
            assert_eq!(of_level(level), 37, "100 pixels go with 37 records");
        }
        // A deeper level has the fewest rays possible, all of which its plan has traced.
        assert!(profile.cache_samples.iter().all(|s| s.work > 0 && (s.rays[5] > 0 || s.level > 0)));

        let bytes =
            profiled.artifacts.iter().find(|a| *blake3::hash(a).as_bytes() == profile.artifacts.profile.0);
        let fresh = rig.run(rig.render_spec(1), None).unwrap();
        let reusing = rig.run(rig.render_spec(1), bytes.cloned()).unwrap();
        let (TaskResult::Render(fresh), TaskResult::Render(reused)) = (&fresh.result, &reusing.result) else {
            panic!()
        };
        assert_eq!(fresh.artifacts.image_png, reused.artifacts.image_png);
        assert_eq!(fresh.artifacts.cost_map_png, reused.artifacts.cost_map_png);
        let (fresh, reused) = (&fresh.stats, &reused.stats);
        assert_eq!((fresh.work, fresh.rays), (reused.work, reused.rays));
        assert_eq!(fresh.cache_records, reused.cache_records);
        assert_eq!((fresh.reused_work, reused.reused_pixels), (0, 0));
        let cache = reused.cache.unwrap();
        assert_eq!(cache.reused_records, of_level(bounces - 1) as u64);
        let deepest = profile.cache_samples.iter().filter(|sample| sample.level == bounces - 1);
        assert_eq!(reused.reused_work, fixed.plan.work + deepest.map(|sample| sample.work).sum::<u64>());
        assert!(reused.reused_rays > fixed.plan_rays.iter().sum());
        assert!(profile.spent.work > reused.reused_work);
    }
}

#[test]
fn a_profiled_cache_that_is_of_no_use_is_left_and_the_image_is_what_it_would_be() {
    let rig = Rig::cached(1);
    let profiled = rig.run(rig.profile_spec(0), None).unwrap();
    let bytes = profiled.artifacts[0].clone();
    let mut other = rig.render_spec(0);
    if let TaskSpec::Render(spec) = &mut other {
        spec.settings = RenderSettings { cache_accuracy: 199, ..rig.settings.clone() }.into();
    }
    for spec in [rig.render_spec(1), other] {
        rig.makes_the_same(&rig.run(spec.clone(), None).unwrap(), spec, bytes.clone());
    }
    // An intact profile that holds a damaged cache.
    let mut profile = forelight_tracer::Profile::from_bytes(&bytes).unwrap();
    profile.cache.as_mut().unwrap()[200] ^= 1;
    let fresh = rig.run(rig.render_spec(0), None).unwrap();
    rig.makes_the_same(&fresh, rig.render_spec(0), profile.to_bytes().into());
}

/// With few samples, uncovered points make much of a pixel's cost. The more there are, the less each adds.
#[test]
fn a_camera_sample_more_costs_what_the_explanation_says_of_it() {
    let rig = Rig::cached(1);
    let shot = OwnRenderer::new(Choice::Cpu).open(&rig.bundle()).unwrap();
    for spp in [1, 2, 8] {
        let (width, height) = (64, 48);
        let at = |spp| RenderSettings { spp, width, height, ..rig.settings.clone() };
        let options = QuoteOptions { samples: width * height, ..QuoteOptions::default() };
        let quoted = quote(&shot, &[0], &at(spp), &options, &Nobody).unwrap();
        let explained = quoted.measured().explain(&at(spp), None).unwrap();
        let work = |spp| {
            let cancel = AtomicBool::new(false);
            let given = Given::default();
            render_frame(&shot, 0, &at(spp), given, &|_| (), &cancel).unwrap().unwrap().stats.work as f64
        };
        let (now, more) = (work(spp), work(spp + 1));
        let off = explained.camera_sample * explained.work / (more - now) - 1.0;
        println!("{spp} samples: one more {:.4}, off by {off:+.3}", (more - now) / now);
        // All pixels were profiled. The plan saw the first samples, so records cover later ones less often.
        assert!(off.abs() < 0.1, "{spp} samples: {off}");
    }
}

/// Bounds fit one deterministic run, with room for a change of samples.
#[test]
fn with_a_cache_the_quote_of_the_kitchen_is_within_a_few_percent_of_its_render() {
    let kitchen = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../deploy/scenes/kitchen");
    let shot = OwnRenderer::new(Choice::Cpu).open(&kitchen).unwrap();
    let mut works = Vec::new();
    for bounces in [1, 2, 3, 8] {
        let settings = RenderSettingsRequest {
            spp: Some(4),
            ambient_bounces: Some(bounces),
            cache: Some(CacheMode::On),
            cache_rays: Some(192),
            ..Default::default()
        };
        let settings = settings.complete((48, 27));
        let options =
            QuoteOptions { samples: 256, profile_frames: Some(1), seed: 0, ..QuoteOptions::default() };
        let quoted = quote(&shot, &[0], &settings, &options, &Nobody).unwrap();
        let cancel = AtomicBool::new(false);
        let stats =
            render_frame(&shot, 0, &settings, Given::default(), &|_| (), &cancel).unwrap().unwrap().stats;
        let forecast = &quoted.document.frames[0];
        let error = forecast.work.mean / stats.work as f64 - 1.0;
        println!(
            "{bounces} bounces: {:?} records, work {:+.2} %, {:?}",
            stats.cache_records,
            error * 100.0,
            stats.cache
        );
        assert!(error.abs() < 0.06, "{error}");
        assert!(forecast.work.p95 > stats.work as f64 && forecast.work.p95 < 1.5 * stats.work as f64);
        let counts: Vec<f64> = stats.cache_records.iter().map(|&count| count as f64).collect();
        assert_eq!(forecast.cache_records.iter().map(|level| level.mean).collect::<Vec<_>>(), counts);
        for (name, (forecast, actual)) in forelight_protocol::Rays::NAMES
            .iter()
            .zip(forecast.rays.to_array().iter().zip(stats.rays.to_array()))
        {
            let error = forecast.mean / (actual as f64).max(1.0) - 1.0;
            println!("  {name}: {actual}, {:+.2} %", error * 100.0);
        }
        works.push((bounces, stats.work as f64));
    }
    // Levels that only gathers read are coarse, and reading them is cheap.
    for pair in works.windows(2) {
        let further = f64::from(pair[1].0 - pair[0].0);
        let share = (pair[1].1 - pair[0].1) / works[0].1 / further;
        println!("{} bounces: each further one {:.0} % of the first", pair[1].0, 100.0 * share);
        assert!((0.0..0.5).contains(&share), "{works:?}");
    }
}
