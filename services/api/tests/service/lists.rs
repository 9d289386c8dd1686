//! Lists, the dashboard, strips and timelines.

use crate::support::events::Events;
use crate::support::{Answer, Farm, PATIENCE, eventually};
use forelight_protocol::{
    Dashboard, EventKind, FrameStrip, Job, JobPage, JobState, NodePage, NodeState, ProblemKind, SpanKind,
    TaskKind, TimelinePage, Timestamp,
};
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

const HOUR: i64 = 3_600_000_000;

fn in_hours(hours: i64) -> Timestamp {
    Timestamp::now().plus_micros(hours * HOUR)
}

async fn submit(farm: &Farm, name: &str, with: Value) -> Job {
    let mut request = farm.job_request("0-3");
    request["name"] = json!(name);
    request.as_object_mut().unwrap().extend(with.as_object().unwrap().clone());
    farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await
}

/// All pages of a list of jobs, one job a page.
async fn names(farm: &Farm, query: &str) -> Vec<String> {
    let (mut names, mut token) = (Vec::new(), String::new());
    loop {
        let page: JobPage = farm.viewer.json(&format!("/v1/jobs?page_size=1&{query}{token}")).await;
        names.extend(page.items.into_iter().map(|job| job.name));
        match page.next_page_token {
            Some(next) => token = format!("&page_token={next}"),
            None => return names,
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_are_found_by_text_and_come_in_every_order_without_gap_or_overlap() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let soon = submit(&farm, "b late", json!({"deadline": Timestamp::now().plus_micros(1_000_000)})).await;
    farm.until_booked(&node, &soon).await;
    farm.project("Film").await;
    let plain = submit(&farm, "C without", json!({"project": "Film"})).await;
    farm.until_booked(&node, &plain).await;
    let safe = submit(&farm, "a safe", json!({"deadline": in_hours(50)})).await;
    farm.until_booked(&node, &safe).await;
    let over = submit(&farm, "d over", json!({})).await;
    farm.submitter.post(&format!("/v1/jobs/{}/cancel", over.id), &json!({})).await;
    assert_eq!(names(&farm, "sort=-created").await, ["d over", "a safe", "C without", "b late"]);
    assert_eq!(names(&farm, "open=true").await, ["a safe", "C without", "b late"]);
    assert_eq!(names(&farm, "open=true&sort=risk").await, ["b late", "a safe", "C without"]);
    assert_eq!(names(&farm, "sort=deadline").await, ["b late", "a safe", "C without", "d over"]);
    assert_eq!(names(&farm, "sort=name").await, ["C without", "a safe", "b late", "d over"]);
    let by_cost = names(&farm, "sort=cost").await;
    assert_eq!((by_cost.len(), by_cost[3].as_str()), (4, "d over"), "{by_cost:?}");
    assert_eq!(names(&farm, "search=SAFE").await, ["a safe"]);
    assert_eq!(names(&farm, "search=film&open=true&sort=name").await, ["C without"]);
    assert_eq!(names(&farm, "search=%25&sort=risk").await, [""; 0], "% is only a letter");
    assert_eq!(names(&farm, "state=cancelled&sort=cost").await, ["d over"]);
    for (query, parameter) in
        [("sort=age", "sort"), ("open=perhaps", "open"), (&*format!("search={}", "x".repeat(201)), "search")]
    {
        let problem = farm.viewer.get(&format!("/v1/jobs?{query}")).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.parameter.as_deref(), Some(parameter), "{query}: {}", problem.detail);
    }
    let page: JobPage = farm.viewer.json("/v1/jobs?page_size=1&sort=name").await;
    let other = format!("/v1/jobs?sort=risk&page_token={}", page.next_page_token.unwrap());
    farm.viewer.get(&other).await.problem(ProblemKind::Invalid).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nodes_are_found_by_state_and_text_and_sorted() {
    let farm = Farm::new().await;
    for (name, speed, price) in [("rack-2", 3.0, 5), ("Rack-1", 1.0, 9), ("cloud", 2.0, 1)] {
        let node = json!({"name": name, "speed": speed, "price_per_hour": price, "cores": 1});
        farm.worker.post("/v1/nodes", &node).await;
    }
    let names = async |query: &str| -> Vec<String> {
        let (mut names, mut token) = (Vec::new(), String::new());
        loop {
            let page: NodePage = farm.viewer.json(&format!("/v1/nodes?page_size=1&{query}{token}")).await;
            names.extend(page.items.into_iter().map(|node| node.name));
            match page.next_page_token {
                Some(next) => token = format!("&page_token={next}"),
                None => return names,
            }
        }
    };
    assert_eq!(names("").await, ["rack-2", "Rack-1", "cloud"]);
    assert_eq!(names("sort=name").await, ["Rack-1", "cloud", "rack-2"]);
    assert_eq!(names("sort=speed").await, ["Rack-1", "cloud", "rack-2"]);
    assert_eq!(names("sort=price").await, ["cloud", "rack-2", "Rack-1"]);
    assert_eq!(names("search=rack&sort=name").await, ["Rack-1", "rack-2"]);
    let page: NodePage = farm.viewer.json("/v1/nodes?search=cloud").await;
    farm.order(&page.items[0], json!({"drain": true})).await;
    assert_eq!(names("state=drained").await, ["cloud"]);
    // What an operator sets counts, on every page.
    farm.order(&page.items[0], json!({"price_per_hour": 1000})).await;
    assert_eq!(names("sort=price").await, ["rack-2", "Rack-1", "cloud"]);
    assert_eq!(names("state=idle&sort=price").await, ["rack-2", "Rack-1"]);
    farm.viewer.get("/v1/nodes?state=lazy").await.problem(ProblemKind::Invalid).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_dashboard_has_risks_ends_and_money_and_is_not_sent_twice() {
    // Time stands still, so that nothing is expected later than before.
    let (farm, _) = Farm::with_clock().await;
    let node = farm.node("<script>alert(1)</script>").await;
    let late = submit(&farm, "late", json!({"deadline": Timestamp::now().plus_micros(1_000_000)})).await;
    farm.until_booked(&node, &late).await;
    let job =
        submit(&farm, "</script>\u{202e}&", json!({"deadline": in_hours(50), "budget": 7_000_000})).await;
    farm.until_booked(&node, &job).await;
    let held = submit(&farm, "held", json!({"hold": true})).await;
    farm.until_booked(&node, &held).await;
    let budget = json!({"project": "default", "period": "night", "amount": 5_000_000});
    farm.operator.post("/v1/budgets", &budget).await;
    let shown: Dashboard = farm.viewer.json("/v1/dashboard").await;
    let names: Vec<&str> = shown.jobs.iter().map(|job| job.name.as_str()).collect();
    assert_eq!(names, ["late", "</script>\u{202e}&", "held"]);
    let counts = shown.counts.jobs;
    assert_eq!((shown.jobs_open_total, counts.quoted, counts.booked + counts.rendering), (3, 1, 2));
    let [_, job, held] = &shown.jobs[..] else { panic!() };
    let (finish, eta) = (job.finish.unwrap(), job.eta.unwrap());
    assert!(finish.p50 <= finish.p80 && finish.p80 <= finish.p95 && finish.p50 <= eta, "{finish:?} {eta}");
    assert!(job.promise.as_ref().unwrap().kept && job.cost.is_some() && job.budget.is_some());
    assert!(held.hold && held.cost.is_some() && held.probability.is_none());
    let versions = &shown.versions;
    assert_eq!((versions.service.as_str(), versions.workers.len()), (env!("CARGO_PKG_VERSION"), 1));
    assert_eq!((versions.workers[0].nodes, versions.plan_id.is_some()), (1, true));
    let farms = shown.finish.unwrap();
    assert!(farms.p50 <= farms.p95 && farms.p95 >= finish.p50, "{farms:?}");
    let spending = &shown.spending[0];
    assert_eq!((spending.project.as_str(), spending.budgets.len()), ("default", 1));
    assert_eq!((shown.nodes[0].name.as_str(), shown.node_counts.idle), ("<script>alert(1)</script>", 1));
    let told: Vec<EventKind> = shown.events.iter().map(|event| event.kind).collect();
    let of_every_task = [EventKind::TaskLeased, EventKind::TaskProgress, EventKind::TaskDone];
    assert!(told.len() <= 20 && !told.iter().any(|kind| of_every_task.contains(kind)), "{told:?}");
    assert!(told.contains(&EventKind::ForecastReady), "{told:?}");
    assert!(shown.events.is_sorted_by_key(|event| std::cmp::Reverse(event.id)));
    // The last plan may still be on its way; after it, nothing changes.
    let tag = eventually("the dashboard comes to rest", async || {
        let first = farm.viewer.get("/v1/dashboard").await;
        let tag = first.headers()["etag"].clone();
        let again = farm.viewer.request(Method::GET, "/v1/dashboard").header("if-none-match", &tag);
        (again.send().await.unwrap().status() == StatusCode::NOT_MODIFIED).then_some(tag)
    })
    .await;
    farm.submitter.post(&format!("/v1/jobs/{}/cancel", held.id), &json!({})).await;
    let after = farm.viewer.request(Method::GET, "/v1/dashboard").header("if-none-match", &tag);
    assert_eq!(after.send().await.unwrap().status(), StatusCode::OK, "people see what they did");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_strip_has_a_letter_and_numbers_for_each_frame() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-3,7").await;
    let path = format!("/v1/jobs/{}/strip", job.id);
    let strip: FrameStrip = farm.viewer.json(&path).await;
    assert_eq!((strip.states.as_str(), &strip.profiled, strip.p50.len()), ("wwwww", &None, 5));
    farm.until_booked(&node, &job).await;
    for _ in 0..2 {
        let lease = farm.next_task(&node).await;
        assert_eq!(lease.spec.kind(), TaskKind::Render);
        farm.finish(&lease).await;
    }
    farm.next_task(&node).await;
    let strip: FrameStrip = farm.viewer.json(&path).await;
    let waiting = strip.frames.iter().zip(strip.states.chars()).find(|(_, letter)| *letter == 'b').unwrap().0;
    let frames = json!({"frames": waiting.to_string()});
    farm.submitter.post(&format!("/v1/jobs/{}/frames/cancel", job.id), &frames).await;
    let strip: FrameStrip = farm.viewer.json(&path).await;
    let count = |letter| strip.states.chars().filter(|other| *other == letter).count();
    assert_eq!((count('d'), count('r'), count('b'), count('c')), (2, 1, 1, 1), "{}", strip.states);
    assert_eq!((strip.frames.to_string().as_str(), strip.actual.iter().flatten().count()), ("0-3,7", 2));
    assert!(strip.profiled.as_ref().is_some_and(|frames| frames.count() == 2));
    for at in 0..5 {
        let [p50, p80, p95] = [&strip.p50, &strip.p80, &strip.p95].map(|values| values[at].unwrap());
        assert!(0.0 < p50 && p50 <= p80 && p80 <= p95, "{p50} {p80} {p95}");
    }
    let money: FrameStrip = farm.viewer.json(&format!("{path}?quantity=cost")).await;
    assert!(money.p50[0].unwrap() > 0.0 && money.actual.iter().flatten().count() == 2, "{money:?}");
    let work: FrameStrip = farm.viewer.json(&format!("{path}?quantity=work")).await;
    assert_eq!(work.actual.iter().flatten().count(), 2);
    farm.viewer.get(&format!("{path}?quantity=joy")).await.problem(ProblemKind::Invalid).await;
    let tag = farm.viewer.get(&path).await.headers()["etag"].clone();
    let again = farm.viewer.request(Method::GET, &path).header("if-none-match", &tag).send().await.unwrap();
    assert_eq!(again.status(), StatusCode::NOT_MODIFIED);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_timeline_has_what_was_what_is_and_what_is_booked_in_spans() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let closed = farm.node("b").await;
    let span = json!({"start": in_hours(1), "end": in_hours(2)});
    farm.order(&closed, json!({"drain": true, "terms": {"maintenance": [span]}})).await;
    let job = farm.submit("0-9").await;
    farm.until_booked(&node, &job).await;
    let done = farm.next_task(&node).await;
    farm.finish(&done).await;
    farm.next_task(&node).await;
    let page: TimelinePage = farm.viewer.json("/v1/timeline").await;
    assert_eq!(page.jobs.iter().map(|job| job.name.as_str()).collect::<Vec<_>>(), ["a job"]);
    let [a, b] = &page.items[..] else { panic!("{page:?}") };
    assert_eq!((a.name.as_str(), a.state, b.state), ("a", NodeState::Working, NodeState::Drained));
    let count = |kind| a.spans.iter().filter(|span| span.kind == kind).count();
    assert!(count(SpanKind::Past) >= 1 && count(SpanKind::Running) == 1, "{:?}", a.spans);
    let booked: Vec<_> = a.spans.iter().filter(|span| span.kind == SpanKind::Booked).collect();
    let frames: u64 = booked.iter().map(|span| span.frames.as_ref().unwrap().count()).sum();
    assert_eq!(frames, 8);
    assert!(booked.len() < 8, "neighbours are merged: {booked:?}");
    assert!(booked.iter().all(|span| span.end_p80.is_some_and(|end| end >= span.end)), "{booked:?}");
    assert!(a.spans.windows(2).all(|pair| pair[0].start <= pair[1].start));
    assert_eq!(b.spans.iter().map(|span| span.kind).collect::<Vec<_>>(), [SpanKind::Maintenance]);
    let one: TimelinePage = farm.viewer.json("/v1/timeline?page_size=1&search=A").await;
    assert_eq!((one.items.len(), one.next_page_token), (1, None));
    let one: TimelinePage = farm.viewer.json("/v1/timeline?page_size=1").await;
    let next = format!("/v1/timeline?page_token={}", one.next_page_token.unwrap());
    assert_eq!(farm.viewer.json::<TimelinePage>(&next).await.items[0].name, "b");
    let later = format!("/v1/timeline?from={}&to={}", in_hours(100), in_hours(101));
    assert!(farm.viewer.json::<TimelinePage>(&later).await.items[0].spans.is_empty());
    for query in [
        "from=2026-01-02T00:00:00Z&to=2026-01-01T00:00:00Z",
        "from=2026-01-01T00:00:00Z&to=2026-03-01T00:00:00Z",
        "from=noon",
    ] {
        farm.viewer.get(&format!("/v1/timeline?{query}")).await.problem(ProblemKind::Invalid).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn events_bring_what_a_page_needs_to_stay_true() {
    let farm = Farm::new().await;
    let mut stream = Events::open(&farm.viewer, "/v1/events", None).await.unwrap();
    let node = farm.node("a").await;
    let job = farm.submit("0-1").await;
    farm.work_off(&node, &job).await;
    farm.order(&node, json!({"drain": true})).await;
    let (mut done, mut registered) = (Vec::new(), None);
    loop {
        let event = stream.next(PATIENCE).await.unwrap();
        match (event.kind, event.task_kind) {
            (EventKind::TaskDone, Some(TaskKind::Render)) => done.push(event),
            (EventKind::NodeRegistered, _) => registered = event.node_state,
            (EventKind::NodeChanged, _) => {
                assert_eq!(event.node_state, Some(NodeState::Drained));
                break;
            }
            _ => {}
        }
    }
    assert_eq!(registered, Some(NodeState::Idle));
    assert_eq!(done.iter().map(|event| event.frames_done).collect::<Vec<_>>(), [Some(1), Some(2)]);
    assert!(
        done.iter().all(|event| event.cost.is_some_and(|cost| cost.work > 0.0 && cost.cpu_seconds > 0.0))
    );
    assert_eq!(farm.job(&job).await.state, JobState::Done);
}
