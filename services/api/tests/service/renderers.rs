//! Jobs of other renderers: the service opens no scene, and only nodes with the renderer get tasks.

use crate::support::made_up::another_renderer;
use crate::support::{Answer, Farm};
use forelight_protocol::{
    Bundle, Explanation, FrameForecast, Job, JobPage, JobState, Lease, Node, Plan, ProblemKind, TaskKind,
    TaskSpec,
};
use reqwest::StatusCode;
use serde_json::{Value, json};

/// A node with the renderer.
async fn with_renderer(farm: &Farm, name: &str) -> Node {
    let node = json!({"name": name, "capabilities": {"renderers": [another_renderer()]}});
    farm.worker.post("/v1/nodes", &node).await.parsed(StatusCode::CREATED).await
}

/// Uploads a file that begins like a Blender file.
async fn uploaded(farm: &Farm) -> Bundle {
    let request = farm.submitter.request(reqwest::Method::POST, "/v1/bundles");
    let request = request.header("content-type", "application/x-blender");
    request.body("BLENDER-v500 and so on").send().await.unwrap().parsed(StatusCode::CREATED).await
}

fn request(bundle: &Bundle) -> Value {
    json!({
        "name": "shot", "bundle": {"id": bundle.id}, "frames": "1-10",
        "renderer": {"name": "cycles", "version": "5"}, "settings": {"own": {"denoise": false}}, "profile_frames": 3,
    })
}

async fn submitted(farm: &Farm) -> Job {
    let request = request(&uploaded(farm).await);
    farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_of_another_renderer_is_described_measured_booked_and_rendered_where_it_is_installed() {
    let farm = Farm::new().await;
    let plain = farm.node("plain").await;
    let job = submitted(&farm).await;
    assert_eq!((job.settings.size(), job.settings.samples(), job.scene.frames), (None, None, 0));
    assert!(farm.claim(&plain).await.is_none());
    let page: JobPage = farm.viewer.get("/v1/jobs").await.parsed(StatusCode::OK).await;
    let waits = page.items[0].waits.as_ref().unwrap();
    assert!(waits.because.contains("no node has cycles 5"), "{}", waits.because);

    let blender = with_renderer(&farm, "blender").await;
    let preview = farm.next_task(&blender).await;
    assert_eq!(preview.spec.kind(), TaskKind::Preview);
    farm.finish(&preview).await;
    let described = farm.job(&job).await;
    assert_eq!(described.renderer.as_ref().unwrap().to_string(), "cycles 5.0.1");
    assert_eq!((described.settings.size(), described.settings.samples()), (Some((8, 8)), Some(32)));
    assert_eq!(described.scene.triangles, 2);
    let mut profiled = Vec::new();
    for _ in 0..3 {
        let profile = farm.next_task(&blender).await;
        assert_eq!(profile.spec.renderer().unwrap().to_string(), "cycles 5.0.1");
        profiled.push(profile.spec.frame().unwrap());
        farm.finish(&profile).await;
    }
    for &frame in &profiled {
        let picture = farm.viewer.get(&format!("/v1/jobs/{}/frames/{frame}/preview.png", job.id)).await;
        assert_eq!(picture.status(), StatusCode::OK);
    }
    assert!(farm.claim(&plain).await.is_none());
    let first = farm.next_task(&blender).await;
    assert_eq!(farm.job(&job).await.state, JobState::Rendering);
    assert_quoted(&farm, &job).await;
    assert_only_on(&farm, &job, &blender).await;
    let shares = |lease: &Lease| match &lease.spec {
        TaskSpec::Render(spec) => spec.shares.len(),
        _ => panic!("{lease:?}"),
    };
    assert_eq!(shares(&first), usize::from(profiled.contains(&first.spec.frame().unwrap())));
    farm.finish(&first).await;
    let done = farm.work_off(&blender, &job).await;
    assert_eq!((done.state, done.frames_done), (JobState::Done, 10));
    assert_eq!((done.scene.name.as_str(), done.scene.frames), ("blender-file", 250));
    assert_explained(&farm, &job).await;
    let ladders = farm.viewer.get(&format!("/v1/jobs/{}/accuracy", job.id)).await;
    let problem = ladders.problem(ProblemKind::Conflict).await;
    assert!(problem.detail.contains("cycles 5.0.1"), "{problem:?}");
}

/// Asserts that the explanation divides the quote's CPU time by object and by what samples have a share in.
async fn assert_explained(farm: &Farm, job: &Job) {
    let path = format!("/v1/jobs/{}/explanation", job.id);
    let why: Explanation = farm.viewer.json(&path).await;
    let samples: f64 = (0..10).map(|frame| 32.0 * (2_000.0 + 20.0 * f64::from(frame))).sum();
    let close = |value: f64, truth: f64| assert!((value / truth - 1.0).abs() < 0.01, "{value} {why:?}");
    close(why.work, samples + 10.0 * 10_000.0);
    close(why.objects[0].work, samples);
    close(why.camera_sample, samples / 32.0 / why.work);
    let one: Explanation = farm.viewer.json(&format!("{path}?frame=9")).await;
    assert_eq!(one.frame, Some(9));
    close(one.work, 10_000.0 + 32.0 * 2_180.0);
    assert!(one.words.iter().any(|line| line.contains("camera samples per pixel instead of 32")), "{one:?}");
}

/// Asserts that the quote is the known line in the samples, and that its work is CPU time.
async fn assert_quoted(farm: &Farm, job: &Job) {
    let quote = farm.quote(job).await;
    for FrameForecast { frame, cpu_seconds, work, .. } in &quote.frames {
        let truth = 0.010 + 32.0 * (0.002 + 0.000_02 * f64::from(*frame));
        assert!((cpu_seconds.mean / truth - 1.0).abs() < 0.01, "frame {frame}: {cpu_seconds:?}, {truth}");
        assert!((work.mean / cpu_seconds.mean / 1e6 - 1.0).abs() < 1e-9);
        assert!(cpu_seconds.p50 <= cpu_seconds.p80 && cpu_seconds.p80 <= cpu_seconds.p95);
    }
    assert_eq!((quote.frames.len(), quote.profiled.frames.len()), (10, 3));
    assert_eq!(quote.of.unwrap().renderer.unwrap().to_string(), "cycles 5.0.1");
}

/// Asserts that the plan books the job on no other node.
async fn assert_only_on(farm: &Farm, job: &Job, node: &Node) {
    let plan = farm.job(job).await.plan_id.unwrap();
    let plan: Plan = farm.viewer.get(&format!("/v1/plans/{plan}")).await.parsed(StatusCode::OK).await;
    assert_eq!(plan.bookings.len(), 10);
    assert!(plan.bookings.iter().all(|booking| booking.node_id == node.id), "{:?}", plan.bookings);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_does_not_go_together_with_another_renderer_is_named() {
    let farm = Farm::new().await;
    let bundle = uploaded(&farm).await;
    let with = |pointer: &str, value: Value| {
        let mut request = request(&bundle);
        let (parent, name) = pointer.rsplit_once('/').unwrap();
        request.pointer_mut(parent).unwrap()[name] = value;
        request
    };
    for (request, pointer, reason) in [
        (with("/renderer/name", json!("Cycles!")), "/renderer/name", "lower-case"),
        (with("/renderer/version", json!("5 or so")), "/renderer/version", "letters, digits"),
        (with("/settings/ambient_bounces", json!(2)), "/settings/ambient_bounces", "own renderer"),
        (with("/settings/spp", json!(0)), "/settings/spp", "1 to 65536"),
        (with("/settings/seed", json!(1u64 << 40)), "/settings/seed", "at most"),
        (with("/cache", json!("shared")), "/cache", "own renderer"),
        (with("/within", json!({"cpu_micros": 5})), "/within", "own renderer"),
        (with("/ladders", json!("all")), "/ladders", "own renderer"),
        (with("/renderer", Value::Null), "/settings/own", "another renderer"),
    ] {
        let problem = farm.submitter.post("/v1/jobs", &request).await.problem(ProblemKind::Invalid).await;
        let place = problem.pointer.as_deref().unwrap_or_default();
        assert!(place == pointer && problem.detail.contains(reason), "{request}: {problem:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_is_no_scene_of_another_renderer() {
    let farm = Farm::new().await;
    let mut request = request(&uploaded(&farm).await);
    request["bundle"] = json!({"path": farm.bundle_path()});
    let problem = farm.submitter.post("/v1/jobs", &request).await.problem(ProblemKind::InvalidBundle).await;
    assert_eq!(problem.pointer.as_deref(), Some("/bundle/path"), "{problem:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn files_that_are_no_blender_files_are_not_kept() {
    let farm = Farm::new().await;
    let request = farm.submitter.request(reqwest::Method::POST, "/v1/bundles");
    let request = request.header("content-type", "application/x-blender").body("a letter");
    let problem = request.send().await.unwrap().problem(ProblemKind::InvalidBundle).await;
    assert!(problem.detail.contains("no Blender file"), "{problem:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_of_another_renderer_that_does_not_fit_is_refused_with_the_place() {
    let farm = Farm::new().await;
    submitted(&farm).await;
    let blender = with_renderer(&farm, "blender").await;
    let preview = farm.next_task(&blender).await;
    let good = serde_json::to_value(farm.made_up_result(&preview).await).unwrap();
    for (pointer, value) in [
        ("/preview/described/renderer/version", json!("4.5.0")),
        ("/preview/described/settings/samples", Value::Null),
        ("/preview/described/scene/digest", json!("00".repeat(32))),
        ("/preview/described", Value::Null),
        ("/preview/frames/0/pixels", json!([49])),
    ] {
        refused(&farm, &preview, &good, pointer, value).await;
    }
    farm.finish(&preview).await;
    let profile = farm.next_task(&blender).await;
    let good = serde_json::to_value(farm.made_up_result(&profile).await).unwrap();
    for (pointer, value) in [
        ("/measured/frame", json!(99)),
        ("/measured/renderer/name", json!("other")),
        ("/measured/costs/0/amount", json!(4)),
        ("/measured/shares/0/offset", json!(1)),
        ("/measured/shares/0/count", json!(33)),
        ("/measured/spent/work", json!(u64::MAX)),
    ] {
        refused(&farm, &profile, &good, pointer, value).await;
    }
    farm.finish(&profile).await;
}

/// All 64 pixels of a frame: 48 of a surface, and 16 of the background. `work` is what the renderer states
/// for each; it is ignored.
async fn profiled_pixels(farm: &Farm, profile: &Lease, work: u64) -> Value {
    let frame = u64::from(profile.spec.frame().unwrap());
    let sample = |pixel: u64| {
        let nanos = if pixel < 48 { 1_000_000 + 10_000 * frame } else { 10_000 };
        let stratum = u64::from(pixel >= 48);
        json!({"pixel": pixel, "stratum": stratum, "work": work, "cpu_nanos": nanos, "rays": [1, 2, 0, 0, 0, 0, 0]})
    };
    let file = farm.artifact(format!("pixels of {frame}").as_bytes()).await;
    let none = json!({"work": 0, "cpu_nanos": 0});
    json!({"profile": {
        "frame": frame,
        "strata": [{"name": {"object": "quad", "material": "paint"}, "object": 0, "material": 0, "prior_cost": 1.0}],
        "samples": (0..64).map(sample).collect::<Vec<_>>(),
        "renderer": another_renderer().to_string(),
        "fixed": {"load": none, "build": {"work": work, "cpu_nanos": 5_000_000}, "plan": none,
            "plan_rays": [0, 0, 0, 0, 0, 0, 0], "write": none},
        "spent": {"work": work, "cpu_nanos": 60_000_000},
        "artifacts": {"profile": file},
    }})
}

#[tokio::test(flavor = "multi_thread")]
async fn a_renderer_that_measures_single_pixels_is_quoted_by_them_and_takes_them_over() {
    let farm = Farm::new().await;
    let job = submitted(&farm).await;
    let node = with_renderer(&farm, "node").await;
    farm.finish(&farm.next_task(&node).await).await;
    let mut profiled = Vec::new();
    for _ in 0..3 {
        let profile = farm.next_task(&node).await;
        let good = profiled_pixels(&farm, &profile, 7).await;
        for (pointer, value) in [
            ("/profile/renderer", json!("cycles 4.5")),
            ("/profile/renderer", Value::Null),
            ("/profile/samples/3/pixel", json!(64)),
            ("/profile/samples", json!([])),
            ("/profile/effects", json!(["ambient"])),
        ] {
            refused_or_added(&farm, &profile, &good, pointer, value).await;
        }
        profiled.push(profile.spec.frame().unwrap());
        let result = serde_json::from_value(good).unwrap();
        assert_eq!(farm.report(&profile, result).await.status(), StatusCode::OK);
    }
    let first = farm.next_task(&node).await;
    let TaskSpec::Render(render) = &first.spec else { panic!("{first:?}") };
    assert_eq!(render.profile.is_some(), profiled.contains(&render.frame));
    let quote = farm.quote(&job).await;
    let why: Explanation = farm.viewer.json(&format!("/v1/jobs/{}/explanation", job.id)).await;
    assert!((why.work / quote.total.work.mean - 1.0).abs() < 1e-3 && why.rays.len() > 1, "{why:?}");
    for FrameForecast { frame, cpu_seconds, work, rays, .. } in &quote.frames {
        let truth = 0.005 + 48.0 * (0.001 + 0.000_01 * f64::from(*frame)) + 16.0 * 0.000_01;
        assert!((cpu_seconds.mean / truth - 1.0).abs() < 0.01, "frame {frame}: {cpu_seconds:?}, {truth}");
        assert!((work.mean / cpu_seconds.mean / 1e6 - 1.0).abs() < 1e-3, "{work:?} {cpu_seconds:?}");
        assert!((rays.shadow.mean - 128.0).abs() < 1e-6, "{rays:?}");
    }
    farm.finish(&first).await;
    assert_eq!(farm.work_off(&node, &job).await.state, JobState::Done);
}

/// As [`refused`], also for a field that is absent.
async fn refused_or_added(farm: &Farm, lease: &Lease, good: &Value, pointer: &str, value: Value) {
    let mut with = good.clone();
    let (parent, name) = pointer.rsplit_once('/').unwrap();
    let parent = with.pointer_mut(parent).unwrap();
    if parent.is_object() {
        parent.as_object_mut().unwrap().entry(name).or_insert(Value::Null);
    }
    refused(farm, lease, &with, pointer, value).await;
}

/// Asserts that a result with this change is refused, and that the error names the place.
async fn refused(farm: &Farm, lease: &Lease, good: &Value, pointer: &str, value: Value) {
    let mut wrong = good.clone();
    *wrong.pointer_mut(pointer).unwrap() = value;
    let result = serde_json::from_value(wrong).unwrap();
    let problem = farm.report(lease, result).await.problem(ProblemKind::Invalid).await;
    let place = problem.pointer.clone().unwrap_or_default();
    let expected = format!("/result{pointer}");
    assert!(expected.starts_with(&place) || place.starts_with(&expected), "{pointer}: {problem:?}");
}
