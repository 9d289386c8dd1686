//! How long frames keep a node beyond their CPU time.

use super::*;
use forelight_protocol::NodeChange;
use forelight_quote::serial_time::SerialTime;

/// A node of speed 2 with four cores.
async fn farm() -> (Farm, Node) {
    let farm = Farm::new().await;
    let node = NodeRegistration { cores: 4, ..registration("a") };
    let node = fresh(farm.store.register_node(&node, None, at(0)).await.unwrap());
    (farm, node)
}

/// Renders a frame that takes eight CPU seconds and keeps its node for this many seconds.
async fn render(farm: &Farm, node: &Node, (from, kept): (i64, i64)) {
    let lease = farm.claim(node.id, at(from)).await.expect("a frame");
    let TaskResult::Render(mut result) = farm.result_for(&lease).await else { panic!("no frame") };
    result.stats.cpu_seconds = 8.0;
    let result = TaskResult::Render(result);
    farm.store.commit_result(lease.lease_id, lease.fence, &result, at(from + kept)).await.unwrap();
}

async fn of_job(farm: &Farm, job: JobId) -> SerialTime {
    let jobs = farm.store.farm_jobs(at(0)).await.unwrap();
    jobs.into_iter().find(|found| found.job.id == job).expect("the job").serial_time
}

/// The P95 of the newest lease, in seconds.
async fn p95(farm: &Farm) -> f64 {
    let micros: i64 = sqlx::query_scalar("SELECT p95 FROM leases WHERE state = 'active'")
        .fetch_one(farm.store.readers())
        .await
        .unwrap();
    micros as f64 * 1e-6
}

fn many_cores(seconds: i64) -> SerialTime {
    SerialTime { one_core: 0, many_cores: seconds * SECOND }
}

#[tokio::test]
async fn frames_teach_plans_and_later_jobs_how_long_they_keep_their_nodes() {
    let (farm, node) = farm().await;
    let first = farm.booked_job(request("0-3"), node.id, at(10)).await;
    assert_eq!(of_job(&farm, first).await, SerialTime::default());
    farm.store.plan_still_good(&farm.store.wanted_plan().await.unwrap()).await.unwrap();
    assert!(!farm.store.wanted_plan().await.unwrap().due);
    // Two seconds of CPU time on each core, and three besides.
    render(&farm, &node, (10, 5)).await;
    assert_eq!(of_job(&farm, first).await, many_cores(3));
    let wanted = farm.store.wanted_plan().await.unwrap();
    assert!(
        wanted.due && wanted.causes.iter().any(|cause| cause.contains("keep their nodes longer")),
        "{wanted:?}"
    );
    farm.store.plan_still_good(&wanted).await.unwrap();
    // A little more is no news: no plan is made for it.
    render(&farm, &node, (20, 5)).await;
    let causes = farm.store.wanted_plan().await.unwrap().causes;
    assert!(!causes.iter().any(|cause| cause.contains("keep their nodes")), "{causes:?}");
    let lease = farm.claim(node.id, at(30)).await.expect("a frame");
    // Five CPU seconds at speed 1 are the P95 of its forecast.
    assert_eq!(p95(&farm).await, 5.0 / 8.0 + 3.0);
    farm.commit(&lease, at(31)).await;

    let expected = |cpu: f64| farm.store.expected_serial_time(None, cpu);
    let learnt = expected(1e6).await.unwrap();
    assert!(learnt.many_cores > 0 && learnt.many_cores <= 3 * SECOND, "{learnt:?}");
    assert!(expected(0.1).await.unwrap().many_cores < learnt.many_cores, "short frames take over a part");
    assert_eq!(farm.store.expected_serial_time(Some("cycles"), 1e6).await.unwrap(), SerialTime::default());
    let mean = Quantiles { mean: 40.0, ..Quantiles::default() };
    let total = ForecastTotals { cpu_seconds: mean, ..ForecastTotals::default() };
    let quote = JobForecast { total, ..job_forecast() };
    let second = farm.quoted_job(request("0-3"), node.id, at(100), &quote, None).await;
    assert!(of_job(&farm, second).await.many_cores > 0);
    // What is left out of the record teaches nothing.
    farm.store.leave_out(first, "it was a test", at(101)).await.unwrap();
    assert_eq!(expected(1e6).await.unwrap(), SerialTime::default());
}

#[tokio::test]
async fn a_lease_that_was_interrupted_teaches_nothing() {
    let (farm, node) = farm().await;
    let job = farm.booked_job(request("0-1"), node.id, at(10)).await;
    let lease = farm.claim(node.id, at(10)).await.expect("a frame");
    let pause = NodeChange { pause: Some(true), ..NodeChange::default() };
    farm.store.change_node(node.id, &pause, at(11)).await.unwrap();
    farm.commit(&lease, at(500)).await;
    assert_eq!(of_job(&farm, job).await, SerialTime::default());
}
