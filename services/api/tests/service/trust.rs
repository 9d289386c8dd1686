//! What the service believes of what workers say.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use forelight_api::{Evidence, ManualClock};
use forelight_protocol::{
    Event, EventKind, Job, JobState, Lease, LeaseOrder, LeftOutJob, Node, ProblemKind, RenewRequest, Renewal,
    TaskError, TaskResult, Timestamp, TrackRecord, Verdict,
};
use forelight_random::Random;
use forelight_store::Answered;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

use crate::support::{Answer, Farm, eventually};

const SECOND: i64 = 1_000_000;

impl Farm {
    async fn told(&self, job: &Job, kind: EventKind) -> Vec<Event> {
        let all = self.service.store().events_after(Some(job.id), 0, 10_000).await.unwrap();
        all.into_iter().filter(|event| event.kind == kind).collect()
    }

    async fn heartbeat(&self, lease: &Lease, progress: f64) -> Renewal {
        let path = format!("/v1/leases/{}", lease.lease_id);
        let beat = self
            .worker
            .request(Method::PATCH, &path)
            .json(&json!({"fence": lease.fence, "progress": progress}));
        beat.send().await.unwrap().parsed(StatusCode::OK).await
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_that_is_not_possible_is_refused_with_the_place_and_the_reason_and_done_elsewhere() {
    let farm = Farm::with(|config| config.evidence = Evidence::Checked).await;
    let (liar, honest) = (farm.node("liar").await, farm.node("honest").await);
    let job = farm.submit("0-3").await;
    let lease = farm.next_task(&liar).await;
    let TaskResult::Preview(honest_preview) = farm.made_up_result(&lease).await else { panic!() };
    let mut forged = honest_preview.clone();
    forged.spent.cpu_nanos = 1_000_000_000_000_000;
    let refused = farm.report(&lease, TaskResult::Preview(forged.clone())).await;
    let refused = refused.problem(ProblemKind::ImplausibleResult).await;
    assert_eq!(refused.pointer.as_deref(), Some("/result/preview/spent"));
    assert!(refused.detail.contains("CPU seconds"), "{}", refused.detail);
    // Sending it again, or another result, changes nothing: the lease has ended.
    for result in [forged, honest_preview] {
        let late = farm.report(&lease, TaskResult::Preview(result)).await;
        late.problem(ProblemKind::LeaseLost).await;
    }
    let told = farm.told(&job, EventKind::ResultRefused).await;
    assert_eq!((told.len(), told[0].node_id), (1, Some(liar.id)));
    let again = farm.next_task(&honest).await;
    assert_eq!(again.task_id, lease.task_id);
    farm.finish(&again).await;
    // An image that is none.
    let profile = farm.next_task(&honest).await;
    let TaskResult::Profile(mut made_up) = farm.made_up_result(&profile).await else { panic!() };
    for sample in &mut made_up.samples {
        sample.cpu_nanos = 1;
    }
    // What is forecast was not spent.
    made_up.fixed.denoise.cpu_nanos = 3_600_000_000_000_000;
    made_up.artifacts.preview_png = Some(farm.artifact(b"<!DOCTYPE html>").await);
    let refused = farm.report(&profile, TaskResult::Profile(made_up)).await;
    let refused = refused.problem(ProblemKind::ImplausibleResult).await;
    assert_eq!(refused.pointer.as_deref(), Some("/result/profile/artifacts/preview_png"));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_operator_takes_a_job_out_of_the_record_with_a_reason_and_puts_it_back() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let submitted = farm.submit("0-3").await;
    let job = farm.work_off(&node, &submitted).await;
    let path = format!("/v1/jobs/{}/left-out", job.id);
    let put = async |caller: &crate::support::Http, body: Value| {
        caller.request(Method::PUT, &path).json(&body).send().await.unwrap()
    };
    let reason = json!({"reason": "rack-7 reported wrong times"});
    put(&farm.submitter, reason.clone()).await.problem(ProblemKind::Forbidden).await;
    put(&farm.operator, json!({"reason": " "})).await.problem(ProblemKind::Invalid).await;
    let out: LeftOutJob = put(&farm.operator, reason).await.parsed(StatusCode::OK).await;
    assert_eq!((out.job_id, out.name.as_str()), (job.id, "a job"));
    let record: TrackRecord = farm.viewer.json("/v1/forecasts/track-record").await;
    assert_eq!((record.frames, record.left_out), (0, vec![out]));
    let back = farm.operator.request(Method::DELETE, &path).send().await.unwrap();
    assert_eq!(back.status(), StatusCode::NO_CONTENT);
    let record: TrackRecord = farm.viewer.json("/v1/forecasts/track-record").await;
    assert_eq!((record.frames, record.left_out.len()), (4, 0));
    let nothing = format!("/v1/jobs/{}/left-out", forelight_protocol::JobId::new());
    let nothing = farm.operator.request(Method::DELETE, &nothing).send().await.unwrap();
    nothing.problem(ProblemKind::NotFound).await;
}

/// A farm whose time passes as it is told.
async fn with_clock() -> (Farm, Arc<ManualClock>) {
    Farm::with_clock_at(Timestamp::now(), |config| config.lease_ttl = TTL).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_promise_falls_while_a_frame_hangs_and_the_expected_end_does_not_slide_along() {
    let (farm, clock) = with_clock().await;
    let node = farm.node("a").await;
    let now = || Timestamp::from_micros(clock_now(&clock));
    let mut request = farm.job_request("0");
    // A frame of just over 25 seconds. It would be run again after five times its P95.
    request["deadline"] = json!(now().plus_micros(60 * SECOND));
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    let job = farm.until_booked(&node, &job).await;
    assert_eq!(job.verdict.as_ref().unwrap().verdict, Verdict::OnTime);
    let lease = farm.next_task(&node).await;
    let mut etas = Vec::new();
    for _ in 0..11 {
        clock.advance_micros(5 * SECOND);
        farm.heartbeat(&lease, 0.0).await;
        farm.service.store().sweep(now()).await.unwrap();
        etas.extend(farm.job(&job).await.eta);
    }
    etas.dedup();
    assert!(etas.len() <= 4, "{etas:?}");
    assert_eq!(farm.told(&job, EventKind::TaskLate).await.len(), 1);
    // On a busy machine, the plans that the loop called for are made at once after it. Time goes on.
    let promise = eventually("the promise is at risk", async || {
        clock.advance_micros(SECOND);
        farm.heartbeat(&lease, 0.0).await;
        farm.service.store().sweep(now()).await.unwrap();
        farm.job(&job).await.promise.filter(|promise| !promise.kept)
    })
    .await;
    assert!(promise.probability < 0.1, "{promise:?}");
    assert_eq!(farm.told(&job, EventKind::JobPromiseAtRisk).await.len(), 1);
}

fn clock_now(clock: &ManualClock) -> i64 {
    forelight_api::Clock::now(clock).micros()
}

/// A worker of the simulated farm.
struct Hand {
    node: Node,
    is_liar: bool,
    /// What it has to do, when it is ready, and what it does.
    task: Option<(Lease, Timestamp, Conduct)>,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum Conduct {
    Honest,
    Hangs,
    /// With an error that is said to be permanent, or not.
    Fails(bool),
}

const TTL: Duration = Duration::from_secs(3600);

#[tokio::test(flavor = "multi_thread")]
async fn of_200_jobs_that_were_promised_at_p80_on_a_farm_with_liars_four_in_five_are_in_time() {
    const JOBS: usize = 200;
    let (farm, clock) = with_clock().await;
    let now = || Timestamp::from_micros(clock_now(&clock));
    let mut hands = Vec::new();
    for number in 0..8 {
        let node = farm.node(&format!("n{number}")).await;
        hands.push(Hand { node, is_liar: number % 4 == 0, task: None });
    }
    let mut random = Random::new(30);
    let mut results = BTreeMap::new();
    let (mut promised, mut kept) = (0, 0);
    for number in 0..JOBS {
        if number % 20 == 0 {
            // An operator brings liars back, who know no better.
            for hand in &hands {
                farm.order(&hand.node, json!({"set_aside": false})).await;
            }
        }
        let mut request = farm.job_request("0-7");
        let deadline = now().plus_micros((40 + random.below(400) as i64) * SECOND);
        request["deadline"] = json!(deadline);
        let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
        let booked = farm.until_booked(&hands[1].node, &job).await;
        let is_promised = booked.verdict.unwrap().verdict == Verdict::OnTime;
        let done = work((&farm, &clock), &mut hands, &mut results, &job, &mut random).await;
        promised += usize::from(is_promised);
        let in_time = done.state == JobState::Done && done.finished_at.unwrap() <= deadline;
        kept += usize::from(is_promised && in_time);
    }
    println!("{kept} of {promised} promises were kept");
    assert!(promised >= JOBS / 2, "only {promised} of {JOBS} jobs were promised");
    assert!(kept * 5 >= promised * 4, "{kept} of {promised}");
    for hand in hands.iter().filter(|hand| !hand.is_liar) {
        let node: Node = farm.viewer.json(&format!("/v1/nodes/{}", hand.node.id)).await;
        assert_eq!(node.set_aside, None, "{}", node.name);
    }
}

/// Works until a job is over. `results` holds what was made up for each frame before.
async fn work(
    (farm, clock): (&Farm, &ManualClock),
    hands: &mut [Hand],
    results: &mut BTreeMap<u32, TaskResult>,
    job: &Job,
    random: &mut Random,
) -> Job {
    let store = farm.service.store();
    loop {
        let now = Timestamp::from_micros(clock_now(clock));
        let state = store.job(job.id).await.unwrap();
        if state.state.is_final() {
            return state;
        }
        store.sweep(now).await.unwrap();
        let mut next = now.plus_micros(10 * SECOND);
        for hand in hands.iter_mut() {
            if let Some((lease, until, conduct)) = &hand.task {
                let (id, fence) = (lease.lease_id, lease.fence);
                let is_over = match conduct {
                    Conduct::Hangs => {
                        let beat = RenewRequest { fence, ..RenewRequest::default() };
                        let answer = store.renew(id, &beat, TTL, now).await;
                        answer.is_err() || answer.is_ok_and(|renewal| renewal.order == LeaseOrder::Stop)
                    }
                    _ if *until > now => false,
                    Conduct::Honest => {
                        let frame = lease.spec.frame().unwrap();
                        if let std::collections::btree_map::Entry::Vacant(missing) = results.entry(frame) {
                            missing.insert(farm.made_up_result(lease).await);
                        }
                        // If another was first, the result is refused.
                        let _ = store.commit_result(id, fence, &results[&frame], now).await;
                        true
                    }
                    Conduct::Fails(permanent) => {
                        let (message, permanent) = ("no".to_owned(), *permanent);
                        let error = TaskError { message, permanent, ..TaskError::default() };
                        let _ = store.fail_task(id, fence, &error, now).await;
                        true
                    }
                };
                if is_over {
                    hand.task = None;
                }
            }
            if hand.task.is_none()
                && let Some(Answered::Fresh(lease)) = store.claim(hand.node.id, TTL, None, now).await.unwrap()
            {
                // As forecast, give or take a fifth.
                let seconds = 25.0 * (0.8 + 0.4 * random.uniform());
                let conduct = match random.below(6) {
                    0 if hand.is_liar => Conduct::Hangs,
                    1 if hand.is_liar => Conduct::Fails(true),
                    2 if hand.is_liar => Conduct::Fails(false),
                    _ => Conduct::Honest,
                };
                hand.task = Some((lease, now.plus_micros((seconds * SECOND as f64) as i64), conduct));
            }
            next =
                hand.task.iter().map(|task| task.1).filter(|&until| until > now).fold(next, Timestamp::min);
        }
        clock.advance_micros(next.micros_since(now));
    }
}
