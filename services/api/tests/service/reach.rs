//! Tokens that reach some projects only.

use std::collections::BTreeSet;

use crate::support::events::Events;
use crate::support::{Answer, Farm, Http, PATIENCE};
use forelight_protocol::{
    BookingPage, BudgetForecast, BudgetList, Dashboard, EventKind, FarmSummary, Job, JobPage, JobState,
    NewToken, NodePage, PlanPage, ProblemKind, ProjectList, Role, Session, TimelinePage, Token, TrackRecord,
};
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

/// A farm with the projects `film` and `ads`, and a job of each.
struct Two {
    farm: Farm,
    /// Submits to `film`, and views nothing else.
    anna: Http,
    /// Views `film`.
    guest: Http,
    film: Job,
    ads: Job,
}

impl Two {
    async fn new() -> Self {
        let farm = Farm::new().await;
        for project in ["film", "ads"] {
            farm.project(project).await;
        }
        let (anna, token) = farm.new_token(json!({"name": "anna", "projects": {"film": "submitter"}})).await;
        assert_eq!(token.role, Role::Submitter);
        let (guest, _) = farm.new_token(json!({"name": "guest", "projects": {"film": "viewer"}})).await;
        let film = submit(&farm, &anna, "film").await;
        let ads = submit(&farm, &farm.submitter, "ads").await;
        Self { farm, anna, guest, film, ads }
    }
}

fn request(farm: &Farm, project: &str) -> Value {
    let mut request = farm.job_request("0-3");
    request["project"] = json!(project);
    request["name"] = json!(format!("shot of {project}"));
    request
}

async fn submit(farm: &Farm, http: &Http, project: &str) -> Job {
    http.post("/v1/jobs", &request(farm, project)).await.parsed(StatusCode::CREATED).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_of_another_project_is_answered_like_one_that_does_not_exist() {
    let Two { farm, anna, guest, film, ads } = Two::new().await;
    let node = farm.node("a").await;
    farm.until_booked(&node, &ads).await;
    let of = |job: &Job| format!("/v1/jobs/{}", job.id);
    for http in [&anna, &guest] {
        assert_eq!(http.json::<Job>(&of(&film)).await.id, film.id);
        for rest in [
            "",
            "/forecast",
            "/accuracy",
            "/explanation",
            "/forecast/history",
            "/forecast/history.svg",
            "/strip",
            "/frames",
            "/frames/0",
            "/frames/0/preview.png",
            "/frames/0/image.png",
            "/answers",
            "/price-curve.svg",
            "/events",
        ] {
            http.get(&format!("{}{rest}", of(&ads))).await.problem(ProblemKind::NotFound).await;
        }
        let list: JobPage = http.json("/v1/jobs").await;
        assert_eq!(list.items.iter().map(|job| job.id).collect::<Vec<_>>(), [film.id]);
        let list: JobPage = http.json("/v1/jobs?project=ads").await;
        assert_eq!(list.items, []);
    }
    for (rest, body) in
        [("/cancel", json!({})), ("/accept", json!({})), ("/frames/retry", json!({"frames": "0"}))]
    {
        anna.post(&format!("{}{rest}", of(&ads)), &body).await.problem(ProblemKind::NotFound).await;
    }
    let patch = async |http: &Http, job: &Job| {
        http.request(Method::PATCH, &of(job)).json(&json!({"budget": 9_000_000})).send().await.unwrap()
    };
    patch(&anna, &ads).await.problem(ProblemKind::NotFound).await;
    guest.post(&format!("{}/cancel", of(&film)), &json!({})).await.problem(ProblemKind::Forbidden).await;
    assert_eq!(farm.job(&ads).await.budget, None);
    let changed: Job = patch(&anna, &film).await.parsed(StatusCode::OK).await;
    assert_eq!(changed.budget.map(|it| it.0), Some(9_000_000));
    let cancelled: Job =
        anna.post(&format!("{}/cancel", of(&film)), &json!({})).await.parsed(StatusCode::OK).await;
    assert_eq!(cancelled.state, JobState::Cancelled);
}

#[tokio::test(flavor = "multi_thread")]
async fn documents_about_the_farm_show_no_other_projects_jobs() {
    let Two { farm, anna, film, ads, .. } = Two::new().await;
    let node = farm.node("a").await;
    for job in [&film, &ads] {
        farm.until_booked(&node, job).await;
    }
    let budget = |project: &str| json!({"project": project, "period": "month", "amount": 1_000_000_000_000_i64, "zone": "UTC"});
    for project in ["film", "ads"] {
        assert_eq!(farm.operator.post("/v1/budgets", &budget(project)).await.status(), StatusCode::OK);
    }
    let lease = farm.next_task(&node).await;
    for path in ["/v1/dashboard", "/v1/timeline", "/v1/bookings", "/v1/jobs", "/v1/budgets", "/v1/projects"] {
        let text = anna.get(path).await.text().await.unwrap();
        let whole = farm.viewer.get(path).await.text().await.unwrap();
        for hidden in [ads.id.to_string(), "shot of ads".to_owned(), "\"ads\"".to_owned()] {
            assert!(!text.contains(&hidden), "{path} shows {hidden}: {text}");
        }
        assert!(whole.contains(&ads.id.to_string()) || whole.contains("\"ads\""), "{path}: {whole}");
    }
    let dashboard: Dashboard = anna.json("/v1/dashboard").await;
    assert_eq!(dashboard.jobs.iter().map(|job| job.id).collect::<Vec<_>>(), [film.id]);
    let bookings: BookingPage = anna.json("/v1/bookings?page_size=200").await;
    assert!(!bookings.items.is_empty() && bookings.items.iter().all(|it| it.job_id == film.id));
    // The time of a node that another project has is shown as taken.
    let own: TimelinePage = anna.json("/v1/timeline").await;
    let all: TimelinePage = farm.viewer.json("/v1/timeline").await;
    assert_eq!(own.items[0].spans.len(), all.items[0].spans.len());
    assert_eq!(anna.json::<BudgetList>("/v1/budgets").await.items.len(), 1);
    assert_eq!(anna.json::<ProjectList>("/v1/projects").await.items.len(), 1);
    assert_eq!(anna.json::<NodePage>("/v1/nodes").await.items.len(), 1);
    assert_eq!((dashboard.counts.jobs_active, dashboard.jobs_open_total), (1, 1));
    let whole: Dashboard = farm.viewer.json("/v1/dashboard").await;
    assert_eq!((whole.counts.jobs_active, whole.counts.nodes), (2, dashboard.counts.nodes));
    // What a change does to all others is asked by those who see them.
    let question = json!({"job_id": film.id, "change": {"more_nodes": {"node_id": node.id, "count": 1}}});
    anna.post("/v1/plans/what-if", &question).await.problem(ProblemKind::Forbidden).await;
    let log = format!("/v1/tasks/{}/log", lease.task_id);
    let is_own = lease.job_id == film.id;
    assert_eq!(anna.get(&log).await.status().is_success(), is_own);
    let whom = if is_own { &ads } else { &film };
    assert_ne!(whom.id, lease.job_id);
}

#[tokio::test(flavor = "multi_thread")]
async fn plans_records_nights_and_metrics_are_those_of_ones_own_projects() {
    let Two { farm, anna, film, ads, .. } = Two::new().await;
    let node = farm.node("a").await;
    for job in [&film, &ads] {
        let job = farm.until_booked(&node, job).await;
        farm.work_off(&node, &job).await;
    }
    // What is planned while nothing of `film` is open is about others alone.
    let other = submit(&farm, &farm.submitter, "ads").await;
    farm.until_booked(&node, &other).await;
    let own = submit(&farm, &anna, "film").await;
    farm.until_booked(&node, &own).await;
    let whole: PlanPage = farm.viewer.json("/v1/plans").await;
    let seen: PlanPage = anna.json("/v1/plans").await;
    assert!(!seen.items.is_empty() && seen.items.len() < whole.items.len());
    let mut hidden = 0;
    for plan in &whole.items {
        let is_own = seen.items.iter().any(|item| item.id == plan.id);
        for path in [format!("/v1/plans/{}", plan.id), format!("/v1/plans/{}/difference", plan.id)] {
            let answer = anna.get(&path).await;
            if !is_own {
                answer.problem(ProblemKind::NotFound).await;
                hidden += 1;
                continue;
            }
            let text = answer.text().await.unwrap();
            for hidden in [ads.id.to_string(), other.id.to_string(), "shot of ads".to_owned()] {
                assert!(!text.contains(&hidden), "{path} shows {hidden}: {text}");
            }
        }
    }
    assert!(hidden > 0);
    let record: TrackRecord = anna.json("/v1/forecasts/track-record").await;
    assert!(record.items.iter().all(|row| row.job_id == film.id));
    let both: TrackRecord = farm.viewer.json("/v1/forecasts/track-record").await;
    assert_eq!((record.frames, both.frames), (4, 8));
    assert_eq!(record.kinds.iter().map(|kind| kind.jobs.count).sum::<u64>(), 1);
    let [one, all] = [&anna, &farm.viewer].map(|http| http.get("/v1/forecasts/track-record.svg"));
    assert_ne!(one.await.text().await.unwrap(), all.await.text().await.unwrap());
    let nights = async |http: &Http| -> BudgetForecast {
        http.post("/v1/budget-forecasts", &json!({})).await.parsed(StatusCode::OK).await
    };
    let (own, all) = (nights(&anna).await, nights(&farm.viewer).await);
    let projects = |forecast: &BudgetForecast| -> BTreeSet<String> {
        forecast.nights.iter().flat_map(|night| &night.projects).map(|line| line.name.clone()).collect()
    };
    assert_eq!(projects(&own), BTreeSet::from(["film".to_owned()]));
    assert_eq!(projects(&all), BTreeSet::from(["ads".to_owned(), "film".to_owned()]));
    let [own, sum] = [&own, &all].map(|forecast| forecast.nights[0].cost.p50.0);
    assert!(0 < own && own < sum, "{own} of {sum}");
    let jobs = async |http: &Http| {
        let text = http.get("/metrics").await.text().await.unwrap();
        let line = text.lines().find(|line| line.starts_with("forelight_jobs{state=\"done\"}"));
        line.unwrap().rsplit_once(' ').unwrap().1.parse::<u64>().unwrap()
    };
    assert_eq!((jobs(&anna).await, jobs(&farm.viewer).await), (1, 2));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_of_the_farms_events_tells_of_ones_own_projects() {
    let Two { farm, anna, film, ads, .. } = Two::new().await;
    let mut own = Events::open(&anna, "/v1/events", Some(0)).await.unwrap();
    let mut all = Events::open(&farm.viewer, "/v1/events", Some(0)).await.unwrap();
    let node = farm.node("a").await;
    farm.work_off(&node, &ads).await;
    farm.work_off(&node, &film).await;
    let ends = |kind: EventKind, state: Option<JobState>| {
        kind == EventKind::JobState && state.is_some_and(JobState::is_final)
    };
    let mut seen = Vec::new();
    loop {
        let event = own.next(PATIENCE).await.expect("the stream goes on");
        let is_end = ends(event.kind, event.job_state);
        seen.push(event);
        if is_end {
            break;
        }
    }
    assert!(seen.iter().all(|event| event.job_id.is_none_or(|job| job == film.id)));
    assert!(seen.iter().any(|event| event.kind == EventKind::NodeRegistered && event.message.is_none()));
    assert!(seen.iter().any(|event| event.kind == EventKind::TaskDone));
    assert!(seen.iter().all(|event| event.job_id.is_none() || event.project.as_deref() == Some("film")));
    let first = all.next(PATIENCE).await.unwrap();
    assert!(first.job_id.is_some());
}

/// Reads a stream of events until it has this text, and returns what it had.
async fn told_until(stream: &mut reqwest::Response, text: &str) -> String {
    let mut told = String::new();
    loop {
        let part = tokio::time::timeout(PATIENCE, stream.chunk()).await.unwrap().unwrap();
        told += std::str::from_utf8(&part.expect("the stream goes on")).unwrap();
        if told.split_once(text).is_some_and(|(_, rest)| rest.contains("\n\n")) {
            return told;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_sums_the_farm_up_for_those_who_reach_all_projects() {
    let Two { farm, anna, .. } = Two::new().await;
    let path = "/v1/events?summaries=true";
    let (mut all, mut own) = (farm.viewer.get(path).await, anna.get(path).await);
    farm.node("a").await;
    let summary = loop {
        let told = told_until(&mut all, "event: farm\ndata: ").await;
        let (_, summary) = told.split_once("event: farm\ndata: ").unwrap();
        let summary: FarmSummary = serde_json::from_str(summary.lines().next().unwrap()).unwrap();
        if summary.counts.nodes == 1 {
            break summary;
        }
    };
    let dashboard: Dashboard = farm.viewer.json("/v1/dashboard").await;
    assert_eq!(summary.node_counts.idle, 1);
    let (at, last_event_id) = (summary.at, summary.last_event_id);
    assert_eq!(summary, FarmSummary { at, last_event_id, ..FarmSummary::from(&dashboard) });
    farm.node("b").await;
    let others = told_until(&mut own, "event: node_registered").await
        + &told_until(&mut own, "event: node_registered").await;
    assert!(!others.contains("event: farm"), "{others}");
}

#[tokio::test(flavor = "multi_thread")]
async fn artefacts_and_bundles_of_other_projects_do_not_exist() {
    let Two { farm, anna, guest, film, ads } = Two::new().await;
    // Made-up results of all jobs are the same, and so are their artefacts.
    let cancel = anna.post(&format!("/v1/jobs/{}/cancel", film.id), &json!({})).await;
    assert_eq!(cancel.status(), StatusCode::OK);
    let node = farm.node("a").await;
    let job = farm.until_booked(&node, &ads).await;
    let done = farm.work_off(&node, &job).await;
    assert_eq!(done.state, JobState::Done);
    let png = farm.viewer.get(&format!("/v1/jobs/{}/frames/0/image.png", ads.id)).await;
    let hash = png.headers()["etag"].to_str().unwrap().trim_matches('"').to_owned();
    let path = format!("/v1/artifacts/{hash}");
    assert_eq!(farm.submitter.get(&path).await.status(), StatusCode::OK);
    anna.get(&path).await.problem(ProblemKind::NotFound).await;
    assert_eq!(anna.request(Method::HEAD, &path).send().await.unwrap().status(), StatusCode::NOT_FOUND);
    // A bundle belongs to whoever uploaded it, and to those whose jobs use it.
    let bundle = anna.upload(crate::support::scene_zip(), None).await;
    let bundle: forelight_protocol::Bundle = bundle.parsed(StatusCode::CREATED).await;
    let path = format!("/v1/bundles/{}", bundle.id);
    assert_eq!(anna.get(&path).await.status(), StatusCode::OK);
    guest.get(&path).await.problem(ProblemKind::NotFound).await;
    let (bert, _) = farm.new_token(json!({"name": "bert", "projects": {"ads": "submitter"}})).await;
    let mut stolen = request(&farm, "ads");
    stolen["bundle"] = json!({"id": bundle.id});
    let refused = bert.post("/v1/jobs", &stolen).await.problem(ProblemKind::Invalid).await;
    assert_eq!(refused.pointer.as_deref(), Some("/bundle/id"));
    let mut own = request(&farm, "film");
    own["bundle"] = json!({"id": bundle.id});
    assert_eq!(anna.post("/v1/jobs", &own).await.status(), StatusCode::CREATED);
    assert_eq!(guest.get(&path).await.status(), StatusCode::OK);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_project_exists_before_jobs_are_booked_on_it_and_only_operators_make_one() {
    let Two { farm, anna, guest, .. } = Two::new().await;
    // A budget is not avoided by another name.
    for http in [&farm.submitter, &anna] {
        let answer = http.post("/v1/jobs", &request(&farm, "film 2")).await;
        assert!(matches!(answer.status(), StatusCode::UNPROCESSABLE_ENTITY | StatusCode::FORBIDDEN));
    }
    let refused = farm.submitter.post("/v1/jobs", &request(&farm, "film 2")).await;
    let refused = refused.problem(ProblemKind::Invalid).await;
    assert_eq!(refused.pointer.as_deref(), Some("/project"));
    anna.post("/v1/jobs", &request(&farm, "ads")).await.problem(ProblemKind::Forbidden).await;
    anna.post("/v1/jobs", &farm.job_request("0")).await.problem(ProblemKind::Forbidden).await;
    guest.post("/v1/jobs", &request(&farm, "film")).await.problem(ProblemKind::Forbidden).await;
    anna.post("/v1/projects", &json!({"project": "film 2", "share": 1}))
        .await
        .problem(ProblemKind::Forbidden)
        .await;
    // The default project needs no set-up, and an operator who submits makes a project.
    assert_eq!(farm.submitter.post("/v1/jobs", &farm.job_request("0")).await.status(), StatusCode::CREATED);
    submit(&farm, &farm.operator, "film 2").await;
    submit(&farm, &farm.submitter, "film 2").await;
    let projects: ProjectList = farm.operator.json("/v1/projects").await;
    let names: Vec<_> = projects.items.iter().map(|project| project.project.as_str()).collect();
    assert_eq!(names, ["ads", "default", "film", "film 2"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_is_given_other_projects_at_once_also_for_its_sessions_and_streams() {
    let Two { farm, film, ads, .. } = Two::new().await;
    let made = json!({"name": "guest 2", "projects": {"film": "viewer"}});
    let made: NewToken = farm.operator.post("/v1/tokens", &made).await.parsed(StatusCode::CREATED).await;
    let guest = farm.with_token(made.secret);
    let session: Session = guest.json("/v1/sessions/current").await;
    assert_eq!(
        session.projects.unwrap().into_iter().collect::<Vec<_>>(),
        [("film".to_owned(), Role::Viewer)]
    );
    let stream = Events::open(&guest, "/v1/events", None).await.unwrap();
    let path = format!("/v1/tokens/{}", made.token.id);
    let patch = farm.operator.request(Method::PATCH, &path).json(&json!({"projects": {"ads": "submitter"}}));
    let changed: Token = patch.send().await.unwrap().parsed(StatusCode::OK).await;
    assert_eq!(changed.role, Role::Submitter);
    stream.rest(PATIENCE).await;
    guest.get(&format!("/v1/jobs/{}", film.id)).await.problem(ProblemKind::NotFound).await;
    assert_eq!(guest.get(&format!("/v1/jobs/{}", ads.id)).await.status(), StatusCode::OK);
    for (wrong, pointer) in [
        (json!({"name": "a", "projects": {"no such": "viewer"}}), "/projects"),
        (json!({"name": "a", "projects": {"film": "operator"}}), "/projects/film"),
        (json!({"name": "a", "projects": {}}), "/projects"),
        (json!({"name": "a", "role": "viewer", "projects": {"film": "viewer"}}), ""),
        (json!({"name": "a"}), ""),
    ] {
        let refused = farm.operator.post("/v1/tokens", &wrong).await.problem(ProblemKind::Invalid).await;
        assert_eq!(refused.pointer.as_deref(), Some(pointer), "{wrong}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_says_what_its_node_costs_once() {
    let farm = Farm::new().await;
    let register = async |http: &Http, price: i64| {
        let node = json!({"name": "rack-7", "cores": 2, "price_per_hour": price});
        let node = http.post("/v1/nodes", &node).await;
        node.parsed::<forelight_protocol::Node>(StatusCode::CREATED).await.price_per_hour.0
    };
    assert_eq!(register(&farm.worker, 5).await, 5);
    assert_eq!(register(&farm.worker, 0).await, 5);
    assert_eq!(register(&farm.operator, 7).await, 7);
}
