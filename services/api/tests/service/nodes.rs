//! Nodes: names, registered numbers, numbers set by operators, and calibration by class of work.

use crate::support::{Answer, Farm};
use forelight_protocol::{Node, NodeSeconds, ProblemKind};
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

/// A node that takes a nanosecond per operation, and this many per memory operation.
fn registration(name: &str, memory: u64) -> Value {
    let picos = json!({"rays": 1000, "traversal": 1000, "memory": 1000 * memory, "shading": 1000, "texture": 1000, "records": 1000});
    let capabilities = json!({"calibration": {"picos_per_work": picos}});
    json!({"name": name, "speed": 0.7, "price_per_hour": 3_600_000, "capabilities": capabilities})
}

async fn register(farm: &Farm, registration: &Value) -> Node {
    farm.worker.post("/v1/nodes", registration).await.parsed(StatusCode::CREATED).await
}

#[tokio::test]
async fn a_quote_says_what_it_takes_on_each_calibrated_node() {
    let farm = Farm::new().await;
    let quick = register(&farm, &registration("quick", 1)).await;
    register(&farm, &registration("starved", 4)).await;
    farm.node("of unknown classes").await;
    let job = farm.submit("0-3").await;
    let job = farm.until_booked(&quick, &job).await;
    let quote = farm.quote(&job).await;
    // A fifth of the made-up work waits for memory.
    let [NodeSeconds { node: first, speed: 1.0, cpu_seconds }, starved] = &quote.cpu_seconds_on[..] else {
        panic!("{:?}", quote.cpu_seconds_on)
    };
    assert_eq!((&first[..], &starved.node[..]), ("quick", "starved"));
    assert_eq!(*cpu_seconds, quote.total.cpu_seconds, "it was profiled at speed 1");
    assert!((starved.cpu_seconds.p80 / cpu_seconds.p80 - 1.6).abs() < 1e-9, "{starved:?}");
}

#[tokio::test]
async fn a_calibration_that_is_out_of_range_is_refused_with_its_place() {
    let farm = Farm::new().await;
    let mut wrong = registration("a", 1);
    wrong["capabilities"]["calibration"]["picos_per_work"]["shading"] = json!(0);
    let refused = farm.worker.post("/v1/nodes", &wrong).await;
    assert_eq!(refused.status(), StatusCode::UNPROCESSABLE_ENTITY);
    let text = refused.text().await.unwrap();
    assert!(text.contains("/capabilities/calibration/picos_per_work"), "{text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn nodes_are_the_same_by_name_and_their_numbers_have_bounds() {
    let farm = Farm::new().await;
    let first = farm.node("rack 3").await;
    let again = farm.node("rack 3").await;
    assert_eq!(again.id, first.id);
    for (body, pointer) in [
        (json!({"name": ""}), "/name"),
        (json!({"name": "a", "speed": 0.0}), "/speed"),
        (json!({"name": "a", "speed": -1.0}), "/speed"),
        (json!({"name": "a", "price_per_hour": -1}), "/price_per_hour"),
        (json!({"name": "a", "cores": 0}), "/cores"),
        (json!({"name": "a", "gpu": true}), "/gpu"),
    ] {
        let problem = farm.worker.post("/v1/nodes", &body).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer), "{body}");
    }
    let patch = farm
        .operator
        .request(Method::PATCH, &format!("/v1/nodes/{}", first.id))
        .json(&json!({"drain": true}));
    let drained: Value = patch.send().await.unwrap().parsed(StatusCode::OK).await;
    assert_eq!((&drained["drain"], &drained["price_per_hour"]), (&json!(true), &json!(3_600_000)));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_operator_sets_on_a_node_holds_when_it_registers_again_until_null_gives_it_up() {
    let farm = Farm::new().await;
    let node = farm.node("rack 3").await;
    let patch = |change: Value| {
        farm.operator.request(Method::PATCH, &format!("/v1/nodes/{}", node.id)).json(&change).send()
    };
    let set: Node =
        patch(json!({"speed": 4.0, "price_per_hour": 5})).await.unwrap().parsed(StatusCode::OK).await;
    assert_eq!((set.speed, set.speed_set, set.price_per_hour.0, set.price_set), (4.0, true, 5, true));
    assert_eq!(Node { last_seen_at: set.last_seen_at, ..farm.node("rack 3").await }, set);
    let reset: Node = patch(json!({"speed": null})).await.unwrap().parsed(StatusCode::OK).await;
    assert_eq!((reset.speed, reset.speed_set, reset.price_per_hour.0), (2.0, false, 5));
    for (change, pointer) in [
        (json!({"speed": 1e-300}), "/speed"),
        (json!({"speed": "fast"}), "/speed"),
        (json!({"price_per_hour": -1}), "/price_per_hour"),
        (json!({"cores": 3}), "/cores"),
    ] {
        let problem = patch(change.clone()).await.unwrap().problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer), "{change}");
    }
}
