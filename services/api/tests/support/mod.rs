//! A service in a temporary folder, callers of every role, and a worker with made-up results.

#![allow(dead_code, reason = "each test program uses a part of this")]

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use forelight_api::{Config, Evidence, ManualClock, Service};
use forelight_protocol::{
    ArtifactHash, ForecastDoc, Job, JobState, Lease, Node, ResultAnswer, ResultRequest, Role, TaskKind,
    TaskResult, Timestamp,
};
use forelight_store::{DATABASE, Store, tokens};
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};
use tempfile::TempDir;

pub mod copies;
#[path = "../../../../tests/support/events.rs"]
pub mod events;
#[path = "../../../../tests/support/http.rs"]
pub mod http;
pub mod made_up;
#[path = "../../../../tests/support/new_database.rs"]
mod new_database;
#[path = "../../../../tests/support/waiting.rs"]
mod waiting;

pub use http::{Answer, Http};
use new_database::new_database;

pub struct Farm {
    pub folder: TempDir,
    pub service: Service,
    pub operator: Http,
    pub submitter: Http,
    pub worker: Http,
    pub viewer: Http,
    pub nobody: Http,
}

/// A quad of 8 × 8 pixels, 20 frames.
pub fn write_scene(folder: &Path) {
    std::fs::create_dir_all(folder).unwrap();
    for (name, content) in scene_files() {
        std::fs::write(folder.join(name), content).unwrap();
    }
}

fn scene_files() -> [(&'static str, String); 3] {
    let scene = json!({
        "version": 1, "name": "quad", "geometry": ["quad.obj"],
        "camera": {"origin": [0, 0, 3], "target": [0, 0, 0], "up": [0, 1, 0], "fov_deg": 40, "fov_axis": "x", "width": 8, "height": 8},
        "environment": {"type": "constant", "radiance": [1, 1, 1]},
        "animation": {"fps": 25, "frames": 20, "tracks": []},
    });
    let geometry =
        "mtllib quad.mtl\no quad\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nusemtl paint\nf 1 2 3 4\n";
    let materials = "newmtl paint\nillum 1\nKd 0.5 0.5 0.5\n";
    [("scene.json", scene.to_string()), ("quad.obj", geometry.to_owned()), ("quad.mtl", materials.to_owned())]
}

pub fn scene_zip() -> Vec<u8> {
    use std::io::Write as _;
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, content) in scene_files() {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(content.as_bytes()).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

pub fn config(folder: &Path) -> Config {
    let mut config = Config::new(folder.join("data"));
    config.listen = SocketAddr::from(([127, 0, 0, 1], 0));
    config.bundle_roots = vec![folder.join("scenes")];
    config.evidence = Evidence::Believed;
    config
}

/// How long a test waits for what must come, and the longest silence of a stream. However busy the machine
/// is, only a defect takes so long.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// Length of a short lease, in microseconds.
pub const LEASE: i64 = 400_000;

/// Asks again and again until there is an answer.
pub async fn eventually<T>(what: &str, ask: impl AsyncFnMut() -> Option<T>) -> T {
    waiting::eventually(what, PATIENCE, ask).await
}

/// Waits until this is so.
pub async fn until(what: &str, mut is_so: impl AsyncFnMut() -> bool) {
    eventually(what, async || is_so().await.then_some(())).await;
}

/// Retries while the previous service still holds the lock, which ends with its last connection.
pub async fn start(config: &Config) -> Service {
    eventually("the data folder is free", async || match Service::start(config.clone()).await {
        Err(error) if error.to_string().contains("another service") => None,
        other => Some(other.unwrap_or_else(|error| panic!("{error}"))),
    })
    .await
}

pub fn address(service: &Service) -> String {
    format!("http://{}", service.local_addr())
}

impl Farm {
    pub async fn new() -> Self {
        Self::with(|_| {}).await
    }

    /// A farm whose time passes as the test says.
    pub async fn with_clock() -> (Self, Arc<ManualClock>) {
        Self::with_clock_at(Timestamp::now(), |_| {}).await
    }

    /// The same with leases of [`LEASE`]. The service looks for expired ones ten times a second of real time.
    pub async fn with_short_leases() -> (Self, Arc<ManualClock>) {
        Self::with_clock_at(Timestamp::now(), |config| config.lease_ttl = Duration::from_micros(LEASE as u64))
            .await
    }

    /// The same with other settings, from this time on.
    pub async fn with_clock_at(now: Timestamp, change: impl FnOnce(&mut Config)) -> (Self, Arc<ManualClock>) {
        let clock = Arc::new(ManualClock::at(now));
        let own = clock.clone();
        let farm = Self::with(|config| {
            config.clock = own;
            change(config);
        });
        (farm.await, clock)
    }

    pub async fn with(change: impl FnOnce(&mut Config)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        write_scene(&folder.path().join("scenes/quad"));
        let mut config = config(folder.path());
        change(&mut config);
        std::fs::create_dir_all(&config.data_dir).unwrap();
        std::fs::write(config.data_dir.join(DATABASE), new_database().await).unwrap();
        let service = start(&config).await;
        let mut clients = Vec::new();
        for role in Role::ALL {
            let token = tokens::create(service.store(), role, role.name(), Timestamp::now()).await.unwrap();
            clients.push(Http::new(&address(&service), Some(token)));
        }
        let [submitter, worker, operator, viewer] = clients.try_into().ok().unwrap();
        let nobody = Http::new(&address(&service), None);
        Self { folder, service, operator, submitter, worker, viewer, nobody }
    }

    /// Kills the service and starts it again.
    pub async fn killed_and_restarted(self) -> Self {
        self.restarted_with(|_| {}).await
    }

    /// The same with another configuration.
    pub async fn restarted_with(self, change: impl FnOnce(&mut Config)) -> Self {
        let Self { folder, service, operator, submitter, worker, viewer, nobody } = self;
        drop(service);
        let mut config = config(folder.path());
        change(&mut config);
        let service = start(&config).await;
        let address = address(&service);
        Self {
            folder,
            operator: operator.at(&address),
            submitter: submitter.at(&address),
            worker: worker.at(&address),
            viewer: viewer.at(&address),
            nobody: nobody.at(&address),
            service,
        }
    }

    pub fn bundle_path(&self) -> PathBuf {
        self.folder.path().join("scenes/quad")
    }

    pub fn job_request(&self, frames: &str) -> Value {
        json!({"name": "a job", "bundle": {"path": self.bundle_path()}, "frames": frames, "samples": 16, "profile_frames": 2})
    }

    /// Makes a project, as an operator does.
    pub async fn project(&self, name: &str) {
        let made = self.operator.post("/v1/projects", &json!({"project": name, "share": 1})).await;
        assert_eq!(made.status(), StatusCode::OK);
    }

    pub async fn submit(&self, frames: &str) -> Job {
        self.submitter.post("/v1/jobs", &self.job_request(frames)).await.parsed(StatusCode::CREATED).await
    }

    pub async fn node(&self, name: &str) -> Node {
        let registration = json!({"name": name, "speed": 2.0, "price_per_hour": 3_600_000, "cores": 2});
        self.worker.post("/v1/nodes", &registration).await.parsed(StatusCode::CREATED).await
    }

    /// Changes a node, as an operator does.
    pub async fn order(&self, node: &Node, order: Value) -> Node {
        let patch = self.operator.request(Method::PATCH, &format!("/v1/nodes/{}", node.id));
        patch.json(&order).send().await.unwrap().parsed(StatusCode::OK).await
    }

    pub async fn job(&self, job: &Job) -> Job {
        self.viewer.get(&format!("/v1/jobs/{}", job.id)).await.parsed(StatusCode::OK).await
    }

    pub async fn claim(&self, node: &Node) -> Option<Lease> {
        self.claim_waiting(node, 0).await
    }

    pub async fn claim_waiting(&self, node: &Node, wait_ms: u32) -> Option<Lease> {
        let response = self.worker.post("/v1/leases", &json!({"node_id": node.id, "wait_ms": wait_ms})).await;
        if response.status() == StatusCode::NO_CONTENT {
            return None;
        }
        Some(response.parsed(StatusCode::OK).await)
    }

    /// Claims a task, waiting for the conductor to make it.
    pub async fn next_task(&self, node: &Node) -> Lease {
        eventually("a task", async || self.claim_waiting(node, 10_000).await).await
    }

    /// Waits until the node was heard of later than this: a claim is there that waits.
    pub async fn until_heard_of_since(&self, node: &Node) {
        let path = format!("/v1/nodes/{}", node.id);
        until("the node is heard of", async || {
            self.viewer.json::<Node>(&path).await.last_seen_at > node.last_seen_at
        })
        .await;
    }

    pub async fn artifact(&self, content: &[u8]) -> ArtifactHash {
        let hash = ArtifactHash(*blake3::hash(content).as_bytes());
        let put = self.worker.request(Method::PUT, &format!("/v1/artifacts/{hash}")).body(content.to_vec());
        assert!(put.send().await.unwrap().status().is_success());
        hash
    }

    pub async fn report(&self, lease: &Lease, result: TaskResult) -> Response {
        let request = ResultRequest { fence: lease.fence, result: Some(result), ..ResultRequest::default() };
        self.worker.post(&format!("/v1/leases/{}/result", lease.lease_id), &request).await
    }

    pub async fn finish(&self, lease: &Lease) -> ResultAnswer {
        let result = self.made_up_result(lease).await;
        self.report(lease, result).await.parsed(StatusCode::OK).await
    }

    /// Fails a task while the bundle of all jobs is gone, which fails the job at once.
    pub async fn fail_without_bundle(&self, lease: &Lease) {
        let (bundle, elsewhere) = (self.bundle_path(), self.folder.path().join("elsewhere"));
        std::fs::rename(&bundle, &elsewhere).unwrap();
        let failed = serde_json::json!({"fence": lease.fence, "error": {"message": "no such file"}});
        let answer = self.worker.post(&format!("/v1/leases/{}/result", lease.lease_id), &failed).await;
        let answer: ResultAnswer = answer.parsed(StatusCode::OK).await;
        assert_eq!(answer.job_state, JobState::Failed);
        std::fs::rename(&elsewhere, &bundle).unwrap();
    }

    /// Works until the job is over.
    pub async fn work_off(&self, node: &Node, job: &Job) -> Job {
        loop {
            let job = self.job(job).await;
            if job.state.is_final() {
                return job;
            }
            if let Some(lease) = self.claim_waiting(node, 5000).await {
                self.finish(&lease).await;
            }
        }
    }

    /// The quote of a job.
    pub async fn quote(&self, job: &Job) -> ForecastDoc {
        self.viewer.get(&format!("/v1/jobs/{}/forecast", job.id)).await.parsed(StatusCode::OK).await
    }

    /// Takes a job to where its first frame, or what divides it, can be claimed.
    pub async fn until_booked(&self, node: &Node, job: &Job) -> Job {
        eventually("the job is booked", async || {
            let job = self.job(job).await;
            if !matches!(job.state, JobState::Previewing | JobState::Profiling) {
                return Some(job);
            }
            match self.claim(node).await {
                Some(lease) if matches!(lease.spec.kind(), TaskKind::Preview | TaskKind::Profile) => {
                    self.finish(&lease).await;
                }
                // A frame, of this job or of another.
                Some(Lease { lease_id, fence, .. }) => {
                    let path = format!("/v1/leases/{lease_id}/release");
                    let released = self.worker.post(&path, &json!({"fence": fence})).await;
                    assert_eq!(released.status(), StatusCode::NO_CONTENT);
                }
                None => {}
            }
            None
        })
        .await
    }

    /// Waits until this is so of the job.
    pub async fn until(&self, job: &Job, what: &str, is_so: impl Fn(&Job) -> bool) -> Job {
        eventually(what, async || Some(self.job(job).await).filter(&is_so)).await
    }
}
