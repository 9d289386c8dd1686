//! Tests the client against a small server with errors.

use axum::Router;
use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post, put};
use forelight_client::{Backoff, Client, ClientError, Token};
use forelight_protocol::{ArtifactHash, NodeRegistration, Problem, ProblemKind};
use parking_lot::Mutex;
use std::sync::Arc;
use std::time::{Duration, Instant};
use uuid::Uuid;

/// Received requests, and the answers to give, first to last.
#[derive(Default)]
struct Script {
    answers: Vec<(StatusCode, HeaderMap, String)>,
    seen: Vec<(HeaderMap, Bytes)>,
}

type Shared = Arc<Mutex<Script>>;

async fn scripted(State(script): State<Shared>, headers: HeaderMap, body: Bytes) -> Response {
    let mut script = script.lock();
    script.seen.push((headers, body));
    if script.answers.is_empty() {
        return StatusCode::NOT_FOUND.into_response();
    }
    script.answers.remove(0).into_response()
}

async fn server(answers: Vec<(StatusCode, HeaderMap, String)>) -> (String, Shared) {
    let script: Shared = Arc::new(Mutex::new(Script { answers, ..Script::default() }));
    let echo = get(|Path(_): Path<String>| async { "not the artefact" });
    let app = Router::new()
        .route("/v1/nodes", post(scripted))
        .route("/v1/artifacts/{hash}", echo.merge(put(scripted)))
        .with_state(script.clone());
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    tokio::spawn(async move { axum::serve(listener, app).await.unwrap() });
    (address, script)
}

fn quick() -> Backoff {
    Backoff { first: Duration::from_millis(5), longest: Duration::from_millis(20), attempts: Some(4) }
}

fn registration() -> NodeRegistration {
    NodeRegistration {
        name: "node-1".into(),
        speed: 1.0,
        price_per_hour: Default::default(),
        cores: 1,
        capabilities: Default::default(),
        schedule: None,
        worker: None,
    }
}

fn node() -> String {
    serde_json::json!({
        "id": Uuid::nil(), "name": "node-1", "speed": 1.0, "speed_set": false, "price_per_hour": 0, "price_set": false, "cores": 1, "drain": false,
        "task_id": null, "created_at": "2026-01-01T00:00:00Z", "last_seen_at": "2026-01-01T00:00:00Z",
    })
    .to_string()
}

fn problem(kind: ProblemKind) -> (StatusCode, HeaderMap, String) {
    let problem = Problem::new(kind, "as the test wants it");
    (
        StatusCode::from_u16(problem.status).unwrap(),
        HeaderMap::new(),
        serde_json::to_string(&problem).unwrap(),
    )
}

#[tokio::test]
async fn a_busy_service_is_asked_again_with_the_same_key_after_the_time_that_it_asked_for() {
    let mut busy = problem(ProblemKind::Busy);
    busy.1.insert(header::RETRY_AFTER, "1".parse().unwrap());
    let in_flight = problem(ProblemKind::IdempotencyInFlight);
    let (address, script) = server(vec![busy, in_flight, (StatusCode::OK, HeaderMap::new(), node())]).await;
    let client = Client::new(&address, Some(Token::new("secret\n"))).unwrap().with_backoff(quick());
    let start = Instant::now();
    let node = client.register(&registration(), Uuid::from_u128(7)).await.unwrap();
    assert_eq!(node.name, "node-1");
    assert!(start.elapsed() >= Duration::from_secs(1));
    let seen = &script.lock().seen;
    assert_eq!(seen.len(), 3);
    for (headers, body) in seen {
        assert_eq!(headers["authorization"], "Bearer secret");
        assert_eq!(headers["idempotency-key"], Uuid::from_u128(7).to_string());
        assert_eq!(serde_json::from_slice::<NodeRegistration>(body).unwrap(), registration());
    }
}

#[tokio::test]
async fn a_refusal_is_final_and_carries_the_services_word() {
    let (address, script) = server(vec![problem(ProblemKind::Invalid)]).await;
    let client = Client::new(&address, None).unwrap().with_backoff(quick());
    let error = client.register(&registration(), Uuid::nil()).await.unwrap_err();
    assert!(error.is(ProblemKind::Invalid));
    assert!(error.to_string().contains("as the test wants it"), "{error}");
    assert_eq!(script.lock().seen.len(), 1);
}

#[tokio::test]
async fn an_answer_that_is_no_problem_document_is_shown_in_one_line() {
    let page = (StatusCode::BAD_REQUEST, HeaderMap::new(), "<html>\n<b>no</b>\n</html>".to_owned());
    let (address, _) = server(vec![page]).await;
    let client = Client::new(&address, None).unwrap().with_backoff(quick());
    let error = client.register(&registration(), Uuid::nil()).await.unwrap_err().to_string();
    assert!(error.contains("400") && error.contains("<b>no</b>") && !error.contains('\n'), "{error}");
}

#[tokio::test]
async fn a_service_that_is_not_there_is_given_up_after_the_attempts_allowed() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    drop(listener);
    let client = Client::new(&address, Some(Token::new("secret"))).unwrap().with_backoff(quick());
    let error = client.register(&registration(), Uuid::nil()).await.unwrap_err();
    assert!(matches!(error, ClientError::Unreachable { .. }), "{error:?}");
    assert!(!format!("{error:?} {client:?}").contains("secret"));
}

#[tokio::test]
async fn a_service_that_comes_up_late_is_reached() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let local = listener.local_addr().unwrap();
    drop(listener);
    let client = Client::new(&format!("http://{local}"), None).unwrap();
    let asking = tokio::spawn(async move { client.register(&registration(), Uuid::nil()).await });
    tokio::time::sleep(Duration::from_millis(300)).await;
    let app = Router::new().route("/v1/nodes", post(|| async { node() }));
    let listener = tokio::net::TcpListener::bind(local).await.unwrap();
    tokio::spawn(async move { axum::serve(listener, app).await.unwrap() });
    assert_eq!(asking.await.unwrap().unwrap().name, "node-1");
}

#[tokio::test]
async fn an_artefact_with_the_wrong_content_is_not_taken() {
    let (address, _) = server(Vec::new()).await;
    let client = Client::new(&address, None).unwrap();
    let hash = ArtifactHash([1; 32]);
    assert!(matches!(client.artifact(hash, 1 << 20).await, Err(ClientError::Corrupt { .. })));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bundle.zip");
    assert!(matches!(client.artifact_to_file(hash, &file).await, Err(ClientError::Corrupt { .. })));
}

#[test]
fn addresses_that_are_none_are_refused_at_once() {
    for address in ["", "localhost:7878", "https://", "ftp://farm", "http://"] {
        let error = Client::new(address, None).unwrap_err().to_string();
        assert!(error.contains("is not the address of a service"), "{address}: {error}");
    }
    assert!(Client::new("https://farm", None).is_ok());
    let error = Client::trusting("https://farm", None, b"no certificate").unwrap_err().to_string();
    assert!(error.contains("no certificate in PEM form"), "{error}");
}
