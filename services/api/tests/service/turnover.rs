//! Tokens are revoked, expire and are rotated, and nodes are removed, while 200 workers work.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use crate::support::events::Events;
use crate::support::{Answer, Farm, Http, PATIENCE, until};
use forelight_protocol::{EventKind, JobState, Lease, NewToken, Node, Timestamp, Token};
use parking_lot::Mutex;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

const WORKERS: usize = 200;

/// A worker with made-up results, and what it met.
struct Worker {
    node: Node,
    token: Token,
    http: Mutex<Http>,
    /// Set once its token is certainly dead.
    is_dead: AtomicBool,
    /// Set before its token dies: a refusal is no surprise from then on.
    may_die: AtomicBool,
    refusals: AtomicU32,
}

impl Worker {
    async fn new(farm: &Farm, number: usize) -> Arc<Self> {
        let node = farm.node(&format!("node-{number}")).await;
        let request = json!({"name": format!("node-{number}"), "role": "worker"});
        let (http, token) = farm.new_token(request).await;
        let flag = || AtomicBool::new(false);
        let (is_dead, may_die) = (flag(), flag());
        Arc::new(Self { node, token, http: Mutex::new(http), is_dead, may_die, refusals: AtomicU32::new(0) })
    }

    /// Sends a request. `None` if it was refused because the token is dead; panics if a dead token's request
    /// succeeds, or if a living token's is refused.
    async fn ask(&self, path: &str, body: &Value) -> Option<reqwest::Response> {
        let (http, was_dead) = (self.http.lock().clone(), self.is_dead.load(Ordering::SeqCst));
        let answer = loop {
            let answer = http.post(path, body).await;
            // Two hundred workers may wait too long for the one writer.
            if answer.status() != StatusCode::SERVICE_UNAVAILABLE {
                break answer;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        };
        if answer.status() == StatusCode::UNAUTHORIZED {
            assert!(self.may_die.load(Ordering::SeqCst), "{}: a living token was refused", self.node.name);
            self.refusals.fetch_add(1, Ordering::SeqCst);
            return None;
        }
        assert!(!was_dead, "{}: a dead token got {} from {path}", self.node.name, answer.status());
        Some(answer)
    }

    /// Takes tasks and reports results until `stop`.
    async fn work(self: Arc<Self>, farm: Arc<Farm>, stop: Arc<AtomicBool>) {
        let claim = json!({"node_id": self.node.id, "wait_ms": 1000});
        while !stop.load(Ordering::SeqCst) {
            let Some(answer) = self.ask("/v1/leases", &claim).await else {
                // It is asked again and again, as a stranger would.
                tokio::time::sleep(Duration::from_millis(500)).await;
                continue;
            };
            match answer.status() {
                StatusCode::NO_CONTENT => {}
                StatusCode::OK => {
                    let lease: Lease = answer.parsed(StatusCode::OK).await;
                    let result = farm.made_up_result(&lease).await;
                    let report = json!({"fence": lease.fence, "result": result});
                    let path = format!("/v1/leases/{}/result", lease.lease_id);
                    let answer = self.ask(&path, &report).await;
                    let answer = answer.map(|answer| answer.status());
                    let was_taken =
                        self.may_die.load(Ordering::SeqCst) && answer == Some(StatusCode::CONFLICT);
                    assert!(matches!(answer, None | Some(StatusCode::OK)) || was_taken, "{answer:?}");
                }
                // Its node was removed.
                StatusCode::NOT_FOUND => assert!(self.may_die.load(Ordering::SeqCst)),
                other => panic!("{}: {other}", self.node.name),
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn tokens_die_among_200_workers_and_only_their_holders_notice() {
    let farm = Arc::new(Farm::new().await);
    let mut workers = Vec::new();
    for number in 0..WORKERS {
        workers.push(Worker::new(&farm, number).await);
    }
    let mut stream = Events::open(&farm.viewer, "/v1/events", None).await.unwrap();
    let job = farm.submit("0-19").await;
    let stop = Arc::new(AtomicBool::new(false));
    let tasks: Vec<_> =
        workers.iter().map(|worker| tokio::spawn(worker.clone().work(farm.clone(), stop.clone()))).collect();
    let mut replaced = Vec::new();
    // A quarter each: revoked, expired, rotated; half of the rest removed; the others are left in peace.
    for (number, worker) in workers.iter().enumerate() {
        let path = format!("/v1/tokens/{}", worker.token.id);
        match number % 8 {
            0 | 1 => {
                worker.may_die.store(true, Ordering::SeqCst);
                farm.revoke(&worker.token).await;
                worker.is_dead.store(true, Ordering::SeqCst);
            }
            2 | 3 => {
                worker.may_die.store(true, Ordering::SeqCst);
                let end = Timestamp::now().plus_micros(15_000_000);
                let patch = farm.operator.request(Method::PATCH, &path).json(&json!({"expires_at": end}));
                patch.send().await.unwrap().parsed::<Token>(StatusCode::OK).await;
                let worker = worker.clone();
                tokio::spawn(async move {
                    let http = worker.http.lock().clone();
                    while http.get("/v1/nodes?page_size=1").await.status() != StatusCode::UNAUTHORIZED {
                        tokio::time::sleep(Duration::from_millis(500)).await;
                    }
                    worker.is_dead.store(true, Ordering::SeqCst);
                });
            }
            4 | 5 => {
                // With a grace, the worker never notices, and its old token dies all the same.
                let grace = json!({"grace_seconds": 20});
                let rotated = farm.operator.post(&format!("{path}/rotate"), &grace).await;
                let new: NewToken = rotated.parsed(StatusCode::CREATED).await;
                replaced.push(std::mem::replace(&mut *worker.http.lock(), farm.with_token(new.secret)));
            }
            6 => {
                worker.may_die.store(true, Ordering::SeqCst);
                let removed = farm.delete(&format!("/v1/nodes/{}?cancel_task=true", worker.node.id)).await;
                assert_eq!(removed.status(), StatusCode::NO_CONTENT);
                farm.revoke(&worker.token).await;
                worker.is_dead.store(true, Ordering::SeqCst);
            }
            _ => {}
        }
    }
    // The job is done by those who are left, and the stream of events has not noticed anything.
    let done = loop {
        let event = stream.next(PATIENCE).await.expect("the stream goes on");
        if event.kind == EventKind::JobState && event.job_state.is_some_and(JobState::is_final) {
            break event;
        }
    };
    assert_eq!(done.job_state, Some(JobState::Done));
    // Whoever holds a dead token has learnt it.
    for (_, worker) in workers.iter().enumerate().filter(|(number, _)| matches!(number % 8, 0..=3 | 6)) {
        until("it is refused", async || worker.refusals.load(Ordering::SeqCst) > 0).await;
    }
    for old in replaced {
        until("the old token dies", async || {
            old.get("/v1/nodes?page_size=1").await.status() == StatusCode::UNAUTHORIZED
        })
        .await;
    }
    stop.store(true, Ordering::SeqCst);
    for task in tasks {
        task.await.unwrap();
    }
    let job = farm.job(&job).await;
    assert_eq!((job.state, job.frames_done), (JobState::Done, 20));
}
