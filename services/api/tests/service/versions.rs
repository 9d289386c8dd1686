//! Workers of other versions than the service's, and nodes that say which they have.

use crate::support::{Answer, Farm};
use forelight_protocol::{
    Node, OLDEST_WORKER_PROTOCOL, Problem, ProblemKind, WORKER_PROTOCOL, WORKER_PROTOCOL_HEADER,
};
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

async fn ask(farm: &Farm, path: &str, version: &str, body: &Value) -> reqwest::Response {
    let request = farm.worker.request(Method::POST, path).header(WORKER_PROTOCOL_HEADER, version);
    request.json(body).send().await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_is_too_old_or_too_new_is_told_so_and_what_to_do() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    // A newer worker has fields that this service does not know. The version is the better answer.
    let registration = json!({"name": "b", "of a later version": 1});
    let claim = json!({"node_id": node.id, "of a later version": 1});
    for (path, body) in [("/v1/nodes", &registration), ("/v1/leases", &claim)] {
        let newer = (WORKER_PROTOCOL + 1).to_string();
        let refused: Problem = ask(&farm, path, &newer, body).await.problem(ProblemKind::WorkerTooNew).await;
        for part in [&*format!("version {newer}"), env!("CARGO_PKG_VERSION"), "upgrade the service"] {
            assert!(refused.detail.contains(part), "{part}: {}", refused.detail);
        }
        let older = (OLDEST_WORKER_PROTOCOL - 1).to_string();
        let refused = ask(&farm, path, &older, body).await.problem(ProblemKind::WorkerTooOld).await;
        assert!(refused.detail.contains("install forelight"), "{}", refused.detail);
        for wrong in ["new", "-1"] {
            ask(&farm, path, wrong, body).await.problem(ProblemKind::Malformed).await;
        }
    }
    for version in OLDEST_WORKER_PROTOCOL..=WORKER_PROTOCOL {
        let body = json!({"name": format!("c{version}")});
        assert_eq!(ask(&farm, "/v1/nodes", &version.to_string(), &body).await.status(), StatusCode::CREATED);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_says_which_version_it_has_and_no_job_names_our_own_renderer() {
    let farm = Farm::new().await;
    let capabilities =
        json!({"version": "1.2.3", "renderers": [{"name": "forelight", "version": "tracer-7"}]});
    let body = json!({"name": "a", "capabilities": capabilities});
    let node: Node = farm.worker.post("/v1/nodes", &body).await.parsed(StatusCode::CREATED).await;
    assert_eq!((node.capabilities.version.as_deref(), node.own_version()), (Some("1.2.3"), Some("tracer-7")));
    let job = farm.submit("0-1").await;
    let job = farm.until_booked(&node, &job).await;
    assert_eq!(job.rendered_by.unwrap().version, "tracer-7");
    let mut named = farm.job_request("0");
    named["renderer"] = json!({"name": "forelight"});
    let problem = farm.submitter.post("/v1/jobs", &named).await.problem(ProblemKind::Invalid).await;
    assert_eq!(problem.pointer.as_deref(), Some("/renderer/name"));
}
