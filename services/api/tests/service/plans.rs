//! Mended plans, promises, reasons to wait, answers, and sleeping nodes.

use std::time::Duration;

use crate::support::{Answer, Farm, LEASE, eventually, until};
use forelight_api::{Clock as _, Config};
use forelight_protocol::{
    AnswersDoc, Dashboard, Event, EventKind, Job, JobState, Lease, Node, Plan, PlanChange, PlanDifference,
    PlanEffect, PlanPage, PlanReason, PowerState, ProblemKind, ProjectList, Renewal, TaskKind, Timestamp,
    Verdict, WaitKind,
};
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

const SECOND: i64 = 1_000_000;
const HOUR: i64 = 3600 * SECOND;

impl Farm {
    async fn asked(&self, change: impl FnOnce(&mut Value), frames: &str) -> Job {
        let mut request = self.job_request(frames);
        change(&mut request);
        self.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await
    }

    async fn plan(&self, job: &Job) -> Plan {
        let path = format!("/v1/plans/{}", job.plan_id.unwrap());
        self.viewer.get(&path).await.parsed(StatusCode::OK).await
    }

    async fn answers(&self, job: &Job, query: &str) -> AnswersDoc {
        self.viewer.get(&format!("/v1/jobs/{}/answers{query}", job.id)).await.parsed(StatusCode::OK).await
    }

    async fn events(&self, job: &Job, kind: EventKind) -> Vec<Event> {
        let all = self.service.store().events_after(Some(job.id), 0, 10_000).await.unwrap();
        all.into_iter().filter(|event| event.kind == kind).collect()
    }
}

fn in_hours(hours: i64) -> Timestamp {
    Timestamp::now().plus_micros(hours * HOUR)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drained_nodes_frames_move_to_another_node_and_no_others() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    let job = farm.asked(|request| request["deadline"] = json!(in_hours(1)), "0-7").await;
    let job = farm.until_booked(&a, &job).await;
    let before = farm.plan(&job).await;
    assert!(job.promise.as_ref().unwrap().kept && job.promise.as_ref().unwrap().probability > 0.7);
    // Both are needed for the earliest end, but the cheapest plan on time may use only one.
    let used = before.bookings[0].node_id;
    let (gone, stays) = if used == a.id { (&a, &b) } else { (&b, &a) };
    farm.order(gone, json!({"drain": true})).await;
    let moved = farm.until(&job, "the frames have moved", |now| now.plan_id != job.plan_id).await;
    let after = farm.plan(&moved).await;
    assert_eq!((after.parent_id, after.reason), (Some(before.id), PlanReason::Events));
    assert!(
        after.causes.iter().any(|cause| cause == &format!("node {} is drained", gone.name)),
        "{:?}",
        after.causes
    );
    assert!(after.bookings.len() == 8 && after.bookings.iter().all(|booking| booking.node_id == stays.id));
    assert!(moved.promise.as_ref().unwrap().kept, "an hour is enough for one node");
    // Valid bookings stayed.
    for old in before.bookings.iter().filter(|old| old.node_id == stays.id) {
        let new = after.bookings.iter().find(|new| new.frame == old.frame).unwrap();
        assert!(new.start.micros_since(old.start).abs() <= 60 * SECOND, "{old:?} {new:?}");
    }
    let path = format!("/v1/plans/{}/difference", after.id);
    let difference: PlanDifference = farm.viewer.get(&path).await.parsed(StatusCode::OK).await;
    let on_gone = before.bookings.iter().filter(|booking| booking.node_id == gone.id).count();
    assert_eq!(
        (difference.frames.len(), difference.unmoved),
        (on_gone, 8 - on_gone as u64),
        "{difference:?}"
    );
    assert_eq!(difference.parent_id, Some(before.id));
    assert!(
        difference.words[0].contains(&format!("node {} is drained", gone.name)),
        "{:?}",
        difference.words
    );
    assert!(difference.words.iter().any(|line| line.contains(&format!("{} from", stays.name))));
    let first = format!("/v1/plans/{}/difference", before.id);
    let first: PlanDifference = farm.viewer.get(&first).await.parsed(StatusCode::OK).await;
    assert!(first.frames.iter().all(|frame| frame.before.is_none()) && first.frames.len() == 8);
    let page: PlanPage = farm.viewer.get("/v1/plans?page_size=1").await.parsed(StatusCode::OK).await;
    assert_eq!((page.items[0].id, page.items[0].bookings), (after.id, 8));
    let next = format!("/v1/plans?page_size=1&page_token={}", page.next_page_token.unwrap().0);
    let next: PlanPage = farm.viewer.get(&next).await.parsed(StatusCode::OK).await;
    assert_eq!(next.items[0].id, before.id);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_falls_silent_is_planned_for_once_and_so_is_its_return() {
    let (farm, clock) = Farm::with_short_leases().await;
    let only = farm.node("only").await;
    let job = farm.submit("0-3").await;
    let job = farm.until_booked(&only, &job).await;
    // A service that starts knows the node from its first look on. This one may have looked before it was there.
    let own = clock.clone();
    let farm = farm
        .restarted_with(|config| {
            config.clock = own;
            config.lease_ttl = Duration::from_micros(LEASE as u64);
        })
        .await;
    let wanted = async || farm.service.store().wanted_plan().await.unwrap();
    let planned = async |what: &str| {
        eventually(what, async || Some(wanted().await).filter(|wanted| !wanted.due)).await.count
    };
    let before = planned("what came before is planned for").await;
    clock.advance_micros(HOUR);
    until("the silence is noticed", async || wanted().await.count > before).await;
    assert_eq!(planned("the silence is planned for").await, before + 1);
    let silent = farm.plan(&farm.job(&job).await).await;
    assert_eq!((silent.causes, silent.bookings.len()), (vec!["node only is not responding".to_owned()], 0));
    // The service looks every second.
    tokio::time::sleep(Duration::from_millis(2500)).await;
    assert_eq!(wanted().await.count, before + 1, "asked again, though nothing is new");
    farm.node("only").await;
    let back = farm.until(&job, "the frames are booked again", |now| now.plan_id != Some(silent.id)).await;
    let back = farm.plan(&back).await;
    assert!(back.causes.contains(&"node only came back".to_owned()), "{:?}", back.causes);
    assert_eq!(back.bookings.len(), 4);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_promise_that_breaks_is_an_event_with_a_rescue_and_so_is_its_mending() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    // Eight frames of just over 25 seconds: on time on two nodes, late on one.
    let deadline = Timestamp::now().plus_micros(150 * SECOND);
    let job = farm.asked(|request| request["deadline"] = json!(deadline), "0-7").await;
    let job = farm.until_booked(&a, &job).await;
    assert_eq!(job.verdict.as_ref().unwrap().verdict, Verdict::OnTime, "{:?}", job.verdict);
    farm.order(&b, json!({"drain": true})).await;
    let kept = |job: &Job| job.promise.as_ref().is_some_and(|promise| promise.kept);
    let late = farm.until(&job, "the promise is at risk", |job| !kept(job)).await;
    let promise = late.promise.clone().unwrap();
    assert!(promise.probability < 0.8, "{promise:?}");
    let rescue = promise.rescue.expect("one more node would do");
    assert!(
        matches!(rescue.change, PlanChange::MoreNodes { .. }) && rescue.words.contains("more node"),
        "{rescue:?}"
    );
    eventually("the dashboard counts it", async || {
        let shown: Dashboard = farm.viewer.json("/v1/dashboard").await;
        (shown.counts.promises_at_risk == 1).then_some(())
    })
    .await;
    let verdict = late.verdict.unwrap();
    assert_eq!(verdict.verdict, Verdict::Late);
    assert!(!verdict.ways_out.is_empty() && verdict.ways_out.len() <= 3, "{verdict:?}");
    let told = farm.events(&job, EventKind::JobPromiseAtRisk).await;
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].promise.as_ref().is_some_and(|told| !told.kept && told.rescue.is_some()));
    assert!(told[0].message.as_ref().unwrap().contains("the cheapest rescue"), "{told:?}");
    farm.order(&b, json!({"drain": false})).await;
    let safe = farm.until(&job, "the promise is kept", kept).await;
    assert_eq!(safe.verdict.unwrap().verdict, Verdict::OnTime);
    assert_eq!(farm.events(&job, EventKind::JobPromiseSafe).await.len(), 1);
    assert_eq!(farm.events(&job, EventKind::JobPromiseAtRisk).await.len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_that_was_due_when_the_service_died_is_made_after_its_start() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    let job = farm.asked(|request| request["deadline"] = json!(in_hours(1)), "0-3").await;
    let job = farm.until_booked(&a, &job).await;
    let used = farm.plan(&job).await.bookings[0].node_id;
    let (gone, stays) = if used == a.id { (&a, &b) } else { (&b, &a) };
    // The service dies as soon as the order is stored.
    let drain = forelight_protocol::NodeChange { drain: Some(true), ..Default::default() };
    farm.service.store().change_node(gone.id, &drain, Timestamp::now()).await.unwrap();
    let farm = farm.killed_and_restarted().await;
    let moved = farm.until(&job, "the frames have moved", |now| now.plan_id != job.plan_id).await;
    assert!(farm.plan(&moved).await.bookings.iter().all(|booking| booking.node_id == stays.id));
    assert!(!farm.service.store().wanted_plan().await.unwrap().due);
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_that_take_much_longer_than_forecast_stretch_what_is_left_of_the_plan() {
    let lasting = |config: &mut Config| config.lease_ttl = Duration::from_secs(3600);
    let (farm, clock) = Farm::with_clock_at(Timestamp::now(), lasting).await;
    let node = farm.node("a").await;
    let deadline = clock.now().plus_micros(3600 * SECOND);
    let job = farm.asked(|request| request["deadline"] = json!(deadline), "0-7").await;
    let job = farm.until_booked(&node, &job).await;
    let before = farm.plan(&job).await;
    let length = |plan: &Plan, frame: u32| {
        let booking = plan.bookings.iter().find(|booking| booking.frame == frame).unwrap();
        booking.end.micros_since(booking.start)
    };
    let mut plan = before.clone();
    for _ in 0..2 {
        let lease = farm.next_task(&node).await;
        let mut result = farm.made_up_result(&lease).await;
        let forelight_protocol::TaskResult::Render(render) = &mut result else { panic!("{result:?}") };
        render.stats.cpu_seconds *= 2.0;
        // It keeps its node for its CPU time alone.
        clock.advance_micros((render.stats.cpu_seconds / f64::from(node.cores) * 1e6) as i64);
        let answer = farm.report(&lease, result).await;
        assert_eq!(answer.status(), StatusCode::OK);
        let known = plan.id;
        let now = farm.until(&job, "there is a new plan", |job| job.plan_id != Some(known)).await;
        plan = farm.plan(&now).await;
    }
    assert!(plan.causes.iter().any(|cause| cause.contains("longer than was forecast")), "{:?}", plan.causes);
    let (done, waits) = (before.bookings[0].frame, before.bookings[7].frame);
    let stretched = length(&plan, waits) as f64 / length(&before, waits) as f64;
    // Single frames had a wide spread, so two frames at twice the forecast do not prove a factor of two.
    assert!((1.2..1.9).contains(&stretched), "{stretched}");
    // Finished frames keep their bookings.
    assert_eq!(length(&plan, done), length(&before, done));
    let verdict = farm.job(&job).await.verdict.unwrap();
    assert!(verdict.reasons.iter().any(|reason| reason.contains("longer than was forecast")), "{verdict:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_is_answered_by_when_for_how_much_and_what_would_change_it() {
    let farm = Farm::new().await;
    let node = farm.node("dear").await;
    let cheap = json!({"name": "cheap", "speed": 1.0, "price_per_hour": 360_000, "cores": 1});
    let cheap: Node = farm.worker.post("/v1/nodes", &cheap).await.parsed(StatusCode::CREATED).await;
    let job = farm.asked(|request| request["deadline"] = json!(in_hours(2)), "0-9").await;
    let path = format!("/v1/jobs/{}/answers", job.id);
    farm.viewer.get(&path).await.problem(ProblemKind::Conflict).await;
    farm.nobody.get(&path).await.problem(ProblemKind::Unauthenticated).await;
    let job = farm.until_booked(&node, &job).await;
    let found = farm.answers(&job, "").await;
    assert_eq!((found.plan_id, found.deadline), (job.plan_id, job.deadline));
    assert_eq!(found.outlook.len(), 3);
    assert!(found.outlook.iter().all(|line| line.in_time == Some(true) && line.cost >= line.cost_at_least));
    assert!(found.outlook.windows(2).all(|pair| pair[0].cost <= pair[1].cost), "{:?}", found.outlook);
    let cheapest = found.cheapest.clone().unwrap();
    // Ten frames of 97 to 106 CPU seconds on the cheap node, at 100 micro-units per second.
    assert!((90_000..130_000).contains(&cheapest.cost.0), "{cheapest:?}");
    assert!(found.curve.len() > 5 && found.curve.windows(2).all(|pair| pair[0].cost >= pair[1].cost));
    assert!(found.curve[0].cost > cheapest.cost, "sooner is dearer: {:?}", found.curve);
    assert!(found.why_not.is_empty() && found.ways_out.is_empty() && found.left_out.is_empty());
    let has = |is: fn(&PlanChange) -> bool| found.what_if.iter().any(|effect| is(&effect.change));
    assert!(has(|change| matches!(change, PlanChange::MoreNodes { count: 1, .. })));
    assert!(has(|change| matches!(change, PlanChange::NodeGone { .. })));
    assert!(has(|change| matches!(change, PlanChange::Later { by_ms: 3_600_000, .. })));
    assert!(found.qualities.iter().filter(|offer| offer.asked_for).count() == 1, "{:?}", found.qualities);
    let budget = farm.answers(&job, &format!("?budget={}", cheapest.cost.0)).await.for_budget.unwrap();
    let offer = budget.offer.expect("the cheapest plan is cheap enough");
    assert!(offer.cost <= cheapest.cost && offer.finish > found.curve[0].finish, "{offer:?}");
    let nothing = farm.answers(&job, "?budget=1").await;
    assert_eq!(nothing.for_budget.unwrap().offer, None);
    assert!(nothing.why_not.iter().any(|reason| reason.contains("budget")), "{:?}", nothing.why_not);
    // A quality fits if it costs no more than the budget that was asked about, and only such a one is a way out.
    let half = cheapest.cost.0 / 2;
    let tight = farm.answers(&job, &format!("?budget={half}")).await;
    let of_quality = |way: &&PlanEffect| matches!(way.change, PlanChange::Quality { .. });
    assert!(
        tight.qualities.iter().any(|offer| offer.fits) && !tight.qualities.iter().all(|offer| offer.fits)
    );
    assert!(tight.qualities.iter().all(|offer| !offer.fits || offer.cost.0 <= half), "{:?}", tight.qualities);
    assert!(tight.ways_out.iter().any(|way| of_quality(&way)), "{:?}", tight.ways_out);
    assert!(tight.ways_out.iter().filter(of_quality).all(|way| way.added_cost.0 < 0), "{:?}", tight.ways_out);
    assert!(found.outlook.iter().all(|line| line.finish.is_some_and(|finish| finish > found.at)));
    let soon = Timestamp::now().plus_micros(20 * SECOND);
    let late = farm.answers(&job, &format!("?deadline={soon}")).await;
    assert!(late.outlook.iter().all(|line| line.in_time == Some(false)) && late.cheapest.is_none());
    assert!(late.why_not.iter().any(|reason| reason.contains("after the deadline")), "{:?}", late.why_not);
    assert!(
        (1..=3).contains(&late.ways_out.len())
            && late.ways_out.iter().all(|way| way.in_time && way.finish.is_some()),
        "{:?}",
        late.ways_out
    );
    let sorted = late.ways_out.windows(2).all(|pair| pair[0].added_cost <= pair[1].added_cost);
    assert!(sorted, "{:?}", late.ways_out);
    // Questions leave no trace.
    assert_eq!((farm.job(&job).await.deadline, farm.job(&job).await.plan_id), (job.deadline, job.plan_id));
    let svg = farm.viewer.get(&format!("/v1/jobs/{}/price-curve.svg", job.id)).await;
    assert_eq!(svg.headers()["content-type"], "image/svg+xml");
    let svg = svg.text().await.unwrap();
    roxmltree::Document::parse(&svg).unwrap();
    assert!(svg.contains("polyline"));
    for query in ["?budget=-1", "?budget=much", "?deadline=tomorrow", "?budget=1000000000000000001"] {
        let refused = farm.viewer.get(&format!("{path}{query}")).await;
        assert!(refused.status().is_client_error(), "{query}: {}", refused.status());
    }
    farm.work_off(&cheap, &job).await;
    farm.viewer.get(&path).await.problem(ProblemKind::Conflict).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_cannot_be_had_says_why_and_the_ways_out_by_itself() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let soon = Timestamp::now().plus_micros(40 * SECOND);
    let job = farm.asked(|request| request["deadline"] = json!(soon), "0-5").await;
    let job = farm.until_booked(&node, &job).await;
    let verdict = job.verdict.unwrap();
    assert_eq!((verdict.verdict, job.promise), (Verdict::Late, None));
    assert!((1..=3).contains(&verdict.ways_out.len()), "{verdict:?}");
    assert!(verdict.ways_out.windows(2).all(|pair| pair[0].added_cost <= pair[1].added_cost));
    let dear = farm.asked(|request| request["budget"] = json!(1000), "0-1").await;
    let dear = farm.until_booked(&node, &dear).await.verdict.unwrap();
    assert_eq!(dear.verdict, Verdict::OverBudget, "{dear:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn projects_take_turns_by_their_shares_and_who_waits_is_told_why() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let share = json!({"project": "film", "share": 3});
    farm.submitter.post("/v1/projects", &share).await.problem(ProblemKind::Forbidden).await;
    assert_eq!(farm.operator.post("/v1/projects", &share).await.status(), StatusCode::OK);
    for wrong in [json!({"project": "film", "share": 0}), json!({"project": "", "share": 1})] {
        farm.operator.post("/v1/projects", &wrong).await.problem(ProblemKind::Invalid).await;
    }
    farm.project("advert").await;
    let of = |project: &'static str| move |request: &mut Value| request["project"] = json!(project);
    let advert = farm.asked(of("advert"), "0-11").await;
    let film = farm.asked(of("film"), "0-11").await;
    // Two previews, the older job's profiles, then the other's. No frame is begun.
    let profiled = |job: &Job| job.state == JobState::Profiling;
    let previews = [farm.next_task(&node).await, farm.next_task(&node).await];
    for preview in &previews {
        farm.finish(preview).await;
    }
    farm.until(&advert, "it is profiled", profiled).await;
    farm.until(&film, "it is profiled", profiled).await;
    for _ in 0..2 {
        farm.finish(&farm.next_task(&node).await).await;
    }
    let booked = farm.until(&advert, "it is booked", |job| job.state == JobState::Booked).await;
    for _ in 0..2 {
        farm.finish(&farm.next_task(&node).await).await;
    }
    let film = farm.until(&film, "it is booked", |job| job.state == JobState::Booked).await;
    let advert = farm.until(&advert, "it was dealt out anew", |now| now.plan_id != booked.plan_id).await;
    assert_eq!(advert.plan_id, film.plan_id, "one plan books both");
    let mut both = farm.plan(&film).await.bookings;
    both.sort_by_key(|booking| booking.start);
    // Three of the first four frames are the film's.
    let of_film = both[..12].iter().filter(|booking| booking.job_id == film.id).count();
    assert!((8..=10).contains(&of_film), "{of_film} of the first 12");
    let waiting = if both[0].job_id == film.id { &advert } else { &film };
    let waits = waiting.waits.as_ref().expect("the second waits");
    assert_eq!(waits.kind, WaitKind::Others);
    assert!(waits.because.starts_with("waits because") && waits.behind.len() == 1, "{waits:?}");
    // Which is first depends on how long a preview took.
    assert!(waits.because.contains(" for a share of 3"), "{waits:?}");
    assert!(waits.share.is_some() && waits.until.is_some());
    let dashboard: Dashboard = farm.viewer.get("/v1/dashboard").await.parsed(StatusCode::OK).await;
    let shown = dashboard.jobs.iter().find(|job| job.id == waiting.id).unwrap();
    assert_eq!(shown.waits.as_ref(), Some(waits));
    let projects: ProjectList = farm.viewer.get("/v1/projects").await.parsed(StatusCode::OK).await;
    let found: Vec<_> = projects.items.iter().map(|entry| (entry.project.as_str(), entry.share)).collect();
    let expected = vec![("advert", 1), ("default", 1), ("film", 3)];
    assert_eq!((found, projects.half_life_hours), (expected, 168));
}

fn monday(hour: i64, minute: i64, second: i64) -> Timestamp {
    let midnight: Timestamp = "2026-03-02T00:00:00Z".parse().unwrap();
    midnight.plus_micros(hour * HOUR + (minute * 60 + second) * SECOND)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_sleeps_gets_nothing_and_is_told_until_when() {
    let (farm, clock) = Farm::with_clock_at(monday(12, 0, 0), |_| {}).await;
    let schedule = json!({"zone": "Europe/Berlin", "windows": [{"days": ["mon", "tue"], "from": "21:00", "until": "08:00"}]});
    let registration = json!({"name": "a", "speed": 2.0, "cores": 2, "schedule": schedule});
    let node: Node = farm.worker.post("/v1/nodes", &registration).await.parsed(StatusCode::CREATED).await;
    let node: Node = farm.viewer.get(&format!("/v1/nodes/{}", node.id)).await.parsed(StatusCode::OK).await;
    let power = node.power.unwrap();
    assert_eq!((power.state, power.until), (PowerState::Asleep, Some(monday(20, 0, 0))));
    let job = farm.submit("0-3").await;
    let claim = json!({"node_id": node.id, "wait_ms": 60_000});
    let begun = std::time::Instant::now();
    let answer = farm.worker.post("/v1/leases", &claim).await;
    assert_eq!(answer.status(), StatusCode::NO_CONTENT);
    assert_eq!(answer.headers()["retry-after"], "28800");
    assert!(begun.elapsed() < Duration::from_secs(30), "who sleeps does not wait");
    clock.advance_micros(8 * HOUR);
    farm.until_booked(&node, &job).await;
    let awake: Node = farm.viewer.get(&format!("/v1/nodes/{}", node.id)).await.parsed(StatusCode::OK).await;
    let power = awake.power.unwrap();
    assert_eq!((power.state, power.until), (PowerState::Awake, Some(monday(31, 0, 0))));
    // A frame takes 25 seconds, so none is handed out ten seconds before the window ends.
    clock.advance_micros(11 * HOUR - 10 * SECOND);
    let late = farm.worker.post("/v1/leases", &json!({"node_id": node.id})).await;
    assert_eq!(late.status(), StatusCode::NO_CONTENT);
    assert!(late.headers().get("retry-after").is_none(), "it is awake still");
    // An operator makes the window an hour longer; the worker's schedule no longer counts.
    let longer = json!({"schedule": {"zone": "UTC", "windows": [{"from": "20:00", "until": "08:00"}]}, "terms": {"window_end": "stop"}});
    let node = farm.order(&node, longer).await;
    assert!(node.schedule_set);
    let lease: Lease = farm.worker.post("/v1/leases", &claim).await.parsed(StatusCode::OK).await;
    assert_eq!(lease.spec.kind(), TaskKind::Render);
    for wrong in [
        json!({"schedule": {"zone": "Mars/Olympus", "windows": [{"from": "20:00", "until": "08:00"}]}}),
        json!({"schedule": {"windows": []}}),
        json!({"terms": {"billing_step_seconds": 604_801}}),
        json!({"terms": {"maintenance": [{"start": "2026-03-02T10:00:00Z", "end": "2026-03-02T10:00:00Z"}]}}),
    ] {
        let patch = farm.operator.request(Method::PATCH, &format!("/v1/nodes/{}", node.id)).json(&wrong);
        let problem = patch.send().await.unwrap().problem(ProblemKind::Invalid).await;
        assert!(problem.pointer.is_some(), "{problem:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn at_the_end_of_a_window_tasks_are_finished_or_stopped_as_the_nodes_terms_say() {
    let (farm, clock) = Farm::with_clock_at(monday(7, 58, 0), |_| {}).await;
    let until_eight = json!({"zone": "UTC", "windows": [{"from": "20:00", "until": "08:00"}]});
    let mut leases = Vec::new();
    for (name, window_end) in [("patient", "finish"), ("strict", "stop")] {
        let node = farm.node(name).await;
        farm.order(&node, json!({"schedule": until_eight, "terms": {"window_end": window_end}})).await;
        let job = farm.submit("0").await;
        farm.until_booked(&node, &job).await;
        leases.push(farm.next_task(&node).await);
    }
    // Leases are renewed all the time, so none expires meanwhile.
    for _ in 0..13 {
        clock.advance_micros(10 * SECOND);
        for lease in &leases {
            let renewal = farm.worker.request(Method::PATCH, &format!("/v1/leases/{}", lease.lease_id));
            renewal.json(&json!({"fence": lease.fence})).send().await.unwrap();
        }
    }
    farm.service.store().sweep(clock.now()).await.unwrap();
    let mut orders = Vec::new();
    for lease in &leases {
        let renewal = farm.worker.request(Method::PATCH, &format!("/v1/leases/{}", lease.lease_id));
        let renewal: Renewal =
            renewal.json(&json!({"fence": lease.fence})).send().await.unwrap().parsed(StatusCode::OK).await;
        assert_eq!(renewal.sleep_until, Some(monday(20, 0, 0)));
        orders.push(renewal.order);
    }
    assert_eq!(orders, [forelight_protocol::LeaseOrder::Continue, forelight_protocol::LeaseOrder::Stop]);
}
