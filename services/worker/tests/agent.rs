//! The agent against a small service that loses leases, restarts and refuses on purpose.
//!
//! The file is longer than 500 lines: its tests share this service, which is a third of it.

use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::{patch, post, put};
use axum::{Json, Router};
use forelight_client::Client;
use forelight_protocol::{
    ArtifactHash, BundleSource, ClaimRequest, FinishedPixels, JobId, JobSettings, Lease, LeaseId, LeaseOrder,
    LogLevel, NodeRegistration, PreviewBackend, PreviewResult, PreviewSpec, Problem, ProblemKind,
    RenderSettingsRequest, RenderSpec, RenewRequest, Renewal, ResultRequest, SceneDigest, Spent, TaskId,
    TaskLimit, TaskLimits, TaskResult, TaskSpec, Timestamp,
};
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Outcome};
use forelight_worker::{Agent, AgentError, Bundles, Errand};
use parking_lot::Mutex;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

const TTL_MS: u64 = 300;

/// State of the service, and what it received.
#[derive(Default)]
struct Farm {
    ready: Vec<Lease>,
    /// Tasks that claims asked for.
    wanted: Vec<Option<TaskId>>,
    /// Claims find the task done, or the node taken over.
    over: bool,
    /// Renewals answer this instead of "continue".
    order: Option<Result<LeaseOrder, ProblemKind>>,
    /// Reports are answered with these problems, one each.
    refuse_reports: Vec<ProblemKind>,
    /// The service forgot its nodes.
    forgot_nodes: bool,
    /// Claims without a task are told that the node sleeps for this many seconds.
    asleep: Option<u64>,
    /// Renewals say that the node will sleep for this many microseconds.
    bedtime: Option<i64>,
    registrations: u32,
    /// Registrations are answered with this problem.
    refuse_registrations: Option<ProblemKind>,
    renewals: Vec<RenewRequest>,
    artifacts: BTreeSet<ArtifactHash>,
    reports: Vec<ResultRequest>,
    releases: Vec<LeaseId>,
    /// Downloads that were started. None ever ends, unless artefacts are damaged.
    downloads: u32,
    artifacts_are_damaged: bool,
}

type Shared = Arc<Mutex<Farm>>;

fn problem(kind: ProblemKind) -> Response {
    let problem = Problem::new(kind, "as the test wants it");
    (StatusCode::from_u16(problem.status).unwrap(), Json(problem)).into_response()
}

async fn claim(State(farm): State<Shared>, Json(request): Json<ClaimRequest>) -> Response {
    {
        let mut farm = farm.lock();
        farm.wanted.push(request.task_id);
        if farm.over {
            return problem(ProblemKind::Conflict);
        }
        if std::mem::take(&mut farm.forgot_nodes) {
            return problem(ProblemKind::NotFound);
        }
        if let Some(lease) = farm.ready.pop() {
            return Json(lease).into_response();
        }
        if let Some(seconds) = farm.asleep {
            return (StatusCode::NO_CONTENT, [("retry-after", seconds.to_string())]).into_response();
        }
    }
    tokio::time::sleep(Duration::from_millis(20)).await;
    StatusCode::NO_CONTENT.into_response()
}

async fn register(State(farm): State<Shared>) -> Response {
    {
        let mut farm = farm.lock();
        farm.registrations += 1;
        if let Some(kind) = farm.refuse_registrations {
            return problem(kind);
        }
    }
    let node = serde_json::json!({
        "id": Uuid::nil(), "name": "node-1", "speed": 1.0, "speed_set": false, "price_per_hour": 0, "price_set": false, "cores": 1, "drain": false,
        "task_id": null, "created_at": "2026-01-01T00:00:00Z", "last_seen_at": "2026-01-01T00:00:00Z",
    });
    Json(node).into_response()
}

async fn renew(State(farm): State<Shared>, Json(renewal): Json<RenewRequest>) -> Response {
    let mut farm = farm.lock();
    farm.renewals.push(renewal);
    match farm.order.unwrap_or(Ok(LeaseOrder::Continue)) {
        Ok(order) => {
            let now = Timestamp::now();
            let expires_at = now.plus_micros(TTL_MS as i64 * 1000);
            let sleep_until = farm.bedtime.map(|micros| now.plus_micros(micros));
            Json(Renewal { expires_at, order, drain: false, sleep_until, divide_rest: None }).into_response()
        }
        Err(kind) => problem(kind),
    }
}

async fn report(State(farm): State<Shared>, Json(result): Json<ResultRequest>) -> Response {
    let mut farm = farm.lock();
    farm.reports.push(result);
    match farm.refuse_reports.pop() {
        Some(kind) => problem(kind),
        None => Json(serde_json::json!({ "duplicate": false, "job_state": "rendering" })).into_response(),
    }
}

async fn release(State(farm): State<Shared>, Path(lease): Path<LeaseId>) -> StatusCode {
    farm.lock().releases.push(lease);
    StatusCode::NO_CONTENT
}

async fn store(State(farm): State<Shared>, Path(hash): Path<ArtifactHash>, body: Bytes) -> Response {
    assert_eq!(hash, ArtifactHash(*blake3::hash(&body).as_bytes()));
    let existed = !farm.lock().artifacts.insert(hash);
    Json(serde_json::json!({ "hash": hash, "size": body.len(), "existed": existed })).into_response()
}

async fn fetch(State(farm): State<Shared>) -> Response {
    {
        let mut farm = farm.lock();
        farm.downloads += 1;
        if farm.artifacts_are_damaged {
            return problem(ProblemKind::ArtifactDamaged);
        }
    }
    std::future::pending().await
}

fn app(farm: Shared) -> Router {
    Router::new()
        .route("/v1/nodes", post(register))
        .route("/v1/leases", post(claim))
        .route("/v1/leases/{id}", patch(renew))
        .route("/v1/leases/{id}/result", post(report))
        .route("/v1/leases/{id}/release", post(release))
        .route("/v1/artifacts/{hash}", put(store).get(fetch))
        .with_state(farm)
}

fn lease(fence: u64) -> Lease {
    let spec = PreviewSpec {
        job_id: JobId::new(),
        bundle: BundleSource::Path("/".into()),
        digest: SceneDigest([0; 32]),
        frames: vec![0],
        settings: RenderSettingsRequest::default().complete((4, 4)).into(),
        renderer: None,
    };
    Lease {
        lease_id: LeaseId::new(),
        task_id: TaskId::new(),
        job_id: spec.job_id,
        fence,
        expires_at: Timestamp::now(),
        ttl_ms: TTL_MS,
        spec: TaskSpec::Preview(spec),
        limits: TaskLimits::default(),
    }
}

/// Works for a while, and records whether it was stopped.
struct Slow {
    time: Duration,
    ends_as: Result<(), ExecuteError>,
    panics: bool,
    runs: AtomicU32,
    stopped: AtomicBool,
    /// Whether the work ends now.
    enough: AtomicBool,
}

/// Longer than any test: the test ends the work.
const LONG: Duration = Duration::from_secs(3600);

/// How long a test waits for something. A machine may pause.
const PATIENCE: Duration = Duration::from_secs(120);

impl Slow {
    fn new(time: Duration) -> Self {
        Self {
            time,
            ends_as: Ok(()),
            panics: false,
            runs: AtomicU32::new(0),
            stopped: AtomicBool::new(false),
            enough: AtomicBool::new(false),
        }
    }
}

impl Execute for Slow {
    fn execute(&self, _: &Assignment, control: &Control) -> Result<Outcome, ExecuteError> {
        self.runs.fetch_add(1, Ordering::SeqCst);
        assert!(!self.panics, "a bug in the renderer");
        let pixels = FinishedPixels { done: 3, all: 16, work: 300, cpu_nanos: 3000 };
        control.finished_pixels(pixels);
        control.finished_pixels(pixels);
        let start = Instant::now();
        while start.elapsed() < self.time && !self.enough.load(Ordering::SeqCst) {
            if control.is_cancelled() {
                self.stopped.store(true, Ordering::SeqCst);
                return Err(ExecuteError::Cancelled);
            }
            control.set_progress(0.5);
            std::thread::sleep(Duration::from_millis(5));
        }
        self.ends_as.clone()?;
        let artifact = bytes::Bytes::from_static(b"preview");
        let hash = ArtifactHash(*blake3::hash(&artifact).as_bytes());
        let frame = forelight_protocol::FrameStrata {
            frame: 0,
            pixels: Vec::new(),
            background: 16,
            cache_records: Vec::new(),
            cache_plan: None,
            lights: 0,
            shining: 0,
            triangles: 0,
            preview_png: Some(hash),
        };
        let result = PreviewResult {
            strata: Vec::new(),
            background_prior_cost: 0.1,
            record_prior_cost: None,
            frames: vec![frame],
            backend: PreviewBackend::Cpu,
            spent: Spent::default(),
            described: None,
        };
        Ok(Outcome { result: TaskResult::Preview(result), artifacts: vec![artifact] })
    }
}

struct Rig {
    farm: Shared,
    executor: Arc<Slow>,
    stop: CancellationToken,
    agent: tokio::task::JoinHandle<Result<(), forelight_worker::AgentError>>,
    _bundles: tempfile::TempDir,
}

/// A worker, and the folder of its bundles.
fn agent(address: &str, executor: Arc<Slow>) -> (Agent, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let bundles = Arc::new(Bundles::new(folder.path()).unwrap());
    let registration = NodeRegistration {
        name: "node-1".into(),
        speed: 1.0,
        price_per_hour: Default::default(),
        cores: 1,
        capabilities: Default::default(),
        schedule: None,
        worker: None,
    };
    let client = Client::new(address, None).unwrap();
    (Agent::new(client, bundles, executor, registration).unwrap(), folder)
}

impl Rig {
    async fn new(farm: Farm, executor: Slow) -> Self {
        let farm: Shared = Arc::new(Mutex::new(farm));
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        let app = app(farm.clone());
        tokio::spawn(async move { axum::serve(listener, app).await.unwrap() });
        Self::at(&address, farm, executor)
    }

    fn at(address: &str, farm: Shared, executor: Slow) -> Self {
        let executor = Arc::new(executor);
        let (agent, bundles) = agent(address, executor.clone());
        let stop = CancellationToken::new();
        let stopping = stop.clone();
        let agent = tokio::spawn(async move { agent.run(stopping).await });
        Self { farm, executor, stop, agent, _bundles: bundles }
    }

    /// Waits for a condition.
    async fn until(&self, what: &str, condition: impl Fn(&Farm) -> bool) {
        let start = Instant::now();
        while !condition(&self.farm.lock()) {
            assert!(start.elapsed() < PATIENCE, "timed out waiting until {what}");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    /// The work ends.
    fn end_work(&self) {
        self.executor.enough.store(true, Ordering::SeqCst);
    }

    async fn end(self) -> Arc<Slow> {
        self.stop.cancel();
        self.agent.await.unwrap().unwrap();
        self.executor
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_is_done_under_a_renewed_lease_and_its_artefacts_are_there_before_its_result() {
    let farm = Farm { ready: vec![lease(3)], ..Farm::default() };
    let rig = Rig::new(farm, Slow::new(LONG)).await;
    let is_renewed =
        |farm: &Farm| farm.renewals.len() >= 3 && farm.renewals.iter().any(|renewal| renewal.progress == 0.5);
    rig.until("the lease is renewed", is_renewed).await;
    rig.end_work();
    rig.until("a result came", |farm| !farm.reports.is_empty()).await;
    {
        let farm = rig.farm.lock();
        assert_eq!(farm.reports[0].fence, 3);
        for hash in farm.reports[0].result.as_ref().unwrap().artifacts() {
            assert!(farm.artifacts.contains(&hash));
        }
    }
    rig.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_lease_stops_the_work_and_nothing_is_reported() {
    for order in [Ok(LeaseOrder::Stop), Err(ProblemKind::LeaseLost)] {
        let farm = Farm { ready: vec![lease(1)], order: Some(order), ..Farm::default() };
        let rig = Rig::new(farm, Slow::new(Duration::from_secs(60))).await;
        let executor = rig.executor.clone();
        rig.until("the work was stopped", |_| executor.stopped.load(Ordering::SeqCst)).await;
        // The worker is free for the next task.
        rig.farm.lock().order = None;
        rig.farm.lock().ready.push(lease(2));
        rig.until("it works again", |_| executor.runs.load(Ordering::SeqCst) == 2).await;
        assert!(rig.farm.lock().reports.is_empty());
        rig.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stale_result_is_dropped_and_the_worker_goes_on() {
    let farm = Farm {
        ready: vec![lease(2), lease(1)],
        refuse_reports: vec![ProblemKind::LeaseLost],
        ..Farm::default()
    };
    let rig = Rig::new(farm, Slow::new(Duration::from_millis(10))).await;
    rig.until("the second result came", |farm| farm.reports.len() == 2).await;
    assert_eq!(rig.farm.lock().reports[1].fence, 2);
    rig.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_outlives_a_restart_of_the_service() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let local = listener.local_addr().unwrap();
    let farm: Shared = Arc::new(Mutex::new(Farm { ready: vec![lease(1)], ..Farm::default() }));
    let first = tokio::spawn({
        let app = app(farm.clone());
        async move { axum::serve(listener, app).await.unwrap() }
    });
    let rig = Rig::at(&format!("http://{local}"), farm.clone(), Slow::new(LONG));
    rig.until("the work began", |farm| !farm.renewals.is_empty()).await;
    first.abort();
    let _ = first.await;
    rig.end_work();
    // The work ends while the service is down, long after the lease expired.
    tokio::time::sleep(Duration::from_millis(1_000)).await;
    assert!(farm.lock().reports.is_empty());
    let listener = loop {
        match tokio::net::TcpListener::bind(local).await {
            Ok(listener) => break listener,
            Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
        }
    };
    let app = app(farm.clone());
    tokio::spawn(async move { axum::serve(listener, app).await.unwrap() });
    rig.until("the result came", |farm| !farm.reports.is_empty()).await;
    assert!(farm.lock().reports[0].result.is_some());
    rig.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn errors_and_panics_are_reported_with_whether_trying_again_can_help() {
    let ends: [(Result<(), ExecuteError>, bool, &str, bool); 3] = [
        (Err(ExecuteError::Permanent("scene.obj: line 7: no".into())), false, "scene.obj: line 7: no", true),
        (Err(ExecuteError::Transient("disk full".into())), false, "disk full", false),
        (Ok(()), true, "a bug in the renderer", false),
    ];
    for (ends_as, panics, message, permanent) in ends {
        let executor = Slow { ends_as, panics, ..Slow::new(Duration::ZERO) };
        let rig = Rig::new(Farm { ready: vec![lease(1)], ..Farm::default() }, executor).await;
        rig.until("an error came", |farm| !farm.reports.is_empty()).await;
        let error = rig.farm.lock().reports[0].error.clone().unwrap();
        assert!(error.message.contains(message), "{}", error.message);
        assert_eq!(error.permanent, permanent, "{message}");
        rig.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_beyond_its_time_limit_is_stopped_and_the_limit_is_said_in_error_and_log() {
    let limits = TaskLimits { memory_bytes: Some(1 << 50), wall_ms: Some(150) };
    let limited = Lease { limits, ..lease(1) };
    let rig =
        Rig::new(Farm { ready: vec![limited], ..Farm::default() }, Slow::new(Duration::from_secs(60))).await;
    rig.until("an error came", |farm| !farm.reports.is_empty()).await;
    assert!(rig.executor.stopped.load(Ordering::SeqCst));
    let end = rig.farm.lock().reports[0].clone();
    let error = end.error.unwrap();
    assert_eq!((error.limit, error.permanent), (Some(TaskLimit::WallTime), false));
    assert!(error.message.contains("0.15 s"), "{}", error.message);
    let last = end.log.last().unwrap();
    assert_eq!((last.level, last.text.contains("0.15 s")), (LogLevel::Error, true), "{last:?}");
    rig.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_paused_worker_stands_still_says_so_and_goes_on() {
    let farm = Farm { ready: vec![lease(1)], order: Some(Ok(LeaseOrder::Pause)), ..Farm::default() };
    let rig = Rig::new(farm, Slow::new(LONG)).await;
    rig.until("it stands still", |farm| farm.renewals.last().is_some_and(|renewal| renewal.paused)).await;
    rig.end_work();
    tokio::time::sleep(Duration::from_millis(3 * TTL_MS)).await;
    assert!(rig.farm.lock().reports.is_empty(), "it went on");
    let told = rig.farm.lock().renewals.last().and_then(|renewal| renewal.pixels);
    assert_eq!(told, Some(FinishedPixels { done: 6, all: 16, work: 600, cpu_nanos: 6000 }));
    rig.farm.lock().order = None;
    rig.until("the result came", |farm| !farm.reports.is_empty()).await;
    let said: Vec<String> = {
        let farm = rig.farm.lock();
        let renewed = farm.renewals.iter().flat_map(|renewal| &renewal.log);
        renewed.chain(&farm.reports[0].log).map(|line| line.text.clone()).collect()
    };
    for line in ["paused by the operator", "resumed by the operator"] {
        assert_eq!(said.iter().filter(|said| *said == line).count(), 1, "{said:?}");
    }
    rig.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_that_the_service_refuses_is_reported_as_an_error() {
    let farm = Farm { ready: vec![lease(1)], refuse_reports: vec![ProblemKind::Invalid], ..Farm::default() };
    let rig = Rig::new(farm, Slow::new(Duration::ZERO)).await;
    rig.until("an error came", |farm| farm.reports.len() == 2).await;
    let error = rig.farm.lock().reports[1].error.clone().unwrap();
    assert!(error.message.contains("as the test wants it"), "{}", error.message);
    rig.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_artefact_is_uploaded_again() {
    let farm =
        Farm { ready: vec![lease(1)], refuse_reports: vec![ProblemKind::MissingArtifact], ..Farm::default() };
    let rig = Rig::new(farm, Slow::new(Duration::ZERO)).await;
    rig.until("the result was taken", |farm| farm.reports.len() == 2).await;
    assert!(rig.farm.lock().reports[1].result.is_some());
    rig.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_is_stopped_gives_its_lease_back() {
    let lease = lease(1);
    let id = lease.lease_id;
    let rig =
        Rig::new(Farm { ready: vec![lease], ..Farm::default() }, Slow::new(Duration::from_secs(60))).await;
    let executor = rig.executor.clone();
    rig.until("it works", |_| executor.runs.load(Ordering::SeqCst) == 1).await;
    let farm = rig.farm.clone();
    let executor = rig.end().await;
    assert!(executor.stopped.load(Ordering::SeqCst));
    let farm = farm.lock();
    assert_eq!(farm.releases, [id]);
    assert!(farm.reports.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_is_stopped_while_it_downloads_gives_its_lease_back_at_once() {
    let mut lease = lease(1);
    let TaskSpec::Preview(spec) = &mut lease.spec else { unreachable!() };
    spec.bundle = BundleSource::Artifact(ArtifactHash([7; 32]));
    let id = lease.lease_id;
    let rig = Rig::new(Farm { ready: vec![lease], ..Farm::default() }, Slow::new(Duration::ZERO)).await;
    rig.until("it downloads", |farm| farm.downloads == 1).await;
    let farm = rig.farm.clone();
    let executor = tokio::time::timeout(PATIENCE, rig.end()).await.expect("an end");
    assert_eq!((executor.runs.load(Ordering::SeqCst), &farm.lock().releases[..]), (0, &[id][..]));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_the_service_forgot_registers_again() {
    let farm = Farm { ready: vec![lease(1)], forgot_nodes: true, ..Farm::default() };
    let rig = Rig::new(farm, Slow::new(Duration::ZERO)).await;
    rig.until("the result came", |farm| farm.reports.len() == 1).await;
    assert_eq!(rig.farm.lock().registrations, 2);
    rig.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_whose_node_another_has_taken_over_ends_and_says_so() {
    let rig = Rig::new(Farm { over: true, ..Farm::default() }, Slow::new(Duration::ZERO)).await;
    let AgentError::Refused { source, .. } = rig.agent.await.unwrap().unwrap_err() else { panic!() };
    assert!(source.is(ProblemKind::Conflict), "{source}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_is_too_old_ends_and_one_that_is_too_new_waits_for_a_newer_service() {
    let refusing = |kind| Farm { refuse_registrations: Some(kind), ..Farm::default() };
    let rig = Rig::new(refusing(ProblemKind::WorkerTooOld), Slow::new(Duration::ZERO)).await;
    let AgentError::Version { source, .. } = rig.agent.await.unwrap().unwrap_err() else { panic!() };
    assert!(source.is(ProblemKind::WorkerTooOld), "{source}");
    let rig = Rig::new(refusing(ProblemKind::WorkerTooNew), Slow::new(Duration::ZERO)).await;
    rig.until("it asked", |farm| farm.registrations == 1).await;
    rig.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_process_for_one_task_waits_for_it_does_it_and_ends_and_ends_at_once_when_it_is_over() {
    let farm = Shared::default();
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let app = app(farm.clone());
    tokio::spawn(async move { axum::serve(listener, app).await.unwrap() });
    let (agent, _bundles) = agent(&address, Arc::new(Slow::new(Duration::from_millis(10))));
    let task = TaskId::new();
    // Another worker holds the task for a while, and loses it.
    let later = farm.clone();
    tokio::spawn(async move {
        while later.lock().wanted.is_empty() {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        later.lock().ready.push(Lease { task_id: task, ..lease(2) });
    });
    assert_eq!(agent.run_task(task, CancellationToken::new()).await.unwrap(), Errand::Ended);
    {
        let mut farm = farm.lock();
        assert_eq!((farm.reports.len(), farm.reports[0].fence), (1, 2));
        assert!(farm.wanted.len() > 1 && farm.wanted.iter().all(|&wanted| wanted == Some(task)));
        farm.over = true;
    }
    let errand = agent.run_task(task, CancellationToken::new()).await.unwrap();
    assert!(matches!(&errand, Errand::Needless(_)), "{errand:?}");
    {
        let mut farm = farm.lock();
        farm.over = false;
        farm.ready.push(Lease { task_id: task, ..lease(3) });
        farm.refuse_reports.push(ProblemKind::LeaseLost);
        farm.reports.clear();
    }
    assert_eq!(agent.run_task(task, CancellationToken::new()).await.unwrap(), Errand::Dropped);
    let stop = CancellationToken::new();
    let stopping = stop.clone();
    tokio::spawn(async move {
        tokio::time::sleep(Duration::from_millis(50)).await;
        stopping.cancel();
    });
    assert_eq!(agent.run_task(task, stop).await.unwrap(), Errand::Stopped);
    assert_eq!(farm.lock().reports.len(), 1);
}

#[tokio::test]
async fn a_worker_whose_node_sleeps_asks_for_nothing_until_it_wakes_up() {
    let begun = Instant::now();
    let rig = Rig::new(Farm { asleep: Some(2), ..Farm::default() }, Slow::new(Duration::ZERO)).await;
    rig.until("it has woken up", |farm| farm.wanted.len() > 1).await;
    assert!(begun.elapsed() >= Duration::from_secs(2), "it asked in its sleep");
    rig.end().await;
}

#[tokio::test]
async fn the_heartbeat_sends_a_worker_to_sleep_after_its_task() {
    let farm = Farm { ready: vec![lease(1)], bedtime: Some(60_000_000), ..Farm::default() };
    let rig = Rig::new(farm, Slow::new(LONG)).await;
    // The answer to the first heartbeat was read before the second.
    rig.until("it heard of its sleep", |farm| farm.renewals.len() >= 2).await;
    rig.end_work();
    rig.until("the task is done", |farm| farm.reports.len() == 1).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert_eq!(rig.farm.lock().wanted.len(), 1, "it asked for more");
    // It stops at once when told to.
    let begun = Instant::now();
    rig.end().await;
    assert!(begun.elapsed() < Duration::from_secs(30), "it slept for a minute first");
}

#[tokio::test]
async fn a_frame_whose_profile_is_damaged_is_rendered_without_it_and_one_without_its_parts_is_not() {
    let hash = ArtifactHash([7; 32]);
    for (profile, parts, runs) in [(Some(hash), Vec::new(), 1), (None, vec![hash], 0)] {
        let spec: RenderSpec = serde_json::from_value(serde_json::json!({
            "job_id": JobId::new(), "bundle": BundleSource::Path("/".into()), "digest": SceneDigest([0; 32]),
            "frame": 0, "settings": JobSettings::from(RenderSettingsRequest::default().complete((4, 4))),
            "profile": profile, "parts": parts,
        }))
        .unwrap();
        let lease = Lease { spec: TaskSpec::Render(spec), ..lease(1) };
        let farm = Farm { ready: vec![lease], artifacts_are_damaged: true, ..Farm::default() };
        let rig = Rig::new(farm, Slow::new(Duration::ZERO)).await;
        rig.until("the task was reported", |farm| !farm.reports.is_empty()).await;
        assert_eq!(rig.farm.lock().reports[0].result.is_some(), runs == 1);
        assert_eq!(rig.end().await.runs.load(Ordering::SeqCst), runs);
    }
}
