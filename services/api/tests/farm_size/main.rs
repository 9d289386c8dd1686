//! A large farm: 5,000 nodes, 2,000 open jobs, one of them of 10,000 frames. Its documents stay short.
//!
//! The database is filled by SQL, with copies of one real job and one real node. With `FORELIGHT_FARM_SIZE`,
//! nothing is tested: the farm's data folder is left at that path, for measurements
//! (`tests/farm_size.sh`).

#[path = "support/mod.rs"]
mod support;

use std::path::Path;
use std::time::{Duration, Instant};

use forelight_protocol::{Dashboard, FrameStrip, Job, JobPage, NodePage, TimelinePage, Timestamp};
use futures::future::join_all;
use futures::{StreamExt, stream};
use reqwest::{Method, StatusCode};
use rusqlite::Connection;
use serde_json::json;

use support::copies::copy;
use support::events::Events;
use support::{Answer, Farm, Http, start};
use tempfile::TempDir;

/// Most bytes of a compressed document.
const MOST_BYTES: usize = 60 << 10;

const NODES: u32 = 5_000;
const JOBS: u32 = 2_000;
const FRAMES: u32 = 10_000;

/// Pages that are open.
const PAGES: usize = 200;

/// Fills the database. It has one booked job of frames 0 to 5, one finished frame, and one node.
///
/// Two or three frames of each copied job are being rendered, each on its own node: nearly all nodes work.
fn fill(database: &Connection, now: i64) {
    let run = |statement: &str| {
        database.execute_batch(statement).unwrap_or_else(|error| panic!("{statement}: {error}"));
    };
    run("PRAGMA foreign_keys = ON; BEGIN");
    run(&format!(
        "CREATE TEMP TABLE template AS SELECT id AS job, plan_id AS plan, (SELECT max(frame) FROM tasks WHERE kind = 'render' AND state = 'ready') AS last FROM jobs;
         CREATE TEMP TABLE ranks AS SELECT frame, row_number() OVER (ORDER BY frame) - 1 AS rank FROM tasks
         WHERE kind = 'render' AND state = 'ready';
         CREATE TEMP TABLE numbers AS WITH RECURSIVE n (n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM n WHERE n < {FRAMES}) SELECT n FROM n;
         CREATE TEMP TABLE new_nodes AS SELECT n, randomblob(16) AS id FROM numbers WHERE n BETWEEN 1 AND {NODES} - 1;
         CREATE UNIQUE INDEX temp.new_nodes_by_n ON new_nodes (n);
         CREATE TEMP TABLE new_jobs AS SELECT n, randomblob(16) AS id FROM numbers WHERE n BETWEEN 1 AND {JOBS} - 1"
    ));
    let a_node = "(SELECT id FROM new_nodes WHERE n = 1 + (e.n * 7 + coalesce(t.frame, 0) * 13) % 4999)";
    let last_seen = now.to_string();
    copy(
        database,
        "nodes",
        "1",
        "new_nodes e",
        &[
            ("id", "e.id"),
            ("name", "printf('rack-%02d-%04d', e.n % 40, e.n)"),
            ("speed", "1 + e.n % 7 / 3.0"),
            ("last_seen_at", &last_seen),
        ],
    );
    copy(
        database,
        "jobs",
        "1",
        "new_jobs e",
        &[
            ("id", "e.id"),
            ("name", "printf('sq%03d_sh%04d_lighting_v%d', e.n % 90, e.n, e.n % 9)"),
            ("project", "printf('project %d', e.n % 12)"),
            ("deadline_at", "t.deadline_at + e.n * 1000000"),
            ("outlook", "json_set(t.outlook, '$.promise.kept', json(iif(e.n % 20, 'true', 'false')))"),
            ("frames_total", &format!("iif(e.n = 1, {FRAMES}, t.frames_total)")),
            ("frames", &format!("iif(e.n = 1, '0-{}', t.frames)", FRAMES - 1)),
        ],
    );
    let of_job = "t.job_id = (SELECT job FROM template)";
    let small = "(SELECT * FROM new_jobs WHERE n > 1) e";
    let large = format!("(SELECT j.id, n.n FROM new_jobs j, numbers n WHERE j.n = 1 AND n.n < {FRAMES}) e");
    let waits = [
        ("actual", "NULL"),
        ("actual_work", "NULL"),
        ("actual_cpu", "NULL"),
        ("artifacts", "NULL"),
        ("finished_at", "NULL"),
    ];
    copy(database, "frames", of_job, small, &[&[("job_id", "e.id")][..], &waits].concat());
    // A third of the frames are done. Costs rise through the shot, and each is a little off its forecast.
    let factor = "(1 + e.n / 5000.0 + (e.n * 7919 % 101) / 2000.0)";
    let of = |column: &str| format!("t.{column} * {factor}");
    let columns = ["work_p50", "work_p80", "work_p95", "cpu_p50", "cpu_p80", "cpu_p95"];
    let scaled: Vec<(&str, String)> = columns.iter().map(|column| (*column, of(column))).collect();
    let done = |column: &str| format!("iif(e.n < 3333, t.{column}, NULL)");
    let about = [
        ("actual", done("actual")),
        ("artifacts", done("artifacts")),
        ("finished_at", done("finished_at")),
        (
            "actual_work",
            format!("iif(e.n < 3333, t.actual_work * {factor} * (0.95 + (e.n * 31 % 97) / 970.0), NULL)"),
        ),
        (
            "actual_cpu",
            format!("iif(e.n < 3333, t.actual_cpu * {factor} * (0.95 + (e.n * 31 % 97) / 970.0), NULL)"),
        ),
        ("job_id", "e.id".to_owned()),
        ("frame", "e.n".to_owned()),
    ];
    let all: Vec<(&str, &str)> =
        scaled.iter().chain(&about).map(|(column, value)| (*column, value.as_str())).collect();
    let finished = format!("{of_job} AND t.actual IS NOT NULL");
    copy(database, "frames", &finished, &large, &all);
    let rank = "(SELECT rank FROM ranks r WHERE r.frame = t.frame)";
    let runs = format!("({rank} < 2 OR ({rank} = 2 AND e.n % 2))");
    // No two of the frames that run have the same node.
    let own_node = format!(
        "(SELECT id FROM new_nodes WHERE n = CASE {rank} WHEN 0 THEN e.n WHEN 1 THEN 2000 + e.n ELSE 4000 + e.n / 2 END)"
    );
    let started = now.to_string();
    let if_it_runs = |then: &str, otherwise: &str| format!("iif({runs}, {then}, {otherwise})");
    copy(
        database,
        "tasks",
        &format!("{of_job} AND t.kind = 'render' AND t.state = 'ready'"),
        small,
        &[
            ("id", "randomblob(16)"),
            ("job_id", "e.id"),
            ("state", &if_it_runs("'leased'", "'ready'")),
            ("fence", "1"),
            ("progress", &if_it_runs("e.n % 50 / 100.0", "0")),
            ("node_id", &if_it_runs(&own_node, "NULL")),
            ("started_at", &if_it_runs(&started, "NULL")),
            ("booked_node", &if_it_runs(&own_node, a_node)),
        ],
    );
    copy(
        database,
        "tasks",
        &format!("{of_job} AND t.kind = 'render' AND t.frame = (SELECT last FROM template)"),
        &large,
        &[
            ("id", "randomblob(16)"),
            ("job_id", "e.id"),
            ("frame", "e.n"),
            ("state", "iif(e.n < 3333, 'done', 'ready')"),
            ("booked_node", "(SELECT id FROM new_nodes WHERE n = 1 + e.n % 4999)"),
        ],
    );
    run(&format!(
        "INSERT INTO bookings (id, plan_id, job_id, frame, node_id, start_at, end_at)
         SELECT randomblob(16), plan, job_id, frame, booked_node, {now} + (place - 1) * 600000000, {now} + place * 600000000
         FROM (SELECT *, row_number() OVER (PARTITION BY booked_node ORDER BY state = 'ready', job_id, frame) AS place
               FROM tasks, template WHERE kind = 'render' AND state <> 'done' AND job_id <> job);
         INSERT INTO leases (id, task_id, node_id, fence, node_speed, state, granted_at, expires_at)
         SELECT randomblob(16), id, node_id, 1, 1.0, 'active', {now}, {now} + 3600000000 FROM tasks, template
         WHERE state = 'leased' AND job_id <> job;
         INSERT INTO leases (id, task_id, node_id, fence, node_speed, state, granted_at, expires_at, ended_at)
         SELECT randomblob(16), t.id, e.id, 100 + e.n * 3 + k.n, 1.0, 'committed', {now} - (k.n + 1) * 1200000000, {now},
                {now} - (k.n + 1) * 1200000000 + 1000000000
         FROM new_nodes e, (SELECT n FROM numbers WHERE n < 3) k
         JOIN tasks t ON t.job_id = (SELECT id FROM new_jobs WHERE n = 1) AND t.frame = (e.n * 3 + k.n) % 3333;
         INSERT INTO live_forecasts SELECT e.id, l.plan_id, l.booked_cpu, l.booked_rest, l.booked_share, l.frames_done,
                l.frames_since, l.cost_is_off, l.finish_is_off, l.body, l.updated_at FROM live_forecasts l, new_jobs e;
         COMMIT"
    ));
}

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

/// Workers are answered while two hundred people look, and all of these are told everything.
async fn pages_and_workers(operator: &Http, leases: &[String]) {
    let (before, during) = leases.split_at(leases.len() / 2);
    let alone = heartbeats(operator, before).await;
    let open = (0..PAGES).map(|_| Events::open(operator, "/v1/events", None));
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
    pages_and_workers(&operator, &leases).await;
    drop(service);
}
