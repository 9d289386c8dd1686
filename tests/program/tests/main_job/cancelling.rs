//! Jobs that are cancelled while workers are busy with them.

use crate::{JOB_PATIENCE, PATIENCE, farm, frames_of, request, until, upload};
use forelight_protocol::{BookingPage, Dashboard, FrameRow, FrameState, Job, JobState, NodePage, Role};
use forelight_tests::http::{Answer, Http};
use forelight_tests::ledger::Ledger;
use forelight_tests::waiting::eventually;
use reqwest::StatusCode;
use serde_json::json;

#[tokio::test(flavor = "multi_thread")]
async fn a_job_cancelled_in_the_middle_of_its_frames_stops_and_frees_its_workers() {
    let mut service = farm().await;
    let http = service.http(Role::Submitter);
    let bundle = upload(&http, "corridor").await;
    // During profiling.
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

    // During its frames, which take longer than a test can wait.
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

    // The farm is free for other jobs.
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

/// Cancels a job twice. The second time changes nothing.
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
