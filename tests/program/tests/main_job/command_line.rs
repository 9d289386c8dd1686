//! Jobs that `forelight submit` sends and follows.

use crate::{HEIGHT, WIDTH, farm, in_a_year};
use forelight_protocol::{ForecastDoc, FrameRow, Quantiles, RenderStats};
use forelight_tests::bundles::{shipped, zip_of};
use forelight_tests::pictures::{Channels, assert_png};
use forelight_tests::processes::{run, run_well};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::path::Path;

#[tokio::test(flavor = "multi_thread")]
async fn submitting_by_the_command_line_brings_every_picture_and_a_contact_sheet() {
    let service = farm().await;
    let (data, scene) = (service.data(), shipped("corridor"));
    let out = service.folder().join("images");
    let submit = |bundle: &Path, more: &[&str]| -> Vec<String> {
        let bundle = bundle.display().to_string();
        let data = data.display().to_string();
        let farm = ["--server", service.address(), "--data", &data, "--width", "48", "--spp", "1"];
        ["submit", &bundle].into_iter().chain(farm).chain(more.iter().copied()).map(str::to_owned).collect()
    };
    let folder = out.display().to_string();
    let key = "0198c0de-0000-7000-8000-000000000003";
    let deadline = in_a_year().to_string();
    let wanted = ["--frames", "0-2", "--deadline", &deadline, "--idempotency-key", key];
    let arguments = submit(&scene, &[&wanted[..], &["--out", &folder, "--json"]].concat());
    let printed: Value =
        serde_json::from_str(&run_well(&arguments)).expect("JSON is printed and nothing else");
    assert_eq!(printed["job"]["state"], "done");
    assert_eq!(printed["frames"].as_array().map(Vec::len), Some(3));
    assert!(printed["forecast"]["total"]["work"]["p80"].as_f64() > Some(0.0));

    let mut expected = BTreeSet::from(["contact-sheet.png".to_owned()]);
    for frame in 0..3 {
        for end in [".exr", ".png", "-cost.png", "-preview.png"] {
            expected.insert(format!("frame-{frame:04}{end}"));
        }
    }
    let names: BTreeSet<String> =
        std::fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    assert_eq!(names, expected);
    for name in &names {
        let content = std::fs::read(out.join(name)).unwrap();
        if name == "contact-sheet.png" {
            let sheet = image::load_from_memory(&content).expect("the sheet is a picture");
            assert!(sheet.width() >= WIDTH && sheet.height() >= HEIGHT);
        } else if name.ends_with(".exr") {
            assert_eq!(Channels::of(&content).size, (WIDTH as usize, HEIGHT as usize));
        } else {
            assert_png(&content, WIDTH, HEIGHT, name);
        }
    }

    // The same submission again is the same job. The table has a line for each of its frames.
    let again = run_well(&submit(&scene, &wanted));
    assert_eq!(again.trim(), printed["job"]["id"].as_str().unwrap());
    let data = data.display().to_string();
    let follow =
        ["submit", "--job", again.trim(), "--follow", "--server", service.address(), "--data", &data];
    let table = run_well(&follow);
    assert!(table.contains("delivered  3 of 3 frames"), "{table}");

    // Wrong input gives a one-line error and its exit code.
    let missing = service.folder().join("no such bundle");
    let empty = service.folder().join("empty.zip");
    std::fs::write(&empty, zip_of([])).unwrap();
    let past_the_end = ["--frames", "0-48"];
    let nowhere = ["--out", "/proc/images"];
    for (bundle, more, said) in [
        (&missing, &[][..], "no such bundle"),
        (&empty, &[], "scene.json"),
        (&scene, &past_the_end, "--frames: "),
        (&scene, &nowhere, "nothing can be written in /proc"),
    ] {
        let output = run(&submit(bundle, more));
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{error}");
        let line = error.lines().find(|line| line.starts_with("error: ")).unwrap_or_default();
        assert!(line.contains(said), "{error}");
        assert_eq!(error.matches("error: ").count(), 1, "{error}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_on_hold_is_quoted_says_when_it_would_end_and_is_rendered_once_it_is_accepted() {
    let service = farm().await;
    let (scene, data) = (shipped("corridor").display().to_string(), service.data().display().to_string());
    let at = ["--server", service.address(), "--data", &data];
    let job =
        ["submit", &scene, "--frames", "0", "--width", "48", "--spp", "1", "--hold", "--follow", "--json"];
    let quoted: Value = serde_json::from_str(&run_well(&[&job[..], &at].concat())).expect("JSON is printed");
    assert_eq!((&quoted["job"]["state"], &quoted["job"]["plan_id"]), (&json!("quoted"), &Value::Null));
    let id = quoted["job"]["id"].as_str().expect("an id");
    let status = run_well(&[&["status", id][..], &at].concat());
    for said in ["if it is accepted now", &format!("waits      for `forelight accept {id}`"), "quoted     "] {
        assert!(status.contains(said), "{status}");
    }
    let accepted =
        run_well(&[&["accept", id, "--deadline", "6h", "--budget", "9.50", "--json"][..], &at].concat());
    let accepted: Value = serde_json::from_str(&accepted).expect("JSON is printed");
    assert_eq!((&accepted["hold"], &accepted["budget"]), (&Value::Null, &json!(9_500_000)));
    let table = run_well(&[&["submit", "--job", id, "--follow"][..], &at].concat());
    assert!(table.contains("delivered  1 of 1 frame"), "{table}");
    let again = run_well(&[&["accept", id][..], &at].concat());
    assert!(again.contains("does not wait to be accepted; nothing was changed"), "{again}");
    let (code, error) = refused(&[&["accept", id, "--confidence", "p50"][..], &at].concat());
    assert!(code == Some(2) && error.contains("does not wait to be accepted"), "{error}");
    // Each of several jobs is cancelled for itself.
    let (code, error) = refused(&[&["cancel", "nosuch", id][..], &at].concat());
    assert_eq!((code, error.matches("error: ").count()), (Some(1), 3), "{error}");
    for said in ["nosuch: no job has this name or id", "the job is done", "2 of 2 could not be cancelled"] {
        assert!(error.contains(said), "{said}: {error}");
    }
}

/// The exit code of a command that fails, and what it says.
fn refused<A: AsRef<OsStr>>(arguments: &[A]) -> (Option<i32>, String) {
    let output = run(arguments);
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[tokio::test(flavor = "multi_thread")]
async fn images_that_were_deleted_are_said_to_be_and_leave_no_contact_sheet() {
    let service = farm().await;
    let (scene, data) = (shipped("corridor").display().to_string(), service.data().display().to_string());
    let at = ["--server", service.address(), "--data", &data];
    let quality = ["--frames", "0,2", "--width", "48", "--spp", "1", "--follow", "--json"];
    let printed = run_well(&[&["submit", &scene][..], &quality, &at].concat());
    let printed: Value = serde_json::from_str(&printed).expect("JSON is printed");
    let id = printed["job"]["id"].as_str().expect("an id");
    let log = run_well(&[&["log", id, "--frame", "2"][..], &at].concat());
    assert!(log.starts_with("profile ") || log.starts_with("render "), "{log}");
    assert!(log.contains("started on node-"), "{log}");
    let (code, error) = refused(&[&["log", id, "--frame", "7"][..], &at].concat());
    assert!(code == Some(2) && error.contains("--frame 7"), "{error}");

    run_well(&[&["retention", "set", "images", "0"][..], &at].concat());
    run_well(&[&["prune"][..], &at].concat());
    let out = service.folder().join("images");
    let folder = out.display().to_string();
    let (code, error) = refused(&[&["submit", "--job", id, "--out", &folder][..], &at].concat());
    let way =
        format!("the images of 2 frames were deleted; `forelight retry {id} --frames 0,2` makes them again");
    assert!(code == Some(1) && error.contains(&way), "{error}");
    assert!(!out.join("contact-sheet.png").exists());
    let status = run_well(&[&["status", id][..], &at].concat());
    assert!(status.contains(&way), "{status}");
    let table = run_well(&[&["submit", "--job", id, "--follow"][..], &at].concat());
    assert_eq!(table.matches("its image was deleted").count(), 2, "{table}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_time_for_a_shot_is_spent_frame_by_frame_where_it_pays() {
    let service = farm().await;
    let (scene, data) = (shipped("corridor").display().to_string(), service.data().display().to_string());
    let job = ["submit", &scene, "--server", service.address(), "--data", &data, "--frames", "0,24"];
    let quality = ["--width", "48", "--spp", "2", "--samples", "64", "--profile-frames", "1"];
    let printed = run_well(&[&job[..], &quality, &["--within", "3s", "--follow", "--json"]].concat());
    let printed: Value = serde_json::from_str(&printed).expect("JSON is printed and nothing else");
    assert_eq!(printed["job"]["state"], "done", "{printed}");
    let quote: ForecastDoc = serde_json::from_value(printed["forecast"].clone()).expect("a quote");
    let frames: Vec<FrameRow> = serde_json::from_value(printed["frames"].clone()).expect("frames");
    assert!(quote.chosen_spp > Some(2) && quote.total.cpu_seconds.p80 <= 3.0, "{quote:?}");
    for (forecast, row) in quote.frames.iter().zip(&frames) {
        let actual = row.actual.as_ref().expect("what it took");
        let share = actual.work as f64 / forecast.work.mean;
        assert!((share - 1.0).abs() < 0.02, "{share} of the work that it was given");
        let samples = actual.allotted.as_ref().expect("how its samples lie");
        assert!(samples.most > samples.least && samples.error.p50 > 0.0, "{samples:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_for_an_error_has_the_bits_that_it_has_without_a_farm_divided_or_not() {
    let service = farm().await;
    let (scene, data) = (shipped("corridor").display().to_string(), service.data().display().to_string());
    let at = ["--server", service.address(), "--data", &data];
    let quality = ["--width", "48", "--error", "15", "--preview", "cpu"];
    for cache in [&[][..], &["--cache", "on", "--cache-rays", "48"]] {
        let render = |name: &str, more: &[&str]| -> (Channels, RenderStats) {
            let out = service.folder().join(name).display().to_string();
            let words = [&["render", &scene, "--frame", "24", "--out", &out, "--json"][..], cache, more];
            let stats = serde_json::from_str(&run_well(&words.concat())).expect("the frame's cost");
            (Channels::of(&std::fs::read(&out).unwrap()), stats)
        };
        let (alone, stats) = render("alone.exr", &quality);
        let error = stats.allotted.clone().expect("its samples differ by pixel").error.p80;
        assert!(error <= 0.15 * 1.01, "{error}");
        for parts in ["1", "3"] {
            let on_farm = [&at[..], &quality[..4], &["--parts", parts]].concat();
            let (image, on_farm) = render("farm.exr", &on_farm);
            image.assert_same(&alone, &format!("{parts} parts, {cache:?}"));
            assert_eq!((on_farm.work, on_farm.rays), (stats.work, stats.rays), "{parts} parts, {cache:?}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn with_a_cache_the_number_of_records_is_known_before_and_what_was_gathered_for_the_quote_is_taken_over()
 {
    let service = farm().await;
    let (scene, data) = (shipped("kitchen").display().to_string(), service.data().display().to_string());
    let job = [
        "submit",
        &scene,
        "--server",
        service.address(),
        "--data",
        &data,
        "--frames",
        "0,1,40",
        "--follow",
        "--json",
    ];
    let quality =
        ["--width", "48", "--spp", "2", "--ambient-bounces", "2", "--cache", "on", "--cache-rays", "48"];
    // Frames that share a cache take over its records instead.
    let sharing = ["--cache-sharing", "private"];
    let profile = ["--samples", "64", "--profile-frames", "1"];
    let printed = run_well(&[&job[..], &quality, &sharing, &profile].concat());
    let printed: Value = serde_json::from_str(&printed).expect("JSON is printed and nothing else");
    assert_eq!(
        (&printed["job"]["state"], &printed["job"]["settings"]["cache"]),
        (&json!("done"), &json!("on"))
    );
    let quote: ForecastDoc = serde_json::from_value(printed["forecast"].clone()).expect("a quote");
    let frames: Vec<FrameRow> = serde_json::from_value(printed["frames"].clone()).expect("frames");
    assert!(quote.effects.iter().any(|effect| effect == "irradiance cache"), "{:?}", quote.effects);
    let mut all = [0.0; 2];
    for (forecast, row) in quote.frames.iter().zip(&frames) {
        let actual = row.actual.as_ref().expect("what it took");
        assert_eq!(actual.cache_records.len(), 2, "{actual:?}");
        for (level, (known, &count)) in forecast.cache_records.iter().zip(&actual.cache_records).enumerate() {
            assert_eq!(*known, Quantiles::known(count as f64), "frame {}, level {level}", row.frame);
            all[level] += count as f64;
        }
        let cache = actual.cache.expect("what the cache came to");
        let profiled = quote.profiled.frames.contains(&row.frame);
        assert_eq!((cache.reused_records > 0, actual.reused_work > 0), (profiled, profiled), "{actual:?}");
        let error = row.work.and_then(|work| work.error).expect("the error");
        assert!(error.abs() < 0.5, "frame {}: {error}", row.frame);
    }
    assert_eq!(quote.total.cache_records, all.map(Quantiles::known));
}

#[tokio::test]
async fn a_job_for_an_error_of_the_cache_has_the_settings_that_were_chosen_for_it() {
    let service = farm().await;
    let (scene, data) = (shipped("kitchen").display().to_string(), service.data().display().to_string());
    let job = ["submit", &scene, "--server", service.address(), "--data", &data, "--frames", "3", "--json"];
    let quality = ["--width", "32", "--spp", "1", "--ambient-bounces", "1", "--cache-error", "20"];
    let printed = run_well(&[&job[..], &quality].concat());
    let printed: Value = serde_json::from_str(&printed).expect("JSON is printed and nothing else");
    let settings = &printed["settings"];
    assert_eq!(
        (&settings["cache"], &settings["cache_accuracy"], &settings["cache_rays"]),
        (&json!("on"), &json!(1000), &json!(48))
    );
}
