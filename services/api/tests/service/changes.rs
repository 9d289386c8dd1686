//! Quotes before booking, other terms, frames that are rendered again or cancelled, what-if questions.

use crate::support::{Answer, Farm, PATIENCE};
use forelight_protocol::{
    AnswersDoc, Confidence, Dashboard, EventKind, Explanation, ForecastDoc, FramePage, FrameState, Job,
    JobState, Lease, Money, Node, PlanPage, ProblemKind, TaskKind, Timestamp, Verdict, WhatIf,
};
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};

const HOUR: i64 = 3_600_000_000;

fn in_hours(hours: i64) -> Timestamp {
    Timestamp::now().plus_micros(hours * HOUR)
}

async fn submit(farm: &Farm, frames: &str, with: Value) -> Job {
    let mut request = farm.job_request(frames);
    request.as_object_mut().unwrap().extend(with.as_object().unwrap().clone());
    farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await
}

/// A job on hold, with its quote complete.
async fn quoted(farm: &Farm, node: &Node, frames: &str) -> Job {
    let job = submit(farm, frames, json!({"hold": true})).await;
    let job = farm.until_booked(node, &job).await;
    assert_eq!((job.state, job.hold), (JobState::Quoted, true));
    job
}

async fn patch(farm: &Farm, job: &Job, change: Value) -> Response {
    let request = farm.submitter.request(Method::PATCH, &format!("/v1/jobs/{}", job.id));
    request.json(&change).send().await.unwrap()
}

async fn post(farm: &Farm, job: &Job, what: &str, body: Value) -> Response {
    farm.submitter.post(&format!("/v1/jobs/{}/{what}", job.id), &body).await
}

async fn states(farm: &Farm, job: &Job) -> Vec<FrameState> {
    let page: FramePage = farm.viewer.json(&format!("/v1/jobs/{}/frames?page_size=200", job.id)).await;
    page.items.into_iter().map(|row| row.state).collect()
}

async fn renders(farm: &Farm, node: &Node) -> Lease {
    let lease = farm.next_task(node).await;
    assert_eq!(lease.spec.kind(), TaskKind::Render);
    lease
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_on_hold_is_quoted_and_books_nothing_until_it_is_accepted() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let early = submit(&farm, "0-3", json!({"hold": true})).await;
    post(&farm, &early, "accept", json!({})).await.problem(ProblemKind::Conflict).await;
    assert_eq!(post(&farm, &early, "cancel", json!({})).await.status(), StatusCode::OK);
    let job = quoted(&farm, &node, "0-3").await;
    assert_eq!((job.plan_id, &job.verdict), (None, &None));
    let plans: PlanPage = farm.viewer.json("/v1/plans").await;
    assert!(plans.items.is_empty(), "nothing is booked");
    assert!(farm.claim(&node).await.is_none(), "there is nothing to do");
    let path = |part: &str| format!("/v1/jobs/{}/{part}", job.id);
    let quote: ForecastDoc = farm.viewer.json(&path("forecast")).await;
    assert_eq!(quote.frames.len(), 4);
    farm.viewer.json::<Explanation>(&path("explanation")).await;
    let answers: AnswersDoc = farm.viewer.json(&path("answers")).await;
    assert!(answers.outlook.iter().all(|line| line.finish.is_some()), "{answers:?}");
    // It stays so after a restart.
    let farm = farm.killed_and_restarted().await;
    assert_eq!(farm.job(&job).await.state, JobState::Quoted);
    let past = json!({"deadline": "2020-01-01T00:00:00Z"});
    let problem = post(&farm, &job, "accept", past).await.problem(ProblemKind::Invalid).await;
    assert_eq!(problem.pointer.as_deref(), Some("/deadline"));
    let deadline = in_hours(5);
    let terms = json!({"deadline": deadline, "budget": 9_000_000, "confidence": "p95"});
    let accepted: Job = post(&farm, &job, "accept", terms).await.parsed(StatusCode::OK).await;
    assert_eq!((accepted.hold, accepted.deadline), (false, Some(deadline)));
    let booked = farm.until(&job, "it is booked", |job| job.state == JobState::Booked).await;
    assert_eq!((booked.budget, booked.confidence), (Some(Money(9_000_000)), Confidence::P95));
    assert_eq!(booked.verdict.unwrap().verdict, Verdict::OnTime);
    assert_eq!(farm.viewer.json::<ForecastDoc>(&path("forecast")).await, quote, "a quote never changes");
    // Accepting again changes nothing; other terms need another request.
    post(&farm, &job, "accept", json!({})).await.parsed::<Job>(StatusCode::OK).await;
    post(&farm, &job, "accept", json!({"confidence": "p50"})).await.problem(ProblemKind::Conflict).await;
    let done = farm.work_off(&node, &job).await;
    assert_eq!((done.state, done.frames_done), (JobState::Done, 4));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_quote_on_hold_says_when_it_would_end_and_whether_that_is_in_time() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    // Eight frames of 25 seconds.
    let job = quoted(&farm, &node, "0-7").await;
    let (eta, finish) = (job.eta.unwrap(), job.finish.unwrap());
    let seconds = eta.micros_since(Timestamp::now()) / 1_000_000;
    assert!((100..600).contains(&seconds) && finish.p50 <= finish.p80 && finish.p80 <= finish.p95);
    assert_eq!(job.probability, None, "it has no deadline");
    let is_likely = |job: &Job, least: f64| job.probability.is_some_and(|share| share >= least);
    patch(&farm, &job, json!({"deadline": in_hours(5)})).await;
    farm.until(&job, "five hours are enough", |job| is_likely(job, 1.0)).await;
    patch(&farm, &job, json!({"deadline": Timestamp::now().plus_micros(60_000_000)})).await;
    farm.until(&job, "a minute is not", |job| is_likely(job, 0.0) && !is_likely(job, 0.1)).await;
    let shown: Dashboard = farm.viewer.json("/v1/dashboard").await;
    let [shown] = &shown.jobs[..] else { panic!("{shown:?}") };
    assert!(shown.probability.is_some_and(|share| share < 0.1) && shown.finish.is_some(), "{shown:?}");
    let answers: AnswersDoc = farm.viewer.json(&format!("/v1/jobs/{}/answers", job.id)).await;
    assert!(answers.probability.is_some_and(|share| share < 0.1), "{answers:?}");
    // Fewer samples would be in time.
    let likely = answers.qualities.iter().filter(|offer| offer.probability.is_some_and(|share| share > 0.9));
    assert!(likely.count() > 0, "{:?}", answers.qualities);
    assert!(answers.qualities.iter().all(|offer| !offer.asked_for || offer.probability < Some(0.1)));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_quote_can_be_dropped_and_a_job_that_is_not_on_hold_cannot_be_accepted_under_other_terms() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = quoted(&farm, &node, "0").await;
    let dropped: Job = post(&farm, &job, "cancel", json!({})).await.parsed(StatusCode::OK).await;
    assert_eq!(dropped.state, JobState::Cancelled);
    post(&farm, &job, "accept", json!({})).await.problem(ProblemKind::Conflict).await;
    let other = farm.submit("0").await;
    farm.until_booked(&node, &other).await;
    post(&farm, &other, "accept", json!({"confidence": "p50"})).await.problem(ProblemKind::Conflict).await;
    farm.viewer
        .post(&format!("/v1/jobs/{}/accept", job.id), &json!({}))
        .await
        .problem(ProblemKind::Forbidden)
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_later_deadline_rescues_a_job_that_was_late_and_the_question_before_says_so() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    // Each frame takes some 48 seconds of one core at speed 1; the node has two at speed 2.
    let deadline = Timestamp::now().plus_micros(60_000_000);
    let job = submit(&farm, "0-19", json!({"deadline": deadline})).await;
    let late = farm.until_booked(&node, &job).await;
    assert_eq!(late.verdict.as_ref().unwrap().verdict, Verdict::Late);
    let later = json!({"later": {"job_id": job.id, "by_ms": 3_600_000}});
    let what_if = json!({"job_id": job.id, "change": later});
    let found: WhatIf = farm.viewer.post("/v1/plans/what-if", &what_if).await.parsed(StatusCode::OK).await;
    assert!(found.effect.in_time && found.effect.words.starts_with("the deadline 1 h later"), "{found:?}");
    assert!(found.words.iter().any(|line| line.contains("is in time now")), "{found:?}");
    assert_eq!(farm.job(&job).await.deadline, Some(deadline), "the question changed nothing");
    let later = deadline.plus_micros(HOUR);
    let changed: Job = patch(&farm, &job, json!({"deadline": later})).await.parsed(StatusCode::OK).await;
    assert_eq!((changed.deadline, changed.probability), (Some(later), None), "0 % was of the old deadline");
    assert!(late.probability.is_some_and(|probability| probability < 0.1) && changed.promise.is_none());
    let is_rescued = |job: &Job| job.verdict.as_ref().is_some_and(|said| said.verdict == Verdict::OnTime);
    let rescued = farm.until(&job, "the job is in time", is_rescued).await;
    assert!(rescued.promise.is_some_and(|promise| promise.kept) && rescued.probability > Some(0.9));
    assert_ne!(rescued.plan_id, late.plan_id);
}

#[tokio::test(flavor = "multi_thread")]
async fn other_terms_are_checked_and_lead_to_a_new_plan() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = submit(&farm, "0-3", json!({"deadline": in_hours(9), "budget": 5})).await;
    let before = farm.until_booked(&node, &job).await;
    for (change, pointer) in [
        (json!({"deadline": "2020-01-01T00:00:00Z"}), "/deadline"),
        (json!({"budget": -1}), "/budget"),
        (json!({"confidence": "p99"}), "/confidence"),
        (json!({"priority": 1001}), "/priority"),
        (json!({"weight": 3}), "/weight"),
    ] {
        let problem = patch(&farm, &job, change.clone()).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer), "{change}");
    }
    let same: Job = patch(&farm, &job, json!({"budget": 5})).await.parsed(StatusCode::OK).await;
    assert_eq!(same.plan_id, before.plan_id);
    let change = json!({"deadline": null, "budget": null, "confidence": "p50"});
    let changed: Job = patch(&farm, &job, change).await.parsed(StatusCode::OK).await;
    assert_eq!((changed.deadline, changed.budget, changed.confidence), (None, None, Confidence::P50));
    let is_new = |job: &Job| job.plan_id != before.plan_id;
    let planned = farm.until(&job, "there is a new plan", is_new).await;
    assert_eq!(planned.verdict.unwrap().confidence, Confidence::P50);
    assert!(planned.promise.is_none(), "without a deadline there is no promise");
    farm.work_off(&node, &job).await;
    patch(&farm, &job, json!({"confidence": "p80"})).await.problem(ProblemKind::Conflict).await;
    let nothing = "0197a8a5-0000-7000-8000-000000000000";
    let request = farm.submitter.request(Method::PATCH, &format!("/v1/jobs/{nothing}")).json(&json!({}));
    request.send().await.unwrap().problem(ProblemKind::NotFound).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn finished_frames_are_rendered_again_and_the_job_is_done_again() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-3").await;
    let done = farm.work_off(&node, &job).await;
    assert_eq!(done.state, JobState::Done);
    let again: Job =
        post(&farm, &job, "frames/retry", json!({"frames": "1,3"})).await.parsed(StatusCode::OK).await;
    assert_eq!((again.state, again.frames_done, again.finished_at), (JobState::Rendering, 2, None));
    let lease = renders(&farm, &node).await;
    let frame = lease.spec.frame().unwrap();
    assert!([1, 3].contains(&frame), "{frame}");
    assert!(lease.fence > 1, "an old result can be told from a new one");
    // A frame under way can be begun again too: its worker is told to stop.
    post(&farm, &job, "frames/retry", json!({"frames": frame.to_string()}))
        .await
        .parsed::<Job>(StatusCode::OK)
        .await;
    let late = farm.made_up_result(&lease).await;
    farm.report(&lease, late).await.problem(ProblemKind::LeaseLost).await;
    let done = farm.work_off(&node, &job).await;
    assert_eq!((done.state, done.frames_done, done.progress), (JobState::Done, 4, 1.0));
    for (frames, kind) in [("0-4", ProblemKind::NotFound), ("x", ProblemKind::Invalid)] {
        post(&farm, &job, "frames/retry", json!({"frames": frames})).await.problem(kind).await;
    }
    let new = submit(&farm, "0", json!({"hold": true})).await;
    post(&farm, &new, "frames/retry", json!({"frames": "0"})).await.problem(ProblemKind::Conflict).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_repeated_result_of_a_frame_that_is_rendered_again_counts_no_more() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0").await;
    farm.until_booked(&node, &job).await;
    let lease = renders(&farm, &node).await;
    farm.finish(&lease).await;
    post(&farm, &job, "frames/retry", json!({"frames": "0"})).await.parsed::<Job>(StatusCode::OK).await;
    let repeated = farm.made_up_result(&lease).await;
    farm.report(&lease, repeated).await.problem(ProblemKind::LeaseLost).await;
    assert_eq!(states(&farm, &job).await, [FrameState::Ready]);
    assert_eq!(farm.work_off(&node, &job).await.state, JobState::Done);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_failed_goes_on_with_all_that_it_had_left() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-3").await;
    farm.until_booked(&node, &job).await;
    farm.finish(&renders(&farm, &node).await).await;
    let lease = renders(&farm, &node).await;
    let frame = lease.spec.frame().unwrap();
    farm.fail_without_bundle(&lease).await;
    assert_eq!(farm.job(&job).await.state, JobState::Failed);
    let frames = json!({"frames": frame.to_string()});
    let going_on: Job = post(&farm, &job, "frames/retry", frames).await.parsed(StatusCode::OK).await;
    assert_eq!((going_on.state, going_on.error), (JobState::Rendering, None));
    assert_eq!(states(&farm, &job).await.iter().filter(|state| **state == FrameState::Ready).count(), 3);
    let done = farm.work_off(&node, &job).await;
    assert_eq!((done.state, done.frames_done), (JobState::Done, 4));
    post(&farm, &done, "cancel", json!({})).await.problem(ProblemKind::Conflict).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_is_done_without_the_frames_that_were_cancelled() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-3").await;
    farm.until_booked(&node, &job).await;
    let lease = renders(&farm, &node).await;
    let running = lease.spec.frame().unwrap();
    let others: Vec<u32> = (0..4).filter(|frame| *frame != running).collect();
    let frames = json!({"frames": format!("{running},{}", others[0])});
    let less: Job = post(&farm, &job, "frames/cancel", frames.clone()).await.parsed(StatusCode::OK).await;
    assert_eq!((less.frames_cancelled, less.frames_total, less.state), (2, 4, JobState::Rendering));
    let late = farm.made_up_result(&lease).await;
    farm.report(&lease, late).await.problem(ProblemKind::LeaseLost).await;
    post(&farm, &job, "frames/cancel", frames).await.parsed::<Job>(StatusCode::OK).await;
    let done = farm.work_off(&node, &job).await;
    assert_eq!((done.state, done.frames_done, done.progress), (JobState::Done, 2, 1.0));
    let cancelled = states(&farm, &job).await.into_iter().filter(|state| *state == FrameState::Cancelled);
    assert_eq!(cancelled.count(), 2);
    post(&farm, &job, "frames/cancel", json!({"frames": "0"})).await.problem(ProblemKind::Conflict).await;
    // A frame that was cancelled can be brought back.
    let frames = json!({"frames": running.to_string()});
    let more: Job = post(&farm, &job, "frames/retry", frames).await.parsed(StatusCode::OK).await;
    assert_eq!((more.state, more.frames_cancelled), (JobState::Rendering, 1));
    assert_eq!(farm.work_off(&node, &job).await.frames_done, 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn without_any_frame_left_a_job_is_done_or_cancelled() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let [all, rest] = [farm.submit("0-1").await, farm.submit("0-1").await];
    farm.until_booked(&node, &all).await;
    let all: Job =
        post(&farm, &all, "frames/cancel", json!({"frames": "0-1"})).await.parsed(StatusCode::OK).await;
    assert_eq!(all.state, JobState::Cancelled);
    farm.until_booked(&node, &rest).await;
    let lease = renders(&farm, &node).await;
    farm.finish(&lease).await;
    let rest: Job =
        post(&farm, &rest, "frames/cancel", json!({"frames": "0-1"})).await.parsed(StatusCode::OK).await;
    assert_eq!((rest.state, rest.frames_done), (JobState::Done, 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_if_questions_change_nothing_and_nonsense_is_refused() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    let job = submit(&farm, "0-9", json!({"name": "first", "deadline": in_hours(9)})).await;
    farm.until_booked(&a, &job).await;
    let other = submit(&farm, "0-9", json!({"name": "<b>second</b>", "deadline": in_hours(9)})).await;
    let other = farm.until_booked(&a, &other).await;
    let plans: PlanPage = farm.viewer.json("/v1/plans").await;
    let ask = async |change: Value| {
        farm.viewer.post("/v1/plans/what-if", &json!({"job_id": job.id, "change": change})).await
    };
    for (change, words) in [
        (json!({"more_nodes": {"node_id": a.id, "count": 2}}), "2 more nodes like a"),
        (json!({"node_gone": {"node_id": b.id}}), "without node b"),
        (json!({"make_way": {"job_id": other.id}}), "<b>second</b> gives up its deadline"),
        (json!({"without_job": {"job_id": other.id}}), "without <b>second</b>"),
        (json!({"confidence": {"job_id": job.id, "confidence": "p50"}}), "at a confidence of 50 % only"),
        (json!({"confidence": {"job_id": job.id, "confidence": "p95"}}), "at a confidence of 95 %:"),
        (json!({"later": {"job_id": job.id, "by_ms": -90_000}}), "the deadline 1 min 30 s earlier"),
        (json!({"later": {"job_id": job.id, "by_ms": 90_000}}), "the deadline 1 min 30 s later"),
    ] {
        let found: WhatIf = ask(change).await.parsed(StatusCode::OK).await;
        assert!(found.effect.words.starts_with(words), "{found:?}");
        assert!(found.effect.finish.is_some() && found.effect.in_time, "{found:?}");
    }
    let nothing = "0197a8a5-0000-7000-8000-000000000000";
    for (change, said) in [
        (json!({"more_nodes": {"node_id": a.id, "count": 0}}), "1 to 1000"),
        (json!({"node_gone": {"node_id": nothing}}), "no node"),
        (json!({"without_job": {"job_id": nothing}}), "no booked job"),
        (json!({"quality": {"spp": 3, "width": 1, "height": 1}}), "no such quality"),
    ] {
        let problem = ask(change).await.problem(ProblemKind::Invalid).await;
        assert!(
            problem.pointer.as_deref() == Some("/change") && problem.detail.contains(said),
            "{problem:?}"
        );
    }
    let unknown = json!({"job_id": nothing, "change": {"make_way": {"job_id": job.id}}});
    farm.viewer.post("/v1/plans/what-if", &unknown).await.problem(ProblemKind::NotFound).await;
    assert_eq!(farm.viewer.json::<PlanPage>("/v1/plans").await, plans, "a question made a plan");
}

#[tokio::test(flavor = "multi_thread")]
async fn changes_are_events() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = quoted(&farm, &node, "0-1").await;
    post(&farm, &job, "accept", json!({})).await.parsed::<Job>(StatusCode::OK).await;
    farm.until(&job, "it is booked", |job| job.state == JobState::Booked).await;
    patch(&farm, &job, json!({"budget": 7_000_000})).await.parsed::<Job>(StatusCode::OK).await;
    post(&farm, &job, "frames/cancel", json!({"frames": "1"})).await.parsed::<Job>(StatusCode::OK).await;
    farm.work_off(&node, &job).await;
    let path = format!("/v1/jobs/{}/events", job.id);
    let stream = crate::support::events::Events::open(&farm.viewer, &path, None).await.unwrap();
    let events = stream.rest(PATIENCE).await;
    let said: Vec<&str> = events
        .iter()
        .filter(|event| event.kind == EventKind::JobChanged)
        .filter_map(|event| event.message.as_deref())
        .collect();
    assert_eq!(said, ["its quote was accepted", "a new budget, 7.00", "frames 1 were cancelled"]);
    let states: Vec<JobState> = events.iter().filter_map(|event| event.job_state).collect();
    assert!(states.windows(2).any(|pair| pair == [JobState::Quoted, JobState::Booked]), "{states:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_greater_priority_lets_a_job_go_first() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let [first, second] = [submit(&farm, "0-3", json!({})).await, submit(&farm, "0-3", json!({})).await];
    farm.until_booked(&node, &first).await;
    let booked = farm.until_booked(&node, &second).await;
    for wrong in [-1001, 1001] {
        let problem =
            patch(&farm, &second, json!({"priority": wrong})).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some("/priority"));
    }
    let changed: Job = patch(&farm, &second, json!({"priority": 7})).await.parsed(StatusCode::OK).await;
    assert_eq!(changed.priority, 7);
    farm.until(&second, "be planned anew", |job| job.plan_id != booked.plan_id).await;
    assert_eq!(renders(&farm, &node).await.job_id, second.id);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lower_priority_lets_those_go_ahead_that_wait_behind_the_job() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let first = submit(&farm, "0-3", json!({})).await;
    farm.until_booked(&node, &first).await;
    let second = submit(&farm, "0-3", json!({})).await;
    farm.until_booked(&node, &second).await;
    let waits_behind = |job: &Job| job.waits.as_ref().is_some_and(|waits| waits.behind.contains(&first.id));
    let waiting = farm.until(&second, "wait behind the first", waits_behind).await;
    patch(&farm, &first, json!({"priority": -1})).await.parsed::<Job>(StatusCode::OK).await;
    farm.until(&second, "be planned anew", |job| job.plan_id != waiting.plan_id).await;
    assert_eq!(renders(&farm, &node).await.job_id, second.id);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_says_what_fails_of_it_until_that_is_done() {
    let (farm, clock) = Farm::with_clock().await;
    let node = farm.node("a").await;
    let job = submit(&farm, "0-1", json!({})).await;
    let job = farm.until_booked(&node, &job).await;
    assert_eq!(job.failing, None);
    let mut frame = None;
    for attempts in 1..=2 {
        let lease = renders(&farm, &node).await;
        let failed = json!({"fence": lease.fence, "error": {"message": "exit code 3"}});
        let answer = farm.worker.post(&format!("/v1/leases/{}/result", lease.lease_id), &failed).await;
        assert_eq!(answer.status(), StatusCode::OK);
        let failing = farm.job(&job).await.failing.unwrap();
        assert_eq!((failing.tasks, failing.attempts, failing.frame), (1, attempts, lease.spec.frame()));
        let times = if attempts == 1 { "once on a" } else { "2 times, last on a" };
        let number = failing.frame.unwrap();
        assert_eq!(failing.words, format!("frame {number} failed {times}: exit code 3"));
        assert!(failing.again_at.is_some());
        frame = failing.frame;
        clock.advance_micros(90_000_000);
    }
    // The next to be handed out is the same frame: its booking came first.
    let lease = renders(&farm, &node).await;
    assert_eq!(lease.spec.frame(), frame);
    assert_eq!(farm.job(&job).await.failing.unwrap().again_at, None);
    farm.finish(&lease).await;
    assert_eq!(farm.job(&job).await.failing, None);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_whose_quote_failed_goes_on_with_what_was_measured() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = submit(&farm, "0-9", json!({"profile_frames": 3})).await;
    let preview = farm.next(&node, TaskKind::Preview).await;
    farm.finish(&preview).await;
    let first = farm.next(&node, TaskKind::Profile).await;
    farm.finish(&first).await;
    let second = farm.next(&node, TaskKind::Profile).await;
    farm.fail_without_bundle(&second).await;
    assert_eq!(farm.job(&job).await.state, JobState::Failed);

    let frames = json!({"frames": "0-9"});
    let again: Job = post(&farm, &job, "frames/retry", frames.clone()).await.parsed(StatusCode::OK).await;
    assert_eq!((again.state, again.error, again.finished_at), (JobState::Profiling, None, None));
    // The two profiles that are missing are made; the first stays.
    let mut profiled = Vec::new();
    for _ in 0..2 {
        let lease = farm.next(&node, TaskKind::Profile).await;
        profiled.extend(lease.spec.frame());
        farm.finish(&lease).await;
    }
    assert!(!profiled.contains(&first.spec.frame().unwrap()), "{profiled:?}");
    assert_eq!(farm.work_off(&node, &job).await.state, JobState::Done);
    post(&farm, &job, "frames/retry", frames).await.parsed::<Job>(StatusCode::OK).await;
}
