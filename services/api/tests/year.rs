//! A year of a studio in minutes: every night, what is past its time is deleted. The database and the files
//! stop growing, the books do not lose anything, and the service starts and answers as on the first day.
//!
//! `FORELIGHT_YEAR_JOBS` sets the number of jobs of the year (default: 1,095).

#[path = "support/mod.rs"]
mod support;

use std::path::Path;
use std::time::Instant;

use forelight_protocol::{JobPage, RetentionKind, RetentionRule, Timestamp};
use forelight_store::Store;
use reqwest::StatusCode;
use rusqlite::Connection;

use support::copies::{copy, run};
use support::{Answer, Farm, start};

const DAYS: i64 = 365;
const DAY: i64 = 86_400_000_000;

/// Days that jobs and their images are kept.
const JOBS_KEPT: i64 = 60;
const IMAGES_KEPT: i64 = 20;

fn jobs_a_day() -> i64 {
    let jobs = std::env::var("FORELIGHT_YEAR_JOBS").map_or(3 * DAYS, |jobs| jobs.parse().unwrap());
    (jobs / DAYS).max(1)
}

/// Makes the rows of the first job, which is done, a template. It stays: its end is in the far future.
fn prepare(database: &Connection) {
    run(
        database,
        "PRAGMA foreign_keys = ON;
             CREATE TEMP TABLE template AS SELECT id AS job FROM jobs;
             UPDATE jobs SET finished_at = 9000000000000000;
             CREATE TEMP TABLE numbers AS WITH RECURSIVE n (n) AS
                 (SELECT 1 UNION ALL SELECT n + 1 FROM n WHERE n < 1000) SELECT n FROM n",
    );
}

/// Adds the jobs of a day, which end at `now`: copies of the template, each with an image of its own.
fn add_day(database: &Connection, folder: &Path, jobs: i64, now: Timestamp) {
    let now = now.micros().to_string();
    run(database, &format!(
        "BEGIN; DROP TABLE IF EXISTS temp.new_jobs; DROP TABLE IF EXISTS temp.new_tasks;
         CREATE TEMP TABLE new_jobs AS SELECT n, randomblob(16) AS id, randomblob(32) AS image FROM numbers
             WHERE n <= {jobs};
         CREATE TEMP TABLE new_tasks AS SELECT j.id AS job, j.image, t.id AS old, t.kind, randomblob(16) AS id,
             randomblob(16) AS lease FROM new_jobs j, tasks t WHERE t.job_id = (SELECT job FROM template);
         INSERT INTO artifacts (hash, size, created_at) SELECT image, 5, {now} FROM new_jobs"
    ));
    let images: Vec<String> = {
        let mut hashes = database.prepare("SELECT lower(hex(image)) FROM new_jobs").unwrap();
        hashes.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect()
    };
    for image in images {
        let place = folder.join("artifacts/blake3").join(&image[..2]);
        std::fs::create_dir_all(&place).unwrap();
        std::fs::write(place.join(&image), "image").unwrap();
    }
    let of_template = "t.job_id = (SELECT job FROM template)";
    let id = ("job_id", "e.id");
    let ended = [("created_at", now.as_str()), ("finished_at", now.as_str()), ("id", "e.id")];
    copy(database, "jobs", "t.id = (SELECT job FROM template)", "new_jobs e", &ended);
    copy(database, "frames", of_template, "new_jobs e", &[id, ("preview_png", "e.image")]);
    for table in ["live_forecasts", "quotes", "quote_spreads"] {
        let place = if table == "quote_spreads" {
            "new_jobs e JOIN quotes q ON q.job_id = e.id"
        } else {
            "new_jobs e"
        };
        copy(database, table, of_template, place, &[id]);
    }
    let task = ("id", "e.id");
    copy(
        database,
        "tasks",
        "t.id = e.old",
        "new_tasks e",
        &[task, ("job_id", "e.job"), ("finished_at", &now)],
    );
    let times = [
        ("granted_at", format!("{now} - 7200000000")),
        ("ended_at", now.clone()),
        ("expires_at", now.clone()),
    ];
    let mut lease: Vec<(&str, &str)> = times.iter().map(|(name, value)| (*name, value.as_str())).collect();
    lease.extend([("id", "e.lease"), ("task_id", "e.id")]);
    copy(database, "leases", "t.task_id = e.old AND t.state = 'committed'", "new_tasks e", &lease);
    copy(
        database,
        "results",
        "t.task_id = e.old",
        "new_tasks e",
        &[("task_id", "e.id"), ("lease_id", "e.lease")],
    );
    let named = "t.task_id = e.old AND e.kind = 'render' AND t.hash = (SELECT min(hash) FROM result_artifacts r WHERE r.task_id = e.old)";
    copy(database, "result_artifacts", named, "new_tasks e", &[("task_id", "e.id"), ("hash", "e.image")]);
    copy(database, "events", of_template, "new_jobs e", &[("id", "NULL"), id, ("at", &now)]);
    run(database, "COMMIT");
}

fn count(database: &Connection, what: &str) -> i64 {
    database.query_row(&format!("SELECT {what}"), [], |row| row.get(0)).unwrap()
}

fn files(folder: &Path) -> usize {
    let Ok(entries) = std::fs::read_dir(folder) else { return 0 };
    entries.map(|entry| entry.unwrap().path()).map(|path| if path.is_dir() { files(&path) } else { 1 }).sum()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_year_leaves_no_more_behind_than_retention_says() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-2").await;
    farm.work_off(&node, &job).await;
    let Farm { folder, service, viewer, .. } = farm;
    service.shutdown().await;
    let data = folder.path().join("data");
    let store = Store::open(&data).await.unwrap();
    for (kind, days) in [
        (RetentionKind::Jobs, JOBS_KEPT),
        (RetentionKind::Images, IMAGES_KEPT),
        (RetentionKind::Events, JOBS_KEPT),
    ] {
        let rule = RetentionRule { project: None, kind, days: u32::try_from(days).ok() };
        store.set_retention(&rule, Timestamp::now()).await.unwrap();
    }
    let database = Connection::open(data.join("forelight.sqlite")).unwrap();
    prepare(&database);
    let (jobs, first) = (jobs_a_day(), Timestamp::now());
    let mut pages = Vec::new();
    let begun = Instant::now();
    for day in 1..=DAYS {
        let now = first.plus_micros(day * DAY);
        add_day(&database, &data, jobs, now);
        store.prune(false, now.plus_micros(DAY / 2)).await.unwrap();
        pages.push(count(&database, "page_count FROM pragma_page_count"));
    }
    println!("{DAYS} days of {jobs} jobs took {:.1} s", begun.elapsed().as_secs_f64());

    // The rows of the last days and of the template, and no others.
    assert_eq!(count(&database, "count(*) FROM jobs"), jobs * JOBS_KEPT + 1);
    assert_eq!(
        count(&database, "count(*) FROM jobs WHERE images_deleted_at IS NULL"),
        jobs * IMAGES_KEPT + 1
    );
    for table in ["frames", "tasks", "ledger", "quotes", "events"] {
        let strays = format!("count(*) FROM {table} WHERE job_id NOT IN (SELECT id FROM jobs)");
        assert_eq!(count(&database, &strays), 0, "{table}");
    }
    // Images are marked on the night after their days, and deleted on the second one.
    let kept = count(&database, "count(*) FROM artifacts");
    assert_eq!(files(&data.join("artifacts")), usize::try_from(kept).unwrap());
    assert!((jobs * IMAGES_KEPT..=jobs * (IMAGES_KEPT + 2) + 20).contains(&kept), "{kept}");
    // The database does not grow any more.
    let (half, end) = (pages[180], pages[pages.len() - 1]);
    println!("database: {half} pages after half a year, {end} after a year; {kept} files");
    assert!(end <= half + half / 20, "{half} pages after half a year, {end} after a year");
    // Every lease of the year was paid, to the last micro-unit.
    let spent = store.ledger(first, first.plus_micros((DAYS + 1) * DAY)).await.unwrap();
    let spent: i64 =
        spent.iter().map(|line| line.cost_within(first, first.plus_micros((DAYS + 1) * DAY)).0).sum();
    let leases = count(
        &database,
        "count(*) FROM leases l JOIN tasks t ON t.id = l.task_id WHERE l.state = 'committed' AND t.job_id = (SELECT id FROM jobs LIMIT 1)",
    );
    assert_eq!(spent, DAYS * jobs * leases * 2 * 3_600_000);
    drop((store, database));

    let begun = Instant::now();
    let service = start(&support::config(folder.path())).await;
    println!("the service starts in {} ms", begun.elapsed().as_millis());
    let viewer = viewer.at(&support::address(&service));
    for path in ["/v1/jobs", "/v1/jobs?sort=cost", "/v1/jobs?state=done&search=job", "/v1/dashboard"] {
        let begun = Instant::now();
        let answer = viewer.get(path).await;
        assert_eq!(answer.status(), StatusCode::OK);
        println!("{path}: {} ms", begun.elapsed().as_millis());
    }
    let page: JobPage = viewer.get("/v1/jobs").await.parsed(StatusCode::OK).await;
    assert_eq!(page.items.len(), 50);
}
