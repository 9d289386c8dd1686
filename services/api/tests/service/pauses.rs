//! Jobs that somebody paused.

use crate::support::{Answer, Farm};
use forelight_protocol::{
    Budget, BudgetAction, EventKind, FramePage, FrameState, Job, JobState, LeaseOrder, ProblemKind, Renewal,
    TaskKind, WaitKind,
};
use reqwest::{Method, Response, StatusCode};
use serde_json::json;

async fn set(farm: &Farm, job: &Job, paused: bool) -> Response {
    let request = farm.submitter.request(Method::PATCH, &format!("/v1/jobs/{}", job.id));
    request.json(&json!({ "paused": paused })).send().await.unwrap()
}

async fn pause(farm: &Farm, job: &Job) -> Job {
    let paused: Job = set(farm, job, true).await.parsed(StatusCode::OK).await;
    assert!(paused.paused && paused.waits.as_ref().is_some_and(|waits| waits.kind == WaitKind::Paused));
    paused
}

async fn resume(farm: &Farm, job: &Job) -> Job {
    let resumed: Job = set(farm, job, false).await.parsed(StatusCode::OK).await;
    assert!(!resumed.paused && resumed.waits.as_ref().is_none_or(|waits| waits.kind != WaitKind::Paused));
    resumed
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_under_way_of_a_paused_job_goes_on_and_nothing_more_is_begun() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-3").await;
    farm.until_booked(&node, &job).await;
    let running = farm.next_task(&node).await;
    pause(&farm, &job).await;
    let renew = farm.worker.request(Method::PATCH, &format!("/v1/leases/{}", running.lease_id));
    let renewed = renew.json(&json!({"fence": running.fence})).send().await.unwrap();
    assert_eq!(renewed.parsed::<Renewal>(StatusCode::OK).await.order, LeaseOrder::Continue);
    farm.finish(&running).await;
    assert_eq!(farm.claim(&node).await, None, "three frames wait");
    let held = farm.until(&job, "it has no end", |job| job.eta.is_none()).await;
    assert_eq!((held.frames_done, held.state), (1, JobState::Rendering));

    // Another job has the node to itself.
    let other = farm.submit("0-1").await;
    let done = farm.work_off(&node, &other).await;
    assert_eq!(done.state, JobState::Done);
    // It stays paused after a restart, and while its terms change.
    let farm = farm.killed_and_restarted().await;
    let request = farm.submitter.request(Method::PATCH, &format!("/v1/jobs/{}", job.id));
    let changed: Job =
        request.json(&json!({"priority": 5})).send().await.unwrap().parsed(StatusCode::OK).await;
    assert!(changed.paused);
    assert_eq!(farm.claim(&node).await, None);

    resume(&farm, &job).await;
    farm.until(&job, "it is planned anew", |job| job.eta.is_some() && job.waits.is_none()).await;
    let done = farm.work_off(&node, &job).await;
    assert_eq!((done.state, done.frames_done, done.paused), (JobState::Done, 4, false));
    set(&farm, &job, true).await.problem(ProblemKind::Conflict).await;

    let events = farm.service.store().events_after(None, 0, 10_000).await.unwrap();
    let told = events.iter().filter(|event| event.kind == EventKind::JobChanged).filter_map(|event| {
        let terms = event.job.as_ref()?.terms?;
        Some((event.message.as_deref()?, terms.paused))
    });
    let told: Vec<_> = told.collect();
    assert_eq!(told, [("paused", true), ("a new priority, 5", true), ("resumed", false)], "in their order");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_under_way_of_a_paused_job_can_be_taken_back() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-1").await;
    farm.until_booked(&node, &job).await;
    let running = farm.next_task(&node).await;
    pause(&farm, &job).await;
    let frame = running.spec.frame().unwrap().to_string();
    let path = format!("/v1/jobs/{}/frames/retry", job.id);
    let retried = farm.submitter.post(&path, &json!({"frames": frame})).await;
    retried.parsed::<Job>(StatusCode::OK).await;
    assert_eq!(farm.claim(&node).await, None);
    let page: FramePage = farm.viewer.json(&format!("/v1/jobs/{}/frames", job.id)).await;
    assert!(page.items.iter().all(|row| row.state == FrameState::Ready), "{page:?}");
    resume(&farm, &job).await;
    let again = farm.next_task(&node).await;
    assert_eq!((again.task_id, again.spec.kind()), (running.task_id, TaskKind::Render));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_quote_can_be_paused_and_is_booked_paused_when_it_is_accepted() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let mut request = farm.job_request("0-1");
    request["hold"] = json!(true);
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    pause(&farm, &job).await;
    assert_eq!(farm.claim(&node).await, None, "not even a preview");
    resume(&farm, &job).await;
    let quoted = farm.until_booked(&node, &job).await;
    assert_eq!((quoted.state, quoted.eta.is_some()), (JobState::Quoted, true));
    assert_eq!(pause(&farm, &job).await.eta, None, "accepting it would begin nothing");
    let accepted = farm.submitter.post(&format!("/v1/jobs/{}/accept", job.id), &json!({})).await;
    accepted.parsed::<Job>(StatusCode::OK).await;
    let booked = farm.until(&job, "it is booked", |job| job.state == JobState::Booked).await;
    assert!(booked.paused && booked.eta.is_none(), "{booked:?}");
    assert_eq!(farm.claim(&node).await, None);
    resume(&farm, &job).await;
    assert_eq!(farm.work_off(&node, &job).await.state, JobState::Done);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_budget_lets_go_of_its_jobs_except_the_paused_ones_and_resuming_leaves_its_hold() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    // The quote of a job is paid for.
    farm.until_booked(&node, &farm.submit("0").await).await;
    let frame = farm.next_task(&node).await;
    farm.finish(&frame).await;
    let (paused, other) = (farm.submit("0").await, farm.submit("0").await);
    pause(&farm, &paused).await;
    let budget = async |amount: i64| {
        let request = json!({"project": paused.project, "period": "night", "amount": amount, "zone": "UTC",
                             "thresholds": [{"percent": 100, "action": "drain"}]});
        farm.operator.post("/v1/budgets", &request).await.parsed::<Budget>(StatusCode::OK).await
    };
    assert_eq!(budget(1).await.action, Some(BudgetAction::Drain));
    resume(&farm, &paused).await;
    assert_eq!(farm.claim(&node).await, None, "the budget holds both");
    pause(&farm, &paused).await;
    assert_eq!(budget(1_000_000_000).await.action, None);
    assert_eq!(farm.claim(&node).await.map(|lease| lease.job_id), Some(other.id));
    assert_eq!(farm.claim(&farm.node("b").await).await.map(|lease| lease.job_id), None);
    resume(&farm, &paused).await;
    assert_eq!(farm.claim(&farm.node("c").await).await.map(|lease| lease.job_id), Some(paused.id));
}
