//! Logs of tasks.

use forelight_protocol::{LOG_LINES, LeaseId, LogLine, TaskId, TaskLog, TaskLogLine};

use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::leases::{LeaseRow, LeaseState, read_in};
use crate::writing::run;

impl Store {
    /// Keeps the last log lines of a worker, before it reports how its task ended. If the worker does not
    /// hold the lease, nothing is kept and no error is returned: the report that follows is refused.
    pub async fn keep_log(&self, lease: LeaseId, fence: u64, lines: &[LogLine]) -> Result<()> {
        if lines.is_empty() {
            return Ok(());
        }
        let mut write = self.write().await?;
        let row = read_in(&mut write, lease).await?;
        if row.fence == fence && row.state == LeaseState::Active {
            keep(&mut write, &row, lines).await?;
            self.commit(write).await?;
        }
        Ok(())
    }

    /// The log of a task: all attempts, oldest first.
    pub async fn task_log(&self, task: TaskId) -> Result<TaskLog> {
        let mut read = self.read().await?;
        let is_there = sqlx::query_scalar!(
            r#"SELECT EXISTS (SELECT 1 FROM tasks WHERE id = ?) AS "is_there!: bool""#,
            task.0
        )
        .fetch_one(&mut *read)
        .await?;
        if !is_there {
            return Err(StoreError::NotFound("task"));
        }
        let lines = sqlx::query_as!(
            TaskLogLine,
            "SELECT fence AS attempt, number, at, level, line AS text FROM task_logs WHERE task_id = ? \
             ORDER BY fence, number",
            task.0
        )
        .fetch_all(&mut *read)
        .await?;
        Ok(TaskLog { task_id: task, lines })
    }
}

/// Keeps log lines of a lease. Lines that are stored already, and lines beyond [`LOG_LINES`], are dropped.
pub(crate) async fn keep(write: &mut Write, row: &LeaseRow, lines: &[LogLine]) -> Result<()> {
    for line in lines.iter().filter(|line| line.number < LOG_LINES) {
        let line = line.clone().cleaned();
        run!(
            write,
            "INSERT INTO task_logs (task_id, fence, number, at, level, line) VALUES (?, ?, ?, ?, ?, ?) \
             ON CONFLICT DO NOTHING",
            row.task_id.0,
            i64::try_from(row.fence).unwrap_or(i64::MAX),
            line.number,
            line.at.micros(),
            line.level.name(),
            line.text
        );
    }
    Ok(())
}
