//! A farm in a temporary folder, with a clock that stands still unless told.

use std::collections::BTreeSet;
use std::time::Duration;

use forelight_protocol::{
    ArtifactHash, BundleRef, BundleSource, CacheFillResult, CacheMergeResult, CachePlanResult, Capabilities,
    DivideResult, Event, EventKind, FinishedPart, FixedCosts, ForecastTotals, FrameForecast, FrameStrata,
    Job, JobId, JobRequest, JobVerdict, Lease, Node, NodeId, NodeRegistration, PartPixels, PartRange,
    PlanReason, PreviewBackend, PreviewResult, ProfileArtifacts, ProfileResult, ProfileSample, Profiled,
    Quantiles, RayQuantiles, Rays, RenderArtifacts, RenderPartResult, RenderResult, RenderStats,
    RenewRequest, SampleRange, SampleShare, SceneDigest, SceneSummary, Spent, Stratum, StratumName,
    TaskResult, TaskSpec, Timestamp, Verdict,
};
use forelight_quote::{JobForecast, QuoteBasis};
use tempfile::TempDir;

use self::new_database::new_database;
use crate::database::DATABASE;
use crate::{Answered, NewBooking, NewJob, NewJobPlan, NewPlan, Store, StoreError};

mod artifacts;
mod calibration;
mod claims;
mod division;
mod failures;
mod fencing;
mod jobs;
mod joining;
mod living;
mod lying_farm;
#[path = "../../../tests/support/new_database.rs"]
mod new_database;
mod node_learning;
mod opening;
mod orders;
mod outputs;
mod plans;
mod records;
mod retention;
mod serial_time;
mod shared_cache;
mod spending;
mod statements;
mod trust;
mod unattended;
mod versions;
mod webhooks;
mod work_stealing;
mod writing;

const TTL: Duration = Duration::from_secs(30);
const SECOND: i64 = 1_000_000;

fn at(seconds: i64) -> Timestamp {
    Timestamp::from_micros(1_800_000_000_000_000).plus_micros(seconds * SECOND)
}

fn fresh<T>(answered: Answered<T>) -> T {
    match answered {
        Answered::Fresh(value) => value,
        Answered::Repeated(answer) => panic!("this was answered before: {}", answer.body),
    }
}

/// The node is heard of.
async fn touch(store: &Store, node: NodeId, now: Timestamp) {
    let mut write = store.write().await.unwrap();
    crate::leases::touch(&mut write, node, now);
    store.commit(write).await.unwrap();
}

struct Farm {
    folder: TempDir,
    store: Store,
}

impl Farm {
    async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(DATABASE), new_database().await).unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        Self { folder, store }
    }

    /// What a dashboard shows.
    async fn dashboard(&self, now: Timestamp) -> forelight_protocol::Dashboard {
        let (bookings, parts) =
            (self.store.open_bookings().await.unwrap(), self.store.open_cache_parts().await.unwrap());
        let record = self.store.track_record_totals(None).await.unwrap();
        let known = (&crate::project(&bookings, &parts, now), &record);
        self.store.dashboard(known, None, TTL, now).await.unwrap()
    }

    /// The service dies and is started again.
    async fn restarted(self) -> Self {
        let Self { folder, store } = self;
        drop(store);
        let store = reopen(folder.path()).await;
        Self { folder, store }
    }

    async fn node(&self, name: &str) -> Node {
        fresh(self.store.register_node(&registration(name), None, at(0)).await.unwrap())
    }

    /// The node after its worker was started again.
    async fn new_worker(&self, name: &str, now: Timestamp) -> Node {
        let started = NodeRegistration { worker: Some(uuid::Uuid::now_v7()), ..registration(name) };
        fresh(self.store.register_node(&started, None, now).await.unwrap())
    }

    async fn job(&self, frames: &str) -> Job {
        self.submit(request(frames)).await
    }

    async fn submit(&self, request: JobRequest) -> Job {
        fresh(self.store.create_job(&new_job(request), None, at(0)).await.unwrap())
    }

    async fn claim(&self, node: NodeId, now: Timestamp) -> Option<Lease> {
        self.store.claim(node, TTL, None, now).await.unwrap().map(fresh)
    }

    async fn artifact(&self, content: &'static str) -> ArtifactHash {
        let hash = ArtifactHash(*blake3::hash(content.as_bytes()).as_bytes());
        self.store.artifacts().put(hash, stream(&[content]), 1000, at(0)).await.unwrap();
        hash
    }

    /// All events of a kind.
    async fn events(&self, kind: EventKind) -> Vec<Event> {
        let all = self.store.events_after(None, 0, 1000).await.unwrap();
        all.into_iter().filter(|event| event.kind == kind).collect()
    }

    async fn commit(&self, lease: &Lease, now: Timestamp) -> crate::Committed {
        let result = self.result_for(lease).await;
        self.store.commit_result(lease.lease_id, lease.fence, &result, now).await.unwrap()
    }

    async fn result_for(&self, lease: &Lease) -> TaskResult {
        let image = self.artifact("an image").await;
        match &lease.spec {
            TaskSpec::Preview(spec) => TaskResult::Preview(preview_result(&spec.frames, image)),
            TaskSpec::Profile(spec) => {
                TaskResult::Profile(profile_result(spec.frame, self.artifact("a profile").await))
            }
            TaskSpec::Divide(spec) => {
                // A frame in passes has one of them.
                let is_over = spec.passes.as_ref().is_some_and(|passes| !passes.before.is_empty());
                let parts = if is_over { 0 } else { spec.parts };
                let samples = if spec.passes.is_some() && !is_over {
                    Some(self.artifact("samples of a pass").await)
                } else {
                    None
                };
                TaskResult::Divide(DivideResult {
                    expected_work: None,
                    ends: (1..=parts).map(|part| part * 100).collect(),
                    work: vec![10; parts as usize],
                    cache: None,
                    coarse_png: Some(self.artifact("a coarse picture").await),
                    samples,
                    spent: Spent { work: 10, cpu_nanos: 500 },
                })
            }
            TaskSpec::RenderPart(spec) => {
                let hash = self.artifact("a part").await;
                let cost = Spent { work: 10, cpu_nanos: 500 };
                TaskResult::RenderPart(RenderPartResult {
                    finished: match spec.range {
                        Some(PartRange::Samples(SampleRange { offset, count })) => {
                            FinishedPart::Samples(SampleShare { offset, count, cpu_nanos: 500, hash })
                        }
                        _ => FinishedPart::Pixels(PartPixels { hash, count: 100, cost }),
                    },
                    rest: None,
                    spent: cost,
                    peak_memory_bytes: 0,
                })
            }
            TaskSpec::Video(_) => panic!("no job of these tests has a video"),
            TaskSpec::CachePlan(_) => TaskResult::CachePlan(CachePlanResult {
                cache: Some(self.artifact("a plan").await),
                bytes: 6,
                records: vec![50, 20],
                frames: Vec::new(),
                spent: Spent { work: 10, cpu_nanos: 500 },
            }),
            TaskSpec::CacheFill(spec) => TaskResult::CacheFill(CacheFillResult {
                cache: self.artifact(["part 0", "part 1", "part 2"][spec.part as usize]).await,
                bytes: 6,
                filled: 10,
                full: spec.parts == 1,
                spent: Spent { work: 100, cpu_nanos: 1_000_000_000 },
            }),
            TaskSpec::CacheMerge(spec) => TaskResult::CacheMerge(CacheMergeResult {
                cache: self.artifact(["half a cache", "a cache"][spec.round as usize]).await,
                bytes: 6,
                full: spec.round == 1,
                spent: Spent { work: 0, cpu_nanos: 500 },
            }),
            TaskSpec::Render(spec) => TaskResult::Render(RenderResult {
                stats: stats(spec.frame),
                artifacts: RenderArtifacts {
                    image_exr: image,
                    image_png: image,
                    cost_map_png: image,
                    preview_png: None,
                },
            }),
        }
    }

    /// Takes a job through preview and profile to `booked`, all on `node`, one frame after the other from
    /// `start`.
    async fn booked_job(&self, request: JobRequest, node: NodeId, start: Timestamp) -> JobId {
        self.quoted_job(request, node, start, &job_forecast(), None).await
    }

    /// The same with a forecast that may be learnt from.
    async fn quoted_job(
        &self,
        request: JobRequest,
        node: NodeId,
        start: Timestamp,
        forecast: &JobForecast,
        basis: Option<&QuoteBasis>,
    ) -> JobId {
        let job = self.submit(request).await;
        let preview = self.claim(node, at(0)).await.expect("a preview");
        assert_eq!(preview.job_id, job.id);
        self.commit(&preview, at(0)).await;
        let first = job.frames.iter().next().unwrap();
        self.store.start_profiling(job.id, &[first], false, at(0)).await.unwrap();
        let profile = self.claim(node, at(0)).await.expect("a profile");
        self.commit(&profile, at(0)).await;
        let plan = self.plan_for(&job, node, start).await;
        let frames = frame_forecasts(&job);
        self.store.book(job.id, forecast, &frames, basis, &plan, at(0)).await.unwrap();
        job.id
    }

    async fn plan_for(&self, job: &Job, node: NodeId, start: Timestamp) -> NewPlan {
        let bookings: Vec<_> = job
            .frames
            .iter()
            .zip(0i64..)
            .map(|(frame, i)| NewBooking {
                frame: frame.into(),
                node,
                start: start.plus_micros(i * 10 * SECOND),
                end: start.plus_micros((i + 1) * 10 * SECOND),
            })
            .collect();
        NewPlan {
            parent: self.store.newest_plan().await.unwrap(),
            reason: PlanReason::JobForecast,
            shared_cache: None,
            wanted: self.store.wanted_plan().await.unwrap(),
            jobs: vec![NewJobPlan {
                verdict: verdict(job.id),
                bookings,
                begun: BTreeSet::new(),
                factor: 1.0,
                terms: 0,
            }],
            outlooks: Vec::new(),
            finish: None,
        }
    }
}

fn registration(name: &str) -> NodeRegistration {
    NodeRegistration {
        name: name.to_owned(),
        speed: 2.0,
        price_per_hour: forelight_protocol::Money(1_000_000),
        cores: 1,
        capabilities: Capabilities::default(),
        schedule: None,
        worker: None,
    }
}

fn renewal(fence: u64, progress: f64) -> RenewRequest {
    RenewRequest { fence, progress, ..RenewRequest::default() }
}

fn preview_result(frames: &[u32], image: ArtifactHash) -> PreviewResult {
    let strata_of = |&frame: &u32| FrameStrata {
        frame,
        pixels: vec![60],
        background: 4,
        cache_records: Vec::new(),
        cache_plan: None,
        lights: 0,
        shining: 0,
        triangles: 0,
        preview_png: Some(image),
    };
    PreviewResult {
        strata: vec![stratum()],
        background_prior_cost: 0.1,
        record_prior_cost: None,
        frames: frames.iter().map(strata_of).collect(),
        backend: PreviewBackend::Cpu,
        spent: Spent { work: 100, cpu_nanos: 1000 },
        described: None,
    }
}

fn profile_result(frame: u32, profile: ArtifactHash) -> ProfileResult {
    ProfileResult {
        frame,
        strata: vec![stratum()],
        samples: vec![ProfileSample {
            pixel: 3,
            stratum: 0,
            work: 10,
            extra_work: 0,
            work_by_ray: [1, 3, 0, 0, 0, 6, 0],
            cpu_nanos: 500,
            rays: [1, 2, 0, 0, 0, 3, 0],
        }],
        uncovered: None,
        shared_samples: Vec::new(),
        shared_cache_samples: Vec::new(),
        cache_samples: Vec::new(),
        noise: Vec::new(),
        samples_for_error: None,
        effects: vec!["ambient".to_owned()],
        work_by_class: None,
        left_out: Vec::new(),
        renderer: None,
        fixed: FixedCosts::default(),
        ladders: None,
        file_bytes: None,
        once: None,
        spent: Spent { work: 10, cpu_nanos: 500 },
        artifacts: ProfileArtifacts { profile, preview_png: None },
    }
}

/// The last clone of the store releases the lock, and connections close in the background.
async fn reopen(folder: &std::path::Path) -> Store {
    for _ in 0..200 {
        match Store::open(folder).await {
            Err(crate::StoreError::InUse(_)) => tokio::time::sleep(Duration::from_millis(10)).await,
            other => return other.unwrap(),
        }
    }
    panic!("the data folder is still locked");
}

fn stream(parts: &[&'static str]) -> impl futures::Stream<Item = Result<bytes::Bytes, StoreError>> + use<> {
    let parts: Vec<_> = parts.iter().map(|part| Ok(bytes::Bytes::from_static(part.as_bytes()))).collect();
    futures::stream::iter(parts)
}

fn request(frames: &str) -> JobRequest {
    let json = serde_json::json!({"name": "a job", "bundle": {"path": "/scenes/a"}, "frames": frames});
    serde_json::from_value(json).unwrap()
}

fn new_job(request: JobRequest) -> NewJob {
    let settings = request.settings.complete((8, 8));
    assert!(request.bundle != BundleRef::default());
    NewJob {
        request,
        scene: scene(),
        source: BundleSource::Path("/scenes/a".to_owned()),
        settings: settings.into(),
    }
}

fn scene() -> SceneSummary {
    SceneSummary {
        name: "a".to_owned(),
        digest: SceneDigest([7; 32]),
        frames: 100,
        width: 8,
        height: 8,
        objects: 1,
        materials: 1,
        triangles: 2,
        frames_per_second: None,
    }
}

fn stratum() -> Stratum {
    let name = StratumName { object: "floor".to_owned(), material: "wood".to_owned() };
    Stratum { name, object: 0, material: 0, prior_cost: 1.0 }
}

fn stats(frame: u32) -> RenderStats {
    RenderStats {
        frame,
        width: 8,
        height: 8,
        spp: 16,
        allotted: None,
        denoised: None,
        effects: vec!["ambient".to_owned()],
        left_out: Vec::new(),
        rays: Rays { primary: 1024, ..Rays::default() },
        cache_records: Vec::new(),
        cache: None,
        cache_choice: None,
        work: 1000,
        work_by_class: None,
        work_by_ray: Some(Rays { primary: 900, ..Rays::default() }),
        cpu_seconds: 2.0,
        once: None,
        wall_seconds: 2.0,
        peak_rss_bytes: 1,
        reused_pixels: 0,
        reused_rays: 0,
        reused_work: 0,
        reused_cpu_seconds: 0.0,
    }
}

fn verdict(job_id: JobId) -> JobVerdict {
    JobVerdict {
        job_id,
        verdict: Verdict::OnTime,
        confidence: forelight_protocol::Confidence::P80,
        finish: Some(at(100)),
        cost: Some(forelight_protocol::Money(5)),
        reasons: Vec::new(),
        ways_out: Vec::new(),
    }
}

fn job_forecast() -> JobForecast {
    JobForecast {
        profiled: Profiled { frames: vec![0], pixels: 1 },
        effects: vec!["ambient".to_owned()],
        ..JobForecast::default()
    }
}

fn frame_forecasts(job: &Job) -> Vec<FrameForecast> {
    job.frames
        .iter()
        .map(|frame| FrameForecast {
            frame,
            rays: RayQuantiles::default(),
            cache_records: Vec::new(),
            work: Quantiles { mean: 900.0, p50: 900.0, p80: 1000.0, p95: 1100.0 },
            cpu_seconds: Quantiles { mean: 4.0, p50: 3.0, p80: 3.5, p95: 5.0 },
        })
        .collect()
}
