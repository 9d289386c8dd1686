//! A shared irradiance cache made by a farm. The images equal those of one process with one cache file.

mod support;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use exr::prelude::{FlatSamples, ReadChannels as _, ReadLayers as _};
use forelight_client::{Client, Token};
use forelight_preview::Choice;
use forelight_protocol::{
    ArtifactHash, CacheSharing, Event, EventKind, ForecastDoc, FramePage, FrameRow, Job, JobState,
    NodeRegistration, Plan, ProblemKind, RenderSpec, Role, SharedCacheForecast, TaskKind, TaskResult,
    TaskSpec, Timestamp,
};
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Outcome};
use forelight_renderer_own::{OwnRenderer, TaskRunner};
use forelight_store::tokens;
use forelight_worker::{Agent, Bundles};
use reqwest::StatusCode;
use serde_json::json;
use support::{Answer, Farm};
use tokio_util::sync::CancellationToken;

/// Does tasks, but stops at the first part of a cache until it is killed.
struct Doomed {
    runner: TaskRunner,
    began: AtomicBool,
    dead: AtomicBool,
    fills: AtomicU32,
    /// Whether it stops at all.
    mortal: bool,
}

impl Execute for Doomed {
    fn execute(&self, assignment: &Assignment, control: &Control) -> Result<Outcome, ExecuteError> {
        if matches!(assignment.spec, TaskSpec::CacheFill(_)) {
            self.fills.fetch_add(1, Ordering::SeqCst);
            if self.mortal {
                control.set_progress(0.5);
                self.began.store(true, Ordering::SeqCst);
                while !self.dead.load(Ordering::SeqCst) {
                    std::thread::sleep(Duration::from_millis(5));
                }
                return Err(ExecuteError::Cancelled);
            }
        }
        self.runner.execute(assignment, control)
    }
}

struct Worker {
    executor: Arc<Doomed>,
    agent: tokio::task::JoinHandle<()>,
    stop: CancellationToken,
    _folder: tempfile::TempDir,
}

impl Worker {
    async fn new(farm: &Farm, name: &str, mortal: bool) -> Self {
        let token = tokens::create(farm.service.store(), Role::Worker, name, Timestamp::now()).await.unwrap();
        let address = support::address(&farm.service);
        let client = Client::new(&address, Some(Token::new(&token))).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let bundles = Arc::new(Bundles::new(folder.path()).unwrap());
        let executor = Arc::new(Doomed {
            runner: TaskRunner::new(OwnRenderer::new(Choice::Cpu)),
            began: AtomicBool::new(false),
            dead: AtomicBool::new(false),
            fills: AtomicU32::new(0),
            mortal,
        });
        let registration = NodeRegistration {
            name: name.to_owned(),
            speed: 1.0,
            price_per_hour: forelight_protocol::Money(3_600_000_000),
            cores: 1,
            capabilities: Default::default(),
            schedule: None,
            worker: None,
        };
        let agent = Agent::new(client, bundles, executor.clone(), registration).unwrap();
        let stop = CancellationToken::new();
        let stopped = stop.clone();
        let agent = tokio::spawn(async move {
            agent.run(stopped).await.unwrap();
        });
        Self { executor, agent, stop, _folder: folder }
    }

    /// Ends the worker without a message to the service.
    async fn kill(&mut self) {
        self.agent.abort();
        let _ = (&mut self.agent).await;
        self.executor.dead.store(true, Ordering::SeqCst);
    }
}

fn scenes() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenes").canonicalize().unwrap()
}

/// Samples of an image by channel, as bits, without the pixels' time.
fn channels(file: &[u8]) -> BTreeMap<String, Vec<u32>> {
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(std::io::Cursor::new(file))
        .unwrap();
    let bits = |samples: &FlatSamples| -> Vec<u32> {
        match samples {
            FlatSamples::F16(values) => values.iter().map(|value| u32::from(value.to_bits())).collect(),
            FlatSamples::F32(values) => values.iter().map(|value| value.to_bits()).collect(),
            FlatSamples::U32(values) => values.clone(),
        }
    };
    let all = image.layer_data.channel_data.list.iter();
    let all = all.map(|channel| (channel.name.to_string(), bits(&channel.sample_data)));
    let all: BTreeMap<_, _> = all.filter(|(name, _)| name != "cost.cpu_nanos").collect();
    assert!(all.len() > 3 && all.values().all(|samples| samples.len() == 64 * 36), "{:?}", all.keys());
    all
}

async fn until(what: &str, mut done: impl AsyncFnMut() -> bool) {
    let start = Instant::now();
    while !done().await {
        assert!(start.elapsed() < Duration::from_secs(300), "{what} took too long");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// The quote's shared cache. Asserts that both prices are there and that the cheaper way is taken.
fn quoted_cache(quote: &ForecastDoc) -> SharedCacheForecast {
    let cache = quote.cache.clone().unwrap();
    let (shared, private) = (cache.shared_price.unwrap(), cache.private_price);
    assert!(cache.shared && shared.work < private.work && shared.records < private.records, "{cache:?}");
    assert!(shared.cost.unwrap() < private.cost.unwrap() && cache.reason.contains("less work"), "{cache:?}");
    let line = cache.shared_cache.unwrap();
    assert_eq!(line.parts, 2);
    line
}

/// Asserts that one process with one cache file renders the same images at the same cost.
async fn assert_offline_images_are_the_same(
    farm: &Farm,
    job: &Job,
    frames: &[FrameRow],
    runner: &TaskRunner,
) {
    let shot = OwnRenderer::new(Choice::Cpu).open(&scenes().join("corridor")).unwrap();
    let never = AtomicBool::new(false);
    let settings = job.settings.own().unwrap();
    let planned = shot.plan_cache(&[0, 12, 24], settings, &|_| (), &never).unwrap().unwrap();
    let filled = shot.fill_cache(planned, settings, (0, 1), &|_, _| (), &never).unwrap().unwrap();
    let file = filled.to_bytes();
    let name = ArtifactHash(*blake3::hash(&file).as_bytes());
    for row in frames {
        let spec = RenderSpec {
            error_target: None,
            denoise: false,
            job_id: job.id,
            bundle: forelight_protocol::BundleSource::Path(scenes().join("corridor").display().to_string()),
            digest: job.scene.digest,
            frame: row.frame,
            settings: job.settings.clone(),
            renderer: None,
            work: None,
            profile: None,
            cache: Some(name),
            frame_cache: None,
            parts: Vec::new(),
            shares: Vec::new(),
        };
        let assignment = Assignment {
            caches: vec![file.clone().into()],
            ..Assignment::new(TaskSpec::Render(spec), scenes().join("corridor"))
        };
        let outcome = runner.execute(&assignment, &Control::default()).unwrap();
        let TaskResult::Render(offline) = outcome.result else { panic!() };
        let made = farm.viewer.get(&format!("/v1/jobs/{}/frames/{}/image.exr", job.id, row.frame)).await;
        let made = made.bytes().await.unwrap();
        let offline_image = outcome
            .artifacts
            .iter()
            .find(|file| ArtifactHash(*blake3::hash(file).as_bytes()) == offline.artifacts.image_exr);
        assert!(channels(&made) == channels(offline_image.unwrap()), "frame {}", row.frame);
        assert_eq!(offline.stats.work, row.actual.as_ref().unwrap().work);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cache_that_two_workers_make_while_one_dies_at_it_gives_the_images_of_one_that_is_made_offline() {
    let farm = Farm::with(|config| {
        config.bundle_roots.push(scenes());
        config.lease_ttl = Duration::from_secs(2);
    })
    .await;
    let mut doomed = Worker::new(&farm, "doomed", true).await;
    let other = Worker::new(&farm, "other", false).await;
    let request = json!({
        "name": "corridor", "bundle": {"path": scenes().join("corridor")}, "frames": "0,12,24",
        "settings": {"width": 64, "height": 36, "spp": 1, "ambient_bounces": 2, "cache": "on", "cache_rays": 48},
        "samples": 100, "profile_frames": 2,
    });
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    assert_eq!(job.cache, CacheSharing::Auto);

    until("its first part", async || doomed.executor.began.load(Ordering::SeqCst)).await;
    let waiting = farm.job(&job).await;
    let cache = waiting.shared_cache.expect("the frames share a cache");
    assert_eq!(
        (waiting.state, cache.parts, cache.ready),
        (JobState::Rendering, 4, false),
        "two parts of two levels"
    );
    doomed.kill().await;
    until("the job", async || farm.job(&job).await.state.is_final()).await;
    other.stop.cancel();
    let done = farm.job(&job).await;
    assert_eq!((done.state, done.error.as_deref()), (JobState::Done, None));
    let cache = done.shared_cache.unwrap();
    assert_eq!((cache.parts_done, cache.ready, cache.progress), (4, true, 1.0));
    assert_eq!(doomed.executor.fills.load(Ordering::SeqCst), 1);
    let events = farm.service.store().events_after(Some(job.id), 0, 10_000).await.unwrap();
    let seen = |kind: EventKind, of: TaskKind| {
        let is_it = |event: &&Event| event.kind == kind && event.task_kind == Some(of);
        events.iter().filter(is_it).count()
    };
    // On a machine that pauses, the other loses leases, too.
    let expired = seen(EventKind::LeaseExpired, TaskKind::CacheFill);
    let fills = other.executor.fills.load(Ordering::SeqCst) as usize;
    assert!(expired >= 1 && fills == 3 + expired, "what the dead one had was done by the other: {fills}");
    assert_eq!(seen(EventKind::TaskDone, TaskKind::CacheMerge), 2);

    // The quote has both prices, and they came true.
    let quote = farm.quote(&job).await;
    let line = quoted_cache(&quote);
    let off = |forecast: f64, actual: u64| (forecast / actual as f64 - 1.0).abs();
    assert!(off(line.work.mean, cache.work) < 0.12, "{line:?}, it took {}", cache.work);
    let page: FramePage =
        farm.viewer.get(&format!("/v1/jobs/{}/frames", job.id)).await.parsed(StatusCode::OK).await;
    let stats: Vec<_> = page.items.iter().map(|row| row.actual.clone().unwrap()).collect();
    let frames_work: u64 = stats.iter().map(|stats| stats.work).sum();
    assert!(off(quote.total.work.mean, frames_work) < 0.1, "{:?}, it took {frames_work}", quote.total.work);
    let records: u64 = line.records.iter().copied().map(u64::from).sum();
    for stats in &stats {
        let cache = stats.cache.unwrap();
        assert_eq!((cache.shared_records, cache.dropped_records, cache.own_records), (records, 0, 0));
    }
    let plan: Plan =
        farm.viewer.get(&format!("/v1/plans/{}", done.plan_id.unwrap())).await.parsed(StatusCode::OK).await;
    let last = plan.shared_cache_bookings.iter().map(|part| part.end).max().unwrap();
    assert_eq!(plan.shared_cache_bookings.len(), 2);
    assert_ne!(
        plan.shared_cache_bookings[0].node_id, plan.shared_cache_bookings[1].node_id,
        "parts are booked side by side"
    );
    assert!(plan.bookings.iter().all(|booking| booking.start >= last), "{plan:?}");

    assert_offline_images_are_the_same(&farm, &job, &page.items, &other.executor.runner).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cache_can_only_be_shared_where_there_is_one() {
    let farm = Farm::new().await;
    let mut request = farm.job_request("0-1");
    request["cache"] = json!("shared");
    let refused = farm.submitter.post("/v1/jobs", &request).await.problem(ProblemKind::Invalid).await;
    assert!(refused.detail.contains("settings.cache"), "{}", refused.detail);
    request["cache"] = json!("sometimes");
    farm.submitter.post("/v1/jobs", &request).await.problem(ProblemKind::Invalid).await;
    request["cache"] = json!("private");
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    assert_eq!((job.cache, job.shared_cache), (CacheSharing::Private, None));
}
