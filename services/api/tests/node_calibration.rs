//! Nodes that are calibrated by class of work.

mod support;

use forelight_protocol::{ForecastDoc, Node, NodeSeconds};
use reqwest::StatusCode;
use serde_json::{Value, json};
use support::{Answer, Farm};

/// A node that takes a nanosecond for an operation, and so many for one that waits for memory.
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
    let quote: ForecastDoc =
        farm.viewer.get(&format!("/v1/jobs/{}/forecast", job.id)).await.parsed(StatusCode::OK).await;
    // A fifth of the work waits for memory (see the results that are made up).
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
