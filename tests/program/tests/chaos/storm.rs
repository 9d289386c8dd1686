//! Combines all faults. Workers and service are killed at random moments. The network loses, doubles and
//! delays messages. The service's clock jumps by hours in both directions, and its disk is full at times.
//! Meanwhile job after job is rendered. Every second job shares an irradiance cache, which workers plan, fill
//! in parts and merge; frames of half of the jobs are divided into three parts. Frames of every fifth job get
//! their samples in passes. Every frame must be delivered once, with the bits of an undisturbed render, and
//! the database must be consistent.
//!
//! The faults follow from a seed; exact times depend on the machine. The default is twelve kills, a full run
//! two hundred:
//!
//! ```sh
//! FORELIGHT_STORM_KILLS=200 cargo test -p forelight-tests --test chaos storm -- --nocapture
//! ```
//!
//! `FORELIGHT_STORM_DIVIDED=1` divides the frames of all jobs.

use super::{Acknowledged, counts, frames_of, job_of};
use forelight_protocol::{Bundle, FrameState, Job, JobState, RenderStats, Role};
use forelight_random::Random;
use forelight_tests::bundles::{shipped, zipped};
use forelight_tests::http::{Answer, Http};
use forelight_tests::ledger::Ledger;
use forelight_tests::pictures::Channels;
use forelight_tests::processes::{Process, Service, run_well};
use forelight_tests::proxy::Proxy;
use forelight_tests::shim::Shim;
use forelight_tests::waiting::eventually;
use reqwest::{Method, StatusCode};
use serde_json::json;
use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::time::Duration;

const SCENE: &str = "corridor";
const WIDTH: u32 = 32;
const HEIGHT: u32 = 18;
/// A frame takes about half a second in a test build.
const SAMPLES_PER_PIXEL: u32 = 12;
const FRAMES: u32 = 10;
const WORKERS: usize = 3;
/// Limit for a whole job during a storm, and for its rest afterwards.
const PATIENCE: Duration = Duration::from_secs(240);

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).ok().map_or(default, |text| text.parse().expect("a number"))
}

/// How the frames of a job are rendered.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// With equally many samples for every pixel.
    Even,
    /// The same, with one irradiance cache that all frames share.
    SharedCache,
    /// In passes, until the error is small enough.
    ForError,
}

/// Per cent of the image's mean.
const ERROR: &str = "20";

impl Kind {
    const ALL: [Self; 3] = [Self::Even, Self::SharedCache, Self::ForError];

    /// The kind of a job. The first has a cache.
    fn of(job: usize) -> Self {
        match job {
            _ if job % 5 == 3 => Self::ForError,
            _ if job.is_multiple_of(2) => Self::SharedCache,
            _ => Self::Even,
        }
    }
}

/// True if the frames of this job are divided. Each kind of job comes with and without it.
fn is_divided(job: usize) -> bool {
    matches!(job % 4, 1 | 2) || job % 10 == 3 || number("FORELIGHT_STORM_DIVIDED", 0) > 0
}

/// Flags of a kind of job.
fn quality(kind: Kind) -> Vec<String> {
    let mut flags = vec!["--width".into(), WIDTH.to_string(), "--height".into(), HEIGHT.to_string()];
    let samples = SAMPLES_PER_PIXEL.to_string();
    let own: &[&str] = match kind {
        Kind::Even => &["--spp", &samples],
        // Two bounces, so that two levels are filled and merged one after the other.
        Kind::SharedCache => &["--spp", "2", "--cache", "on", "--cache-rays", "48", "--ambient-bounces", "2"],
        Kind::ForError => &["--error", ERROR],
    };
    flags.extend(own.iter().map(|&flag| flag.to_owned()));
    flags
}

/// Frames of the program without a farm. Frames that share a cache use one file for it.
fn undisturbed(kind: Kind) -> BTreeMap<u32, (Channels, RenderStats)> {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).display().to_string();
    let run = |words: &[&str], flags: &[String]| {
        let scene = shipped(SCENE).display().to_string();
        let mut arguments: Vec<String> = words.iter().map(|&word| word.to_owned()).collect();
        arguments.extend([scene, "--preview".to_owned(), "cpu".to_owned()]);
        arguments.extend(quality(kind));
        arguments.extend_from_slice(flags);
        run_well(&arguments)
    };
    let flags = |flags: &[&str]| flags.iter().map(|&flag| flag.to_owned()).collect::<Vec<_>>();
    if kind == Kind::SharedCache {
        let frames = format!("0-{}", FRAMES - 1);
        run(&["cache", "plan"], &flags(&["--frames", &frames, "--out", &file("plan")]));
        run(&["cache", "fill"], &flags(&["--cache-file", &file("plan"), "--out", &file("full")]));
    }
    let render = |frame: u32| {
        let out = file(&format!("{frame}.exr"));
        let mut own = flags(&["--frame", &frame.to_string(), "--out", &out, "--json"]);
        if kind == Kind::SharedCache {
            own.extend(flags(&["--cache-file", &file("full")]));
        }
        let stats: RenderStats = serde_json::from_str(&run(&["render"], &own)).unwrap();
        (frame, (Channels::of(&std::fs::read(out).unwrap()), stats))
    };
    (0..FRAMES).map(render).collect()
}

async fn submit(http: &Http, bundle: &Bundle, number: usize) -> Job {
    let mut request = json!({
        "name": format!("storm {number}"), "bundle": {"id": bundle.id}, "frames": format!("0-{}", FRAMES - 1),
        "settings": {"width": WIDTH, "height": HEIGHT, "spp": SAMPLES_PER_PIXEL}, "samples": 32, "profile_frames": 2,
    });
    if is_divided(number) {
        request["division"] = json!({"into": 3});
    }
    if Kind::of(number) == Kind::SharedCache {
        request["cache"] = json!("shared");
        request["settings"] = json!({
            "width": WIDTH, "height": HEIGHT, "spp": 2, "cache": "on", "cache_rays": 48, "ambient_bounces": 2,
        });
    }
    if Kind::of(number) == Kind::ForError {
        request["error_target"] = json!({"ppm": ERROR.parse::<u32>().unwrap() * 10_000});
    }
    // The disk is not full now, but a service that has just started may be busy.
    let key = format!("storm-{number}");
    eventually("a job to be taken", PATIENCE, async || {
        let post = http.request(Method::POST, "/v1/jobs").header("idempotency-key", &key).json(&request);
        let answer = post.send().await.ok()?;
        match answer.status() {
            StatusCode::CREATED => Some(answer.parsed(StatusCode::CREATED).await),
            status => {
                assert!(status.is_server_error(), "{status}");
                None
            }
        }
    })
    .await
}

/// Number of times each fault happened.
#[derive(Debug, Default)]
struct Happened {
    workers_killed: u64,
    services_killed: u64,
    clocks_set: u64,
    disks_full: u64,
}

struct Storm {
    service: Service,
    proxy: Proxy,
    shim: Option<Shim>,
    workers: Vec<Process>,
    born: usize,
    random: Random,
    clock: i64,
    happened: Happened,
}

impl Storm {
    async fn new(seed: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let shim = Shim::compile(folder.path());
        let mut service = Service::prepared(folder, "serve", &["--lease-ttl", "2s"]);
        if let Some(shim) = &shim {
            service.set_environment(&shim.environment());
        }
        service.launch().await;
        let proxy = Proxy::start(service.address(), seed).await;
        let mut storm = Self {
            service,
            proxy,
            shim,
            workers: Vec::new(),
            born: 0,
            random: Random::new(seed ^ 1),
            clock: 0,
            happened: Happened::default(),
        };
        for slot in 0..WORKERS {
            let worker = storm.worker(slot);
            storm.workers.push(worker);
        }
        storm
    }

    fn worker(&mut self, slot: usize) -> Process {
        self.born += 1;
        let (node, process) = (format!("node-{slot}"), format!("worker-{}", self.born));
        self.service.worker_at(&self.proxy.address(), &node, &process, "100ms")
    }

    async fn moment(&mut self, longest_ms: u64) {
        tokio::time::sleep(Duration::from_millis(self.random.below(longest_ms))).await;
    }

    /// Starts workers again whose node a late registration of a killed process has taken over, as a supervisor
    /// would. Workers end for no other reason.
    fn revive(&mut self) {
        for slot in 0..WORKERS {
            if self.workers[slot].has_ended().is_some() {
                let why = self.workers[slot].last_words();
                assert!(why.contains("taken the node over"), "a worker ended: {why}");
                self.workers[slot] = self.worker(slot);
            }
        }
    }

    /// Makes one more fault.
    async fn strike(&mut self) {
        self.revive();
        match self.random.below(100) {
            0..50 => {
                let slot = self.random.below(WORKERS as u64) as usize;
                self.workers.swap_remove(slot).kill();
                self.happened.workers_killed += 1;
                self.moment(300).await;
                let worker = self.worker(slot);
                // The last worker replaced the killed one; this one takes its name.
                self.workers.push(worker);
                let last = self.workers.len() - 1;
                self.workers.swap(slot, last);
            }
            50..80 => {
                self.service.kill();
                self.happened.services_killed += 1;
                self.moment(1200).await;
                self.service.start_again().await;
            }
            80..92 => {
                let hours = self.random.below(9) as i64 - 4;
                self.clock += hours * 3600 + self.random.below(100) as i64;
                if let Some(shim) = &self.shim {
                    shim.set_clock(self.clock);
                    self.happened.clocks_set += 1;
                }
            }
            _ => {
                if let Some(shim) = &self.shim {
                    shim.fill_disk(true);
                    self.happened.disks_full += 1;
                }
                self.moment(700).await;
                if let Some(shim) = &self.shim {
                    shim.fill_disk(false);
                }
            }
        }
    }

    fn kills(&self) -> u64 {
        self.happened.workers_killed + self.happened.services_killed
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_storm_of_kills_lost_messages_full_disks_and_clocks_that_are_set_loses_no_frame_and_changes_no_bit()
{
    let wanted = number("FORELIGHT_STORM_KILLS", 12);
    let references = Kind::ALL.map(undisturbed);
    let mut storm = Storm::new(number("FORELIGHT_STORM_SEED", 1)).await;
    let http = storm.service.http(Role::Operator);
    let bundle: Bundle = http.upload(zipped(&shipped(SCENE)), None).await.parsed(StatusCode::CREATED).await;
    let mut jobs = vec![submit(&http, &bundle, 0).await];
    let mut acknowledged = Acknowledged::default();
    while storm.kills() < wanted {
        storm.moment(900).await;
        storm.strike().await;
        let last = jobs.last().unwrap();
        acknowledged.look(&frames_of(&http, last).await);
        let state = job_of(&http, last).await;
        assert!(!matches!(state.state, JobState::Failed | JobState::Cancelled), "{:?}", state.error);
        if state.state == JobState::Done {
            acknowledged = Acknowledged::default();
            jobs.push(submit(&http, &bundle, jobs.len()).await);
        }
    }
    // The storm is over. The rest must be done, and no lease may stay.
    storm.proxy.calm();
    if jobs.len() == 1 {
        jobs.push(submit(&http, &bundle, 1).await);
    }
    for (number, job) in jobs.iter().enumerate() {
        let kind = Kind::of(number);
        let reference = &references[kind as usize];
        let done = eventually("the end of a job", PATIENCE, async || {
            let job = job_of(&http, job).await;
            job.state.is_final().then_some(job)
        })
        .await;
        assert_eq!(done.state, JobState::Done, "{:?}", done.error);
        assert_eq!((done.frames_done, done.progress), (FRAMES, 1.0));
        assert_eq!(
            done.shared_cache.is_some_and(|cache| cache.ready),
            kind == Kind::SharedCache,
            "{}",
            done.name
        );
        for row in frames_of(&http, job).await {
            let (image, stats) = &reference[&row.frame];
            assert_eq!(row.state, FrameState::Done, "frame {}", row.frame);
            assert_eq!(row.parts, if is_divided(number) { 3 } else { 1 }, "frame {}", row.frame);
            let actual = row.actual.as_ref().unwrap();
            assert_eq!(counts(actual), counts(stats), "frame {}", row.frame);
            let path = format!("/v1/jobs/{}/frames/{}/image.exr", job.id, row.frame);
            let what = format!("frame {} of {} and of an undisturbed render", row.frame, done.name);
            Channels::of(&http.bytes(&path, "image/x-exr").await).assert_same(image, &what);
        }
    }
    storm.revive();
    for worker in storm.workers.drain(..) {
        worker.end().await;
    }
    storm.service.end().await;
    Ledger::of(&storm.service.data()).await.assert_balanced().await;
    let faults = storm.proxy.faults();
    println!("{} jobs of {FRAMES} frames; {:?}; {faults:?}", jobs.len(), storm.happened);
    for (what, number) in [
        ("lost requests", &faults.lost_requests),
        ("lost answers", &faults.lost_answers),
        ("doubled requests", &faults.doubled),
        ("late requests", &faults.late),
        ("delayed requests", &faults.delayed),
    ] {
        assert!(number.load(Ordering::Relaxed) > 0, "no {what}: it was no storm");
    }
}
