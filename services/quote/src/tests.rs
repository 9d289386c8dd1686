//! Tests of quotes from previews and profiles as workers report them.

use crate::*;
use forelight_forecast::{Correction, Corrections, Strategy};
use forelight_protocol::{
    ArtifactHash, CacheSample, FixedCosts, FixedPart, FrameStrata, LeftOut, MeasuredFrame, PreviewBackend,
    PreviewResult, ProcessCosts, ProfileArtifacts, ProfileResult, ProfileSample, Profiled, Quantiles,
    RendererId, SampleCost, ShotSettings, Spent, Stratum, StratumName, StratumTime, Varied,
};

fn stratum(object: u32) -> Stratum {
    let name = ["wall", "vase", "spoon"][object as usize].to_owned();
    let name = StratumName { object: name, material: "paint".to_owned() };
    Stratum { name, object, material: 0, prior_cost: 1.0 }
}

fn preview(frames: &[(u32, &[u32], u32)]) -> PreviewResult {
    PreviewResult {
        strata: vec![stratum(0), stratum(1)],
        background_prior_cost: 0.1,
        record_prior_cost: None,
        frames: frames
            .iter()
            .map(|&(frame, pixels, background)| FrameStrata {
                frame,
                pixels: pixels.to_vec(),
                background,
                cache_records: Vec::new(),
                cache_plan: None,
                lights: 0,
                shining: 0,
                triangles: 0,
                preview_png: None,
            })
            .collect(),
        backend: PreviewBackend::Cpu,
        spent: Spent { work: 50, cpu_nanos: 0 },
        described: None,
    }
}

/// Every stratum has one cost: 100 for walls, 900 for the vase, 10 for the background.
fn profile(frame: u32, strata: Vec<Stratum>, counts: &[usize]) -> MeasuredProfile {
    let mut samples = Vec::new();
    for (stratum, &count) in counts.iter().enumerate() {
        let work = match strata.get(stratum).map(|stratum| stratum.name.object.as_str()) {
            Some("vase") => 900,
            Some(_) => 100,
            None => 10,
        };
        for _ in 0..count {
            samples.push(ProfileSample {
                pixel: samples.len() as u32,
                stratum: stratum as u32,
                work,
                extra_work: 0,
                work_by_ray: [work, 0, 0, 0, 0, 0, 0],
                cpu_nanos: 10 * work,
                rays: [1, 0, 0, 0, 0, 0, 0],
            });
        }
    }
    let artifacts = ProfileArtifacts { profile: ArtifactHash([0; 32]), preview_png: None };
    let load = Spent { work: 7, cpu_nanos: 30 };
    let write = Spent { work: 0, cpu_nanos: 40 };
    let fixed = FixedCosts { load, write, ..FixedCosts::default() };
    let result = ProfileResult {
        frame,
        strata,
        samples,
        uncovered: None,
        shared_samples: Vec::new(),
        shared_cache_samples: Vec::new(),
        cache_samples: Vec::new(),
        samples_for_error: None,
        noise: Vec::new(),
        effects: vec!["ambient".to_owned(), "mirror".to_owned()],
        work_by_class: None,
        left_out: vec![LeftOut { what: "sun 0".to_owned(), reason: "outside".to_owned() }],
        renderer: Some("r 1".to_owned()),
        fixed,
        file_bytes: Some(5000),
        once: Some(ProcessCosts { load, build: write }),
        ladders: None,
        spent: Spent { work: 50, cpu_nanos: 0 },
        artifacts,
    };
    MeasuredProfile::new(result, 2.0, 4)
}

#[test]
fn counts_times_unit_costs_make_the_frames_whatever_the_order_of_the_strata_and_the_speed_of_the_node() {
    let preview = preview(&[(0, &[200, 40], 16), (3, &[100, 140], 16)]);
    let profile = profile(0, vec![stratum(1), stratum(0)], &[8, 16, 4]);
    let forecast = Measured::new(&preview, std::slice::from_ref(&profile)).quote(None).unwrap();
    let means: Vec<f64> = forecast.frames.iter().map(|frame| frame.work.mean).collect();
    let expected = [20_000.0 + 36_000.0 + 160.0 + 7.0, 10_000.0 + 126_000.0 + 160.0 + 7.0];
    for (mean, expected) in means.iter().zip(expected) {
        assert!((mean / expected - 1.0).abs() < 1e-9, "{mean} for {expected}");
    }
    let seconds = forecast.frames[0].cpu_seconds.mean;
    assert!((seconds / (expected[0] * 10.0 * 2.0 * 1e-9) - 1.0).abs() < 1e-9, "{seconds}");
    assert_eq!(forecast.frames[0].rays.primary.mean, 256.0);
    assert_eq!(forecast.job.profiled, Profiled { frames: vec![0], pixels: 28 });
    assert_eq!(forecast.job.spent.work, 100);
    assert_eq!(forecast.job.effects, ["ambient", "mirror"]);
    assert_eq!(forecast.job.left_out[0].what, "sun 0");
    let spent = |work, cpu_nanos| Spent { work, cpu_nanos };
    assert_eq!(forecast.job.once, Some(ProcessCosts { load: spent(7, 60), build: spent(0, 80) }));
    // Older workers do not report it. That does not mean zero.
    let mut silent = self::profile(3, vec![stratum(1), stratum(0)], &[8, 16, 4]);
    silent.result.once = None;
    let of_both = Measured::new(&preview, &[profile, silent.clone()]).quote(None).unwrap().job.once;
    assert_eq!(of_both, forecast.job.once);
    assert_eq!(Measured::new(&preview, &[silent]).quote(None).unwrap().job.once, None);
}

#[test]
fn which_lights_shine_is_kept_where_they_change() {
    let mut preview = preview(&[(0, &[200, 40], 16), (3, &[100, 140], 16)]);
    let lights = |preview: &PreviewResult| {
        let profile = profile(0, vec![stratum(1), stratum(0)], &[8, 16, 4]);
        Measured::new(preview, &[profile]).quote(None).unwrap().job.lights
    };
    assert_eq!(lights(&preview), Vec::<u32>::new());
    preview.frames[1].lights = 3;
    assert_eq!(lights(&preview), [0, 3]);
}

#[test]
fn records_are_counted_by_the_preview_and_priced_by_those_that_were_gathered() {
    let mut preview = preview(&[(0, &[200, 40], 16), (3, &[100, 140], 16)]);
    preview.record_prior_cost = Some(48.0);
    preview.frames[0].cache_records = vec![900, 300];
    preview.frames[1].cache_records = vec![700, 100];
    let mut profile = profile(0, vec![stratum(1), stratum(0)], &[8, 16, 4]);
    let plan = Spent { work: 1000, cpu_nanos: 5000 };
    profile.result.fixed = FixedCosts { plan, plan_rays: [9, 0, 0, 0, 0, 20, 0], ..profile.result.fixed };
    let sample = |level, work| CacheSample {
        level,
        own: false,
        work,
        cpu_nanos: 10 * work,
        rays: [0, 1, 0, 0, 0, 48, 0],
    };
    profile.result.cache_samples =
        [0, 1].into_iter().flat_map(|level| vec![sample(level, [5000, 2000][level as usize]); 12]).collect();
    let forecast = Measured::new(&preview, &[profile]).quote(None).unwrap();
    let expected = [
        20_000.0 + 36_000.0 + 160.0 + 1007.0 + 900.0 * 5000.0 + 300.0 * 2000.0,
        10_000.0 + 126_000.0 + 160.0 + 1007.0 + 700.0 * 5000.0 + 100.0 * 2000.0,
    ];
    for (frame, expected) in forecast.frames.iter().zip(expected) {
        assert!((frame.work.mean / expected - 1.0).abs() < 1e-9, "{} for {expected}", frame.work.mean);
        let seconds = frame.cpu_seconds.mean;
        assert!((seconds / (expected * 10.0 * 2.0 * 1e-9) - 1.0).abs() < 1e-3, "{seconds}");
    }
    let known = |counts: [f64; 2]| counts.map(Quantiles::known).to_vec();
    assert_eq!(forecast.frames[1].cache_records, known([700.0, 100.0]));
    assert_eq!(forecast.job.total.cache_records, known([1600.0, 400.0]));
    assert_eq!(forecast.frames[0].rays.ambient.mean, 20.0 + 48.0 * 1200.0);
    assert_eq!(forecast.job.profiled.pixels, 28, "records are no pixels");
}

#[test]
fn a_stratum_that_only_the_profile_saw_does_not_sink_the_forecast() {
    let preview = preview(&[(0, &[200, 0], 56)]);
    let profile = profile(0, vec![stratum(0), stratum(1), stratum(2)], &[8, 1, 1, 4]);
    let forecast = Measured::new(&preview, &[profile]).quote(None).unwrap();
    assert!(forecast.frames[0].work.mean > 20_000.0);
}

#[test]
fn frames_are_chosen_within_the_allowance_and_by_their_own_numbers() {
    let frames: Vec<(u32, &[u32], u32)> = (0..20).map(|i| (10 + 2 * i, &[200u32, 40][..], 16)).collect();
    let chosen = frames_to_profile(&preview(&frames), Strategy::Snapshot, Some(3)).unwrap();
    assert_eq!(chosen.len(), 3);
    assert!(chosen.iter().all(|frame| frames.iter().any(|(number, ..)| number == frame)), "{chosen:?}");
}

#[test]
fn past_jobs_move_the_quantiles_and_neither_the_means_nor_what_will_be_learnt() {
    let preview = preview(&[(0, &[200, 40], 16), (3, &[100, 140], 16)]);
    let mut profile = profile(0, vec![stratum(0), stratum(1)], &[16, 8, 4]);
    profile.result.samples.iter_mut().for_each(|sample| sample.work += u64::from(sample.pixel % 5));
    let profiles = [profile];
    let plain = Measured::new(&preview, &profiles).quote(None).unwrap();
    let correction = Correction { p50: 1.0, p80: 2.0, p95: 4.0 };
    let corrections = Corrections {
        frame_work: correction,
        frame_cpu: correction,
        job_work: correction,
        job_cpu: correction,
    };
    let taught = Measured::new(&preview, &profiles).quote(Some(&corrections)).unwrap();
    assert!(taught.job.calibrated && !plain.job.calibrated);
    assert_eq!(taught.spreads, plain.spreads);
    assert_eq!((taught.spreads.1.len(), plain.frames[1].work.mean), (2, taught.frames[1].work.mean));
    for (frame, spreads) in taught.frames.iter().zip(&taught.spreads.1) {
        let log = |quantile: f64| (quantile / frame.work.mean).ln() / spreads.work;
        assert!(spreads.work > 0.0 && (log(frame.work.p95) - 4.0).abs() < 1e-9);
        assert!((log(frame.work.p50) - 1.0).abs() < 1e-9);
    }
    assert!(taught.job.total.cpu_seconds.p50 > plain.job.total.cpu_seconds.p50);
}

#[test]
fn profiles_of_several_renderers_are_of_no_kind() {
    let settings = forelight_protocol::RenderSettingsRequest::default().complete((8, 8));
    let of = |renderer: Option<&str>| {
        let mut profile = profile(0, vec![stratum(0)], &[4]);
        profile.result.renderer = renderer.map(str::to_owned);
        profile
    };
    let found = QuoteKind::of(&[of(Some("a 1")), of(Some("a 1"))], &settings).unwrap();
    assert_eq!((found.renderer.as_str(), found.feature_class.as_str()), ("a 1", "gathered"));
    assert_eq!(QuoteKind::of(&[of(Some("a 1")), of(Some("a 2"))], &settings), None);
    assert_eq!(
        (QuoteKind::of(&[of(Some("a 1")), of(None)], &settings), QuoteKind::of(&[of(None)], &settings)),
        (None, None)
    );
    assert_eq!(QuoteKind::of(&[], &settings), None);
}

#[test]
fn cpu_time_of_another_renderer_is_divided_by_what_a_frame_shows() {
    // Microseconds of a sample: 2 for a pixel of the wall, 6 for one of the vase. 100 are fixed.
    let preview = preview(&[(0, &[80, 10], 10), (1, &[40, 50], 10)]);
    let cost = |amount, micros: u64| SampleCost { amount, cpu_nanos: (100 + micros) * 1000 };
    let fixed = |name: &str, micros: u64| FixedPart { name: name.to_owned(), cpu_nanos: micros * 1000 };
    let measured = |frame, wall: u64, vase: u64, varied| {
        let time = |object, nanos| StratumTime { object: Some(object), material: Some(0), nanos };
        let result = MeasuredFrame {
            frame,
            renderer: RendererId { name: "cycles".to_owned(), version: "5.0.1".to_owned() },
            varied,
            whole: 64,
            costs: vec![cost(1, wall + vase), cost(0, 0)],
            fixed: vec![fixed("tree", 70), fixed("write", 20), fixed("a word of its own", 10)],
            strata: vec![time(0, wall), time(1, vase)],
            shares: Vec::new(),
            preview_png: None,
            spent: Spent::default(),
            peak_memory_bytes: 0,
        };
        SampledProfile { result, node_speed: 1.0 }
    };
    let profiles = |varied| [measured(0, 160, 60, varied), measured(1, 80, 300, varied)];
    let size = |side| Some(side);
    let settings =
        ShotSettings { width: size(10), height: size(10), samples: size(64), ..Default::default() };
    let explained = explain_sampled(&preview, &profiles(Varied::Samples), &settings, Some(1)).unwrap();
    assert!((explained.work / (100.0 + 64.0 * 380.0) - 1.0).abs() < 1e-9, "{explained:?}");
    let objects: Vec<(&str, u64, f64)> = explained
        .objects
        .iter()
        .map(|o| (o.shows.as_ref().unwrap().object.as_str(), o.pixels, o.work.round()))
        .collect();
    assert_eq!(objects, [("vase", 50, 64.0 * 300.0), ("wall", 40, 64.0 * 80.0)]);
    let parts: Vec<(&str, f64)> = explained.parts.iter().map(|p| (p.part.as_str(), p.work.round())).collect();
    let others = [("building the tree", 70.0), ("writing the image", 20.0), ("a word of its own", 10.0)];
    assert_eq!((parts[0], &parts[1..]), (("pixels", 24_320.0), &others[..]));
    let mut untold = profiles(Varied::Samples);
    untold[1].result.fixed.clear();
    let untold = explain_sampled(&preview, &untold, &settings, Some(1)).unwrap();
    assert_eq!((untold.parts[1].part.as_str(), untold.parts[1].work.round()), ("setting up", 100.0));
    assert_eq!(explained.halving.iter().map(|way| (&*way.setting, way.to)).next(), Some(("spp", 32.0)));
    assert!(
        explained.words[1].starts_with("vase, paint: 78.6 % of the work, 50.0 % of the pixels"),
        "{:?}",
        explained.words
    );

    // Both frames have the work of their quotes. With adaptive sampling, samples are no way to halve it.
    let all = explain_sampled(&preview, &profiles(Varied::Samples), &settings, None).unwrap();
    assert!((all.work / (200.0 + 64.0 * 600.0) - 1.0).abs() < 1e-9);
    assert_eq!(all.objects.iter().map(|o| o.pixels).sum::<u64>(), 180);
    let adaptive = explain_sampled(&preview, &profiles(Varied::Regions), &settings, None).unwrap();
    assert!(adaptive.halving.iter().all(|way| way.setting == "width") && adaptive.camera_sample == 0.0);
    let absent = explain_sampled(&preview, &profiles(Varied::Samples), &settings, Some(7));
    assert!(matches!(absent, Err(QuoteError::NoFrame(7))));
}
