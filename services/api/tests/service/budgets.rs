//! Budgets, the ledger behind them, and forecasts of nights.

use std::sync::Arc;
use std::time::Duration;

use crate::support::{Answer, Farm, eventually};
use forelight_api::{Clock as _, ManualClock};
use forelight_protocol::{
    AnswersDoc, Budget, BudgetAction, BudgetForecast, BudgetList, Job, JobState, Lease, LeaseOrder, Money,
    Node, ProblemKind, Renewal, Timestamp, Verdict, Waits,
};
use reqwest::StatusCode;
use serde_json::{Value, json};

/// A farm whose clock stands at 18:00.
async fn farm() -> (Farm, Arc<ManualClock>) {
    farm_with_leases_of(Duration::from_secs(120)).await
}

async fn farm_with_leases_of(lease_ttl: Duration) -> (Farm, Arc<ManualClock>) {
    let (farm, clock) =
        Farm::with_clock_at("2026-03-01T18:00:00Z".parse().unwrap(), |config| config.lease_ttl = lease_ttl)
            .await;
    for project in ["film", "advert"] {
        farm.project(project).await;
    }
    (farm, clock)
}

async fn job(farm: &Farm, node: &Node, project: &str, deadline: Option<&str>) -> Job {
    let mut request = farm.job_request("0-9");
    request["project"] = json!(project);
    request["name"] = json!(format!("shot of {project}"));
    if let Some(deadline) = deadline {
        request["deadline"] = json!(deadline);
    }
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    let booked = farm.until_booked(node, &job).await;
    assert!(matches!(booked.state, JobState::Booked | JobState::Rendering), "{booked:?}");
    booked
}

fn budget(project: &str, amount: i64, thresholds: Value) -> Value {
    json!({"project": project, "period": "night", "amount": amount, "thresholds": thresholds})
}

async fn set(farm: &Farm, budget: &Value) -> Budget {
    farm.operator.post("/v1/budgets", budget).await.parsed(StatusCode::OK).await
}

async fn forecast(farm: &Farm, request: &Value) -> BudgetForecast {
    farm.viewer.post("/v1/budget-forecasts", request).await.parsed(StatusCode::OK).await
}

async fn renew(farm: &Farm, lease: &Lease) -> Renewal {
    let path = format!("/v1/leases/{}", lease.lease_id);
    let request = farm.worker.request(reqwest::Method::PATCH, &path).json(&json!({"fence": lease.fence}));
    request.send().await.unwrap().parsed(StatusCode::OK).await
}

/// Runs a sweep; returns the farm's only budget, which must have this action in force.
async fn in_force(farm: &Farm, clock: &ManualClock, action: Option<BudgetAction>) -> Budget {
    farm.service.store().enforce_budgets(clock.now()).await.unwrap();
    let list: BudgetList = farm.viewer.get("/v1/budgets").await.parsed(StatusCode::OK).await;
    assert_eq!(list.items[0].action, action, "{list:?}");
    list.items[0].clone()
}

/// The same, waiting for the service's own sweep.
async fn soon_in_force(farm: &Farm, action: Option<BudgetAction>) -> Budget {
    eventually("the action comes into force", async || {
        let list: BudgetList = farm.viewer.get("/v1/budgets").await.parsed(StatusCode::OK).await;
        Some(list.items[0].clone()).filter(|budget| budget.action == action)
    })
    .await
}

/// The job, once it waits for money. Until the plan is made anew, it states the reason of the plan before.
async fn soon_waits_for_money(farm: &Farm, job: &Job) -> Job {
    let waits_for_money = |job: &Job| job.waits.as_ref().is_some_and(Waits::is_held);
    farm.until(job, "it waits for money", waits_for_money).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_night_is_forecast_by_project_job_and_class_and_asking_again_changes_nothing() {
    let (farm, _) = farm().await;
    let node = farm.node("a").await;
    let film = job(&farm, &node, "film", Some("2026-03-01T18:00:30Z")).await;
    job(&farm, &node, "advert", None).await;
    let first = forecast(&farm, &json!({"days": 2})).await;
    assert_eq!((first.date.to_string().as_str(), first.days, first.nights.len()), ("2026-03-01", 2, 2));
    let night = &first.nights[0];
    assert_eq!(night.projects.iter().map(|line| line.name.as_str()).collect::<Vec<_>>(), ["advert", "film"]);
    assert_eq!((night.jobs.len(), night.node_classes.len()), (2, 1));
    let cost = night.cost;
    assert!(cost.p50 < cost.p80 && cost.p80 < cost.p95, "{cost:?}");
    // Errors of different jobs are independent, so summed quantiles exceed the quantile of the sum.
    assert!(cost.p95.0 < night.projects.iter().map(|line| line.cost.p95.0).sum::<i64>());
    assert_eq!(night.node_classes[0].cost, cost);
    assert_eq!((first.nights[1].cost.p95, first.cost), (Money(0), cost));
    // Two jobs of ten frames: about 50 CPU seconds each on two cores, at a thousandth of a unit per second.
    assert!((480_000..530_000).contains(&cost.p50.0), "{cost:?}");
    let late = first.not_ready.iter().find(|late| late.job_id == film.id).expect("120 seconds of work in 30");
    assert!(late.probability == Some(1.0) && late.finish[0] <= late.finish[2], "{late:?}");
    assert!(!first.threatened && first.budgets.is_empty() && first.beforehand);
    assert_eq!(forecast(&farm, &json!({"days": 2})).await, first);
    // A screen of a large farm asks for less.
    let screen = json!({"days": 2, "by_job": false, "max_age": 60});
    let mut short = first.clone();
    short.nights.iter_mut().for_each(|night| night.jobs.clear());
    short.not_ready.clear();
    short.unknown.clear();
    assert_eq!(forecast(&farm, &screen).await, short);

    let tight = set(&farm, &budget("film", cost.p50.0 / 4, json!([]))).await;
    assert_eq!((tight.spent.0 > 0, tight.action), (false, None));
    let second = forecast(&farm, &json!({"date": "2026-03-01"})).await;
    assert!(second.threatened && second.budgets[0].probability_over > 0.9, "{:?}", second.budgets);
    assert_eq!(forecast(&farm, &screen).await, short, "the answer of this minute, without the budget");
    set(&farm, &budget("film", cost.p95.0, json!([]))).await;
    let third = forecast(&farm, &json!({})).await;
    assert!(!third.threatened && third.budgets[0].probability_over < 0.05, "{:?}", third.budgets);
    // Stored once per night, however often it is requested.
    let kept = farm.service.store().budget_forecasts_before("UTC", Timestamp::from_micros(i64::MAX), 10);
    let kept = kept.await.unwrap();
    assert_eq!(kept.len(), 1);
    assert_eq!(kept[0].forecast, third);
}

#[tokio::test(flavor = "multi_thread")]
async fn drain_finishes_what_runs_and_the_next_night_begins_anew() {
    let (farm, clock) = farm().await;
    let node = farm.node("a").await;
    job(&farm, &node, "film", None).await;
    set(
        &farm,
        &budget(
            "film",
            1_000,
            json!([{"percent": 50, "action": "warn"}, {"percent": 100, "action": "drain"}]),
        ),
    )
    .await;
    let running = farm.next_task(&node).await;
    // The expected cost of the running frame counts too.
    let drained = in_force(&farm, &clock, Some(BudgetAction::Drain)).await;
    assert!(drained.spent.0 + drained.committed.0 >= 1_000, "{drained:?}");
    assert_eq!(farm.claim(&node).await, None);
    assert_eq!(renew(&farm, &running).await.order, LeaseOrder::Continue);
    clock.advance_micros(10_000_000);
    renew(&farm, &running).await;
    farm.finish(&running).await;
    assert_eq!(farm.claim(&node).await, None);
    // Quotes of the project are held back too.
    let held: Job = {
        let mut request = farm.job_request("0-1");
        request["project"] = json!("film");
        farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await
    };
    assert_eq!(farm.claim(&node).await, None);
    // Other projects are not affected.
    let other = farm.submit("0-1").await;
    assert_eq!(farm.claim(&node).await.map(|lease| lease.job_id), Some(other.id));

    let spent = in_force(&farm, &clock, Some(BudgetAction::Drain)).await.spent;
    assert!((9_000..12_000).contains(&spent.0), "ten seconds at a thousandth of a unit: {spent:?}");
    clock.advance_micros(18 * 3_600_000_000);
    let anew = in_force(&farm, &clock, None).await;
    assert_eq!((anew.spent, anew.from.to_string().as_str()), (Money(0), "2026-03-02T12:00:00.000000Z"));
    let again = farm.next_task(&node).await;
    assert!([held.id, running.job_id].contains(&again.job_id));
}

#[tokio::test(flavor = "multi_thread")]
async fn stop_takes_back_what_runs_until_the_budget_is_set_again() {
    let (farm, clock) = farm().await;
    let node = farm.node("a").await;
    let film = job(&farm, &node, "film", None).await;
    let running = farm.next_task(&node).await;
    clock.advance_micros(500_000);
    set(&farm, &budget("film", 100, json!([{"percent": 100, "action": "stop"}]))).await;
    assert_eq!(in_force(&farm, &clock, Some(BudgetAction::Stop)).await.committed, Money(0));
    assert_eq!(renew(&farm, &running).await.order, LeaseOrder::Stop);
    assert_eq!(farm.claim(&node).await, None);
    // It stays in force although nothing more is committed.
    clock.advance_micros(5_000_000);
    in_force(&farm, &clock, Some(BudgetAction::Stop)).await;
    assert_eq!(farm.claim(&node).await, None);
    let refused = farm.report(&running, farm.made_up_result(&running).await).await;
    assert_eq!(refused.status(), StatusCode::CONFLICT);

    set(&farm, &budget("film", 10_000_000, json!([{"percent": 100, "action": "stop"}]))).await;
    let again = farm.next_task(&node).await;
    assert_eq!((again.task_id, again.fence), (running.task_id, running.fence + 1));
    farm.finish(&again).await;
    assert_eq!(farm.job(&film).await.frames_done, 1);
    let events = farm.service.store().events_after(None, 0, 10_000).await.unwrap();
    let said: Vec<&str> = events
        .iter()
        .filter(|event| event.kind == forelight_protocol::EventKind::Budget)
        .filter_map(|event| event.message.as_deref())
        .collect();
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains("film") && said[0].contains("stopped"), "{said:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_has_begun_says_that_a_budget_holds_it_and_not_when_it_is_ready() {
    let (farm, clock) = farm().await;
    let node = farm.node("a").await;
    let film = job(&farm, &node, "film", None).await;
    let done = farm.next_task(&node).await;
    farm.finish(&done).await;
    assert!(farm.job(&film).await.eta.is_some());
    let running = farm.next_task(&node).await;
    clock.advance_micros(500_000);
    set(&farm, &budget("film", 100, json!([{"percent": 100, "action": "stop"}]))).await;
    in_force(&farm, &clock, Some(BudgetAction::Stop)).await;
    renew(&farm, &running).await;
    let held = soon_waits_for_money(&farm, &film).await;
    let waits = held.waits.unwrap();
    assert!(waits.because.contains("budget of project film"), "{waits:?}");
    assert_eq!((held.eta, waits.until), (None, None));
    let path = format!("/v1/jobs/{}/answers", held.id);
    let answers: AnswersDoc = farm.viewer.get(&path).await.parsed(StatusCode::OK).await;
    assert!(answers.why_not[0].contains("budget of project film is used up"), "{:?}", answers.why_not);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_says_beforehand_what_a_budget_will_hold_back_of_it() {
    let (farm, _) = farm().await;
    let node = farm.node("a").await;
    let film = job(&farm, &node, "film", None).await;
    assert_eq!(film.budget_hold, None);
    let booked = film.verdict.as_ref().and_then(|said| said.cost).unwrap();
    let in_all = |amount| json!({"project": "film", "period": "total", "amount": amount, "zone": "UTC", "thresholds": [{"percent": 100, "action": "drain"}]});
    set(&farm, &in_all(booked.0 / 2)).await;
    let short = farm.until(&film, "it lacks money", |job| job.budget_hold.is_some()).await;
    let hold = short.budget_hold.unwrap();
    assert!((1..10).contains(&hold.frames) && hold.until.is_none(), "{hold:?}");
    assert!(hold.missing > Money(0) && hold.missing <= Money(booked.0), "{hold:?}");
    assert!(hold.because.contains("budget of project film lasts until"), "{hold:?}");
    assert_eq!((short.verdict.unwrap().verdict, short.eta, short.finish), (Verdict::OverBudget, None, None));
    // With what is missing, it has enough.
    set(&farm, &in_all(booked.0 / 2 + hold.missing.0 + booked.0 / 100)).await;
    let enough = farm.until(&film, "it has money", |job| job.budget_hold.is_none()).await;
    assert_eq!(enough.verdict.unwrap().verdict, Verdict::OnTime);
    assert!(enough.eta.is_some());
}

#[tokio::test(flavor = "multi_thread")]
async fn the_service_looks_after_budgets_by_itself() {
    let (farm, _) = farm_with_leases_of(Duration::from_millis(800)).await;
    let node = farm.node("a").await;
    job(&farm, &node, "film", None).await;
    set(&farm, &budget("film", 1_000, json!([{"percent": 100, "action": "stop"}]))).await;
    let running = farm.next_task(&node).await;
    soon_in_force(&farm, Some(BudgetAction::Stop)).await;
    assert_eq!(renew(&farm, &running).await.order, LeaseOrder::Stop);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_removed_budget_held_goes_on() {
    let (farm, _) = farm_with_leases_of(Duration::from_millis(800)).await;
    let node = farm.node("a").await;
    let film = job(&farm, &node, "film", None).await;
    let stop = json!([{"percent": 100, "action": "stop"}]);
    set(&farm, &budget("film", 1_000, stop)).await;
    farm.next_task(&node).await;
    soon_in_force(&farm, Some(BudgetAction::Stop)).await;
    soon_waits_for_money(&farm, &film).await;
    let path = "/v1/budgets?project=film&period=night";
    let by_viewer = farm.viewer.request(reqwest::Method::DELETE, path).send().await.unwrap();
    assert_eq!(by_viewer.status(), StatusCode::FORBIDDEN);
    let other = farm.delete("/v1/budgets?project=film&period=month").await;
    assert_eq!(other.status(), StatusCode::NOT_FOUND);
    assert_eq!(farm.delete(path).await.status(), StatusCode::NO_CONTENT);
    assert_eq!(farm.delete(path).await.status(), StatusCode::NOT_FOUND);
    let left: BudgetList = farm.viewer.get("/v1/budgets").await.parsed(StatusCode::OK).await;
    assert!(left.items.is_empty());
    farm.next_task(&node).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_has_ended_tonight_has_its_name_beside_its_cost() {
    let (farm, clock) = farm().await;
    let node = farm.node("a").await;
    let film = job(&farm, &node, "film", None).await;
    for _ in 0..10 {
        let lease = farm.next_task(&node).await;
        clock.advance_micros(900_000);
        farm.finish(&lease).await;
    }
    let lines = &forecast(&farm, &json!({})).await.nights[0].jobs;
    assert_eq!(
        (lines.len(), lines[0].name.as_str(), lines[0].job_id),
        (1, film.name.as_str(), Some(film.id))
    );
    assert!(lines[0].spent > Money(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn the_track_record_counts_nights_that_were_forecast_before_and_changes_are_told() {
    let (farm, clock) = farm().await;
    let node = farm.node("a").await;
    let film = job(&farm, &node, "film", None).await;
    let said = forecast(&farm, &json!({})).await;
    assert_eq!(said.track_record.nights, 0);
    for _ in 0..10 {
        let lease = farm.next_task(&node).await;
        clock.advance_micros(900_000);
        farm.finish(&lease).await;
    }
    clock.advance_micros(20 * 3_600_000_000);
    let next = forecast(&farm, &json!({})).await;
    let record = next.track_record;
    assert_eq!((record.nights, record.within_p50, record.within_p95), (1, 1, 1));
    assert_eq!(next.compared_with, Some(said.made_at));
    let gone = &next.changes[0];
    assert_eq!((gone.job_id, gone.after), (film.id, None));
    assert_eq!(gone.before, Some(said.nights[0].jobs[0].cost.p80));
    assert!(next.cost.p95 == Money(0) && next.budgets.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn only_operators_set_budgets_and_every_wrong_field_is_named() {
    let (farm, _) = farm().await;
    let good = budget("film", 1_000, json!([]));
    for client in [&farm.viewer, &farm.submitter, &farm.worker] {
        client.post("/v1/budgets", &good).await.problem(ProblemKind::Forbidden).await;
    }
    farm.worker.get("/v1/budgets").await.problem(ProblemKind::Forbidden).await;
    farm.worker.post("/v1/budget-forecasts", &json!({})).await.problem(ProblemKind::Forbidden).await;
    let with = |key: &str, value: Value| {
        let mut request = good.clone();
        request[key] = value;
        request
    };
    for (request, pointer) in [
        (with("project", json!("")), "/project"),
        (with("amount", json!(-1)), "/amount"),
        (with("amount", json!(i64::MAX)), "/amount"),
        (with("period", json!("year")), "/period"),
        (with("zone", json!("Mars/Olympus")), "/zone"),
        (with("thresholds", json!([{"percent": 0, "action": "warn"}])), "/thresholds/0/percent"),
        (with("thresholds", json!([{"percent": 5, "action": "shout"}])), "/thresholds/0/action"),
        (with("thresholds", json!(vec![json!({"percent": 5, "action": "warn"}); 11])), "/thresholds"),
        (with("colour", json!("blue")), "/colour"),
    ] {
        let problem = farm.operator.post("/v1/budgets", &request).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer), "{request}");
    }
    for (request, pointer) in [
        (json!({"days": 0}), "/days"),
        (json!({"days": 61}), "/days"),
        (json!({"date": "2026-02-30"}), "/date"),
        (json!({"date": "2020-01-01"}), "/date"),
        (json!({"zone": "Nowhere"}), "/zone"),
        (json!({"max_age": 3601}), "/max_age"),
    ] {
        let answer = farm.viewer.post("/v1/budget-forecasts", &request).await;
        assert_eq!(answer.problem(ProblemKind::Invalid).await.pointer.as_deref(), Some(pointer), "{request}");
    }
    let list: BudgetList = farm.viewer.get("/v1/budgets").await.parsed(StatusCode::OK).await;
    assert_eq!(list.items, []);
}
