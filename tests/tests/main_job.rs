//! The main job of the program, over HTTP and by the command line: a bundle goes in; a quote, bookings and images come out, and what
//! cannot be is refused without a trace.

use forelight_protocol::{
    Booking, BookingPage, Bundle, Dashboard, Event, EventKind, ForecastDoc, FramePage, FrameRow, FrameState,
    Job, JobState, NodePage, Plan, Problem, ProblemKind, Quantiles, Role, Timestamp, Verdict,
};
use forelight_tests::bundles::{shipped, zip_of, zipped};
use forelight_tests::events::Events;
use forelight_tests::http::{Answer, Http};
use forelight_tests::ledger::Ledger;
use forelight_tests::pictures::{Channels, assert_png};
use forelight_tests::processes::{Service, run, run_well};
use forelight_tests::waiting::eventually;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Duration;

const WIDTH: u32 = 48;
const HEIGHT: u32 = 27;

/// For anything that happens in the middle of a job.
const PATIENCE: Duration = Duration::from_secs(90);
/// For a whole job.
const JOB_PATIENCE: Duration = Duration::from_secs(240);

/// A farm of two workers on this machine.
async fn farm() -> Service {
    let flags =
        ["--workers", "2", "--threads", "1", "--price", "3.60", "--preview", "cpu", "--lease-ttl", "2s"];
    Service::start("farm", &flags).await
}

async fn upload(http: &Http, scene: &str) -> Bundle {
    http.upload(zipped(&shipped(scene)), None).await.parsed(StatusCode::CREATED).await
}

fn in_a_year() -> Timestamp {
    Timestamp::now().plus_micros(365 * 86_400_000_000)
}

fn request(bundle: &Bundle, frames: &str, samples_per_pixel: u32) -> Value {
    json!({
        "name": "a shot", "project": "a film", "bundle": {"id": bundle.id}, "frames": frames,
        "settings": {"width": WIDTH, "height": HEIGHT, "spp": samples_per_pixel},
        "samples": 128, "profile_frames": 2, "deadline": in_a_year(),
    })
}

async fn frames_of(http: &Http, job: &Job) -> Vec<FrameRow> {
    let page: FramePage = http.json(&format!("/v1/jobs/{}/frames", job.id)).await;
    page.items
}

async fn until(http: &Http, job: &Job, patience: Duration, wanted: impl Fn(&Job) -> bool) -> Job {
    eventually("a state of the job", patience, async || {
        let job: Job = http.json(&format!("/v1/jobs/{}", job.id)).await;
        wanted(&job).then_some(job)
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shot_is_quoted_booked_rendered_and_every_step_can_be_read() {
    const FRAMES: [u32; 5] = [0, 1, 2, 10, 40];
    let mut service = farm().await;
    let http = service.http(Role::Submitter);

    // A bundle, sent twice under one key, is one bundle; another body under the same key is a mistake.
    let zip = zipped(&shipped("kitchen"));
    let key = "0198c0de-0000-7000-8000-000000000001";
    let bundle: Bundle = http.upload(zip.clone(), Some(key)).await.parsed(StatusCode::CREATED).await;
    let again = http.upload(zip.clone(), Some(key)).await;
    assert_eq!(again.headers()["idempotency-replayed"], "true");
    assert_eq!(again.parsed::<Bundle>(StatusCode::CREATED).await, bundle);
    http.upload(zipped(&shipped("corridor")), Some(key))
        .await
        .problem(ProblemKind::IdempotencyKeyReused)
        .await;
    assert_eq!((bundle.scene.name.as_str(), bundle.scene.frames), ("kitchen", 48));
    assert_eq!(bundle.hash.to_string(), blake3::hash(&zip).to_hex().as_str());

    // The same with the job.
    let wanted = request(&bundle, "0-2,10,40", 2);
    let submit = async |body: &Value| {
        let request = http.request(Method::POST, "/v1/jobs").header("idempotency-key", key).json(body);
        request.send().await.unwrap()
    };
    // The key belongs to an upload already.
    submit(&wanted).await.problem(ProblemKind::IdempotencyKeyReused).await;
    let key = "0198c0de-0000-7000-8000-000000000002";
    let submit = async |body: &Value| {
        let request = http.request(Method::POST, "/v1/jobs").header("idempotency-key", key).json(body);
        request.send().await.unwrap()
    };
    let job: Job = submit(&wanted).await.parsed(StatusCode::CREATED).await;
    assert_eq!(submit(&wanted).await.parsed::<Job>(StatusCode::CREATED).await, job);
    submit(&request(&bundle, "0-3", 2)).await.problem(ProblemKind::IdempotencyKeyReused).await;
    assert_eq!((job.state, job.frames_total), (JobState::Previewing, FRAMES.len() as u32));

    // Its events up to the first frame that is handed out: by then there is a quote and a plan.
    let path = format!("/v1/jobs/{}", job.id);
    let mut stream = Events::open(&http, &format!("{path}/events"), None).await.expect("the job lives");
    let mut events: Vec<Event> = Vec::new();
    while events.last().is_none_or(|event| event.job_state != Some(JobState::Booked)) {
        events.push(stream.next(PATIENCE).await.expect("the job goes on"));
    }
    let quote: ForecastDoc = http.json(&format!("{path}/forecast")).await;
    events.extend(stream.rest(JOB_PATIENCE).await);
    assert_story(&events, FRAMES.len());
    // From any event on, the rest is the same again; after the last there is nothing.
    let middle = events.len() / 2;
    let rest = Events::open(&http, &format!("{path}/events"), Some(events[middle].id)).await.expect("a rest");
    assert_eq!(rest.rest(PATIENCE).await, events[middle + 1..]);
    assert!(Events::open(&http, &format!("{path}/events"), events.last().map(|e| e.id)).await.is_none());

    let done: Job = http.json(&path).await;
    assert_eq!((done.state, done.frames_done, done.progress), (JobState::Done, FRAMES.len() as u32, 1.0));
    let frames = frames_of(&http, &job).await;
    assert_eq!(frames.iter().map(|row| row.frame).collect::<Vec<_>>(), FRAMES);
    for row in &frames {
        assert_complete(row);
    }
    assert_quote(&quote, &frames);
    assert_eq!(http.json::<ForecastDoc>(&format!("{path}/forecast")).await, quote, "a quote never changes");
    assert_booked(&http, &done, &frames).await;
    for row in &frames {
        assert_pictures(&http, &format!("{path}/frames/{}", row.frame), row).await;
    }

    let dashboard: Dashboard = http.json("/v1/dashboard").await;
    assert_eq!((dashboard.counts.jobs_done, dashboard.counts.jobs_active), (1, 0));
    assert_eq!((dashboard.counts.nodes, dashboard.track_frames), (2, FRAMES.len() as u64));
    assert!(dashboard.nodes.iter().all(|node| node.alive && node.activity.is_none()));
    service.end().await;
    Ledger::of(&service.data()).await.assert_balanced().await;
}

/// Each step of the job's way once, the quote and the plan before any frame.
fn assert_story(events: &[Event], frames: usize) {
    assert!(events.windows(2).all(|pair| pair[0].id < pair[1].id));
    assert_eq!(events[0].kind, EventKind::JobCreated);
    let states: Vec<JobState> = events.iter().filter_map(|event| event.job_state).collect();
    assert!(
        states.ends_with(&[JobState::Profiling, JobState::Booked, JobState::Rendering, JobState::Done]),
        "{states:?}"
    );
    let place = |wanted: &dyn Fn(&Event) -> bool| events.iter().position(wanted).expect("it happened");
    let rendering = |event: &Event| event.task_kind.is_some_and(|kind| kind.name() == "render");
    let first_frame = place(&|event| event.kind == EventKind::TaskLeased && rendering(event));
    assert!(place(&|event| event.kind == EventKind::ForecastReady) < first_frame);
    assert!(place(&|event| event.kind == EventKind::PlanStored) < first_frame);
    let delivered: BTreeSet<_> = events
        .iter()
        .filter(|event| event.kind == EventKind::TaskDone && rendering(event))
        .map(|event| event.frame)
        .collect();
    assert_eq!(delivered.len(), frames);
}

/// A frame that is done has every cell of its row.
fn assert_complete(row: &FrameRow) {
    let frame = row.frame;
    assert_eq!((row.state, row.attempts, row.progress), (FrameState::Done, 1, 1.0), "frame {frame}");
    let actual = row.actual.as_ref().expect("what it took");
    assert_eq!((actual.frame, actual.width, actual.height, actual.spp), (frame, WIDTH, HEIGHT, 2));
    assert_eq!(actual.rays.primary, u64::from(WIDTH * HEIGHT * 2), "frame {frame}");
    let forecast = row.forecast.as_ref().expect("its forecast");
    assert_eq!(forecast.frame, frame);
    let (work, cpu) = (row.work.expect("its work"), row.cpu_seconds.expect("its CPU time"));
    assert_eq!((work.forecast, cpu.forecast), (forecast.work, forecast.cpu_seconds));
    assert_eq!(work.actual, Some(actual.work as f64));
    for figure in [work, cpu] {
        let (actual, error) = (figure.actual.expect("what it was"), figure.error.expect("the error"));
        assert!((error - (figure.forecast.mean / actual - 1.0)).abs() < 1e-9, "frame {frame}: {figure:?}");
    }
    let booked = row.booked.as_ref().expect("a booking");
    assert!(booked.start < booked.end && booked.node.starts_with("node-"), "{booked:?}");
    let (started, finished) = (row.started.expect("a start"), row.finished.expect("an end"));
    assert!(started < finished, "frame {frame}");
    assert!(row.node.is_some() && row.error.is_none());
    let there = &row.artifacts;
    let all = [there.preview_png, there.cost_map_png, there.image_png, there.image_exr];
    assert!(all.iter().all(Option::is_some), "frame {frame}: {there:?}");
}

/// The quote is consistent in itself, and not absurd: within a factor of two of the truth in total, of three for each frame. How good
/// it is beyond that is for other tests to say.
fn assert_quote(quote: &ForecastDoc, frames: &[FrameRow]) {
    let rising = |q: &Quantiles| 0.0 < q.p50 && q.p50 <= q.p80 && q.p80 <= q.p95 && q.mean > 0.0;
    assert!(rising(&quote.total.work) && rising(&quote.total.cpu_seconds));
    assert_eq!(quote.profiled.frames.len(), 2);
    assert!(quote.profiled.frames.iter().all(|frame| frames.iter().any(|row| row.frame == *frame)));
    assert!(quote.profiled.pixels > 0 && quote.spent.work > 0);
    assert!(quote.cost.is_some_and(|cost| cost.p50.0 > 0 && cost.p50 <= cost.p80 && cost.p80 <= cost.p95));
    let within =
        |forecast: f64, actual: f64, factor: f64| forecast < actual * factor && actual < forecast * factor;
    let mut truth = 0.0;
    for (forecast, row) in quote.frames.iter().zip(frames) {
        assert_eq!(forecast.frame, row.frame);
        let actual = row.actual.as_ref().map_or(0.0, |stats| stats.work as f64);
        assert!(rising(&forecast.work), "{forecast:?}");
        assert!(
            within(forecast.work.mean, actual, 3.0),
            "frame {}: {:?}, was {actual}",
            row.frame,
            forecast.work
        );
        truth += actual;
    }
    assert!(within(quote.total.work.mean, truth, 2.0), "{:?}, was {truth}", quote.total.work);
    let reused = |row: &FrameRow| row.actual.as_ref().is_some_and(|stats| stats.reused_pixels > 0);
    let reusing: Vec<u32> = frames.iter().filter(|row| reused(row)).map(|row| row.frame).collect();
    assert_eq!(reusing, quote.profiled.frames, "the frames whose profiled pixels were taken over");
}

/// The plan has a word on the job, and a node for every frame; no node has two frames at once.
async fn assert_booked(http: &Http, job: &Job, frames: &[FrameRow]) {
    let verdict = job.verdict.as_ref().expect("a verdict");
    assert_eq!(
        (verdict.job_id, verdict.verdict, verdict.confidence),
        (job.id, Verdict::OnTime, job.confidence)
    );
    assert!(verdict.cost.is_some_and(|cost| cost.0 > 0) && verdict.finish < job.deadline);
    let plan: Plan = http.json(&format!("/v1/plans/{}", job.plan_id.expect("a plan"))).await;
    assert_eq!(plan.verdicts, std::slice::from_ref(verdict));
    let mut by_node: BTreeMap<_, Vec<&Booking>> = BTreeMap::new();
    for booking in &plan.bookings {
        assert!(booking.start < booking.end && booking.job_id == job.id);
        by_node.entry(booking.node_id).or_default().push(booking);
        let row = frames.iter().find(|row| row.frame == booking.frame).expect("a frame of the job");
        let told = row.booked.as_ref().expect("a booking");
        assert_eq!((told.node_id, told.start, told.end), (booking.node_id, booking.start, booking.end));
    }
    assert_eq!(plan.bookings.len(), frames.len());
    for bookings in by_node.values() {
        assert!(bookings.windows(2).all(|pair| pair[0].end <= pair[1].start), "{bookings:?}");
    }
    assert!(plan.bookings.iter().map(|booking| booking.end).max() <= verdict.finish);
    let open: BookingPage = http.json("/v1/bookings").await;
    assert_eq!(open.items, [], "what is rendered is not booked any more");
}

async fn assert_pictures(http: &Http, path: &str, row: &FrameRow) {
    for name in ["image.png", "preview.png", "cost-map.png"] {
        let address = format!("{path}/{name}");
        assert_png(&http.bytes(&address, "image/png").await, WIDTH, HEIGHT, &address);
    }
    let address = format!("{path}/image.exr");
    let response = http.get(&address).await;
    let tag = response.headers()["etag"].clone();
    assert_eq!(tag, format!("\"{}\"", row.artifacts.image_exr.expect("an image")));
    let image = Channels::of(&http.bytes(&address, "image/x-exr").await);
    assert_eq!(image.size, (WIDTH as usize, HEIGHT as usize));
    let total: u64 = image.samples["rays.shadow"].iter().map(|&rays| u64::from(rays)).sum();
    assert_eq!(Some(total), row.actual.as_ref().map(|stats| stats.rays.shadow), "rays of image and row");
    let asked = http.request(Method::GET, &address).header("if-none-match", tag).send().await.unwrap();
    assert_eq!(asked.status(), StatusCode::NOT_MODIFIED);
}

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

    // The same submission again is the same job, and the table for people has a line for each of its frames.
    let again = run_well(&submit(&scene, &wanted));
    assert_eq!(again.trim(), printed["job"]["id"].as_str().unwrap());
    let data = data.display().to_string();
    let follow =
        ["submit", "--job", again.trim(), "--follow", "--server", service.address(), "--data", &data];
    let table = run_well(&follow);
    assert!(table.contains("delivered  3 of 3 frames"), "{table}");

    // What cannot be is said in one line, with the exit code for wrong input.
    let missing = service.folder().join("no such bundle");
    let empty = service.folder().join("empty.zip");
    std::fs::write(&empty, zip_of([])).unwrap();
    let past_the_end = ["--frames", "0-48"];
    for (bundle, more, said) in
        [(&missing, &[][..], "no such bundle"), (&empty, &[], "scene.json"), (&scene, &past_the_end, "48")]
    {
        let output = run(&submit(bundle, more));
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{error}");
        let line = error.lines().find(|line| line.starts_with("error: ")).unwrap_or_default();
        assert!(line.contains(said), "{error}");
        assert_eq!(error.matches("error: ").count(), 1, "{error}");
    }
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
    let profile = ["--samples", "64", "--profile-frames", "1"];
    let printed = run_well(&[&job[..], &quality, &profile].concat());
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

#[tokio::test(flavor = "multi_thread")]
async fn a_job_cancelled_in_the_middle_of_its_frames_stops_and_frees_its_workers() {
    let mut service = farm().await;
    let http = service.http(Role::Submitter);
    let bundle = upload(&http, "corridor").await;
    // While it is profiled.
    let job: Job =
        http.post("/v1/jobs", &request(&bundle, "0-47", 256)).await.parsed(StatusCode::CREATED).await;
    until(&http, &job, PATIENCE, |job| job.state == JobState::Profiling).await;
    eventually("a worker at work", PATIENCE, async || {
        let dashboard: Dashboard = http.json("/v1/dashboard").await;
        dashboard.nodes.iter().any(|node| node.activity.is_some()).then_some(())
    })
    .await;
    cancel(&http, &job).await;
    idle(&http).await;

    // In the middle of its frames, all of which take longer than a test can wait.
    let mut long = request(&bundle, "0-47", 192);
    long["samples"] = json!(16);
    let job: Job = http.post("/v1/jobs", &long).await.parsed(StatusCode::CREATED).await;
    eventually("two frames in the middle", PATIENCE, async || {
        let frames = frames_of(&http, &job).await;
        let middle = |row: &&FrameRow| row.state == FrameState::Leased && row.progress > 0.0;
        (frames.iter().filter(middle).count() == 2).then_some(())
    })
    .await;
    let cancelled = cancel(&http, &job).await;
    idle(&http).await;

    // The farm is free for others.
    let short: Job =
        http.post("/v1/jobs", &request(&bundle, "0-1", 1)).await.parsed(StatusCode::CREATED).await;
    until(&http, &short, JOB_PATIENCE, |job| job.state == JobState::Done).await;

    let stays: Job = http.json(&format!("/v1/jobs/{}", job.id)).await;
    assert!(stays.spent.is_some_and(|spent| spent.0 > 0), "what its workers did until then is paid for");
    assert_eq!(Job { spent: cancelled.spent, ..stays }, cancelled, "it stays as it was cancelled");
    for row in frames_of(&http, &job).await {
        let untouched = row.actual.is_none() && row.finished.is_none() && row.artifacts.image_exr.is_none();
        assert!(row.state == FrameState::Cancelled && untouched, "{row:?}");
    }
    let open: BookingPage = http.json("/v1/bookings").await;
    assert_eq!(open.items, [], "what was cancelled is not booked any more");
    service.end().await;
    let leases = Ledger::of(&service.data()).await.leases(job.id).await;
    let held: Vec<_> = leases.iter().filter(|lease| lease.kind == "render").collect();
    assert!(held.len() >= 2 && held.iter().all(|lease| lease.state == "revoked"), "{held:?}");
}

/// Cancels a job, and again, which changes nothing.
async fn cancel(http: &Http, job: &Job) -> Job {
    let path = format!("/v1/jobs/{}/cancel", job.id);
    let cancelled: Job = http.post(&path, &json!({})).await.parsed(StatusCode::OK).await;
    assert_eq!(cancelled.state, JobState::Cancelled);
    assert!(cancelled.finished_at.is_some() && cancelled.error.is_none());
    assert_eq!(http.post(&path, &json!({})).await.parsed::<Job>(StatusCode::OK).await, cancelled);
    cancelled
}

/// Waits until no node holds a task.
async fn idle(http: &Http) {
    eventually("idle nodes", PATIENCE, async || {
        let nodes: NodePage = http.json("/v1/nodes").await;
        nodes.items.iter().all(|node| node.task_id.is_none()).then_some(())
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_malformed_bundle_is_refused_with_its_reason_and_leaves_nothing_behind() {
    let mut service = Service::start("serve", &[]).await;
    let http = service.http(Role::Submitter);
    let text = |text: &str| text.as_bytes().to_vec();
    let scene = |geometry: &str| {
        json!({
            "version": 1, "name": "x", "geometry": [geometry],
            "camera": {"origin": [0, 0, 3], "target": [0, 0, 0], "up": [0, 1, 0], "fov_deg": 40, "fov_axis": "x", "width": 8, "height": 8},
        })
        .to_string()
        .into_bytes()
    };
    let triangle = text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    let good = zip_of([("scene.json", scene("a.obj")), ("a.obj", triangle.clone())]);
    let mut cut = zipped(&shipped("corridor"));
    cut.truncate(cut.len() / 2);
    let mut damaged = good.clone();
    let middle = damaged.len() / 3;
    damaged[middle] ^= 0x55;
    let bundles: [(&str, Vec<u8>, &str); 9] = [
        ("nothing", Vec::new(), "zip"),
        ("no zip", text("this is not a zip file"), "zip"),
        ("half a zip", cut, "zip"),
        ("a zip with a wrong byte", damaged, ""),
        ("an empty zip", zip_of([]), "scene.json"),
        ("a scene that is no JSON", zip_of([("scene.json", text("{"))]), "scene.json"),
        ("a scene without its geometry", zip_of([("scene.json", scene("a.obj"))]), "a.obj"),
        (
            "geometry outside",
            zip_of([("scene.json", scene("../../a.obj")), ("a.obj", triangle.clone())]),
            "..",
        ),
        (
            "a file outside",
            zip_of([("scene.json", scene("a.obj")), ("a.obj", triangle), ("../out", vec![1])]),
            "..",
        ),
    ];
    let before = files(&service.data());
    for (number, (what, zip, said)) in bundles.into_iter().enumerate() {
        for key in [None, Some(format!("key {number}"))] {
            let refused = http.upload(zip.clone(), key.as_deref()).await;
            let problem: Problem = refused.problem(ProblemKind::InvalidBundle).await;
            assert!(problem.detail.contains(said), "{what}: {}", problem.detail);
        }
    }
    // Nor do jobs that cannot be.
    for (body, pointer) in [
        (json!({"name": "x", "bundle": {"path": "/etc"}, "frames": "0"}), "/bundle/path"),
        (
            json!({"name": "x", "bundle": {"id": "0198c0de-0000-7000-8000-000000000009"}, "frames": "0"}),
            "/bundle/id",
        ),
        (json!({"name": "x", "bundle": {}, "frames": "0"}), "/bundle"),
        (json!({"name": "x", "bundle": {"path": "/x"}, "frames": "2-1"}), "/frames"),
    ] {
        let problem = http.post("/v1/jobs", &body).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer), "{body}");
    }
    assert_eq!(files(&service.data()), before, "a refused bundle left a file");
    service.kill();
    let rows = Ledger::of(&service.data()).await.rows().await;
    assert!(rows.values().all(|count| *count == 0), "{rows:?}");

    // A key that came with a refused bundle is free for a good one.
    service.start_again().await;
    let bundle: Bundle = http.upload(good, Some("key 0")).await.parsed(StatusCode::CREATED).await;
    assert_eq!(bundle.scene.triangles, 1);
}

/// All files below a folder, without those of the database.
fn files(folder: &Path) -> BTreeSet<PathBuf> {
    let mut found = BTreeSet::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
            if entry.is_dir() {
                folders.push(entry);
            } else if !entry.display().to_string().contains("forelight.sqlite") {
                found.insert(entry);
            }
        }
    }
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_is_missing_unknown_or_of_the_wrong_role_opens_nothing() {
    let service = Service::start("serve", &[]).await;
    let nothing = "0198c0de-0000-7000-8000-000000000000";
    let hash = "0".repeat(64);
    // What each role may not do; all else of this list is answered by another status than 401 and 403.
    let doors: [(Method, String, &[Role]); 14] = [
        (Method::POST, "/v1/bundles".into(), &[Role::Worker, Role::Viewer]),
        (Method::GET, format!("/v1/bundles/{nothing}"), &[]),
        (Method::POST, "/v1/jobs".into(), &[Role::Worker, Role::Viewer]),
        (Method::POST, "/v1/jobs/check".into(), &[Role::Worker, Role::Viewer]),
        (Method::GET, "/v1/jobs".into(), &[Role::Worker]),
        (Method::POST, format!("/v1/jobs/{nothing}/cancel"), &[Role::Worker, Role::Viewer]),
        (Method::GET, format!("/v1/jobs/{nothing}/frames/0/image.exr"), &[Role::Worker]),
        (Method::GET, "/v1/dashboard".into(), &[Role::Worker]),
        (Method::POST, "/v1/nodes".into(), &[Role::Submitter, Role::Viewer]),
        (Method::PATCH, format!("/v1/nodes/{nothing}"), &[Role::Submitter, Role::Viewer]),
        (Method::POST, "/v1/leases".into(), &[Role::Submitter, Role::Viewer]),
        (Method::POST, format!("/v1/leases/{nothing}/result"), &[Role::Submitter, Role::Viewer]),
        (Method::PUT, format!("/v1/artifacts/{hash}"), &[Role::Submitter, Role::Viewer]),
        (Method::GET, "/metrics".into(), &[Role::Worker]),
    ];
    let anonymous = service.anonymous();
    let stranger = Http::new(service.address(), Some("a".repeat(64)));
    for (method, path, forbidden) in &doors {
        let what = format!("{method} {path}");
        for http in [&anonymous, &stranger] {
            let response = http.request(method.clone(), path).send().await.unwrap();
            assert!(response.headers()["www-authenticate"].to_str().unwrap().starts_with("Bearer"), "{what}");
            response.problem(ProblemKind::Unauthenticated).await;
        }
        for role in Role::ALL {
            let response = service.http(role).request(method.clone(), path).send().await.unwrap();
            if forbidden.contains(&role) {
                response.problem(ProblemKind::Forbidden).await;
            } else {
                let status = response.status();
                assert!(
                    !matches!(status.as_u16(), 401 | 403) && status.as_u16() < 500,
                    "{role}: {what}: {status}"
                );
            }
        }
    }
    for path in ["/healthz", "/readyz", "/openapi.yaml"] {
        assert_eq!(anonymous.get(path).await.status(), StatusCode::OK, "{path}");
    }
    // The command line says which of the two it is, and ends with the code for failure.
    let (address, bundle) = (service.address().to_owned(), shipped("corridor").display().to_string());
    let viewer = service.token_file(Role::Viewer).display().to_string();
    for (flag, token, said) in [("--token", "wrong", "401"), ("--token-file", viewer.as_str(), "403")] {
        let output = run(&["submit", &bundle, "--server", &address, flag, token]);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(1) && error.contains(said), "{error}");
    }
}
