//! Tasks of a job that failed and are tried again.

use forelight_protocol::words::counted;
use forelight_protocol::{Failing, JobId, TaskKind, Timestamp};

use crate::columns::{Id, Word};
use crate::database::Store;
use crate::error::Result;

struct Row {
    task: Id,
    kind: Word<TaskKind>,
    frame: Option<u32>,
    attempts: u32,
    error: Option<String>,
    not_before: i64,
    is_ready: bool,
    node: Option<String>,
    /// Whether the last attempt ended without a word of its worker.
    is_lost: bool,
    tasks: u32,
}

impl Store {
    /// What fails of a job that is not over; `None` if nothing does. A worker that was lost once is no failure:
    /// machines are switched off.
    pub async fn failing(&self, job: JobId, now: Timestamp) -> Result<Option<Failing>> {
        let row = sqlx::query_as!(
            Row,
            r#"SELECT t.id AS task, t.kind AS "kind: Word<TaskKind>", t.frame, t.failures + t.expiries AS "attempts!: u32",
                      t.error, t.not_before AS "not_before!: i64", t.state = 'ready' AS "is_ready!: bool",
                      n.name AS "node?", ifnull(l.state = 'expired', 1) AS "is_lost!: bool", count(*) OVER () AS "tasks!: u32"
               FROM tasks t INDEXED BY tasks_failing
               LEFT JOIN leases l ON l.id = (SELECT o.id FROM leases o WHERE o.task_id = t.id
                                             AND o.state IN ('failed', 'expired') ORDER BY o.ended_at DESC, o.id DESC LIMIT 1)
               LEFT JOIN nodes n ON n.id = l.node_id
               WHERE t.job_id = ? AND t.state IN ('waiting', 'ready', 'leased') AND (t.failures > 0 OR t.expiries > 1)
               ORDER BY t.failures + t.expiries DESC, t.frame, t.id LIMIT 1"#,
            job.0
        )
        .fetch_optional(self.readers())
        .await?;
        Ok(row.map(|row| {
            let again = Timestamp::from_micros(row.not_before);
            Failing {
                words: words(&row),
                tasks: row.tasks,
                task_id: row.task.into(),
                frame: row.frame,
                attempts: row.attempts,
                again_at: Some(again).filter(|&again| row.is_ready && again > now),
            }
        }))
    }
}

/// What happened, as a sentence without its end.
fn words(row: &Row) -> String {
    let kind = row.kind.0.name().replace('_', " ");
    let what = match (row.kind.0, row.frame) {
        (TaskKind::Render, Some(frame)) => format!("frame {frame}"),
        (_, Some(frame)) => format!("the {kind} of frame {frame}"),
        (_, None) => format!("the {kind}"),
    };
    let last = if row.attempts == 1 { "" } else { ", last" };
    let node = row.node.as_ref().map_or(String::new(), |node| format!("{last} on {node}"));
    let error = row.error.as_deref().filter(|_| !row.is_lost).unwrap_or("its worker was lost");
    let others = match row.tasks.saturating_sub(1) {
        0 => String::new(),
        others => format!("; so did {}", counted(others, "other task")),
    };
    let times = if row.attempts == 1 { "once".to_owned() } else { counted(row.attempts, "time") };
    format!("{what} failed {times}{node}: {error}{others}")
}
