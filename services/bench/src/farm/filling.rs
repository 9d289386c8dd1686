//! Writes made-up jobs for a whole farm into a store.

use anyhow::{Result, anyhow, bail};
use bytes::Bytes;
use forelight_protocol::{
    ArtifactHash, BundleSource, Capabilities, Confidence, FrameForecast, FrameSet, Job, JobRequest,
    JobVerdict, Money, Node, NodeRegistration, PlanReason, Quantiles, RayQuantiles, Rays, RenderArtifacts,
    RenderResult, RenderStats, SceneDigest, SceneSummary, TaskKind, TaskResult, TaskSpec, Timestamp, Verdict,
};
use forelight_quote::JobForecast;
use forelight_store::{Answered, NewBooking, NewJob, NewJobPlan, NewPlan, Store, StoreError};
use image::{ImageFormat, Rgb32FImage, RgbImage};
use std::collections::BTreeSet;
use std::io::Cursor;
use std::time::Duration;

/// Duration of leases. Long, so that none expires during a measurement.
pub const LEASE: Duration = Duration::from_secs(30);

/// Width and height of every frame.
const SIZE: u32 = 8;

/// The files of every made-up frame. The farm checks that they are images of the frame's size.
#[derive(Debug, Clone, Copy)]
pub struct Images {
    /// The OpenEXR image.
    pub exr: ArtifactHash,
    /// The PNG image.
    pub png: ArtifactHash,
}

impl Images {
    pub fn new() -> Result<Self> {
        let [exr, png] = Self::files()?.map(|file| hash_of(&file));
        Ok(Self { exr, png })
    }

    fn files() -> Result<[Vec<u8>; 2]> {
        let mut exr = Cursor::new(Vec::new());
        Rgb32FImage::new(SIZE, SIZE).write_to(&mut exr, ImageFormat::OpenExr)?;
        Ok([exr.into_inner(), forelight_pictures::png(&RgbImage::new(SIZE, SIZE))?])
    }
}

fn hash_of(file: &[u8]) -> ArtifactHash {
    ArtifactHash(*blake3::hash(file).as_bytes())
}

/// Name of a simulated worker's node.
pub fn name_of(worker: u32) -> String {
    format!("node-{worker}")
}

/// Registers a node for each worker, then adds jobs with `frames` frames in total, ready to render. All are
/// booked on another node. Nodes come first: a node that joins later causes a new plan.
pub async fn fill(store: &Store, frames: u32, workers: u32) -> Result<Vec<Node>> {
    const FRAMES: u32 = 1000;
    /// Time of a frame in microseconds, as in `frame_forecasts` and `rendered`.
    const SECOND: i64 = 1_000_000;
    let now = Timestamp::now();
    let mut nodes = Vec::new();
    for worker in 0..workers {
        nodes.push(register(store, &name_of(worker)).await?);
    }
    let node = register(store, "planner").await?;
    for file in Images::files()? {
        let hash = hash_of(&file);
        let stream = futures::stream::iter([Ok::<_, StoreError>(Bytes::from(file))]);
        store.artifacts().put(hash, stream, 1 << 10, now).await?;
    }
    let mut left = frames;
    while left > 0 {
        let count = left.min(FRAMES);
        left -= count;
        let job = submit(store, count).await?;
        let lease = store.claim(node.id, LEASE, None, now).await?;
        let Some(Answered::Fresh(preview)) = lease else { bail!("the farm leased no preview task") };
        if preview.spec.kind() != TaskKind::Preview {
            bail!("the farm leased a {} task before the preview", preview.spec.kind());
        }
        store.commit_result(preview.lease_id, preview.fence, &previewed(&preview.spec)?, now).await?;
        // No frame is profiled. The forecast is made up, and the plan uses one node.
        store.start_profiling(job.id, &[], false, now).await?;
        // Bookings follow each other from an hour on, as long as forecast. So every result is in time and
        // calls for no new plan.
        let bookings: Vec<_> = (job.frames.iter().zip(i64::from(frames - left - count)..))
            .map(|(frame, place)| {
                let start = now.plus_micros((3600 + place) * SECOND);
                NewBooking { frame: frame.into(), node: node.id, start, end: start.plus_micros(SECOND) }
            })
            .collect();
        let finish = bookings.last().map(|booking| booking.end);
        let verdict = JobVerdict {
            job_id: job.id,
            verdict: Verdict::OnTime,
            confidence: Confidence::P80,
            finish,
            cost: Some(Money(0)),
            reasons: Vec::new(),
            ways_out: Vec::new(),
        };
        let plan = NewPlan {
            parent: store.newest_plan().await?,
            reason: PlanReason::JobForecast,
            shared_cache: None,
            wanted: store.wanted_plan().await?,
            jobs: vec![NewJobPlan { verdict, bookings, begun: BTreeSet::new(), factor: 1.0, terms: 0 }],
            finish: None,
            outlooks: Vec::new(),
        };
        store.book(job.id, &JobForecast::default(), &frame_forecasts(&job), None, &plan, now).await?;
    }
    Ok(nodes)
}

async fn register(store: &Store, name: &str) -> Result<Node> {
    match store.register_node(&registration(name), None, Timestamp::now()).await? {
        Answered::Fresh(node) => Ok(node),
        Answered::Repeated(_) => Err(anyhow!("a request without a key was answered before")),
    }
}

/// Registration of a simulated worker's node.
pub fn registration(name: &str) -> NodeRegistration {
    NodeRegistration {
        name: name.to_owned(),
        speed: 1.0,
        price_per_hour: Money(0),
        cores: 1,
        capabilities: Capabilities::default(),
        schedule: None,
        worker: None,
    }
}

async fn submit(store: &Store, frames: u32) -> Result<Job> {
    let request: JobRequest = serde_json::from_value(serde_json::json!({
        "name": "bench", "bundle": {"path": "/nowhere"}, "frames": FrameSet::range(0, frames - 1).to_string(),
    }))?;
    let scene = SceneSummary {
        name: "bench".to_owned(),
        digest: SceneDigest([0; 32]),
        frames,
        width: SIZE,
        height: SIZE,
        objects: 1,
        materials: 1,
        triangles: 2,
        frames_per_second: None,
    };
    let settings = request.settings.complete((SIZE, SIZE));
    let new = NewJob {
        request,
        scene,
        source: BundleSource::Path("/nowhere".to_owned()),
        settings: settings.into(),
    };
    match store.create_job(&new, None, Timestamp::now()).await? {
        Answered::Fresh(job) => Ok(job),
        Answered::Repeated(_) => Err(anyhow!("a request without a key was answered before")),
    }
}

fn previewed(spec: &TaskSpec) -> Result<TaskResult> {
    let TaskSpec::Preview(spec) = spec else { bail!("the task is a {}", spec.kind()) };
    let frames: Vec<serde_json::Value> = spec
        .frames
        .iter()
        .map(|frame| serde_json::json!({"frame": frame, "pixels": [], "background": 64, "cache_records": [], "preview_png": null}))
        .collect();
    Ok(serde_json::from_value(serde_json::json!({"preview": {
        "strata": [], "background_prior_cost": 1.0, "record_prior_cost": null, "frames": frames, "backend": "cpu",
        "spent": {"work": 0, "cpu_nanos": 0},
    }}))?)
}

/// A made-up result of a frame, as large as a real one.
pub fn rendered(images: Images, frame: u32, spp: u32) -> TaskResult {
    let Images { exr, png } = images;
    TaskResult::Render(RenderResult {
        stats: RenderStats {
            frame,
            width: SIZE,
            height: SIZE,
            spp,
            effects: vec!["ambient".to_owned()],
            left_out: Vec::new(),
            rays: Rays { primary: 64 * u64::from(spp), ..Rays::default() },
            cache_records: Vec::new(),
            cache: None,
            cache_choice: None,
            allotted: None,
            denoised: None,
            work: 1000,
            work_by_class: None,
            work_by_ray: None,
            cpu_seconds: 1.0,
            once: None,
            wall_seconds: 1.0,
            peak_rss_bytes: 1,
            reused_pixels: 0,
            reused_rays: 0,
            reused_work: 0,
            reused_cpu_seconds: 0.0,
        },
        artifacts: RenderArtifacts { image_exr: exr, image_png: png, cost_map_png: png, preview_png: None },
    })
}

fn frame_forecasts(job: &Job) -> Vec<FrameForecast> {
    let one = Quantiles { mean: 1.0, p50: 1.0, p80: 1.0, p95: 1.0 };
    let forecast = |frame| FrameForecast {
        frame,
        rays: RayQuantiles::default(),
        cache_records: Vec::new(),
        work: one,
        cpu_seconds: one,
    };
    job.frames.iter().map(forecast).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn the_farm_takes_made_up_results_for_possible_ones() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let node = fill(&store, 1, 1).await.unwrap()[0].id;
        let now = Timestamp::now();
        let Some(Answered::Fresh(lease)) = store.claim(node, LEASE, None, now).await.unwrap() else {
            panic!("the farm leased no frame")
        };
        let result = rendered(Images::new().unwrap(), 0, 1);
        store.check_evidence(lease.lease_id, lease.fence, &result, now).await.unwrap();
        store.commit_result(lease.lease_id, lease.fence, &result, now).await.unwrap();
    }
}
