//! A job from its submission to its last picture, also through crashes of the service.

use std::time::Duration;

use crate::support::{Answer, Farm, LEASE};
use forelight_protocol::{
    Booking, BookingPage, Dashboard, EventKind, FramePage, FrameState, Job, JobState, Node, Plan,
    ProblemKind, TaskKind, TrackRecord, Verdict,
};
use reqwest::StatusCode;
use serde_json::json;

/// Asserts that the quote is near the actual cost and rests on these frames.
async fn assert_quoted(farm: &Farm, job: &Job, profiled: &[u32]) {
    let forecast = farm.quote(job).await;
    assert_eq!(
        (forecast.frames.len(), &forecast.profiled.frames[..], forecast.profiled.pixels),
        (10, profiled, 32)
    );
    let truth: f64 = (0..10).map(|frame| f64::from(48 * (1000 + 10 * frame) + 165)).sum();
    let error = forecast.total.work.mean / truth - 1.0;
    assert!(error.abs() < 0.05, "the total is off by {error}");
    let total = forecast.total.work;
    assert!(total.p50 <= total.p80 && total.p80 <= total.p95);
    assert!(forecast.cost.unwrap().p95 >= forecast.cost.unwrap().p50);
}

/// Asserts that pictures have a tag, and that one with a missing file is reported as lost.
async fn assert_pictures(farm: &Farm, job: &Job) {
    let image = farm.viewer.get(&format!("/v1/jobs/{}/frames/7/image.exr", job.id)).await;
    assert_eq!(image.headers()["content-type"], "image/x-exr");
    let tag = image.headers()["etag"].clone();
    assert_eq!(image.bytes().await.unwrap(), &b"image 7"[..]);
    let again = farm.viewer.request(reqwest::Method::GET, &format!("/v1/jobs/{}/frames/7/image.exr", job.id));
    assert_eq!(again.header("if-none-match", tag).send().await.unwrap().status(), StatusCode::NOT_MODIFIED);
    let name = blake3::hash(b"image 6").to_hex().to_string();
    let kept = farm.folder.path().join("data/artifacts/blake3").join(&name[..2]).join(&name);
    std::fs::remove_file(kept).unwrap();
    let path = format!("/v1/jobs/{}/frames/6/image.exr", job.id);
    let lost = farm.viewer.get(&path).await.problem(ProblemKind::ArtifactLost).await;
    assert!(lost.detail.contains(&format!("{name}: its file is missing; bring it back")), "{lost:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_is_previewed_profiled_forecast_booked_rendered_and_done() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let deadline = forelight_protocol::Timestamp::now().plus_micros(3_600_000_000);
    let mut request = farm.job_request("0-9");
    request["deadline"] = json!(deadline);
    request["budget"] = json!(10_000_000_000i64);
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    assert_eq!(
        (job.state, job.frames_total, job.settings.own().unwrap().width, job.scene.triangles),
        (JobState::Previewing, 10, 8, 2)
    );

    let preview = farm.next_task(&node).await;
    assert_eq!(preview.spec.kind(), TaskKind::Preview);
    let scene = forelight_scene::Scene::load(&farm.bundle_path(), &Default::default()).unwrap();
    assert_eq!((preview.spec.digest(), job.scene.digest.0), (Some(job.scene.digest), scene.digest()));
    assert_eq!(farm.finish(&preview).await.job_state, JobState::Previewing);
    let mut profiled = Vec::new();
    for _ in 0..2 {
        let profile = farm.next_task(&node).await;
        assert_eq!((profile.spec.kind(), profile.spec.digest()), (TaskKind::Profile, Some(job.scene.digest)));
        profiled.push(profile.spec.frame().unwrap());
        farm.finish(&profile).await;
    }
    let first = farm.next_task(&node).await;
    assert_eq!((first.spec.kind(), first.spec.digest()), (TaskKind::Render, Some(job.scene.digest)));
    assert_eq!(farm.job(&job).await.state, JobState::Rendering);
    profiled.sort_unstable();

    assert_quoted(&farm, &job, &profiled).await;
    let booked = farm.job(&job).await;
    let verdict = booked.verdict.unwrap();
    assert_eq!(verdict.verdict, Verdict::OnTime, "{:?}", verdict.reasons);
    assert!(booked.eta.unwrap() <= deadline);
    let plan: Plan =
        farm.viewer.get(&format!("/v1/plans/{}", booked.plan_id.unwrap())).await.parsed(StatusCode::OK).await;
    assert_eq!((plan.bookings.len(), plan.parent_id), (10, None));
    assert!(
        plan.bookings.windows(2).all(|pair| pair[0].end <= pair[1].start),
        "one node renders one frame at a time"
    );
    assert_eq!(first.spec.frame(), Some(plan.bookings[0].frame), "what is booked first is handed out first");
    let page: BookingPage = farm.viewer.get("/v1/bookings?page_size=4").await.parsed(StatusCode::OK).await;
    assert_eq!(page.items, plan.bookings[..4]);
    // Those that overlap a stretch of time.
    let (from, to) = (plan.bookings[1].end, plan.bookings[4].start);
    let path = format!("/v1/bookings?from={from}&to={to}");
    let page: BookingPage = farm.viewer.get(&path).await.parsed(StatusCode::OK).await;
    assert_eq!(page.items, plan.bookings[2..4]);
    farm.viewer.get("/v1/bookings?from=noon").await.problem(ProblemKind::Invalid).await;
    let told = farm.service.store().events_after(Some(job.id), 0, 1000).await.unwrap();
    let news =
        |kind| told.iter().find(|event| event.kind == kind).and_then(|event| event.job.clone()).unwrap();
    assert!(told.iter().all(|event| event.job_name.as_ref() == Some(&job.name)));
    let created = news(EventKind::JobCreated);
    assert_eq!(created.frames_total, Some(10));
    assert_eq!(created.terms.unwrap().deadline, Some(deadline));
    assert!(news(EventKind::ForecastReady).cost.is_some());
    let planned = news(EventKind::PlanStored);
    assert_eq!((planned.verdict, planned.eta), (Some(Verdict::OnTime), verdict.finish));
    assert!(planned.booked_cost == verdict.cost && planned.probability.is_some_and(|share| share > 0.7));

    farm.finish(&first).await;
    let done = farm.work_off(&node, &job).await;
    assert_eq!((done.state, done.frames_done, done.progress, done.eta), (JobState::Done, 10, 1.0, None));
    let page: FramePage =
        farm.viewer.get(&format!("/v1/jobs/{}/frames", job.id)).await.parsed(StatusCode::OK).await;
    for row in &page.items {
        assert_eq!(row.state, FrameState::Done);
        let work = row.work.unwrap();
        assert!(work.error.unwrap().abs() < 0.06, "frame {}: {work:?}", row.frame);
        let cpu = row.cpu_seconds.unwrap();
        assert!(cpu.error.unwrap().abs() < 0.06, "frame {}: {cpu:?}", row.frame);
        assert!(row.booked.is_some() && row.started.is_some() && row.finished.is_some());
    }
    let open: BookingPage = farm.viewer.get("/v1/bookings").await.parsed(StatusCode::OK).await;
    assert!(open.items.is_empty(), "the job is done: {:?}", open.items);
    assert_pictures(&farm, &job).await;
    let record: TrackRecord =
        farm.viewer.get("/v1/forecasts/track-record?page_size=3").await.parsed(StatusCode::OK).await;
    assert_eq!((record.frames, record.items.len(), record.next_page_token.is_some()), (10, 3, true));
    let dashboard: Dashboard = farm.viewer.get("/v1/dashboard").await.parsed(StatusCode::OK).await;
    assert_eq!((dashboard.counts.jobs_done, dashboard.bookings.len(), dashboard.track_frames), (1, 0, 10));
    let metrics = farm.viewer.get("/metrics").await.text().await.unwrap();
    assert!(metrics.contains("forelight_results_committed_total 13\n"), "{metrics}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_second_job_is_booked_around_the_first() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let first = farm.submit("0-4").await;
    farm.until_booked(&node, &first).await;
    let second = farm.submit("0-4").await;
    let second = farm.until_booked(&node, &second).await;
    let plan: Plan =
        farm.viewer.get(&format!("/v1/plans/{}", second.plan_id.unwrap())).await.parsed(StatusCode::OK).await;
    assert!(plan.parent_id.is_some());
    let page: BookingPage = farm.viewer.get("/v1/bookings").await.parsed(StatusCode::OK).await;
    let of = |job| page.items.iter().filter(|booking| booking.job_id == job).count();
    assert_eq!((of(first.id), of(second.id)), (5, 5), "{:?}", page.items);
    // By start, all on the one node. Frames returned while the second job was quoted keep their places.
    let frames: FramePage =
        farm.viewer.get(&format!("/v1/jobs/{}/frames", first.id)).await.parsed(StatusCode::OK).await;
    let came_back =
        |booking: &Booking| booking.job_id == first.id && frames.items[booking.frame as usize].attempts > 0;
    let placed: Vec<&Booking> = page.items.iter().filter(|booking| !came_back(booking)).collect();
    assert!(placed.len() > 5, "{placed:?}");
    for pair in placed.windows(2) {
        assert!(pair[1].start >= pair[0].end, "{:?} lies on {:?}", pair[1], pair[0]);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_impossible_deadline_and_a_small_budget_are_said_and_the_job_is_rendered_all_the_same() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let mut late = farm.job_request("0-4");
    late["deadline"] = json!(forelight_protocol::Timestamp::now().plus_micros(30_000_000));
    let late: Job = farm.submitter.post("/v1/jobs", &late).await.parsed(StatusCode::CREATED).await;
    let late = farm.until_booked(&node, &late).await;
    let verdict = late.verdict.unwrap();
    assert_eq!(verdict.verdict, Verdict::Late);
    assert!(
        verdict.reasons.iter().any(|reason| reason.contains("no plan can be in time")),
        "{:?}",
        verdict.reasons
    );
    let mut dear = farm.job_request("0-1");
    dear["budget"] = json!(1);
    let dear: Job = farm.submitter.post("/v1/jobs", &dear).await.parsed(StatusCode::CREATED).await;
    let dear = farm.until_booked(&node, &dear).await;
    assert_eq!(dear.verdict.as_ref().unwrap().verdict, Verdict::OverBudget);
    assert_eq!(farm.work_off(&node, &dear).await.state, JobState::Done);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_dies_at_any_point_goes_on_where_it_was() {
    let mut farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-3").await;
    let mut kinds = Vec::new();
    for _ in 0..7 {
        let lease = farm.next_task(&node).await;
        kinds.push(lease.spec.kind());
        let result = farm.made_up_result(&lease).await;
        // Dies while the worker works, and again right after acknowledging the result.
        farm = farm.killed_and_restarted().await;
        let answer: forelight_protocol::ResultAnswer =
            farm.report(&lease, result.clone()).await.parsed(StatusCode::OK).await;
        assert!(!answer.duplicate);
        farm = farm.killed_and_restarted().await;
        let answer: forelight_protocol::ResultAnswer =
            farm.report(&lease, result).await.parsed(StatusCode::OK).await;
        assert!(answer.duplicate, "an acknowledged result was lost");
    }
    use TaskKind::{Preview, Profile, Render};
    assert_eq!(kinds, [Preview, Profile, Profile, Render, Render, Render, Render]);
    assert_eq!(farm.job(&job).await.state, JobState::Done);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_crash_between_result_and_advance_is_made_up_for_at_the_start() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-3").await;
    let lease = farm.next_task(&node).await;
    // Committed directly in the store: the conductor is not told.
    let result = farm.made_up_result(&lease).await;
    let now = forelight_protocol::Timestamp::now();
    farm.service.store().commit_result(lease.lease_id, lease.fence, &result, now).await.unwrap();
    let farm = farm.killed_and_restarted().await;
    let lease = farm.next_task(&node).await;
    assert_eq!((lease.job_id, lease.spec.kind()), (job.id, TaskKind::Profile));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_worker_costs_one_lease_time_and_its_late_result_nothing() {
    let (farm, clock) = Farm::with_short_leases().await;
    let (lost, other) = (farm.node("lost").await, farm.node("other").await);
    farm.submit("0-3").await;
    let stale = farm.next_task(&lost).await;
    clock.advance_micros(LEASE);
    // No event announces the expired lease; the waiting claim finds it.
    let current = farm.claim_waiting(&other, 5000).await.unwrap();
    assert_eq!(current.task_id, stale.task_id);
    assert!(current.fence > stale.fence);
    let result = farm.made_up_result(&stale).await;
    farm.report(&stale, result.clone()).await.problem(forelight_protocol::ProblemKind::LeaseLost).await;
    let answer: forelight_protocol::ResultAnswer =
        farm.report(&current, result).await.parsed(StatusCode::OK).await;
    assert!(!answer.duplicate);
    let metrics = farm.viewer.get("/metrics").await.text().await.unwrap();
    assert!(metrics.contains("forelight_leases_lost_total 1\n"), "{metrics}");
}

/// Claims here wait for a minute. An answer before this time was no timeout.
const HALF_OF_THE_WAIT: Duration = Duration::from_secs(30);

#[tokio::test(flavor = "multi_thread")]
async fn a_waiting_claim_is_answered_when_work_comes_and_empty_when_none_does() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let begun = std::time::Instant::now();
    assert!(farm.claim_waiting(&node, 300).await.is_none());
    assert!(begun.elapsed() > Duration::from_millis(250), "{:?}", begun.elapsed());
    let begun = std::time::Instant::now();
    let (lease, job) = tokio::join!(farm.claim_waiting(&node, 60_000), async {
        tokio::time::sleep(Duration::from_millis(200)).await;
        farm.submit("0").await
    });
    assert_eq!(lease.unwrap().job_id, job.id);
    assert!(begun.elapsed() < HALF_OF_THE_WAIT, "it was answered when its time was over");
}

#[tokio::test(flavor = "multi_thread")]
async fn stopping_the_service_ends_waits_and_streams_at_once() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0").await;
    farm.finish(&farm.next_task(&node).await).await;
    let stream = farm.viewer.get(&format!("/v1/jobs/{}/events", job.id)).await;
    let (worker, body) = (farm.worker.clone(), json!({"node_id": node.id, "wait_ms": 60_000}));
    farm.next_task(&node).await;
    let node: Node = farm.viewer.json(&format!("/v1/nodes/{}", node.id)).await;
    let waiting = tokio::spawn(async move { worker.post("/v1/leases", &body).await.status() });
    farm.until_heard_of_since(&node).await;
    let begun = std::time::Instant::now();
    farm.service.shutdown().await;
    assert_eq!(waiting.await.unwrap(), StatusCode::NO_CONTENT);
    assert!(stream.text().await.unwrap().contains("event: task_leased"));
    assert!(begun.elapsed() < HALF_OF_THE_WAIT, "the service waited for its waiters");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_job_stops_its_workers_and_is_not_booked() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-3").await;
    let lease = farm.next_task(&node).await;
    let cancelled: Job = farm
        .submitter
        .post(&format!("/v1/jobs/{}/cancel", job.id), &json!({}))
        .await
        .parsed(StatusCode::OK)
        .await;
    assert_eq!(cancelled.state, JobState::Cancelled);
    let renewal = farm.worker.request(reqwest::Method::PATCH, &format!("/v1/leases/{}", lease.lease_id));
    let renewal = renewal.json(&json!({"fence": lease.fence, "progress": 0.5})).send().await.unwrap();
    let renewal: serde_json::Value = renewal.parsed(StatusCode::OK).await;
    assert_eq!(renewal["order"], "stop");
    assert!(farm.claim(&node).await.is_none());
}
