//! Workers: joining, orders, logs, checkpoints.

use std::time::Duration;

use crate::support::{Answer, Farm, Http, LEASE, address, until};
use forelight_api::Clock as _;
use forelight_protocol::{
    Dashboard, Job, JobPage, JoinToken, Lease, Node, NodeState, ProblemKind, Renewal, TaskLog, Timestamp,
    WaitKind,
};
use forelight_store::{token_hash, tokens};
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};
use uuid::Uuid;

impl Farm {
    async fn renew(&self, lease: &Lease, more: Value) -> Response {
        let mut body = json!({"fence": lease.fence, "progress": 0.5});
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        let patch = self.worker.request(Method::PATCH, &format!("/v1/leases/{}", lease.lease_id));
        patch.json(&body).send().await.unwrap()
    }
}

fn node(name: &str) -> Value {
    json!({"name": name, "cores": 4, "capabilities": {"memory_bytes": 1 << 30, "vulkan_adapter": "llvmpipe"}})
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_workers_of_one_name_the_later_has_the_node_and_the_earlier_is_told() {
    let farm = Farm::new().await;
    farm.submit("0").await;
    let [first, second] = [Uuid::now_v7(), Uuid::now_v7()];
    let register = async |worker: Option<Uuid>| -> Node {
        let node = json!({"name": "rack-7", "cores": 4, "worker": worker});
        farm.worker.post("/v1/nodes", &node).await.parsed(StatusCode::CREATED).await
    };
    let node = register(Some(first)).await;
    let claim = async |worker: Option<Uuid>| {
        farm.worker.post("/v1/leases", &json!({"node_id": node.id, "worker": worker})).await
    };
    let lease: Lease = claim(Some(first)).await.parsed(StatusCode::OK).await;
    // Nothing changes if it registers again, or if a process without a worker number registers.
    for worker in [Some(first), None] {
        assert_eq!(register(worker).await.task_id, Some(lease.task_id));
    }
    assert_eq!(claim(Some(first)).await.status(), StatusCode::NO_CONTENT);
    // A second worker takes the node over at once.
    assert_eq!((register(Some(second)).await.id, register(None).await.task_id), (node.id, None));
    let again: Lease = claim(Some(second)).await.parsed(StatusCode::OK).await;
    assert_eq!((again.task_id, again.fence), (lease.task_id, lease.fence + 1));
    let told = claim(Some(first)).await.problem(ProblemKind::Conflict).await;
    assert!(told.detail.contains("another worker has registered as \"rack-7\""), "{told:?}");
    farm.renew(&lease, json!({})).await.problem(ProblemKind::LeaseLost).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_machine_joins_with_a_one_time_token_and_then_speaks_for_itself_alone() {
    let farm = Farm::new().await;
    let asked = json!({"name": "rack 7", "valid_hours": 1});
    let made: JoinToken =
        farm.operator.post("/v1/join-tokens", &asked).await.parsed(StatusCode::CREATED).await;
    let joining = Http::new(&address(&farm.service), Some(made.token.clone()));
    let own = tokens::random();
    let request = json!({"node": node("rack-7"), "token_hash": token_hash(&own)});
    // A one-time token allows nothing else.
    joining.get("/v1/nodes").await.problem(ProblemKind::Unauthenticated).await;
    let joined: Node = joining.post("/v1/nodes/join", &request).await.parsed(StatusCode::CREATED).await;
    assert_eq!((joined.capabilities.memory_bytes, joined.state), (Some(1 << 30), NodeState::Idle));
    let again: Node = joining.post("/v1/nodes/join", &request).await.parsed(StatusCode::CREATED).await;
    assert_eq!(again.id, joined.id);
    let thief = json!({"node": node("other"), "token_hash": token_hash(&tokens::random())});
    let used = joining.post("/v1/nodes/join", &thief).await.problem(ProblemKind::Conflict).await;
    assert!(used.detail.contains("was used at"), "{}", used.detail);
    let stranger = Http::new(&address(&farm.service), Some(tokens::random()));
    let refused = stranger.post("/v1/nodes/join", &request).await;
    assert!(refused.headers()["www-authenticate"].to_str().unwrap().contains("invalid_token"));
    refused.problem(ProblemKind::Unauthenticated).await;
    let wrong = json!({"node": {"name": "rack-7", "cores": 0}, "token_hash": token_hash(&own)});
    let wrong = joining.post("/v1/nodes/join", &wrong).await.problem(ProblemKind::Invalid).await;
    assert_eq!(wrong.pointer.as_deref(), Some("/node/cores"));

    let itself = Http::new(&address(&farm.service), Some(own));
    let other = farm.node("other").await;
    farm.submit("0").await;
    let claim = |node: &Node| json!({"node_id": node.id});
    itself.post("/v1/nodes", &node("rack-7")).await.parsed::<Node>(StatusCode::CREATED).await;
    itself.post("/v1/nodes", &node("other")).await.problem(ProblemKind::Forbidden).await;
    itself.post("/v1/leases", &claim(&other)).await.problem(ProblemKind::Forbidden).await;
    let lease: Lease = farm.worker.post("/v1/leases", &claim(&other)).await.parsed(StatusCode::OK).await;
    let release = format!("/v1/leases/{}/release", lease.lease_id);
    itself.post(&release, &json!({"fence": lease.fence})).await.problem(ProblemKind::Forbidden).await;
    let released = farm.worker.post(&release, &json!({"fence": lease.fence})).await;
    assert_eq!(released.status(), StatusCode::NO_CONTENT);
    let lease: Lease = itself.post("/v1/leases", &claim(&joined)).await.parsed(StatusCode::OK).await;
    let patch = itself.request(Method::PATCH, &format!("/v1/leases/{}", lease.lease_id));
    let renewed = patch.json(&json!({"fence": lease.fence})).send().await.unwrap();
    assert_eq!(renewed.status(), StatusCode::OK);
    for (path, order) in [(&other, json!({"drain": true})), (&joined, json!({"set_aside": false}))] {
        let patch = itself.request(Method::PATCH, &format!("/v1/nodes/{}", path.id)).json(&order);
        patch.send().await.unwrap().problem(ProblemKind::Forbidden).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn orders_travel_with_the_heartbeat_and_are_seen_to_be_obeyed() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.submit("0").await;
    let lease = farm.next_task(&node).await;
    let ordered = async |order: Value| farm.order(&node, order).await.state;
    let heard = async |more: Value| -> Value { farm.renew(&lease, more).await.parsed(StatusCode::OK).await };
    assert_eq!(ordered(json!({"pause": true})).await, NodeState::Pausing);
    assert_eq!(heard(json!({})).await["order"], "pause");
    assert_eq!(heard(json!({"paused": true})).await["order"], "pause");
    assert_eq!(ordered(json!({})).await, NodeState::Paused);
    assert_eq!(ordered(json!({"pause": false, "drain": true})).await, NodeState::Draining);
    let told = heard(json!({})).await;
    assert_eq!((&told["order"], &told["drain"]), (&json!("continue"), &json!(true)));
    assert_eq!(ordered(json!({"cancel_task": true})).await, NodeState::Drained);
    assert_eq!(heard(json!({})).await["order"], "stop");
    assert_eq!(ordered(json!({"drain": false})).await, NodeState::Idle);
    assert_eq!(farm.next_task(&node).await.fence, lease.fence + 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_no_node_would_quote_says_why_it_waits() {
    let farm = Farm::new().await;
    let job = farm.submit("0").await;
    let listed: JobPage = farm.viewer.get("/v1/jobs").await.parsed(StatusCode::OK).await;
    let told = farm.job(&job).await.waits;
    assert!(
        told.as_ref().is_some_and(|waits| waits.because.contains("no worker has registered")),
        "{told:?}"
    );
    assert_eq!(listed.items[0].waits, told);
    let node = farm.node("a").await;
    assert_eq!(farm.job(&job).await.waits, None);
    farm.order(&node, json!({"drain": true})).await;
    assert!(farm.job(&job).await.waits.is_some_and(|waits| waits.because.ends_with(": 1 drained")));
}

#[tokio::test(flavor = "multi_thread")]
async fn without_room_no_task_is_handed_out_and_every_job_says_so() {
    let farm = Farm::with(|config| config.limits.least_disk_space = u64::MAX).await;
    let job = farm.submit("0").await;
    let node = farm.node("a").await;
    let claim = farm.worker.post("/v1/leases", &json!({"node_id": node.id, "wait_ms": 0})).await;
    // Other programs write meanwhile, so the space is another each time.
    for answer in [claim, farm.nobody.get("/readyz").await] {
        let lack = answer.problem(ProblemKind::StorageFull).await.detail;
        assert!(lack.contains("MiB of free disk space"), "{lack}");
    }
    // Nor is an artefact taken that would leave the database none.
    let path = format!("/v1/artifacts/{}", blake3::hash(b"one").to_hex());
    let upload = farm.worker.request(Method::PUT, &path).body("one").send().await.unwrap();
    upload.problem(ProblemKind::StorageFull).await;
    let told = farm.job(&job).await.waits.expect("a reason");
    assert_eq!((told.kind, told.because.contains("MiB of free disk space")), (WaitKind::Room, true));
    let listed: JobPage = farm.viewer.get("/v1/jobs").await.parsed(StatusCode::OK).await;
    assert_eq!(listed.items[0].waits.as_ref().map(|waits| waits.kind), Some(WaitKind::Room));
    let shown: Dashboard = farm.viewer.get("/v1/dashboard").await.parsed(StatusCode::OK).await;
    assert_eq!(shown.jobs[0].waits.as_ref().map(|waits| waits.kind), Some(WaitKind::Room));
    let cancel = farm.submitter.post(&format!("/v1/jobs/{}/cancel", job.id), &json!({})).await;
    cancel.parsed::<Job>(StatusCode::OK).await;
    assert_eq!(farm.job(&job).await.waits, None);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_workers_say_can_be_read_while_they_work_and_after_they_failed() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.submit("0").await;
    let lease = farm.next_task(&node).await;
    let line = |number: u32, text: &str| json!({"number": number, "at": Timestamp::now(), "level": "info", "text": text});
    let read = async || -> TaskLog {
        farm.viewer.get(&format!("/v1/tasks/{}/log", lease.task_id)).await.parsed(StatusCode::OK).await
    };
    assert!(read().await.lines.is_empty());
    farm.renew(&lease, json!({"log": [line(0, "bundle fetched")]}))
        .await
        .parsed::<Renewal>(StatusCode::OK)
        .await;
    assert_eq!(read().await.lines[0].text, "bundle fetched");
    let end = json!({"fence": lease.fence, "error": {"message": "no"}, "log": [line(1, "the disk is full")]});
    for _ in 0..2 {
        let answer = farm.worker.post(&format!("/v1/leases/{}/result", lease.lease_id), &end).await;
        assert_eq!(answer.status(), StatusCode::OK);
    }
    let log = read().await;
    assert_eq!(
        log.lines.iter().map(|line| (line.attempt, line.number)).collect::<Vec<_>>(),
        [(1, 0), (1, 1)]
    );
    let many: Vec<Value> = (0..101).map(|number| line(number, "again")).collect();
    let refused = farm.renew(&lease, json!({"log": many})).await.problem(ProblemKind::Invalid).await;
    assert_eq!(refused.pointer.as_deref(), Some("/log"));
}

#[tokio::test(flavor = "multi_thread")]
async fn finished_tiles_outlive_their_worker_and_go_with_the_task() {
    let (farm, clock) = Farm::with_short_leases().await;
    let (lost, other) = (farm.node("lost").await, farm.node("other").await);
    let job = farm.submit("0").await;
    farm.until_booked(&other, &job).await;
    let lease = farm.next_task(&lost).await;
    let address =
        |lease: &Lease, fence: u64| format!("/v1/leases/{}/checkpoint?fence={fence}", lease.lease_id);
    let put = async |lease: &Lease, fence: u64, tiles: &'static [u8]| {
        farm.worker.request(Method::PUT, &address(lease, fence)).body(tiles).send().await.unwrap()
    };
    farm.worker.get(&address(&lease, 0)).await.problem(ProblemKind::NotFound).await;
    for tiles in [b"one tile" as &[u8], b"two tiles"] {
        assert_eq!(put(&lease, lease.fence, tiles).await.status(), StatusCode::NO_CONTENT);
    }
    put(&lease, lease.fence + 1, b"a stranger's").await.problem(ProblemKind::LeaseLost).await;
    clock.advance_micros(LEASE);
    let taken = farm.claim_waiting(&other, 5000).await.unwrap();
    assert_eq!((taken.task_id, taken.fence), (lease.task_id, lease.fence + 1));
    put(&lease, lease.fence, b"too late").await.problem(ProblemKind::LeaseLost).await;
    let found = farm.worker.get(&address(&taken, 0)).await;
    assert_eq!(found.bytes().await.unwrap(), &b"two tiles"[..]);
    farm.finish(&taken).await;
    let folder = farm.folder.path().join("data/checkpoints");
    until("it is gone", async || std::fs::read_dir(&folder).unwrap().count() == 0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_that_failed_comes_back_to_a_waiting_claim_when_its_time_has_come() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    farm.submit("0").await;
    let lease = farm.next_task(&a).await;
    let end = json!({"fence": lease.fence, "error": {"message": "no"}});
    let begun = std::time::Instant::now();
    farm.worker.post(&format!("/v1/leases/{}/result", lease.lease_id), &end).await;
    let again = farm.next_task(&b).await;
    assert_eq!(again.task_id, lease.task_id);
    assert!(begun.elapsed() > Duration::from_millis(300), "{:?}", begun.elapsed());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clock_that_is_set_by_hours_costs_no_lease_and_holds_none() {
    let (farm, clock) = Farm::with_short_leases().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    farm.submit("0").await;
    let lease = farm.next_task(&a).await;
    for hours in [5, -9] {
        clock.set_by(hours * 3_600_000_000);
        until("the clock is followed", async || {
            assert!(farm.claim(&b).await.is_none(), "the lease was taken for one that ran out");
            let renewal: Renewal = farm.renew(&lease, json!({})).await.parsed(StatusCode::OK).await;
            renewal.expires_at == clock.now().plus_micros(LEASE)
        })
        .await;
    }
    clock.advance_micros(LEASE);
    assert_eq!(farm.next_task(&b).await.task_id, lease.task_id);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dear_node_leaves_booked_frames_to_the_cheap_one_says_why_and_helps_when_there_is_no_deadline() {
    let farm = Farm::new().await;
    let register = async |name: &str, price: i64| -> Node {
        let node = json!({"name": name, "speed": 2.0, "price_per_hour": price, "cores": 2});
        farm.worker.post("/v1/nodes", &node).await.parsed(StatusCode::CREATED).await
    };
    let cheap = register("cheap", 3_600_000).await;
    let dear = register("dear", 36_000_000).await;
    let mut request = farm.job_request("0-3");
    request["deadline"] = json!(Timestamp::now().plus_micros(3_600_000_000));
    let job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    let job = farm.until_booked(&cheap, &job).await;
    assert_eq!(farm.claim_waiting(&dear, 300).await, None);
    let seen = async |node: &Node| -> Node {
        farm.viewer.get(&format!("/v1/nodes/{}", node.id)).await.parsed(StatusCode::OK).await
    };
    let reason = seen(&dear).await.idle_reason.expect("frames wait");
    let said =
        "cheaper to wait for cheap: an hour of a core of speed 1 of job a job costs 0.90 there and 9.00 here";
    assert_eq!(reason, said);
    assert_eq!(farm.claim(&cheap).await.map(|lease| lease.job_id), Some(job.id));
    assert_eq!(seen(&cheap).await.idle_reason, None);
    // This job has no deadline, so its cost is not weighed.
    let free = farm.submit("0-1").await;
    let free = farm.until_booked(&cheap, &free).await;
    assert_eq!(farm.claim(&dear).await.map(|lease| lease.job_id), Some(free.id));
    assert_eq!(seen(&dear).await.idle_reason, None);
}
