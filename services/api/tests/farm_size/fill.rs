//! Fills the database of a large farm by SQL, with copies of one real job and one real node.

use rusqlite::Connection;

use crate::support::copies::{copy, run};

/// Nodes of the farm.
pub const NODES: u32 = 5_000;
/// Open jobs.
pub const JOBS: u32 = 2_000;
/// Frames of the longest job.
pub const FRAMES: u32 = 10_000;

/// Fills the database. It has one booked job of frames 0 to 5, one finished frame, and one node.
///
/// Of each copied job, the same frame is finished, and two or three others are being rendered, each on its own
/// node: nearly all nodes work.
pub fn fill(database: &Connection, now: i64) {
    run(database, "PRAGMA foreign_keys = ON; BEGIN");
    templates(database);
    nodes_and_jobs(database, now);
    frames(database);
    tasks(database, now);
    bookings_and_leases(database, now);
    run(database, "COMMIT");
}

/// Temporary tables of what is copied, and of the ids of the copies.
fn templates(database: &Connection) {
    run(database, &format!(
        "CREATE TEMP TABLE template AS SELECT id AS job, plan_id AS plan, (SELECT max(frame) FROM tasks WHERE kind = 'render' AND state = 'ready') AS last FROM jobs;
         CREATE TEMP TABLE ranks AS SELECT frame, row_number() OVER (ORDER BY frame) - 1 AS rank FROM tasks
         WHERE kind = 'render' AND state = 'ready';
         CREATE TEMP TABLE numbers AS WITH RECURSIVE n (n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM n WHERE n < {FRAMES}) SELECT n FROM n;
         CREATE TEMP TABLE new_nodes AS SELECT n, randomblob(16) AS id FROM numbers WHERE n BETWEEN 1 AND {NODES} - 1;
         CREATE UNIQUE INDEX temp.new_nodes_by_n ON new_nodes (n);
         CREATE TEMP TABLE new_jobs AS SELECT n, randomblob(16) AS id FROM numbers WHERE n BETWEEN 1 AND {JOBS} - 1"
    ));
}

fn nodes_and_jobs(database: &Connection, now: i64) {
    // As long as the leases last: on a busy machine, the test takes longer than a node may be silent.
    let last_seen = (now + 3_600_000_000).to_string();
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
            ("deadline_at", &format!("{now} + 5400000000 + e.n % 97 * 300000000")),
            ("outlook", "json_set(t.outlook, '$.promise.kept', json(iif(e.n % 20, 'true', 'false')))"),
            ("frames_total", &format!("iif(e.n = 1, {FRAMES}, t.frames_total)")),
            ("frames", &format!("iif(e.n = 1, '0-{}', t.frames)", FRAMES - 1)),
        ],
    );
}

/// Rows of the job that is copied.
const OF_JOB: &str = "t.job_id = (SELECT job FROM template)";
/// The copies of its own length.
const SMALL: &str = "(SELECT * FROM new_jobs WHERE n > 1) e";

/// The frames of the copy that is longer.
fn large() -> String {
    format!("(SELECT j.id, n.n FROM new_jobs j, numbers n WHERE j.n = 1 AND n.n < {FRAMES}) e")
}

fn frames(database: &Connection) {
    copy(database, "frames", OF_JOB, SMALL, &[("job_id", "e.id")]);
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
    let finished = format!("{OF_JOB} AND t.actual IS NOT NULL");
    copy(database, "frames", &finished, &large(), &all);
}

fn tasks(database: &Connection, now: i64) {
    let a_node = "(SELECT id FROM new_nodes WHERE n = 1 + (e.n * 7 + coalesce(t.frame, 0) * 13) % 4999)";
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
        &format!("{OF_JOB} AND t.kind = 'render' AND t.state IN ('ready', 'done')"),
        SMALL,
        &[
            ("id", "randomblob(16)"),
            ("job_id", "e.id"),
            ("state", &if_it_runs("'leased'", "t.state")),
            ("fence", "1"),
            ("progress", &if_it_runs("e.n % 50 / 100.0", "0")),
            ("node_id", &if_it_runs(&own_node, "t.node_id")),
            ("started_at", &if_it_runs(&started, "t.started_at")),
            ("booked_node", &if_it_runs(&own_node, a_node)),
        ],
    );
    copy(
        database,
        "tasks",
        &format!("{OF_JOB} AND t.kind = 'render' AND t.frame = (SELECT last FROM template)"),
        &large(),
        &[
            ("id", "randomblob(16)"),
            ("job_id", "e.id"),
            ("frame", "e.n"),
            ("state", "iif(e.n < 3333, 'done', 'ready')"),
            ("booked_node", "(SELECT id FROM new_nodes WHERE n = 1 + e.n % 4999)"),
        ],
    );
}

fn bookings_and_leases(database: &Connection, now: i64) {
    run(database, &format!(
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
                l.frames_since, l.cost_is_off, l.finish_is_off, l.body, l.updated_at FROM live_forecasts l, new_jobs e"
    ));
}
