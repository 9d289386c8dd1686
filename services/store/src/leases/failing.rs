//! Records failed tasks. [`crate::policy::retries`] decides what follows.

use forelight_protocol::{Event, EventKind, JobState, LeaseId, NodeId, TaskError, TaskId, Timestamp};

use crate::columns::Time;
use crate::database::{Store, Write};
use crate::error::Result;
use crate::events::{append, node_event};
use crate::jobs;
use crate::jobs::ending::fail_task_and_job;
use crate::leases::{LeaseState, back_to_ready, end, read_in, touch};
use crate::nodes;
use crate::plans::replans;
use crate::policy::retries::{HEAD_START, HELD_AGAINST, is_blameless, job_error, reason_to_set_aside, wait};
use crate::writing::run;

impl Store {
    /// Records that a worker could not do its task. Returns whether it is a repetition, and the job's state.
    pub async fn fail_task(
        &self,
        lease: LeaseId,
        fence: u64,
        error: &TaskError,
        now: Timestamp,
    ) -> Result<(bool, JobState)> {
        let mut write = self.write().await?;
        let row = read_in(&mut write, lease).await?;
        if row.fence == fence && row.state == LeaseState::Failed {
            return Ok((true, jobs::state(write.connection().await?, row.job_id).await?));
        }
        if row.fence != fence || row.state != LeaseState::Active {
            return self.refuse(write, &row, now).await;
        }
        end(&mut write, &row, "failed", now);
        touch(&mut write, row.node_id, now);
        let blameless = is_blameless(error);
        if blameless {
            run!(write, "UPDATE leases SET blameless = 1 WHERE id = ?", lease.0);
        }
        append(
            &mut write,
            Event { message: Some(error.message.clone()), ..row.event(EventKind::TaskFailed, now) },
        );
        let failures = row.failures + 1;
        run!(
            write,
            "UPDATE tasks SET failures = ?, not_before = ? WHERE id = ?",
            failures,
            now.plus_micros(wait(row.task_id, failures)).micros(),
            row.task_id.0
        );
        let failed_on = nodes_that_failed(&mut write, row.task_id).await?;
        match job_error(error, row.task_id, failures, &failed_on) {
            Some(job_error) => fail_task_and_job(&mut write, &row, &job_error, now).await?,
            None => back_to_ready(&mut write, &row, Some(&error.message)),
        }
        if !blameless {
            set_aside_if_at_fault(&mut write, row.node_id, &error.message, now).await?;
        }
        let state = jobs::state(write.connection().await?, row.job_id).await?;
        self.commit(write).await?;
        Ok((false, state))
    }

    /// When the next task that waits after a failure may be handed out, to a node on which it failed or to
    /// another. `None` if none waits.
    pub async fn next_retry(&self, now: Timestamp) -> Result<Option<Timestamp>> {
        let at = sqlx::query_scalar!(
            "SELECT min(CASE WHEN not_before > ?1 THEN not_before ELSE not_before + ?2 END) AS \"at?: \
             Time\" FROM tasks INDEXED BY tasks_backing_off WHERE state = 'ready' AND not_before > 0 \
             AND not_before + ?2 > ?1",
            now.micros(),
            HEAD_START
        )
        .fetch_one(self.readers())
        .await?;
        Ok(at.map(Into::into))
    }
}

/// Names of the nodes on which a task failed, sorted.
async fn nodes_that_failed(write: &mut Write, task: TaskId) -> Result<Vec<String>> {
    Ok(sqlx::query_scalar!(
        "SELECT DISTINCT n.name FROM leases l JOIN nodes n ON n.id = l.node_id \
         WHERE l.task_id = ? AND l.state = 'failed' ORDER BY n.name",
        task.0
    )
    .fetch_all(write.connection().await?)
    .await?)
}

/// Sets a node aside on which tasks of too many jobs failed. Tasks that failed their jobs do not count.
async fn set_aside_if_at_fault(write: &mut Write, node: NodeId, error: &str, now: Timestamp) -> Result<()> {
    let jobs = sqlx::query_scalar!(
        "SELECT count(DISTINCT t.job_id) FROM leases l INDEXED BY leases_failed_on_node \
         JOIN tasks t ON t.id = l.task_id WHERE l.node_id = ?1 AND l.state = 'failed' \
         AND NOT l.blameless AND t.state <> 'failed' AND l.ended_at > max(?2, (SELECT trusted_since \
         FROM nodes WHERE id = ?1))",
        node.0,
        now.plus_micros(-HELD_AGAINST).micros()
    )
    .fetch_one(write.connection().await?)
    .await?;
    let Some(reason) = reason_to_set_aside(jobs, error) else { return Ok(()) };
    let set =
        run!(write, "UPDATE nodes SET set_aside = ? WHERE id = ? AND set_aside IS NULL", reason, node.0);
    if set == 1 {
        let node = nodes::read(write.connection().await?, node).await?;
        replans::want(write, &format!("node {} is set aside", node.name)).await?;
        node_event(write, EventKind::NodeSetAside, &node, format!("{}: {reason}", node.name), now);
    }
    Ok(())
}
