//! Clients that hold what others need: sockets, uploads, disk space.

use std::time::Duration;

use crate::support::{self, Answer as _, Farm};
use forelight_protocol::{Problem, ProblemKind};
use reqwest::StatusCode;
use serde_json::json;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

/// A plain connection, with the answers that came on it.
struct Socket(TcpStream);

impl Socket {
    async fn open(farm: &Farm) -> Self {
        Self(TcpStream::connect(farm.service.local_addr()).await.unwrap())
    }

    async fn send(&mut self, text: &str) {
        self.0.write_all(text.as_bytes()).await.unwrap();
    }

    /// All that comes until the service closes the connection.
    async fn rest(&mut self) -> String {
        let mut rest = Vec::new();
        // A connection that is given up with unread bytes is reset.
        let _ = self.0.read_to_end(&mut rest).await;
        String::from_utf8(rest).unwrap()
    }

    /// The head of an answer, and as much of its body as it announces.
    async fn answer(&mut self) -> String {
        let mut answer = String::new();
        let mut byte = [0];
        while !answer.ends_with("\r\n\r\n") {
            self.0.read_exact(&mut byte).await.unwrap();
            answer.push(byte[0].into());
        }
        let length = answer.lines().find_map(|line| line.strip_prefix("content-length: "));
        let mut body = vec![0; length.map_or(0, |length| length.parse().unwrap())];
        self.0.read_exact(&mut body).await.unwrap();
        answer + &String::from_utf8(body).unwrap()
    }
}

fn problem(answer: &str) -> Problem {
    serde_json::from_str(answer.split_once("\r\n\r\n").unwrap().1).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_without_a_whole_request_is_closed_after_a_time() {
    let farm = Farm::with(|config| config.limits.connections.head_time = Duration::from_secs(1)).await;
    let mut silent = Socket::open(&farm).await;
    let mut slow = Socket::open(&farm).await;
    slow.send("GET /healthz HTTP/1.1\r\nHost: a\r\n").await;
    let mut done = Socket::open(&farm).await;
    done.send("GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n").await;
    assert!(done.rest().await.starts_with("HTTP/1.1 200"), "it is answered, and then closed");
    assert_eq!(silent.rest().await, "");
    assert!(!slow.rest().await.contains(" 200 "));
}

#[tokio::test(flavor = "multi_thread")]
async fn sockets_that_are_held_open_keep_neither_workers_nor_health_checks_out() {
    let farm = Farm::with(|config| config.limits.connections.at_once = Some(8)).await;
    let token = forelight_store::tokens::create(
        farm.service.store(),
        forelight_protocol::Role::Worker,
        "w",
        forelight_protocol::Timestamp::now(),
    );
    let token = token.await.unwrap();
    let mut worker = Socket::open(&farm).await;
    let request = format!("GET /v1/nodes HTTP/1.1\r\nHost: a\r\nAuthorization: Bearer {token}\r\n\r\n");
    worker.send(&request).await;
    assert!(worker.answer().await.starts_with("HTTP/1.1 200"));
    let mut held = Vec::new();
    for _ in 0..60 {
        held.push(Socket::open(&farm).await);
        if held.len() % 10 == 0 {
            assert_eq!(farm.nobody.get("/healthz").await.status(), StatusCode::OK);
        }
    }
    // The worker's connection was quiet for longest, and is still there.
    worker.send(&request).await;
    assert!(worker.answer().await.starts_with("HTTP/1.1 200"));
    let node = farm.node("a").await;
    farm.submit("0").await;
    assert!(farm.claim(&node).await.is_some());
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_of_a_byte_now_and_then_is_given_up_and_leaves_nothing() {
    let farm = Farm::with(|config| {
        config.limits.uploads.grace = Duration::from_millis(300);
        config.limits.uploads.least_rate = 1 << 20;
    })
    .await;
    let mut socket = Socket::open(&farm).await;
    let token = forelight_store::tokens::create(
        farm.service.store(),
        forelight_protocol::Role::Submitter,
        "s",
        forelight_protocol::Timestamp::now(),
    );
    let token = token.await.unwrap();
    socket
        .send(&format!(
            "POST /v1/bundles HTTP/1.1\r\nHost: a\r\nAuthorization: Bearer {token}\r\n\
             Content-Type: application/zip\r\nContent-Length: 1000000\r\n\r\nPK"
        ))
        .await;
    let problem = problem(&socket.answer().await);
    assert_eq!(problem.known_kind(), Some(ProblemKind::Malformed));
    assert!(problem.detail.contains("too slowly: 2 bytes"), "{}", problem.detail);
    let staging = std::fs::read_dir(farm.folder.path().join("data/artifacts/staging"));
    assert_eq!(staging.map_or(0, Iterator::count), 0);
    // A JSON document is held to the same.
    let mut socket = Socket::open(&farm).await;
    socket
        .send(&format!(
            "POST /v1/jobs HTTP/1.1\r\nHost: a\r\nAuthorization: Bearer {token}\r\n\
             Content-Type: application/json\r\nContent-Length: 1000\r\n\r\n{{"
        ))
        .await;
    assert!(self::problem(&socket.answer().await).detail.contains("too slowly"));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_that_the_disk_has_no_room_for_is_refused_before_it_is_sent() {
    let farm = Farm::with(|config| {
        config.limits.bundle_bytes = 1 << 60;
        config.limits.uploads.bytes_per_token = 1 << 60;
    })
    .await;
    let upload = async |bytes: u64| {
        let request = farm.submitter.request(reqwest::Method::POST, "/v1/bundles");
        let endless = futures::stream::pending::<Result<Vec<u8>, std::io::Error>>();
        let request = request.header("content-type", "application/zip").header("content-length", bytes);
        request.body(reqwest::Body::wrap_stream(endless)).send().await.unwrap()
    };
    let refused = upload(1 << 59).await;
    assert_eq!(refused.status(), StatusCode::INSUFFICIENT_STORAGE);
    let problem: Problem = refused.json().await.unwrap();
    assert!(problem.detail.contains("MiB beside other uploads"), "{}", problem.detail);
    // One token cannot take it all, whatever the disk has.
    let farm = Farm::with(|config| config.limits.uploads.bytes_per_token = 100).await;
    let refused = farm.submitter.upload(vec![0; 200], None).await;
    assert_eq!(refused.status(), StatusCode::TOO_MANY_REQUESTS);
    assert!(refused.headers().contains_key("retry-after"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_has_so_many_requests_under_way_and_workers_are_not_counted() {
    let farm = Farm::with(|config| config.limits.requests_per_token = 2).await;
    // A stream of events is a request that goes on.
    let streams = [farm.viewer.get("/v1/events").await, farm.viewer.get("/v1/events").await];
    let refused = farm.viewer.get("/v1/jobs").await;
    assert_eq!(refused.status(), StatusCode::TOO_MANY_REQUESTS);
    assert!(refused.headers().contains_key("retry-after"));
    assert_eq!(farm.operator.get("/v1/jobs").await.status(), StatusCode::OK, "another token");
    let node = farm.node("a").await;
    let claim = json!({"node_id": node.id, "wait_ms": 300});
    let wait = || farm.worker.post("/v1/leases", &claim);
    let (a, b, c) = tokio::join!(wait(), wait(), wait());
    assert_eq!([a, b, c].map(|answer| answer.status()), [StatusCode::NO_CONTENT; 3]);
    drop(streams);
    // The service notices that the streams are gone when it writes to them, or reads their end.
    while farm.viewer.get("/v1/jobs").await.status() != StatusCode::OK {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// A service whose bundles are loaded by this shell script.
async fn inspected_by(script: &str, change: impl FnOnce(&mut forelight_api::Inspection)) -> Farm {
    use std::os::unix::fs::PermissionsExt as _;
    Farm::with(|config| {
        let program = config.data_dir.with_file_name("inspect");
        std::fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o700)).unwrap();
        config.inspection.program = Some(program);
        change(&mut config.inspection);
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bundle_that_breaks_its_loader_harms_one_request() {
    let reason = async |farm: &Farm| {
        farm.submitter
            .upload(support::scene_zip(), None)
            .await
            .problem(ProblemKind::InvalidBundle)
            .await
            .detail
    };
    let farm = inspected_by("exit 101", |_| {}).await;
    assert!(reason(&farm).await.contains("bundle.zip: the scene loader failed on it"));
    let farm = inspected_by("exec sleep 600", |limits| limits.time = Duration::from_millis(300)).await;
    assert!(reason(&farm).await.contains("bundle.zip: it takes more than 0 s to load"));
    let bomb = r#"exec tail /dev/zero"#;
    let farm = inspected_by(bomb, |limits| limits.memory_bytes = 64 << 20).await;
    assert!(reason(&farm).await.contains("bundle.zip: it takes more than 64 MiB of memory to load"));
    // The next one is as good as ever.
    let answer = r#"echo '{"Err":"'"$3"': no scene"}'"#;
    let farm = inspected_by(answer, |_| {}).await;
    assert_eq!(reason(&farm).await, "bundle.zip: no scene");
    assert_eq!(farm.nobody.get("/readyz").await.status(), StatusCode::OK);
}
