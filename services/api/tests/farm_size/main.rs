//! A large farm: 5,000 nodes, 2,000 open jobs, one of them of 10,000 frames. Its documents stay short.
//!
//! With `FORELIGHT_FARM_SIZE`, nothing is tested: the farm's data folder is left at that path, for measurements
//! (`tests/farm_size.sh`).

mod fill;
#[path = "../support/mod.rs"]
mod support;

use std::path::Path;
use std::time::{Duration, Instant};

use forelight_protocol::{Dashboard, FrameStrip, Job, JobPage, NodePage, TimelinePage, Timestamp};
use futures::future::join_all;
use futures::{StreamExt, stream};
use reqwest::{Method, StatusCode};
use rusqlite::Connection;
use serde_json::json;

use fill::{FRAMES, JOBS, NODES, fill};
use support::events::Events;
use support::{Answer, Farm, Http, start};
use tempfile::TempDir;

/// Most bytes of a compressed document.
const MOST_BYTES: usize = 60 << 10;

/// Pages that are open.
const PAGES: usize = 200;

/// A document: its bytes compressed and plain, and how long it took.
async fn document(operator: &Http, path: &str) -> Vec<u8> {
    let begun = Instant::now();
    let request = operator.request(Method::GET, path).header("accept-encoding", "gzip");
    let answer = request.send().await.unwrap();
    assert_eq!(answer.status(), StatusCode::OK, "{path}");
    assert_eq!(answer.headers()["content-encoding"], "gzip", "{path}");
    let short = answer.bytes().await.unwrap();
    let took = begun.elapsed();
    let plain = operator.get(path).await.bytes().await.unwrap();
    println!(
        "{path:60} {:6.1} KiB compressed, {:7.1} KiB plain, {:5} ms",
        short.len() as f64 / 1024.0,
        plain.len() as f64 / 1024.0,
        took.as_millis()
    );
    assert!(short.len() <= MOST_BYTES, "{path}: {} bytes", short.len());
    plain.to_vec()
}

/// Workers tell that they are done with all pixels, 16 at a time. Each makes an event. Returns how long it
/// took for the slowest hundredth.
async fn heartbeats(operator: &Http, leases: &[String]) -> Duration {
    let beat = async |lease: &String| {
        let begun = Instant::now();
        let patch = operator.request(Method::PATCH, &format!("/v1/leases/{lease}"));
        let answer = patch.json(&json!({"fence": 1, "progress": 1.0})).send().await.unwrap();
        assert_eq!(answer.status(), StatusCode::OK, "{:?}", answer.text().await);
        begun.elapsed()
    };
    let mut took: Vec<Duration> = stream::iter(leases).map(beat).buffer_unordered(16).collect().await;
    took.sort_unstable();
    took[took.len() * 99 / 100]
}

/// Workers are answered while two hundred people look, and all of these are told everything. The farm plans
/// meanwhile, so all pages start after the same event.
async fn pages_and_workers(operator: &Http, folder: &Path, leases: &[String]) {
    let (before, during) = leases.split_at(leases.len() / 2);
    let alone = heartbeats(operator, before).await;
    let newest = database(folder).query_row("SELECT max(id) FROM events", [], |row| row.get(0)).unwrap();
    let open = (0..PAGES).map(|_| Events::open(operator, "/v1/events", Some(newest)));
    let mut pages: Vec<Events> = join_all(open).await.into_iter().flatten().collect();
    assert_eq!(pages.len(), PAGES);
    let told = join_all(pages.iter_mut().map(|page| page.take(during.len(), Duration::from_secs(60))));
    let (watched, told) = tokio::join!(heartbeats(operator, during), told);
    println!("99 of 100 heartbeats: {alone:?} alone, {watched:?} with {PAGES} pages open");
    assert!(told.iter().all(|events| *events == told[0]));
}

/// The folder of a filled farm whose service has ended, and an operator of it.
async fn filled() -> (TempDir, Http) {
    let farm = Farm::new().await;
    let node = farm.node("rack-00-0000").await;
    let mut request = farm.job_request("0-5");
    request["deadline"] = json!(Timestamp::now().plus_micros(300 * 86_400_000_000));
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    farm.until_booked(&node, &job).await;
    farm.finish(&farm.next_task(&node).await).await;
    let Farm { folder, service, operator, .. } = farm;
    service.shutdown().await;
    fill(&database(folder.path()), Timestamp::now().micros());
    (folder, operator)
}

fn database(folder: &Path) -> Connection {
    Connection::open(folder.join("data/forelight.sqlite")).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn documents_of_a_large_farm_are_short() {
    let (folder, operator) = filled().await;
    if let Some(place) = std::env::var_os("FORELIGHT_FARM_SIZE") {
        std::fs::rename(folder.path().join("data"), &place).unwrap();
        return;
    }
    let leases: Vec<String> = {
        let database = database(folder.path());
        let mut found = database
            .prepare("SELECT lower(hex(id)) FROM leases WHERE state = 'active' ORDER BY id LIMIT 1000")
            .unwrap();
        found.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect()
    };
    let service = start(&support::config(folder.path())).await;
    let operator = operator.at(&support::address(&service));
    let dashboard: Dashboard = serde_json::from_slice(&document(&operator, "/v1/dashboard").await).unwrap();
    assert_eq!((dashboard.counts.nodes, dashboard.jobs_open_total), (u64::from(NODES), u64::from(JOBS)));
    assert_eq!((dashboard.jobs.len(), dashboard.nodes.len(), dashboard.bookings.len()), (200, 200, 100));
    assert!(dashboard.jobs[..90].iter().all(|job| job.promise.as_ref().is_some_and(|promise| !promise.kept)));
    let page = document(&operator, "/v1/jobs?open=true&sort=risk").await;
    let page: JobPage = serde_json::from_slice(&page).unwrap();
    let big = document(&operator, "/v1/jobs?open=true&search=sh0001_&sort=deadline").await;
    let big: JobPage = serde_json::from_slice(&big).unwrap();
    assert_eq!((page.items.len(), big.items[0].frames_total), (50, FRAMES));
    let nodes = document(&operator, "/v1/nodes?sort=name&state=working").await;
    assert_eq!(serde_json::from_slice::<NodePage>(&nodes).unwrap().items.len(), 50);
    let timeline = document(&operator, "/v1/timeline?page_size=50").await;
    let timeline: TimelinePage = serde_json::from_slice(&timeline).unwrap();
    assert!(timeline.items.iter().all(|node| node.spans.len() >= 3), "{:?}", timeline.items[0]);
    for quantity in ["cpu_seconds", "work", "cost"] {
        let path = format!("/v1/jobs/{}/strip?quantity={quantity}", big.items[0].id);
        let strip: FrameStrip = serde_json::from_slice(&document(&operator, &path).await).unwrap();
        assert_eq!((strip.states.len(), strip.p95.len()), (FRAMES as usize, FRAMES as usize));
    }
    pages_and_workers(&operator, folder.path(), &leases).await;
    drop(service);
}
