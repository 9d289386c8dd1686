//! Kills workers and the service in the middle of their work. Every frame must be delivered once, with the
//! bits of an undisturbed render, and nothing acknowledged may be lost.
//!
//! Speed is not tested. Waits have generous limits, so that a hang is an error.

mod storm;

use forelight_protocol::{
    Event, EventKind, FramePage, FrameRow, FrameState, Job, JobState, Node, NodePage, Rays, RenderStats,
    Role, TaskKind, TrackRecord,
};
use forelight_tests::bundles::{shipped, zipped};
use forelight_tests::events::Events;
use forelight_tests::http::{Answer, Http};
use forelight_tests::ledger::{LeaseLine, Ledger};
use forelight_tests::pictures::Channels;
use forelight_tests::processes::{Process, Service, run_well};
use forelight_tests::waiting::eventually;
use reqwest::StatusCode;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;
use std::time::Duration;

const SCENE: &str = "corridor";
const WIDTH: u32 = 48;
const HEIGHT: u32 = 27;
/// A frame takes more than a second in a test build, long enough to kill its worker in the middle.
const SAMPLES_PER_PIXEL: u32 = 16;
const FRAMES: u32 = 10;
/// Profiled pixels of a profiled frame, and number of profiled frames, with and without a farm.
const PROFILED_PIXELS: u32 = 64;
const PROFILED_FRAMES: u32 = 3;

/// Number of kills in the middle of work.
const KILLS: usize = 10;
/// Most kills of one frame. A task survives nine lost workers.
const MOST_KILLS_OF_A_FRAME: u32 = 4;

/// Limit for steps of a job.
const PATIENCE: Duration = Duration::from_secs(90);
/// Limit for a whole job.
const JOB_PATIENCE: Duration = Duration::from_secs(240);

/// Frames of `forelight render` without a farm: images and statistics.
struct Reference {
    images: BTreeMap<u32, Channels>,
    stats: BTreeMap<u32, RenderStats>,
}

/// Rendered once for all tests of this file.
fn reference() -> &'static Reference {
    static REFERENCE: OnceLock<Reference> = OnceLock::new();
    REFERENCE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let render = |frame: u32, name: &str, more: &[&str]| {
            let out = folder.path().join(format!("{name}-{frame}.exr"));
            let mut arguments = quality("render");
            arguments.extend([
                "--frame".into(),
                frame.to_string(),
                "--out".into(),
                out.display().to_string(),
            ]);
            arguments.push("--json".into());
            arguments.extend(more.iter().map(|&argument| argument.to_owned()));
            let stats: RenderStats = serde_json::from_str(&run_well(&arguments)).unwrap();
            (Channels::of(&std::fs::read(out).unwrap()), stats)
        };
        let mut reference = Reference { images: BTreeMap::new(), stats: BTreeMap::new() };
        for frame in 0..FRAMES {
            let (image, stats) = render(frame, "plain", &[]);
            reference.images.insert(frame, image);
            reference.stats.insert(frame, stats);
        }
        // Render again with the pixels of a profile.
        let profiles = folder.path().join("profiles");
        let mut arguments = quality("forecast");
        arguments.extend(["--frames".into(), format!("0-{}", FRAMES - 1)]);
        arguments.extend(["--samples".into(), PROFILED_PIXELS.to_string()]);
        arguments.extend(["--profile-frames".into(), "2".into(), "--json".into()]);
        arguments.extend(["--save-profile".into(), profiles.display().to_string()]);
        run_well(&arguments);
        let mut profiled = 0;
        for frame in 0..FRAMES {
            let profile = profiles.join(format!("frame-{frame:04}.profile"));
            if !profile.exists() {
                continue;
            }
            profiled += 1;
            let (image, stats) = render(frame, "profiled", &["--profile", profile.to_str().unwrap()]);
            assert!(stats.reused_pixels > 0, "frame {frame}");
            let what = format!("frame {frame} with and without its profile");
            image.assert_same(&reference.images[&frame], &what);
            assert_eq!(counts(&stats), counts(&reference.stats[&frame]), "{what}");
        }
        assert!(profiled > 0, "no profile was saved");
        reference
    })
}

/// The part of a frame's cost that two runs must agree on.
fn counts(stats: &RenderStats) -> (u32, u64, Rays, Vec<String>) {
    (stats.frame, stats.work, stats.rays, stats.effects.clone())
}

fn quality(command: &str) -> Vec<String> {
    let scene = shipped(SCENE).display().to_string();
    let words = [command, &scene, "--width", &WIDTH.to_string(), "--spp", &SAMPLES_PER_PIXEL.to_string()];
    let machine = ["--threads", "2", "--preview", "cpu"];
    words.into_iter().chain(machine).map(str::to_owned).collect()
}

/// Submits the job that all tests of this file disturb.
async fn submit(http: &Http) -> Job {
    let bundle: serde_json::Value =
        http.upload(zipped(&shipped(SCENE)), None).await.parsed(StatusCode::CREATED).await;
    let request = json!({
        "name": "disturbed", "bundle": {"id": bundle["id"]}, "frames": format!("0-{}", FRAMES - 1),
        "settings": {"width": WIDTH, "height": HEIGHT, "spp": SAMPLES_PER_PIXEL},
        "samples": PROFILED_PIXELS, "profile_frames": PROFILED_FRAMES,
    });
    http.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await
}

async fn job_of(http: &Http, job: &Job) -> Job {
    http.json(&format!("/v1/jobs/{}", job.id)).await
}

async fn frames_of(http: &Http, job: &Job) -> Vec<FrameRow> {
    let page: FramePage = http.json(&format!("/v1/jobs/{}/frames?page_size=200", job.id)).await;
    assert_eq!(page.items.len(), FRAMES as usize);
    page.items
}

/// Frames that are partly rendered.
fn in_the_middle(frames: &[FrameRow]) -> impl Iterator<Item = &FrameRow> {
    frames.iter().filter(|row| row.state == FrameState::Leased && row.progress > 0.0 && row.progress < 1.0)
}

/// Waits until a job is done.
async fn until_done(http: &Http, job: &Job) -> Job {
    eventually("the end of the job", JOB_PATIENCE, async || {
        let job = job_of(http, job).await;
        job.state.is_final().then(|| {
            assert_eq!(job.state, JobState::Done, "{:?}", job.error);
            job
        })
    })
    .await
}

/// Frames reported as done. They must never change.
#[derive(Default)]
struct Acknowledged(BTreeMap<u32, FrameRow>);

impl Acknowledged {
    fn look(&mut self, frames: &[FrameRow]) {
        for row in frames {
            match self.0.get(&row.frame) {
                Some(earlier) => assert_eq!(earlier, row, "a frame that was done is not what it was"),
                None if row.state == FrameState::Done => drop(self.0.insert(row.frame, row.clone())),
                None => {}
            }
        }
    }
}

/// Checks everything about a farm whose one job is done, then stops the service.
async fn assert_delivered(mut service: Service, job: &Job, workers: Vec<Process>) -> Vec<LeaseLine> {
    let http = service.http(Role::Viewer);
    let done = until_done(&http, job).await;
    assert_eq!((done.frames_done, done.frames_total, done.progress), (FRAMES, FRAMES, 1.0));
    assert!(done.verdict.is_some() && done.finished_at.is_some() && done.error.is_none());

    let frames = frames_of(&http, job).await;
    let mut taken_over = 0;
    for row in &frames {
        assert_eq!((row.state, row.progress), (FrameState::Done, 1.0), "frame {}", row.frame);
        assert_eq!(row.error, None, "frame {}", row.frame);
        let actual = row.actual.as_ref().expect("a frame that is done says what it took");
        assert_eq!(counts(actual), counts(&reference().stats[&row.frame]), "frame {}", row.frame);
        taken_over += u32::from(actual.reused_pixels > 0);
        let image =
            http.bytes(&format!("/v1/jobs/{}/frames/{}/image.exr", job.id, row.frame), "image/x-exr").await;
        let what = format!("frame {} of the farm and without one", row.frame);
        Channels::of(&image).assert_same(&reference().images[&row.frame], &what);
    }
    assert!(taken_over > 0, "no frame took its profiled pixels over");

    assert_told_once(&events_of(&http, job).await);
    assert_track_record(&http.json("/v1/forecasts/track-record?page_size=200").await, &frames);

    for worker in workers {
        worker.end().await;
    }
    service.end().await;
    let mut ledger = Ledger::of(&service.data()).await;
    ledger.assert_balanced().await;
    ledger.leases(job.id).await
}

async fn events_of(http: &Http, job: &Job) -> Vec<Event> {
    let events = Events::open(http, &format!("/v1/jobs/{}/events", job.id), None).await;
    events.expect("a job that is done has events").rest(PATIENCE).await
}

/// Each step of a job has one event, in order, and so has each task's end.
fn assert_told_once(events: &[Event]) {
    assert!(events.is_sorted_by(|a, b| a.id < b.id), "events out of order");
    let states: Vec<JobState> = events.iter().filter_map(|event| event.job_state).collect();
    let way = [JobState::Profiling, JobState::Booked, JobState::Rendering, JobState::Done];
    assert_eq!(
        states.iter().filter(|&&state| state != JobState::Previewing).collect::<Vec<_>>(),
        way.iter().collect::<Vec<_>>()
    );
    let once = |kind: EventKind| events.iter().filter(|event| event.kind == kind).count();
    assert_eq!((once(EventKind::JobCreated), once(EventKind::ForecastReady)), (1, 1));
    assert!(once(EventKind::PlanStored) >= 1, "booked, and planned anew when workers were lost");
    let done = || events.iter().filter(|event| event.kind == EventKind::TaskDone);
    let tasks: BTreeSet<_> = done().map(|event| event.task_id).collect();
    assert_eq!(tasks.len(), done().count(), "a task was told done twice");
    let rendered: Vec<_> = done().filter(|event| event.task_kind == Some(TaskKind::Render)).collect();
    let frames: BTreeSet<_> = rendered.iter().filter_map(|event| event.frame).collect();
    assert_eq!((rendered.len(), frames), (FRAMES as usize, (0..FRAMES).collect()));
}

/// The track record must count every frame once, with the numbers of its row.
fn assert_track_record(record: &TrackRecord, frames: &[FrameRow]) {
    assert_eq!(record.frames, u64::from(FRAMES));
    let listed: BTreeSet<u32> = record.items.iter().map(|row| row.frame).collect();
    assert_eq!((listed, record.items.len()), ((0..FRAMES).collect(), FRAMES as usize));
    let figures: Vec<_> = frames.iter().map(|row| row.work.expect("a forecast frame has a figure")).collect();
    let actual = |figure: &forelight_protocol::FrameFigure| figure.actual.expect("it is done");
    let hits = |quantile: fn(&forelight_protocol::Quantiles) -> f64| {
        figures.iter().filter(|figure| actual(figure) <= quantile(&figure.forecast)).count() as u64
    };
    let work = record.work_hits;
    assert_eq!((work.p50, work.p80, work.p95), (hits(|q| q.p50), hits(|q| q.p80), hits(|q| q.p95)));
    let forecast: f64 = figures.iter().map(|figure| figure.forecast.mean).sum();
    let sum: f64 = figures.iter().map(actual).sum();
    let bias = record.work_bias.expect("there are frames");
    assert!((bias - (forecast / sum - 1.0)).abs() < 1e-9, "{bias} against {forecast} / {sum} - 1");
}

/// A worker process, and the name of its node.
struct Worker {
    name: String,
    process: Process,
}

async fn node_names(http: &Http) -> BTreeMap<forelight_protocol::NodeId, String> {
    let page: NodePage = http.json("/v1/nodes?page_size=200").await;
    page.items.into_iter().map(|Node { id, name, .. }| (id, name)).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn workers_killed_ten_times_in_the_middle_of_a_frame_lose_no_frame_and_change_no_bit() {
    let service = Service::start("serve", &["--lease-ttl", "2s"]).await;
    let http = service.http(Role::Operator);
    let job = submit(&http).await;
    let mut workers: Vec<Worker> = Vec::new();
    let mut born = 0;
    let mut start = |workers: &mut Vec<Worker>, name: String| {
        let process = service.worker(&name, &format!("worker-{born}"));
        born += 1;
        workers.push(Worker { name, process });
    };
    for number in 0..2 {
        start(&mut workers, format!("node-{number}"));
    }
    let mut acknowledged = Acknowledged::default();
    let mut kills_of_frame = BTreeMap::<u32, u32>::new();
    let mut hits = 0;
    // Sometimes the worker delivers its frame before the kill.
    for attempt in 0..4 * KILLS {
        if hits == KILLS {
            break;
        }
        let (victim, row) = eventually("a worker in the middle of a frame", PATIENCE, async || {
            let (frames, names) = (frames_of(&http, &job).await, node_names(&http).await);
            acknowledged.look(&frames);
            assert!(frames.iter().any(|row| row.state != FrameState::Done), "all is done after {hits} hits");
            in_the_middle(&frames)
                .filter(|row| {
                    kills_of_frame.get(&row.frame).is_none_or(|kills| *kills < MOST_KILLS_OF_A_FRAME)
                })
                .find_map(|row| {
                    let name = names.get(&row.node?)?;
                    // A dead process of the same name may still have a valid lease.
                    let holds =
                        |w: &Worker| w.name == *name && row.started.is_some_and(|at| at >= w.process.started);
                    Some((workers.iter().position(holds)?, row.clone()))
                })
        })
        .await;
        let Worker { name, process } = workers.swap_remove(victim);
        process.kill();
        let left = frames_of(&http, &job).await.swap_remove(row.frame as usize);
        if (left.state, left.attempts, left.node) == (FrameState::Leased, row.attempts, row.node) {
            hits += 1;
            *kills_of_frame.entry(row.frame).or_default() += 1;
        }
        // Half of the machines come back under their name, the others are replaced.
        let next = if attempt % 2 == 0 { name } else { format!("node-{}", attempt + 2) };
        start(&mut workers, next);
    }
    assert_eq!(hits, KILLS);
    let workers = workers.into_iter().map(|worker| worker.process).collect();
    let leases = assert_delivered(service, &job, workers).await;
    // A worker that comes back takes over its node's lease at once. Other leases expire.
    let is_lost = |state: &str| ["expired", "revoked"].contains(&state);
    let lost = leases.iter().filter(|lease| is_lost(&lease.state)).count();
    assert!(lost >= KILLS, "{lost} leases were lost after {KILLS} kills");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_killed_ten_times_in_the_middle_of_leases_loses_nothing_that_it_acknowledged() {
    let mut service = Service::start("serve", &["--lease-ttl", "2s"]).await;
    let http = service.http(Role::Operator);
    let job = submit(&http).await;
    // The answered request is on disk, so a kill right after it loses nothing.
    service.kill();
    service.start_again().await;
    // The reason to wait is computed on request.
    let kept = job_of(&http, &job).await;
    assert!(kept.waits.as_ref().is_some_and(|waits| waits.because.contains("no worker has registered")));
    assert_eq!(Job { waits: None, ..kept }, job);
    let workers: Vec<Process> =
        (0..2).map(|number| service.worker(&format!("node-{number}"), &format!("worker-{number}"))).collect();
    // Kills during previews, profiles and the service's own steps.
    for pause in [300, 700, 1100] {
        tokio::time::sleep(Duration::from_millis(pause)).await;
        service.kill();
        service.start_again().await;
    }
    let mut acknowledged = Acknowledged::default();
    let mut hit = BTreeSet::<String>::new();
    let mut seen = BTreeSet::new();
    let mut hits = 0;
    for attempt in 0..4 * KILLS as u64 {
        if hits == KILLS {
            break;
        }
        eventually("a frame that went on since the last kill", PATIENCE, async || {
            let frames = frames_of(&http, &job).await;
            acknowledged.look(&frames);
            assert!(frames.iter().any(|row| row.state != FrameState::Done), "all is done after {hits} hits");
            let news = in_the_middle(&frames).map(|row| (row.frame, row.attempts, row.progress.to_bits()));
            let news: Vec<_> = news.filter(|news| !seen.contains(news)).collect();
            (!news.is_empty()).then(|| seen.extend(news))
        })
        .await;
        // Vary the moment between two renewals.
        tokio::time::sleep(Duration::from_millis(attempt * 61 % 240)).await;
        service.kill();
        let leases = Ledger::of(&service.data()).await.leases(job.id).await;
        let held: Vec<_> =
            leases.into_iter().filter(|lease| lease.state == "active" && lease.progress > 0.0).collect();
        hits += usize::from(!held.is_empty());
        hit.extend(held.into_iter().map(|lease| lease.id));
        service.start_again().await;
    }
    assert_eq!(hits, KILLS);
    // An orderly stop must work in the middle of leases too.
    service.end().await;
    service.start_again().await;
    let leases = assert_delivered(service, &job, workers).await;
    // Workers outlive the service: some leases that were active at a kill were committed.
    let survived =
        leases.iter().filter(|lease| lease.state == "committed" && hit.contains(&lease.id)).count();
    assert!(
        survived > 0,
        "none of the {} leases that were held at a kill was committed: {leases:?}",
        hit.len()
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_ends_gives_its_frame_back_and_one_that_sleeps_beyond_its_lease_harms_nothing() {
    let service = Service::start("serve", &["--lease-ttl", "5s"]).await;
    let http = service.http(Role::Operator);
    let job = submit(&http).await;
    // A worker that is asked to stop releases its frame first.
    let polite = service.worker("polite", "worker-polite");
    let begun = eventually("a frame in the middle", PATIENCE, async || {
        in_the_middle(&frames_of(&http, &job).await).next().map(|row| row.frame)
    })
    .await;
    polite.end().await;
    assert!(frames_of(&http, &job).await.iter().all(|row| row.state != FrameState::Leased));

    let sleeper = service.worker("sleeper", "worker-sleeper");
    let row = eventually("a worker that is paused in the middle of a frame", PATIENCE, async || {
        in_the_middle(&frames_of(&http, &job).await).next()?;
        sleeper.signal("STOP");
        // It may have delivered that frame just before.
        let paused = frames_of(&http, &job).await.into_iter().find(|row| row.state == FrameState::Leased);
        if paused.is_none() {
            sleeper.signal("CONT");
        }
        paused
    })
    .await;
    let other = service.worker("other", "worker-other");
    let done = until_done(&http, &job).await;
    // On a busy machine, the other worker may have lost a lease of its own. It is idle from here on.
    let lost = http.metric("forelight_leases_lost_total").await;
    sleeper.signal("CONT");
    eventually("the sleeper to be refused", PATIENCE, async || {
        (http.metric("forelight_leases_lost_total").await > lost).then_some(())
    })
    .await;
    assert_eq!(job_of(&http, &job).await, done, "the sleeper changed the job");
    let frame = frames_of(&http, &job).await.swap_remove(row.frame as usize);
    assert!(frame.attempts > row.attempts, "the frame was not handed out again");
    assert_ne!(frame.node, row.node);
    let leases = assert_delivered(service, &job, vec![sleeper, other]).await;
    let released =
        leases.iter().find(|lease| lease.state == "released").expect("the frame that was given back");
    assert_eq!(released.kind, "render", "{released:?}, not frame {begun}");
    let of_frame: Vec<_> =
        leases.iter().filter(|l| l.kind == "render" && l.frame == Some(i64::from(row.frame))).collect();
    assert!(of_frame.iter().any(|lease| lease.state == "expired"), "{of_frame:?}");
}
