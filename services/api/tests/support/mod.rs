//! A service in a temporary folder, clients of every role, and a worker that makes its results up.

#![allow(dead_code, reason = "each test program uses a part of this")]

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use forelight_api::{Config, Service};
use forelight_protocol::{
    AccuracyDoc, AccuracyRung, AllottedStats, ArtifactHash, ByClass, FixedCosts, FrameStrata, ImageError,
    Job, JobState, LadderKind, Lease, MissingLadder, Node, NoiseCell, NoiseSample, PreviewBackend,
    PreviewResult, ProfileArtifacts, ProfileResult, ProfileSample, ProfileSpec, Profiled, Quantiles, Rays,
    RenderArtifacts, RenderResult, RenderStats, ResultAnswer, ResultRequest, Role, Spent, SpentOnForecast,
    Stratum, StratumName, TaskKind, TaskResult, TaskSpec, Timestamp,
};
use forelight_store::tokens;
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};
use tempfile::TempDir;

#[path = "../../../../tests/support/events.rs"]
pub mod events;
#[path = "../../../../tests/support/http.rs"]
pub mod http;

pub use http::{Answer, Http};

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
        "animation": {"fps": 24, "frames": 20, "tracks": []},
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
    config
}

/// The lock goes with the last connection of the service before.
pub async fn start(config: &Config) -> Service {
    for _ in 0..500 {
        match Service::start(config.clone()).await {
            Err(error) if error.to_string().contains("another service") => {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            other => return other.unwrap_or_else(|error| panic!("{error}")),
        }
    }
    panic!("the data folder stays locked");
}

/// Where a service can be reached.
pub fn address(service: &Service) -> String {
    format!("http://{}", service.local_addr())
}

impl Farm {
    pub async fn new() -> Self {
        Self::with(|_| {}).await
    }

    pub async fn with(change: impl FnOnce(&mut Config)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        write_scene(&folder.path().join("scenes/quad"));
        let mut config = config(folder.path());
        change(&mut config);
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

    /// The service dies without a word and is started again.
    pub async fn killed_and_restarted(self) -> Self {
        let Self { folder, service, operator, submitter, worker, viewer, nobody } = self;
        drop(service);
        let service = start(&config(folder.path())).await;
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

    pub async fn submit(&self, frames: &str) -> Job {
        self.submitter.post("/v1/jobs", &self.job_request(frames)).await.parsed(StatusCode::CREATED).await
    }

    pub async fn node(&self, name: &str) -> Node {
        let registration = json!({"name": name, "speed": 2.0, "price_per_hour": 3_600_000, "cores": 2});
        self.worker.post("/v1/nodes", &registration).await.parsed(StatusCode::CREATED).await
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

    /// Claims, waiting for the conductor to have made the task.
    pub async fn next_task(&self, node: &Node) -> Lease {
        self.claim_waiting(node, 10_000).await.expect("a task within ten seconds")
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

    /// Takes a job to where its first frame could be claimed.
    pub async fn until_booked(&self, node: &Node, job: &Job) -> Job {
        for _ in 0..500 {
            let job = self.job(job).await;
            if !matches!(job.state, JobState::Previewing | JobState::Profiling) {
                return job;
            }
            match self.claim(node).await {
                Some(lease) if lease.spec.kind() != TaskKind::Render => {
                    self.finish(&lease).await;
                }
                claimed => {
                    // A frame of another job: not what is wanted here.
                    if let Some(Lease { lease_id, fence, .. }) = claimed {
                        let path = format!("/v1/leases/{lease_id}/release");
                        let released = self.worker.post(&path, &json!({"fence": fence})).await;
                        assert_eq!(released.status(), StatusCode::NO_CONTENT);
                    }
                    tokio::time::sleep(Duration::from_millis(10)).await;
                }
            }
        }
        panic!("the job was not booked in time");
    }

    /// 48 pixels of the quad and 16 of nothing; a quad's pixel costs 1000 in frame 0 and 1 % more in each frame after.
    pub async fn made_up_result(&self, lease: &Lease) -> TaskResult {
        match &lease.spec {
            TaskSpec::Preview(spec) => TaskResult::Preview(PreviewResult {
                strata: vec![stratum()],
                background_prior_cost: 0.1,
                record_prior_cost: None,
                frames: spec
                    .frames
                    .iter()
                    .map(|&frame| FrameStrata {
                        frame,
                        pixels: vec![48],
                        background: 16,
                        cache_records: Vec::new(),
                        cache_plan: None,
                        lights: 0,
                        shining: 0,
                        triangles: 0,
                        preview_png: None,
                    })
                    .collect(),
                backend: PreviewBackend::Cpu,
                spent: Spent { work: 100, cpu_nanos: 100_000 },
            }),
            TaskSpec::Profile(spec) => {
                let samples = (0..spec.samples.min(64)).map(|pixel| {
                    let background = pixel % 4 == 3;
                    let work = if background { 10 } else { pixel_work(spec.frame) };
                    ProfileSample {
                        pixel,
                        stratum: u32::from(background),
                        work,
                        extra_work: 0,
                        work_by_ray: [work - work / 4, 0, 0, 0, 0, work / 4, 0],
                        cpu_nanos: work * 1_000_000,
                        rays: [u64::from(spec.settings.spp), 0, 0, 0, 0, 2, 0],
                    }
                });
                TaskResult::Profile(ProfileResult {
                    frame: spec.frame,
                    strata: vec![stratum()],
                    samples: samples.collect(),
                    uncovered: None,
                    shared_samples: Vec::new(),
                    shared_cache_samples: Vec::new(),
                    cache_samples: Vec::new(),
                    noise: made_up_noise(spec.settings.spp),
                    effects: vec!["ambient".to_owned()],
                    work_by_class: Some(ByClass { rays: 800, memory: 200, ..ByClass::default() }),
                    left_out: Vec::new(),
                    renderer: Some("made up 1".to_owned()),
                    fixed: FixedCosts {
                        load: Spent { work: 5, cpu_nanos: 5_000_000 },
                        ..FixedCosts::default()
                    },
                    once: None,
                    ladders: spec.ladders.then(|| Box::new(made_up_ladders(spec))),
                    spent: Spent { work: 1000, cpu_nanos: 1_000_000 },
                    artifacts: ProfileArtifacts {
                        profile: self.artifact(format!("profile of {}", spec.frame).as_bytes()).await,
                        preview_png: Some(self.artifact(b"a preview").await),
                    },
                })
            }
            TaskSpec::CachePlan(_) | TaskSpec::CacheFill(_) | TaskSpec::CacheMerge(_) => {
                panic!("these scenes have no irradiance caches")
            }
            TaskSpec::Render(spec) => {
                let work = 48 * pixel_work(spec.frame) + 16 * 10 + 5;
                TaskResult::Render(RenderResult {
                    stats: RenderStats {
                        frame: spec.frame,
                        width: spec.settings.width,
                        height: spec.settings.height,
                        spp: spec.settings.spp + u32::from(spec.work.is_some()),
                        allotted: spec.work.map(|_| {
                            Box::new(AllottedStats {
                                least: 1,
                                most: 4 * spec.settings.spp,
                                mean: f64::from(spec.settings.spp + 1),
                                error: ImageError { p05: 0.01, p50: 0.02, p80: 0.03, p95: 0.04 },
                                forecast: None,
                                within: None,
                            })
                        }),
                        effects: vec!["ambient".to_owned()],
                        left_out: Vec::new(),
                        rays: Rays { primary: 1024, ..Rays::default() },
                        cache_records: Vec::new(),
                        cache: None,
                        work,
                        work_by_class: None,
                        work_by_ray: Some(Rays { primary: work / 2, ..Rays::default() }),
                        cpu_seconds: work as f64 * 1e-3,
                        once: None,
                        wall_seconds: work as f64 * 1e-3,
                        peak_rss_bytes: 1,
                        reused_pixels: 0,
                        reused_rays: 0,
                        reused_work: 0,
                        reused_cpu_seconds: 0.0,
                    },
                    artifacts: RenderArtifacts {
                        image_exr: self.artifact(format!("image {}", spec.frame).as_bytes()).await,
                        image_png: self.artifact(b"a picture").await,
                        cost_map_png: self.artifact(b"a cost map").await,
                        preview_png: None,
                    },
                })
            }
        }
    }
}

/// The quad's pixels have a mean of 2 and a variance of 1 / n at n samples, those of nothing are 1 exactly.
fn made_up_noise(spp: u32) -> Vec<NoiseCell> {
    let doublings = spp.ilog2() as i32;
    let drops = |variance: f32| (1..=doublings).map(|k| variance * 0.5f32.powi(k)).collect();
    let cell = |pixels, brightness, variance| NoiseCell {
        pixels,
        samples: vec![NoiseSample { brightness, drops: drops(variance) }; 4],
    };
    vec![cell(48, 2.0, 1.0), cell(16, 1.0, 0.0)]
}

/// How many times what was asked for a made-up rung takes, and errs: those with a cache a tenth of their place on the ladder, others more than once.
pub fn made_up_times(kind: LadderKind, place: u32) -> f64 {
    match kind {
        LadderKind::CachedSamples => f64::from(place) / 10.0,
        _ => f64::from(place) + 1.0,
    }
}

fn made_up_ladders(spec: &ProfileSpec) -> AccuracyDoc {
    let even = |value| Quantiles { mean: value, p50: value, p80: value, p95: value };
    let rungs = LadderKind::ALL.into_iter().flat_map(|kind| {
        let rungs = kind.rungs(&spec.settings).unwrap_or_default();
        (1..).zip(rungs).map(move |(place, settings)| {
            let times = if settings == spec.settings { 1.0 } else { made_up_times(kind, place) };
            let error = times / 100.0;
            AccuracyRung {
                ladder: kind,
                asked_for: settings == spec.settings,
                settings,
                work: even(500.0 * times),
                cpu_seconds: even(2.0 * times),
                error: Some(ImageError { p05: error, p50: error, p80: error, p95: error }),
                worth_taking: false,
                next: None,
                measured: None,
            }
        })
    });
    AccuracyDoc {
        frames: 1,
        settings: spec.settings.clone(),
        rungs: rungs.collect(),
        missing: vec![MissingLadder { ladder: LadderKind::Divisions, reason: "too dear".to_owned() }],
        profiled: Profiled { frames: vec![spec.frame], pixels: 99 },
        spent: SpentOnForecast { work: 400, cpu_seconds: 1e-4, fraction_of_forecast: 0.5 },
        calibrated: false,
    }
}

fn pixel_work(frame: u32) -> u64 {
    1000 + 10 * u64::from(frame)
}

fn stratum() -> Stratum {
    let name = StratumName { object: "quad".to_owned(), material: "paint".to_owned() };
    Stratum { name, object: 0, material: 0, prior_cost: 1.0 }
}
