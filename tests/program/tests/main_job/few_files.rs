//! A service that may open few files.

use forelight_protocol::Role;
use forelight_tests::processes::Service;
use reqwest::StatusCode;
use serde_json::{Value, json};
use tokio::net::TcpStream;

/// With 400 open files allowed, three times as many sockets keep nobody out: neither a health check, nor a worker
/// with a task, nor a person.
#[tokio::test(flavor = "multi_thread")]
async fn with_four_hundred_open_files_a_thousand_idle_sockets_keep_nobody_out() {
    let mut service = Service::limited("serve", &[], "ulimit -n 400").await;
    let worker = service.http(Role::Worker);
    let register = async |name: &str| -> Value {
        let answer = worker.post("/v1/nodes", &json!({"name": name})).await;
        assert_eq!(answer.status(), StatusCode::CREATED);
        answer.json().await.expect("a node")
    };
    let node = register("rack-1").await;
    let address = service.address().strip_prefix("http://").expect("an address of HTTP").to_owned();
    // This process may open enough of them: the limit is the service's own.
    let mut held = Vec::new();
    for _ in 0..1200 {
        // One that is not let in any more is refused or closed. Those that are count.
        if let Ok(socket) = TcpStream::connect(&address).await {
            held.push(socket);
        }
    }
    assert!(held.len() > 400, "{} sockets were opened", held.len());
    for round in 0..20 {
        let health = service.anonymous().get("/healthz").await;
        assert_eq!(health.status(), StatusCode::OK, "round {round}");
        let claim = json!({"node_id": node["id"], "wait_ms": 0});
        let claim = service.http(Role::Worker).post("/v1/leases", &claim).await;
        assert_eq!(claim.status(), StatusCode::NO_CONTENT, "round {round}");
        let jobs = service.http(Role::Viewer).get("/v1/jobs").await;
        assert_eq!(jobs.status(), StatusCode::OK, "round {round}");
    }
    // Files are opened, too: a scene is written and read.
    let zip = forelight_tests::bundles::zipped(&forelight_tests::bundles::shipped("corridor"));
    let uploaded = service.http(Role::Submitter).upload(zip, None).await;
    assert_eq!(uploaded.status(), StatusCode::CREATED, "{:?}", uploaded.text().await);
    drop(held);
    service.end().await;
}
