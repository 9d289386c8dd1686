//! Reads the database of a stopped service without the service's own code.

use forelight_protocol::JobId;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{Connection as _, Row as _};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const FILES: [&str; 2] = ["forelight.sqlite", "forelight.sqlite-wal"];

/// A copy of a database, so that reading it cannot affect the next start of the service.
pub struct Ledger {
    connection: SqliteConnection,
    data: PathBuf,
    _copy: tempfile::TempDir,
}

/// A lease and the state of its task.
#[derive(Clone, Debug, PartialEq)]
pub struct LeaseLine {
    /// Hexadecimal id.
    pub id: String,
    /// Kind of the task.
    pub kind: String,
    /// Frame. `None` for previews.
    pub frame: Option<i64>,
    /// Fencing token.
    pub fence: i64,
    /// `active`, `committed`, `expired`, …
    pub state: String,
    /// Progress of the task.
    pub progress: f64,
}

impl Ledger {
    /// Copies the database from the data folder of a stopped service.
    pub async fn of(data: &Path) -> Self {
        let copy = tempfile::tempdir().expect("a temporary folder can be made");
        for name in FILES {
            let from = data.join(name);
            if from.exists() {
                std::fs::copy(&from, copy.path().join(name))
                    .unwrap_or_else(|error| panic!("{name}: {error}"));
            }
        }
        let options = SqliteConnectOptions::new().filename(copy.path().join(FILES[0]));
        let connection = SqliteConnection::connect_with(&options).await.expect("the copy can be opened");
        Self { connection, data: data.to_owned(), _copy: copy }
    }

    /// All leases of a job, by task and fencing token.
    pub async fn leases(&mut self, job: JobId) -> Vec<LeaseLine> {
        let rows = sqlx::query(
            "SELECT lower(hex(l.id)) AS id, t.kind, t.frame, l.fence, l.state, t.progress FROM leases l \
             JOIN tasks t ON t.id = l.task_id WHERE t.job_id = ? ORDER BY t.kind, t.frame, l.fence",
        )
        .bind(job.0)
        .fetch_all(&mut self.connection)
        .await
        .expect("leases can be read");
        let line = |row: &sqlx::sqlite::SqliteRow| LeaseLine {
            id: row.get("id"),
            kind: row.get("kind"),
            frame: row.get("frame"),
            fence: row.get("fence"),
            state: row.get("state"),
            progress: row.get("progress"),
        };
        rows.iter().map(line).collect()
    }

    /// Numbers of rows that clients can add to, by table.
    pub async fn rows(&mut self) -> BTreeMap<&'static str, i64> {
        let tables = [
            ("artifacts", "SELECT count(*) FROM artifacts"),
            ("bundles", "SELECT count(*) FROM bundles"),
            ("jobs", "SELECT count(*) FROM jobs"),
            ("tasks", "SELECT count(*) FROM tasks"),
            ("frames", "SELECT count(*) FROM frames"),
            ("events", "SELECT count(*) FROM events"),
            ("idempotency", "SELECT count(*) FROM idempotency"),
        ];
        let mut rows = BTreeMap::new();
        for (table, count) in tables {
            rows.insert(table, self.number(count).await);
        }
        rows
    }

    async fn number(&mut self, query: &'static str) -> i64 {
        sqlx::query_scalar(query)
            .fetch_one(&mut self.connection)
            .await
            .unwrap_or_else(|error| panic!("{query}: {error}"))
    }

    /// Checks the consistency of a farm whose jobs are all done. Every task has one result, from its last
    /// lease. Tasks, leases and events agree on claims, losses and results. Every referenced artefact exists
    /// with its content.
    pub async fn assert_balanced(&mut self) {
        let intact: String = sqlx::query_scalar("PRAGMA integrity_check")
            .fetch_one(&mut self.connection)
            .await
            .expect("the database can be checked");
        assert_eq!(intact, "ok");
        for (what, query) in WRONGS {
            assert_eq!(self.number(query).await, 0, "{what}");
        }
        let artifacts: Vec<(String, i64)> = sqlx::query_as("SELECT lower(hex(hash)), size FROM artifacts")
            .fetch_all(&mut self.connection)
            .await
            .expect("artefacts can be read");
        assert!(!artifacts.is_empty());
        for (hash, size) in artifacts {
            let path = self.data.join("artifacts/blake3").join(&hash[..2]).join(&hash);
            let content = std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            assert_eq!(content.len() as i64, size, "{hash}");
            assert_eq!(blake3::hash(&content).to_hex().as_str(), hash);
        }
    }
}

/// Forbidden states, with queries that count them.
const WRONGS: [(&str, &str); 14] = [
    ("rows that refer to nothing", "SELECT count(*) FROM pragma_foreign_key_check"),
    ("jobs that are not done", "SELECT count(*) FROM jobs WHERE state <> 'done'"),
    ("tasks that are not done", "SELECT count(*) FROM tasks WHERE state <> 'done'"),
    (
        "frames without a render task of their own",
        "SELECT count(*) FROM frames f WHERE (SELECT count(*) FROM tasks t WHERE t.job_id = f.job_id AND t.kind = 'render' AND t.frame = f.frame) <> 1",
    ),
    (
        "frames without an actual cost",
        "SELECT count(*) FROM frames WHERE actual IS NULL OR finished_at IS NULL OR artifacts IS NULL",
    ),
    ("leases that are still held", "SELECT count(*) FROM leases WHERE state = 'active'"),
    (
        "tasks without exactly one committed lease, or one for each pass over their frame",
        "SELECT count(*) FROM tasks t WHERE (SELECT count(*) FROM leases l WHERE l.task_id = t.id AND l.state = 'committed') <> \
         CASE WHEN t.kind IN ('divide', 'render_part') THEN ifnull((SELECT count(*) - (t.kind = 'render_part') FROM leases l \
         JOIN tasks d ON d.id = l.task_id WHERE d.job_id = t.job_id AND d.frame = t.frame AND d.kind = 'divide' \
         AND json_extract(d.spec, '$.divide.passes') IS NOT NULL AND l.state = 'committed' HAVING count(*) > 0), 1) ELSE 1 END",
    ),
    (
        "tasks without exactly one result",
        "SELECT count(*) FROM tasks t WHERE (SELECT count(*) FROM results r WHERE r.task_id = t.id) <> 1",
    ),
    (
        "results that another lease than the task's last brought",
        "SELECT count(*) FROM results r JOIN tasks t ON t.id = r.task_id JOIN leases l ON l.id = r.lease_id WHERE l.state <> 'committed' OR l.fence <> t.fence OR l.task_id <> t.id",
    ),
    (
        "tasks handed out another number of times than there are leases",
        "SELECT count(*) FROM tasks t WHERE t.fence <> (SELECT count(*) FROM leases l WHERE l.task_id = t.id)",
    ),
    (
        "tasks whose lost workers were miscounted",
        // A task that has a pass behind it begins to count anew.
        "SELECT count(*) FROM tasks t WHERE t.expiries <> (SELECT count(*) FROM leases l WHERE l.task_id = t.id AND l.state = 'expired' \
         AND l.fence > ifnull((SELECT max(c.fence) FROM leases c WHERE c.task_id = t.id AND c.state = 'committed' AND c.fence < t.fence), 0))",
    ),
    (
        "results that were not told, or told twice",
        "SELECT abs((SELECT count(*) FROM events WHERE kind = 'task_done') - (SELECT count(*) FROM leases WHERE state = 'committed'))",
    ),
    (
        "hand-outs that were not told, or told twice",
        "SELECT abs((SELECT count(*) FROM events WHERE kind = 'task_leased') - (SELECT count(*) FROM leases))",
    ),
    (
        "lost leases that were not told, or told twice",
        "SELECT abs((SELECT count(*) FROM events WHERE kind = 'lease_expired') - (SELECT count(*) FROM leases WHERE state = 'expired'))",
    ),
];
