//! Tokens: listing, renaming, expiry, rotation and revocation; nodes that are removed.

use crate::support::events::Events;
use crate::support::{Answer, Farm, Http, PATIENCE, address, until};
use forelight_api::Clock as _;
use forelight_protocol::{
    EventKind, JoinToken, Lease, NewToken, Node, NodePage, Plan, PlanPage, ProblemKind, Role, Timestamp,
    Token, TokenPage,
};
use forelight_store::{Store, token_hash, tokens};
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};

const MINUTE: i64 = 60_000_000;

impl Farm {
    pub async fn new_token(&self, request: Value) -> (Http, Token) {
        let made: NewToken =
            self.operator.post("/v1/tokens", &request).await.parsed(StatusCode::CREATED).await;
        (self.with_token(made.secret), made.token)
    }

    pub fn with_token(&self, secret: String) -> Http {
        Http::new(&address(&self.service), Some(secret))
    }

    pub async fn revoke(&self, token: &Token) {
        let answer = self.delete(&format!("/v1/tokens/{}", token.id)).await;
        assert_eq!(answer.status(), StatusCode::NO_CONTENT);
    }

    pub async fn delete(&self, path: &str) -> Response {
        self.operator.request(Method::DELETE, path).send().await.unwrap()
    }

    /// A machine that has joined, with its own token.
    pub async fn joined(&self, name: &str) -> (Http, Node) {
        let made: JoinToken = self
            .operator
            .post("/v1/join-tokens", &json!({"name": name}))
            .await
            .parsed(StatusCode::CREATED)
            .await;
        let own = tokens::random();
        let request = json!({"node": {"name": name, "cores": 2, "price_per_hour": 3_600_000}, "token_hash": token_hash(&own)});
        let node = self.with_token(made.token).post("/v1/nodes/join", &request).await;
        (self.with_token(own), node.parsed(StatusCode::CREATED).await)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn operators_make_list_rename_and_revoke_tokens_and_nobody_else_does() {
    let (farm, clock) = Farm::with_clock().await;
    let (anna, token) = farm.new_token(json!({"name": "anna", "role": "submitter"})).await;
    assert_eq!((token.name.as_str(), token.role, token.last_used_at), ("anna", Role::Submitter, None));
    let path = format!("/v1/tokens/{}", token.id);
    for http in [&anna, &farm.viewer, &farm.worker] {
        http.get("/v1/tokens").await.problem(ProblemKind::Forbidden).await;
        http.get(&path).await.problem(ProblemKind::Forbidden).await;
        let request = json!({"name": "b", "role": "operator"});
        http.post("/v1/tokens", &request).await.problem(ProblemKind::Forbidden).await;
        let revoke = http.request(Method::DELETE, &path).send().await.unwrap();
        revoke.problem(ProblemKind::Forbidden).await;
    }
    // Its use is seen at once, and is no secret.
    let used: Token = farm.operator.json(&path).await;
    assert_eq!(used, Token { last_used_at: Some(clock.now()), ..token.clone() });
    let text = farm.operator.get("/v1/tokens").await.text().await.unwrap();
    assert!(!text.contains("forelight_"), "{text}");
    let first: TokenPage = farm.operator.json("/v1/tokens?page_size=3").await;
    let rest = format!("/v1/tokens?page_token={}", first.next_page_token.unwrap());
    let rest: TokenPage = farm.operator.json(&rest).await;
    let names: Vec<_> = first.items.iter().chain(&rest.items).map(|it| it.name.as_str()).collect();
    assert!(names.len() == 5 && names.contains(&"anna"), "{names:?}");
    let patch = farm.operator.request(Method::PATCH, &path).json(&json!({"name": "anna's laptop"}));
    let renamed: Token = patch.send().await.unwrap().parsed(StatusCode::OK).await;
    assert_eq!(renamed.name, "anna's laptop");
    farm.revoke(&token).await;
    anna.get("/v1/jobs").await.problem(ProblemKind::Unauthenticated).await;
    farm.delete(&path).await.problem(ProblemKind::NotFound).await;
    for (wrong, pointer) in [
        (json!({"name": "", "role": "viewer"}), "/name"),
        (json!({"name": "a", "role": "boss"}), "/role"),
        (json!({"name": "a", "role": "viewer", "expires_at": clock.now()}), "/expires_at"),
    ] {
        let refused = farm.operator.post("/v1/tokens", &wrong).await.problem(ProblemKind::Invalid).await;
        assert_eq!(refused.pointer.as_deref(), Some(pointer));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_requests_and_streams_of_a_revoked_token_end_at_once() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let (screen, of_screen) = farm.new_token(json!({"name": "screen", "role": "viewer"})).await;
    let (worker, of_worker) = farm.new_token(json!({"name": "rack", "role": "worker"})).await;
    let session = farm.nobody.post("/v1/sessions", &json!({"code": code(&screen).await})).await;
    let cookie = session.headers()["set-cookie"].to_str().unwrap().split(';').next().unwrap().to_owned();
    let with_cookie = |path: &str| farm.nobody.request(Method::GET, path).header("cookie", &cookie);
    let stream = Events::open(&screen, "/v1/events", None).await.unwrap();
    let of_session = with_cookie("/v1/events").send().await.unwrap();
    assert_eq!(of_session.status(), StatusCode::OK);
    let own = Events::open(&farm.viewer, "/v1/events", None).await.unwrap();
    let waiting = {
        let (worker, node) = (worker.clone(), node.clone());
        tokio::spawn(async move {
            worker.post("/v1/leases", &json!({"node_id": node.id, "wait_ms": 60_000})).await
        })
    };
    // An upload that has begun: the service has its head, and waits for its body.
    let (more, body) = tokio::sync::mpsc::channel::<Result<Vec<u8>, std::io::Error>>(1);
    let uploading = {
        let hash = blake3::hash(b"12").to_string();
        let put = worker.request(Method::PUT, &format!("/v1/artifacts/{hash}"));
        let stream = futures::stream::unfold(body, async |mut body| body.recv().await.map(|it| (it, body)));
        tokio::spawn(put.body(reqwest::Body::wrap_stream(stream)).send())
    };
    more.send(Ok(b"1".to_vec())).await.unwrap();
    until_used(&farm, &of_worker).await;
    farm.revoke(&of_screen).await;
    farm.revoke(&of_worker).await;
    assert_eq!(stream.rest(PATIENCE).await, []);
    tokio::time::timeout(PATIENCE, of_session.bytes()).await.expect("the stream to end").unwrap();
    with_cookie("/v1/jobs").send().await.unwrap().problem(ProblemKind::Unauthenticated).await;
    waiting.await.unwrap().problem(ProblemKind::Unauthenticated).await;
    let upload = tokio::time::timeout(PATIENCE, uploading).await.expect("the upload to end").unwrap();
    // The answer may be lost, since the service closes a connection whose body it does not read.
    if let Ok(answer) = upload {
        answer.problem(ProblemKind::Unauthenticated).await;
    }
    drop(more);
    // Nobody else notices.
    let mut own = own;
    farm.submit("0").await;
    let seen = loop {
        let event = own.next(PATIENCE).await.expect("the stream goes on");
        if event.kind == EventKind::JobCreated {
            break event;
        }
    };
    assert!(seen.job_id.is_some());
}

async fn code(http: &Http) -> String {
    let code: Value = http.post("/v1/sessions/codes", &()).await.parsed(StatusCode::CREATED).await;
    code["code"].as_str().unwrap().to_owned()
}

/// Waits until the service has seen a request with this token.
async fn until_used(farm: &Farm, token: &Token) {
    until("the token is used", async || {
        let token: Token = farm.operator.json(&format!("/v1/tokens/{}", token.id)).await;
        token.last_used_at.is_some()
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_expires_with_its_streams_and_can_be_given_more_time() {
    let (farm, clock) = Farm::with_clock().await;
    let end = |minutes: i64| clock.now().plus_micros(minutes * MINUTE);
    let request = json!({"name": "guest", "role": "viewer", "expires_at": end(10)});
    let (guest, token) = farm.new_token(request).await;
    let stream = Events::open(&guest, "/v1/events", None).await.unwrap();
    let path = format!("/v1/tokens/{}", token.id);
    let patch = farm.operator.request(Method::PATCH, &path).json(&json!({"expires_at": end(20)}));
    let changed: Token = patch.send().await.unwrap().parsed(StatusCode::OK).await;
    assert_eq!(changed.expires_at, Some(end(20)));
    clock.advance_micros(15 * MINUTE);
    guest.get("/v1/jobs").await.parsed::<Value>(StatusCode::OK).await;
    clock.advance_micros(5 * MINUTE);
    guest.get("/v1/jobs").await.problem(ProblemKind::Unauthenticated).await;
    assert_eq!(stream.rest(PATIENCE).await, []);
    let expired: Token = farm.operator.json(&path).await;
    assert_eq!(expired.expires_at, changed.expires_at, "it is still listed");
    let rotate = farm.operator.post(&format!("{path}/rotate"), &json!({})).await;
    rotate.problem(ProblemKind::Conflict).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rotated_token_lives_for_its_grace_and_its_successor_has_its_rights() {
    let (farm, clock) = Farm::with_clock().await;
    let (old, node) = farm.joined("rack-7").await;
    let list: TokenPage = farm.operator.json("/v1/tokens").await;
    let of_node = list.items.iter().find(|token| token.node_id == Some(node.id)).unwrap();
    let rotate = format!("/v1/tokens/{}/rotate", of_node.id);
    let new: NewToken =
        farm.operator.post(&rotate, &json!({"grace_seconds": 60})).await.parsed(StatusCode::CREATED).await;
    assert_eq!((new.token.name.as_str(), new.token.node_id), ("rack-7", Some(node.id)));
    assert_ne!(new.token.id, of_node.id);
    let successor = farm.with_token(new.secret.clone());
    let claim = json!({"node_id": node.id});
    for http in [&old, &successor] {
        assert_eq!(http.post("/v1/leases", &claim).await.status(), StatusCode::NO_CONTENT);
    }
    clock.advance_micros(MINUTE);
    old.post("/v1/leases", &claim).await.problem(ProblemKind::Unauthenticated).await;
    assert_eq!(successor.post("/v1/leases", &claim).await.status(), StatusCode::NO_CONTENT);
    // Without a grace, the old one is gone when the answer is there.
    let rotate = format!("/v1/tokens/{}/rotate", new.token.id);
    let newest: NewToken = farm.operator.post(&rotate, &json!({})).await.parsed(StatusCode::CREATED).await;
    successor.post("/v1/leases", &claim).await.problem(ProblemKind::Unauthenticated).await;
    let newest = farm.with_token(newest.secret);
    assert_eq!(newest.post("/v1/leases", &claim).await.status(), StatusCode::NO_CONTENT);
    farm.operator.post(&rotate, &json!({})).await.problem(ProblemKind::NotFound).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_another_process_revokes_ends_with_its_streams() {
    let farm = Farm::new().await;
    let (screen, token) = farm.new_token(json!({"name": "screen", "role": "viewer"})).await;
    let stream = Events::open(&screen, "/v1/events", None).await.unwrap();
    let beside = Store::open_beside(&farm.folder.path().join("data")).await.unwrap();
    beside.revoke_token(token.id, Timestamp::now()).await.unwrap();
    beside.close().await;
    screen.get("/v1/jobs").await.problem(ProblemKind::Unauthenticated).await;
    assert_eq!(stream.rest(PATIENCE).await, []);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_with_a_task_is_removed_only_with_it_and_comes_back_only_with_a_token_that_may() {
    let farm = Farm::new().await;
    let (own, node) = farm.joined("rack-7").await;
    let job = farm.submit("0-3").await;
    farm.until_booked(&node, &job).await;
    let lease: Lease =
        own.post("/v1/leases", &json!({"node_id": node.id})).await.parsed(StatusCode::OK).await;
    let path = format!("/v1/nodes/{}", node.id);
    let refused = farm.delete(&path).await.problem(ProblemKind::Conflict).await;
    assert!(refused.detail.contains(&lease.task_id.to_string()), "{}", refused.detail);
    own.request(Method::DELETE, &path).send().await.unwrap().problem(ProblemKind::Forbidden).await;
    let other = farm.node("other").await;
    let removed = farm.delete(&format!("{path}?cancel_task=true")).await;
    assert_eq!(removed.status(), StatusCode::NO_CONTENT);
    own.get("/v1/nodes").await.problem(ProblemKind::Unauthenticated).await;
    farm.operator.get(&path).await.problem(ProblemKind::NotFound).await;
    farm.delete(&path).await.problem(ProblemKind::NotFound).await;
    let nodes: NodePage = farm.operator.json("/v1/nodes").await;
    assert_eq!(nodes.items.iter().map(|it| it.id).collect::<Vec<_>>(), [other.id]);
    // Its shared token does not help it.
    let claim = json!({"node_id": node.id});
    farm.worker.post("/v1/leases", &claim).await.problem(ProblemKind::NotFound).await;
    // The farm is planned without it, and the other node does all frames, the one that it held too.
    let plan = async || {
        let plans: PlanPage = farm.operator.json("/v1/plans").await;
        farm.operator.json::<Plan>(&format!("/v1/plans/{}", plans.items[0].id)).await
    };
    until("the other node has all bookings", async || {
        plan().await.bookings.iter().all(|booking| booking.node_id == other.id)
    })
    .await;
    let done = farm.work_off(&other, &job).await;
    assert_eq!(done.frames_done, 4);
    let again: Node = farm
        .worker
        .post("/v1/nodes", &json!({"name": "rack-7", "cores": 2}))
        .await
        .parsed(StatusCode::CREATED)
        .await;
    assert_eq!(again.id, node.id);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_workers_token_changes_only_what_nodes_may_change() {
    let farm = Farm::new().await;
    let (own, node) = farm.joined("rack-7").await;
    let path = format!("/v1/nodes/{}", node.id);
    let patch = async |http: &Http, change: Value| {
        http.request(Method::PATCH, &path).json(&change).send().await.unwrap()
    };
    for http in [&own, &farm.worker] {
        for (change, pointer) in [
            (json!({"price_per_hour": 0}), "/price_per_hour"),
            (json!({"price_per_hour": null}), "/price_per_hour"),
            (json!({"speed": 9.0}), "/speed"),
            (json!({"terms": {"billing_step_seconds": 3600}}), "/terms"),
            (json!({"set_aside": false, "drain": true}), "/set_aside"),
        ] {
            let refused = patch(http, change.clone()).await.problem(ProblemKind::Forbidden).await;
            assert_eq!(refused.pointer.as_deref(), Some(pointer), "{change}");
        }
        let paused: Node = patch(http, json!({"pause": true})).await.parsed(StatusCode::OK).await;
        assert!(paused.pause && !paused.drain);
        patch(http, json!({"pause": false, "set_aside": true})).await.parsed::<Node>(StatusCode::OK).await;
    }
}
