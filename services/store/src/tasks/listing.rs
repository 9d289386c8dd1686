//! Tasks of a job, as lists show them.

use forelight_protocol::{JobId, TaskId, TaskKind, TaskRow};

use crate::columns::{Hash, Id, Time, Word};
use crate::database::Store;
use crate::error::Result;
use crate::jobs;
use crate::jobs::frames::state_of;

/// A row of the list.
struct Row {
    id: Id,
    kind: Word<TaskKind>,
    frame: Option<u32>,
    part: Option<u32>,
    state: String,
    node_id: Option<Id>,
    attempts: u32,
    progress: f64,
    started_at: Option<Time>,
    finished_at: Option<Time>,
    pixels: Option<Hash>,
    coarse_png: Option<Hash>,
    error: Option<String>,
}

impl Store {
    /// The job's tasks after `after`, oldest first, at most `limit`; only those of one frame if `frame` is
    /// given.
    pub async fn tasks(
        &self,
        job: JobId,
        frame: Option<u32>,
        after: Option<TaskId>,
        limit: u32,
    ) -> Result<Vec<TaskRow>> {
        let mut transaction = self.read().await?;
        jobs::state(&mut transaction, job).await?;
        let rows = sqlx::query_as!(
            Row,
            r#"SELECT t.id, t.kind, t.frame, t.part, t.state, t.node_id, t.fence AS "attempts!: u32", t.progress,
                      t.started_at, t.finished_at, t.error,
                      (SELECT a.hash FROM result_artifacts a WHERE a.task_id = t.id AND t.kind = 'render_part')
                      AS "pixels?: Hash",
                      (SELECT a.hash FROM results r JOIN result_artifacts a ON a.task_id = r.task_id
                       AND a.hash = unhex(json_extract(r.body, '$.divide.coarse_png'))
                       WHERE r.task_id = t.id AND t.kind = 'divide') AS "coarse_png?: Hash"
               FROM tasks t INDEXED BY tasks_once
               WHERE t.job_id = ?1 AND (?2 IS NULL OR t.frame = ?2) AND t.id > ?3 ORDER BY t.id LIMIT ?4"#,
            job.0,
            frame,
            after.map_or(uuid::Uuid::nil(), |task| task.0),
            limit
        )
        .fetch_all(&mut *transaction)
        .await?;
        rows.into_iter().map(Row::shown).collect()
    }
}

impl Row {
    fn shown(self) -> Result<TaskRow> {
        Ok(TaskRow {
            id: self.id.into(),
            kind: self.kind.0,
            frame: self.frame,
            part: self.part,
            state: state_of(&self.state)?,
            node: self.node_id.map(Into::into),
            attempts: self.attempts,
            progress: self.progress,
            started: self.started_at.map(Into::into),
            finished: self.finished_at.map(Into::into),
            pixels: self.pixels.map(Into::into),
            coarse_png: self.coarse_png.map(Into::into),
            error: self.error,
        })
    }
}
