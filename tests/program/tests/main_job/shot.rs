//! A shot from the upload to the last picture, step by step over HTTP.

use crate::{HEIGHT, JOB_PATIENCE, PATIENCE, WIDTH, farm, frames_of, request};
use forelight_protocol::{
    Booking, BookingPage, Bundle, Dashboard, Event, EventKind, ForecastDoc, FrameRow, FrameState, Job,
    JobState, Plan, ProblemKind, Quantiles, Role, Verdict,
};
use forelight_tests::bundles::{shipped, zipped};
use forelight_tests::events::Events;
use forelight_tests::http::{Answer, Http};
use forelight_tests::ledger::Ledger;
use forelight_tests::pictures::{Channels, assert_png};
use reqwest::{Method, StatusCode};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

#[tokio::test(flavor = "multi_thread")]
async fn a_shot_is_quoted_booked_rendered_and_every_step_can_be_read() {
    const FRAMES: [u32; 5] = [0, 1, 2, 10, 40];
    let mut service = farm().await;
    let http = service.http(Role::Submitter);

    // A bundle sent twice with one key is one bundle. Another body with the same key is an error.
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
    // The key belongs to an upload.
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

    // Events up to the first leased frame. A quote and a plan exist by then.
    let path = format!("/v1/jobs/{}", job.id);
    let mut stream = Events::open(&http, &format!("{path}/events"), None).await.expect("the job lives");
    let mut events: Vec<Event> = Vec::new();
    while events.last().is_none_or(|event| event.job_state != Some(JobState::Booked)) {
        events.push(stream.next(PATIENCE).await.expect("the job goes on"));
    }
    let quote: ForecastDoc = http.json(&format!("{path}/forecast")).await;
    events.extend(stream.rest(JOB_PATIENCE).await);
    assert_story(&events, FRAMES.len());
    // From any event on, the rest is the same. After the last there is nothing.
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
    assert_promised(&http, &events).await;
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

/// Each step of the job happens once, the quote and the plan before any frame.
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

/// A finished frame has every cell of its row.
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

/// The quote is consistent, within a factor of two of the truth in total, and of three for each frame. Other
/// tests check its accuracy.
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

/// The plan has a verdict on the job and a node for every frame. No node has two frames at once.
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
    let open: BookingPage = http.json("/v1/bookings").await;
    assert_eq!(open.items, [], "what is rendered is not booked any more");
}

/// The plan that first books the job ends it no sooner than its last booking. Later plans may: frames that
/// have begun keep their bookings, however soon they end.
async fn assert_promised(http: &Http, events: &[Event]) {
    let first = events.iter().find(|event| event.kind == EventKind::PlanStored).expect("a plan");
    let plan: Plan = http.json(&format!("/v1/plans/{}", first.plan_id.expect("its id"))).await;
    let finish = plan.verdicts[0].finish.expect("an end");
    assert!(plan.bookings.iter().all(|booking| booking.end <= finish), "{plan:?}");
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
