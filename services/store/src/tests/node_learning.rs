//! What finished frames teach about nodes.

use super::*;
use forelight_protocol::{ByClass, NodeCalibration};

/// A node that takes a nanosecond for every operation: speed 1 for any work.
fn calibrated(name: &str) -> NodeRegistration {
    let calibration = NodeCalibration {
        picos_per_work: ByClass::from_array([1000; ByClass::CLASSES]),
        kernels: Vec::new(),
    };
    let capabilities = Capabilities { calibration: Some(calibration), ..Capabilities::default() };
    NodeRegistration { capabilities, ..registration(name) }
}

/// Work of 1000 operations that is forecast to take a second at speed 1.
fn forecast() -> JobForecast {
    let of = |mean: f64| Quantiles { mean, p50: mean, p80: mean, p95: mean };
    let total = ForecastTotals { work: of(1000.0), cpu_seconds: of(1.0), ..ForecastTotals::default() };
    JobForecast { total, ..job_forecast() }
}

/// Two nodes, and a job of three frames that was profiled on the first.
async fn farm() -> (Farm, Node, Node) {
    let farm = Farm::new().await;
    let [first, second] = [calibrated("a"), calibrated("b")];
    let first = fresh(farm.store.register_node(&first, None, at(0)).await.unwrap());
    let second = fresh(farm.store.register_node(&second, None, at(0)).await.unwrap());
    (farm, first, second)
}

/// Renders the job's frames on a node, where they take so many seconds each.
async fn render(farm: &Farm, node: &Node, seconds: &[f64]) {
    for &cpu_seconds in seconds {
        let lease = farm.claim(node.id, at(50)).await.expect("a frame");
        let TaskResult::Render(mut result) = farm.result_for(&lease).await else { panic!("no frame") };
        result.stats.cpu_seconds = cpu_seconds;
        result.stats.work_by_class = Some(ByClass { rays: 400, memory: 600, ..ByClass::default() });
        let result = TaskResult::Render(result);
        farm.store.commit_result(lease.lease_id, lease.fence, &result, at(60)).await.unwrap();
    }
}

#[tokio::test]
async fn frames_teach_about_nodes_that_did_not_profile_them_in_whatever_order_they_come() {
    let mut factors = Vec::new();
    for order in [[1.2, 1.4, 1.3], [1.3, 1.2, 1.4]] {
        let (farm, first, second) = farm().await;
        farm.quoted_job(request("0-2"), first.id, at(0), &forecast(), None).await;
        assert_eq!(farm.store.node(second.id).await.unwrap().time_factor, 1.0);
        render(&farm, &second, &order).await;
        let learned = farm.store.node(second.id).await.unwrap();
        // One job is believed half.
        let mean = (1.2f64 * 1.3 * 1.4).cbrt();
        assert!((learned.time_factor - mean.sqrt()).abs() < 1e-5, "{}", learned.time_factor);
        let speed = learned.corrected_speed(Some(&ByClass::from_array([1; ByClass::CLASSES]))).unwrap();
        assert!((speed * learned.time_factor - 1.0).abs() < 1e-12);
        assert_eq!(farm.store.node(first.id).await.unwrap().time_factor, 1.0);
        factors.push(learned.time_factor);
    }
    assert_eq!(factors[0], factors[1]);
}

#[tokio::test]
async fn the_speed_of_a_lease_is_that_of_the_node_for_the_work_of_the_job() {
    let (farm, first, second) = farm().await;
    assert_eq!(first.speed, 2.0, "what it says of itself, for any work");
    let classes = ByClass { rays: 400, memory: 600, ..ByClass::default() };
    let forecast = JobForecast { work_by_class: Some(classes), ..forecast() };
    farm.quoted_job(request("0"), first.id, at(0), &forecast, None).await;
    let lease = farm.claim(second.id, at(50)).await.unwrap();
    let mut read = farm.store.read().await.unwrap();
    assert_eq!(crate::leases::read(&mut read, lease.lease_id).await.unwrap().node_speed, 1.0);
}

#[tokio::test]
async fn what_a_node_does_before_its_window_ends_goes_by_its_speed_for_the_work_of_the_job() {
    let (farm, first, _) = farm().await;
    let classes = ByClass { rays: 400, memory: 600, ..ByClass::default() };
    let forecast = JobForecast { work_by_class: Some(classes), ..forecast() };
    farm.quoted_job(request("0-2"), first.id, at(0), &forecast, None).await;
    let closed = forelight_protocol::TimeSpan { start: at(56), end: None };
    let terms = forelight_protocol::NodeTerms { maintenance: vec![closed], ..Default::default() };
    let change = forelight_protocol::NodeChange { terms: Some(terms), ..Default::default() };
    farm.store.change_node(first.id, &change, at(0)).await.unwrap();
    // One frame in twenty takes five seconds or more at speed 1, the node's for this work. Otherwise it is 2.
    assert!(farm.claim(first.id, at(51)).await.is_some());
    assert_eq!(farm.claim(first.id, at(52)).await, None);
}

#[tokio::test]
async fn a_node_is_not_judged_by_its_own_profiles_nor_by_frames_far_off() {
    let (farm, first, second) = farm().await;
    farm.quoted_job(request("0-2"), first.id, at(0), &forecast(), None).await;
    render(&farm, &first, &[1.5, 1.5]).await;
    assert_eq!(farm.store.node(first.id).await.unwrap().time_factor, 1.0);
    render(&farm, &second, &[1000.0]).await;
    let learned = farm.store.node(second.id).await.unwrap().time_factor;
    assert!((learned - 2f64.sqrt()).abs() < 1e-5, "bounded by a factor of two, believed half: {learned}");
}

#[tokio::test]
async fn a_speed_that_was_set_by_hand_holds_and_nothing_is_learnt() {
    let (farm, first, second) = farm().await;
    let change = forelight_protocol::NodeChange { speed: Some(Some(3.0)), ..Default::default() };
    let set = farm.store.change_node(second.id, &change, at(0)).await.unwrap();
    assert_eq!(set.corrected_speed(Some(&ByClass::from_array([1; ByClass::CLASSES]))), None);
    farm.quoted_job(request("0"), first.id, at(0), &forecast(), None).await;
    render(&farm, &second, &[1.5]).await;
    assert_eq!(farm.store.node(second.id).await.unwrap().time_factor, 1.0);
}
