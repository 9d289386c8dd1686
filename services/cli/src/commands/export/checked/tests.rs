use super::*;
use forelight_protocol::{RendererId, RendererRequest, SceneDigest, ShotSettings, Spent};
use std::collections::BTreeMap;
use std::fs;

fn message<T: std::fmt::Debug>(result: Result<T>) -> String {
    result.unwrap_err().to_string()
}

#[test]
fn a_name_that_a_job_cannot_have_is_refused() {
    let longest = "ä".repeat(LONGEST_JOB_NAME);
    assert_eq!(job_name(&longest).unwrap(), longest);
    assert!(message(job_name(&format!("{longest}x"))).contains("129 characters"));
    assert!(message(job_name("a\nb")).contains("control"));
    assert!(message(job_name("")).contains("has to have a name"));
}

#[test]
fn a_bundle_is_named_from_the_templates_folder_or_not_at_all() {
    let dir = tempfile::tempdir().unwrap();
    let bundle = dir.path().join("shots/a {{b}} \"c\"");
    fs::create_dir_all(&bundle).unwrap();
    let seen = |out: &str| bundle_default(&bundle, Some(&dir.path().join(out))).unwrap();
    assert_eq!(seen("job.json").as_deref(), Some("shots/a {{b}} \"c\""));
    assert_eq!(seen("shots/job.json").as_deref(), Some("a {{b}} \"c\""));
    assert_eq!(seen("shots/a {{b}} \"c\"/job.json").as_deref(), Some("."));
    assert_eq!(seen("shots/../job.json").as_deref(), Some("shots/a {{b}} \"c\""));
    fs::create_dir(dir.path().join("jobs")).unwrap();
    assert_eq!(seen("jobs/job.json"), None);
    assert_eq!(seen("to/be/made/job.json"), None);

    let odd = dir.path().join("a\nb");
    fs::create_dir(&odd).unwrap();
    let refused = bundle_default(&odd, Some(&dir.path().join("job.json")));
    assert!(message(refused).contains("control characters"));
}

fn quote(frames: &str, p95: f64) -> ForecastDoc {
    let quantiles = |p95: f64| serde_json::json!({"mean": p95, "p50": p95, "p80": p95, "p95": p95});
    let rays = |value: f64| {
        let names = ["primary", "shadow", "transparent", "reflected", "refracted", "ambient", "specular"];
        names.map(|name| (name.to_owned(), quantiles(value))).into_iter().collect::<serde_json::Map<_, _>>()
    };
    let forecast = |value: f64| serde_json::json!({"rays": rays(1.0), "cache_records": [], "work": quantiles(1.0), "cpu_seconds": quantiles(value)});
    let frames: FrameSet = frames.parse().unwrap();
    let each = frames.iter().map(|frame| {
        let mut one = forecast(p95);
        one["frame"] = frame.into();
        one
    });
    serde_json::from_value(serde_json::json!({
        "frames": each.collect::<Vec<_>>(),
        "total": forecast(p95 * frames.count() as f64),
        "profiled": {"frames": [], "pixels": 0},
        "spent": {"work": 0, "cpu_seconds": 0.0, "fraction_of_forecast": 0.0},
        "calibrated": false,
        "cost": {"mean": 0, "p50": 12_500_000, "p80": 0, "p95": 0},
    }))
    .unwrap()
}

#[test]
fn a_forecast_sets_limits_of_time_unless_one_is_asked_for() {
    let frames: FrameSet = "0-9".parse().unwrap();
    let limits = |asked, quote: Option<&ForecastDoc>| Limits::new(asked, quote, &frames, None);
    assert_eq!(limits(None, None).unwrap(), Limits { frame: None, cache: None });
    let dear = quote("0-9", 1000.25);
    assert_eq!(limits(None, Some(&dear)).unwrap(), Limits { frame: Some(4001), cache: Some(40010) });
    let cheap = quote("0-9", 20.0);
    assert_eq!(limits(None, Some(&cheap)).unwrap(), Limits { frame: Some(600), cache: Some(800) });
    let build = Spent { work: 9, cpu_nanos: 12_000_000_000 };
    let once = Some(ProcessCosts { load: Spent { work: 0, cpu_nanos: 500_000_000 }, build });
    let loaded = ForecastDoc { once, ..dear.clone() };
    assert_eq!(limits(None, Some(&loaded)).unwrap(), Limits { frame: Some(4051), cache: Some(40060) });
    let asked = Some(Duration::from_millis(1500));
    assert_eq!(limits(asked, Some(&dear)).unwrap(), Limits { frame: Some(2), cache: Some(2) });
    assert!(message(limits(None, Some(&quote("0-8", 1.0)))).contains("the frames 0-8, not of 0-9"));
    assert!(message(limits(None, Some(&quote("0-9", -1.0)))).contains("out of range"));
    assert!(message(limits(None, Some(&quote("0-9", 1e300)))).contains("out of range"));
}

#[test]
fn a_task_has_as_many_frames_as_take_its_time() {
    let frames_of = |time: u64, quote: &ForecastDoc, threads| {
        chunk(Duration::from_secs(time), quote, threads).map(|chunk| (chunk.frames, chunk.seconds))
    };
    // Ten frames of 20 s each, and 100 s for loading.
    let load = Spent { work: 0, cpu_nanos: 100_000_000_000 };
    let once = Some(ProcessCosts { load, build: Spent::default() });
    let loaded = ForecastDoc { once, ..quote("0-9", 20.0) };
    assert_eq!(frames_of(600, &loaded, 1).unwrap(), (25, 600));
    assert_eq!(frames_of(600, &loaded, 4).unwrap(), (100, 600));
    assert_eq!(frames_of(86_400, &loaded, 1).unwrap(), (LARGEST_CHUNK, 86_400));
    assert_eq!(frames_of(120, &loaded, 1).unwrap(), (1, 120));
    let refused = message(frames_of(119, &loaded, 1));
    assert!(
        refused
            .starts_with("--chunk: a frame takes 20.0 s by the forecast with --threads 1, after 1 min 40 s"),
        "{refused}"
    );
    assert!(message(frames_of(60, &quote("0-9", 0.0), 1)).starts_with("--chunk: a frame takes"));
    // The time limit leaves room for the dearest frames in a row, and for more frames than were forecast.
    let mut uneven = loaded.clone();
    (3..5).for_each(|frame| uneven.frames[frame].cpu_seconds.p95 = 200.0);
    let frames: FrameSet = "0-9".parse().unwrap();
    let limit_of = |number| {
        let chunk = Some(Chunk { frames: number, seconds: 60 });
        Limits::new(None, Some(&uneven), &frames, chunk).unwrap().frame.unwrap()
    };
    assert_eq!([limit_of(1), limit_of(2), limit_of(3), limit_of(99)], [1200, 2000, 2080, 2640]);
    let Typed { args } = clap::Parser::try_parse_from(["export", "b"]).unwrap();
    let args = Args { chunk: Some(Duration::from_secs(600)), ..args };
    let settings = forelight_protocol::RenderSettingsRequest::default().complete((4, 2));
    let shot = exported(&args, source(settings, &frames), Some(&loaded), None).unwrap();
    assert_eq!((shot.chunk.unwrap().frames, shot.frame_limit), (25, Some(2400)));
}

fn source(settings: RenderSettings, frames: &FrameSet) -> Source {
    Source {
        name: "x".into(),
        digest: "00".repeat(32).parse().unwrap(),
        renderer: None,
        settings: settings.into(),
        set: BTreeMap::new(),
        formats: vec!["exr".into()],
        frames: frames.iter().collect(),
    }
}

#[derive(Debug, clap::Parser)]
struct Typed {
    #[command(flatten)]
    args: Args,
}

#[test]
fn what_a_job_cannot_hold_or_has_no_use_for_is_refused_by_its_flag() {
    let every_second = |frames: u32| FrameSet::from_frames((0..frames).map(|frame| 2 * frame)).unwrap();
    let exported = |flags: &str, change: fn(&mut RenderSettings), frames: u32| {
        let Typed { args } = clap::Parser::try_parse_from(flags.split(' ')).unwrap();
        let mut settings = forelight_protocol::RenderSettingsRequest::default().complete((4, 2));
        change(&mut settings);
        super::exported(&args, source(settings, &every_second(frames)), None, None)
    };
    assert_eq!(exported("export b", |_| (), 270).unwrap().frames.count(), 270);
    for (message, flag) in [
        (message(exported("export b", |_| (), 271)), "--frames: the list has 1028 characters"),
        (message(exported("export b", |settings| settings.seed = u64::MAX, 1)), "--seed"),
        (message(exported("export b --cache off --cache-parts 2", |_| (), 1)), "--cache-parts"),
        (
            message(exported(
                "export b --cache on",
                |settings| {
                    settings.cache = CacheMode::On;
                    settings.ambient_bounces = 0;
                },
                1,
            )),
            "--cache: these settings use no",
        ),
    ] {
        assert!(message.starts_with(flag), "{message}");
    }
}

#[test]
fn a_quote_of_something_else_is_refused_with_what_differs() {
    let settings = forelight_protocol::RenderSettingsRequest::default().complete((4, 2));
    let of = |scene: SceneDigest, settings: &RenderSettings, chosen_spp| ForecastDoc {
        of: Some(QuotedShot { scene, renderer: None, settings: settings.clone().into() }),
        chosen_spp,
        ..quote("0-9", 1.0)
    };
    let frames: FrameSet = "0-9".parse().unwrap();
    let check = |quote: ForecastDoc, settings: &RenderSettings| {
        check_quoted(&quote, &source(settings.clone(), &frames))
    };
    let scene = || source(settings.clone(), &frames).digest;
    check(of(scene(), &settings, None), &settings).unwrap();
    let finer = RenderSettings { spp: 64, cache: CacheMode::On, ..settings.clone() };
    let refused = message(check(of(scene(), &settings, None), &finer));
    assert!(refused.contains("another quality (cache: \"off\" and \"on\"; spp: 16 and 64)"), "{refused}");
    let changed = "07".repeat(32).parse().unwrap();
    let refused = message(check(of(changed, &settings, None), &settings));
    assert!(refused.contains("another scene"), "{refused}");
    // The samples that a limit chose are those that count.
    let chosen = RenderSettings { spp: 37, ..settings.clone() };
    check(of(scene(), &settings, Some(37)), &chosen).unwrap();
    check(of(scene(), &settings, Some(37)), &settings).unwrap_err();
    // Quotes of older versions do not say what they are of.
    check(quote("0-9", 1.0), &settings).unwrap();
}

#[test]
fn a_quote_of_another_renderer_is_held_against_its_version_and_settings() {
    let settings = |width, denoise: bool| ShotSettings {
        width: Some(width),
        height: Some(2),
        samples: Some(16),
        seed: Some(0),
        own: [("denoise".to_owned(), denoise.into())].into_iter().collect(),
    };
    let frames: FrameSet = "0-9".parse().unwrap();
    let source = |width, denoise| Source {
        renderer: Some(RendererId { name: "cycles".into(), version: "5.0.1".into() }),
        settings: JobSettings::Shot(settings(width, denoise)),
        ..source(forelight_protocol::RenderSettingsRequest::default().complete((4, 2)), &frames)
    };
    let asked = |version: &str| ForecastDoc {
        of: Some(QuotedShot {
            scene: source(4, true).digest,
            renderer: Some(RendererRequest { name: "cycles".into(), version: Some(version.into()) }),
            settings: JobSettings::Shot(settings(4, true)),
        }),
        ..quote("0-9", 1.0)
    };
    check_quoted(&asked("5.0"), &source(4, true)).unwrap();
    let refused = message(check_quoted(&asked("5.0.1"), &source(8, false)));
    assert!(refused.contains("(denoise: true and false; width: 4 and 8)"), "{refused}");
    let refused = message(check_quoted(&asked("4.5"), &source(4, true)));
    assert!(refused.contains("another renderer or version"), "{refused}");
}

#[test]
fn the_memory_of_a_frame_is_asked_for_if_it_is_of_the_same_size() {
    let stats: FrameStats = serde_json::from_value(serde_json::json!({
        "frame": 0, "width": 4, "height": 2, "spp": 1, "effects": [], "work": 1, "cpu_seconds": 1.0, "wall_seconds": 1.0,
        "rays": {"primary": 8, "shadow": 0, "transparent": 0, "reflected": 0, "refracted": 0, "ambient": 0, "specular": 0},
        "peak_rss_bytes": (5u64 << 20) + 1,
    }))
    .unwrap();
    let Typed { args } = clap::Parser::try_parse_from(["export", "b"]).unwrap();
    let exported = |width: u32| {
        let settings = forelight_protocol::RenderSettingsRequest::default().complete((width, 2));
        super::exported(&args, source(settings, &"0".parse().unwrap()), None, Some(&stats))
    };
    assert_eq!(exported(4).unwrap().memory_mib, Some(6));
    assert!(message(exported(8)).contains("an image of 4 x 2 pixels, not of 8 x 2"));
}

#[test]
fn the_description_says_what_the_shot_will_cost() {
    let settings = forelight_protocol::RenderSettingsRequest::default().complete((4, 2));
    let frames: FrameSet = "0-9".parse().unwrap();
    let text = description(&source(settings.clone(), &frames), &frames, Some(&quote("0-9", 20.0)));
    assert!(text.starts_with("10 frames of 4 x 2 pixels, 16 samples"), "{text}");
    assert!(text.contains("3 min 20 s (P95)") && text.contains("Costs 12.50 (P50)"), "{text}");
    assert!(!description(&source(settings, &frames), &frames, None).contains("Forecast"));
}
