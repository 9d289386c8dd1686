//! Quotes of shots against renders of them.

use crate::room::{Nobody, Rig};
use forelight_forecast::Strategy;
use forelight_preview::Choice;
use forelight_protocol::{PreviewResult, RenderStats};
use forelight_quote::{Measured, MeasuredProfile};
use forelight_renderer_own::{
    Given, Observer, OwnRenderer, QuoteOptions, ShotError, profile_frame, quote, render_frame,
};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};

#[test]
fn a_quote_from_all_pixels_is_the_render_to_the_last_operation() {
    let rig = Rig::new();
    let shot = OwnRenderer::new(Choice::Cpu).open(&rig.bundle()).unwrap();
    let options =
        QuoteOptions { samples: 32 * 24, profile_frames: Some(3), seed: 1, ..QuoteOptions::default() };
    let quoted = quote(&shot, &[0, 1, 2], &rig.settings, &options, &Nobody).unwrap();
    let mut total = 0;
    for forecast in &quoted.document.frames {
        let cancel = AtomicBool::new(false);
        let rendered = render_frame(&shot, forecast.frame, &rig.settings, Given::default(), &|_| (), &cancel)
            .unwrap()
            .unwrap();
        let stats = rendered.stats;
        assert_eq!(forecast.work.mean, stats.work as f64, "frame {}", stats.frame);
        assert_eq!(forecast.work.p95, stats.work as f64);
        for (forecast, actual) in forecast.rays.to_array().iter().zip(stats.rays.to_array()) {
            assert_eq!(forecast.mean, actual as f64);
        }
        total += stats.work;
    }
    assert_eq!(quoted.document.total.work.mean, total as f64);
    assert_eq!(quoted.document.profiled.pixels, 3 * 32 * 24);
}

#[test]
fn pixels_cost_what_the_quote_says_of_each() {
    let rig = Rig::new();
    let shot = OwnRenderer::new(Choice::Cpu).open(&rig.bundle()).unwrap();
    let options = QuoteOptions { samples: 160, profile_frames: Some(1), seed: 3, ..QuoteOptions::default() };
    let quoted = quote(&shot, &[0, 1], &rig.settings, &options, &Nobody).unwrap();
    for frame in [0, 1] {
        let work =
            |probability| quoted.pixel_work(&shot, &rig.settings, frame, probability).unwrap().unwrap();
        let (mean, p80) = (work(None), work(Some(0.8)));
        let cancel = AtomicBool::new(false);
        let rendered = render_frame(&shot, frame, &rig.settings, Given::default(), &|_| (), &cancel);
        let truth = &rendered.unwrap().unwrap().image.pixels;
        assert_eq!((mean.len(), p80.len()), (truth.len(), truth.len()));
        let estimate = quoted.measured().estimate().unwrap();
        let total = estimate.shot.frames[frame as usize].strata.iter();
        let total: f64 = total.map(|known| f64::from(known.pixels) * known.mean.work).sum();
        assert!((mean.iter().sum::<f64>() / total - 1.0).abs() < 1e-9);
        let below = truth.iter().zip(&p80).filter(|(pixel, most)| pixel.work as f64 <= **most).count();
        let share = below as f64 / truth.len() as f64;
        // Four standard errors of an order statistic of 160 pixels, half of which may vary in common.
        let noise = 4.0 * (0.8f64 * 0.2 / 80.0).sqrt();
        println!("frame {frame}: {share:.3} of its pixels cost at most their P80");
        assert!((share - 0.8).abs() < noise, "frame {frame}: {share}");
    }
    assert!(quoted.pixel_work(&shot, &rig.settings, 2, None).unwrap().is_none(), "it is not in the quote");
}

/// A farm makes quotes from JSON that workers send.
#[test]
fn measurements_that_went_through_json_give_the_same_quote_and_explanation_to_the_last_bit() {
    for rig in [Rig::new(), Rig::cached(2)] {
        let shot = OwnRenderer::new(Choice::Cpu).open(&rig.bundle()).unwrap();
        let options = QuoteOptions { samples: 48, seed: 3, ..QuoteOptions::default() };
        let quoted = quote(&shot, &[0, 1, 2], &rig.settings, &options, &Nobody).unwrap();
        let json = serde_json::to_string(quoted.preview()).unwrap();
        let preview: PreviewResult = serde_json::from_str(&json).unwrap();
        let sent = |profile: &MeasuredProfile| {
            let json = serde_json::to_string(&profile.result).unwrap();
            MeasuredProfile::new(serde_json::from_str(&json).unwrap(), 1.0, profile.spp)
        };
        let profiles: Vec<MeasuredProfile> = quoted.measured().profiles.iter().map(sent).collect();
        let measured = Measured::new(&preview, &profiles);
        let found = measured.quote(None).unwrap();
        let of = quoted.document.of.clone().unwrap();
        assert_eq!(found.job.document(of, found.frames), quoted.document);
        let explained = |measured: Measured<'_>| measured.explain(&rig.settings, None).unwrap();
        let explanation = explained(measured);
        assert_eq!(explanation, explained(quoted.measured()));
        assert!(explanation.objects.len() > 1 && !explanation.words.is_empty(), "{explanation:?}");
    }
}

#[test]
fn every_strategy_quotes_a_shot_and_from_all_pixels_exactly() {
    let rig = Rig::new();
    let shot = OwnRenderer::new(Choice::Cpu).open(&rig.bundle()).unwrap();
    let work = |strategy: Strategy, samples: u32| {
        let options =
            QuoteOptions { samples, profile_frames: Some(2), seed: 3, strategy, ..QuoteOptions::default() };
        let quoted = quote(&shot, &[0, 1, 2], &rig.settings, &options, &Nobody).unwrap();
        assert!(quoted.document.profiled.pixels <= 2 * u64::from(samples), "{strategy:?}");
        quoted.document
    };
    let all = work(Strategy::Snapshot, 32 * 24);
    for strategy in Strategy::ALL {
        let exact = work(strategy, 32 * 24);
        assert_eq!(exact.profiled.frames, all.profiled.frames, "{strategy:?}");
        for frame in &all.profiled.frames {
            let [one, other] = [&exact, &all].map(|document| document.frames[*frame as usize].work);
            assert_eq!([one.mean, one.p95], [other.mean, other.p95], "{strategy:?}, frame {frame}");
        }
        let few = work(strategy, 48).total.work;
        assert!(few.p95 > few.mean, "{strategy:?}: {few:?}");
        assert!((few.mean / all.total.work.mean - 1.0).abs() < 0.4, "{strategy:?}: {few:?}");
    }
}

#[test]
fn a_quote_depends_on_its_seed_and_not_on_the_threads() {
    let rig = Rig::new();
    let shot = OwnRenderer::new(Choice::Cpu).open(&rig.bundle()).unwrap();
    let work = |seed: u64, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = QuoteOptions { samples: 64, profile_frames: Some(1), seed, ..QuoteOptions::default() };
        let quoted = pool.install(|| quote(&shot, &[0, 1, 2], &rig.settings, &options, &Nobody)).unwrap();
        quoted.document.frames.iter().map(|frame| frame.work).collect::<Vec<_>>()
    };
    assert_eq!(work(1, 1), work(1, 3));
    assert_ne!(work(1, 1), work(2, 1));
}

#[test]
fn building_the_tree_is_in_a_frames_cost_only_where_something_moves_and_motion_is_said_to_be() {
    let rig = Rig::new();
    let rendered = || {
        let shot = OwnRenderer::new(Choice::Cpu).open(&rig.bundle()).unwrap();
        // Frame 0 of the moving shot has the same geometry as without the motion.
        let cancel = AtomicBool::new(false);
        render_frame(&shot, 0, &rig.settings, Given::default(), &|_| (), &cancel).unwrap().unwrap().stats
    };
    let still = rendered();
    rig.animate(serde_json::json!({
        "target": "object:window", "property": "translation", "interpolation": "linear",
        "keys": [{ "frame": 0, "value": [0, 0, 0] }, { "frame": 2, "value": [0, 1, 0] }],
    }));
    let moving = rendered();
    assert!(moving.work > still.work);
    let (once, each) = (still.once.unwrap(), moving.once.unwrap());
    assert_eq!((once.build.work, each.build.work), (moving.work - still.work, 0));
    assert!(once.load.cpu_nanos > 0 && each.load.cpu_nanos > 0);
    let motion = |stats: &RenderStats| stats.effects.iter().any(|effect| effect == "motion");
    assert!(motion(&moving) && !motion(&still), "{:?}", moving.effects);
}

#[test]
fn a_frame_in_the_dark_is_forecast_from_one_in_the_dark() {
    // With a cache, a dark frame has no records, so all three frames are profiled.
    for (rig, profile_frames) in [(Rig::new(), 2), (Rig::cached(1), 3)] {
        rig.animate(serde_json::json!({
            "target": "light:0", "property": "radiance", "interpolation": "step",
            "keys": [
                { "frame": 0, "value": [9, 9, 9] },
                { "frame": 1, "value": [0, 0, 0] },
                { "frame": 2, "value": [9, 9, 9] },
            ],
        }));
        let shot = OwnRenderer::new(Choice::Cpu).open(&rig.bundle()).unwrap();
        // Half of all pixels: the remaining error is that of carrying costs to other frames.
        let options = QuoteOptions {
            samples: 384,
            profile_frames: Some(profile_frames),
            seed: 2,
            ..QuoteOptions::default()
        };
        let quoted = quote(&shot, &[0, 1, 2], &rig.settings, &options, &Nobody).unwrap();
        let lights: Vec<u32> = quoted.preview().frames.iter().map(|frame| frame.lights).collect();
        assert_eq!(lights, [0, 1, 0]);
        let render = |frame| {
            let given = Given::default();
            let rendered = render_frame(&shot, frame, &rig.settings, given, &|_| (), &AtomicBool::new(false));
            rendered.unwrap().unwrap().stats
        };
        let stats: Vec<RenderStats> = (0..3).map(render).collect();
        assert!(4 * stats[1].work < stats[0].work, "{} of {}", stats[1].work, stats[0].work);
        assert!(
            stats[1].effects.iter().all(|effect| !["ambient", "irradiance cache"].contains(&&effect[..]))
        );
        for (forecast, stats) in quoted.document.frames.iter().zip(&stats) {
            let off = forecast.work.mean / stats.work as f64 - 1.0;
            assert!(off.abs() < 0.08, "frame {}: {off}", forecast.frame);
            assert_eq!(stats.cache_records.len(), forecast.cache_records.len());
        }
    }
}

/// Cancels after a number of checks.
struct Patience(AtomicUsize);

impl Observer for Patience {
    fn previewed(&self, _: usize, _: usize) {}
    fn profiled(&self, _: usize, _: usize) {}
    fn is_cancelled(&self) -> bool {
        self.0.fetch_update(Relaxed, Relaxed, |left| left.checked_sub(1)).is_err()
    }
}

#[test]
fn a_profile_is_broken_off_in_the_middle_of_its_pixels() {
    let rig = Rig::new();
    let options = QuoteOptions { samples: 32 * 24, profile_frames: Some(1), ..QuoteOptions::default() };
    let shot = OwnRenderer::new(Choice::Cpu).open(&rig.bundle()).unwrap();
    let profile = |questions: usize| {
        profile_frame(&shot, 0, &rig.settings, &options, &Patience(AtomicUsize::new(questions)))
    };
    // It checks before every one of 768 pixels.
    assert!(matches!(profile(8), Err(ShotError::Cancelled)));
    assert_eq!(profile(10_000).unwrap().observations.len(), 32 * 24);
}
