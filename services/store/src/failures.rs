//! Tasks that fail: when they are tried again, when no more, and when it is the node that is at fault.
//!
//! * A task that failed waits before it is handed out again, twice as long each time, and longer before the node that it failed on gets
//!   it again: another node is the better experiment.
//! * A task that failed on three nodes is the task's fault: it fails its job, and its log says why. Where there are fewer nodes, the
//!   sixth failure does.
//! * A node on which tasks of three jobs failed within a day is at fault, if none of these tasks failed for good elsewhere. It is set
//!   aside: it gets no tasks until an operator brings it back. So a job that fails everywhere does not take the farm with it.

use forelight_protocol::{Event, EventKind, JobState, LeaseId, NodeId, TaskError, TaskId, Timestamp};

use crate::database::Write;
use crate::events::{append, event};
use crate::leases::{LeaseState, back_to_ready, end, fail_for_good, read_in, touch};
use crate::{Store, StoreError, jobs, nodes, replans};

/// Nodes on which a task fails before it fails its job.
pub const FAILED_NODES: u32 = 3;

/// Failures of a task, on however few nodes, before it fails its job.
pub const MAX_FAILURES: u32 = 6;

/// Jobs that fail on a node before it is set aside.
pub const FAILED_JOBS: u32 = 3;

/// For how long a failure is held against a node: a day, in microseconds.
const HELD_AGAINST: i64 = 24 * 3_600_000_000;

/// The first wait of a task that failed: a second, in microseconds.
const FIRST_WAIT: i64 = 1_000_000;

/// The longest wait of a task that failed: a minute, in microseconds.
pub(crate) const LONGEST_WAIT: i64 = 60_000_000;

/// For how long after its wait a task is kept for nodes on which it has not failed: ten seconds, in microseconds.
pub(crate) const HEAD_START: i64 = 10_000_000;

/// How long a task waits after its failure number `failures` (from 1), in microseconds: between half and the whole of a ceiling that
/// doubles from a second to a minute. The jitter is a hash of task and number, so that the tasks of a job do not come back at once, and
/// two runs of the same story agree.
pub(crate) fn wait(task: TaskId, failures: u32) -> i64 {
    let doublings = failures.saturating_sub(1).min(16);
    let half = FIRST_WAIT.saturating_mul(1 << doublings).min(LONGEST_WAIT) / 2;
    let mut hasher = blake3::Hasher::new();
    hasher.update(task.0.as_bytes()).update(&failures.to_le_bytes());
    let [a, b, c, d, ..] = *hasher.finalize().as_bytes();
    half + i64::from(u32::from_le_bytes([a, b, c, d])) * half / i64::from(u32::MAX)
}

impl Store {
    /// A worker could not do its task. Says whether this had been reported before, and where the job stands now.
    pub async fn fail_task(
        &self,
        lease: LeaseId,
        fence: u64,
        error: &TaskError,
        now: Timestamp,
    ) -> Result<(bool, JobState), StoreError> {
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
        // What anyone would have met says nothing about the node; neither does a limit that the job set.
        let blameless = error.permanent || error.limit.is_some();
        if blameless {
            sqlx::query("UPDATE leases SET blameless = 1 WHERE id = ?")
                .bind(lease.0)
                .execute(write.connection().await?)
                .await?;
        }
        append(
            &mut write,
            Event { message: Some(error.message.clone()), ..row.event(EventKind::TaskFailed, now) },
        )?;
        let failures = row.failures + 1;
        sqlx::query("UPDATE tasks SET failures = ?, not_before = ? WHERE id = ?")
            .bind(failures)
            .bind(now.plus_micros(wait(row.task_id, failures)).micros())
            .bind(row.task_id.0)
            .execute(write.connection().await?)
            .await?;
        let failed_on = nodes_that_failed(&mut write, row.task_id).await?;
        if error.permanent {
            fail_for_good(&mut write, &row, &error.message, now).await?;
        } else if failed_on.len() >= FAILED_NODES as usize || failures >= MAX_FAILURES {
            let times = match failed_on.as_slice() {
                [one] => format!("{failures} times on {one}"),
                several => format!("on {}", several.join(", ")),
            };
            let error =
                format!("{} (it failed {times}; the log of task {} says more)", error.message, row.task_id);
            fail_for_good(&mut write, &row, &error, now).await?;
        } else {
            back_to_ready(&mut write, &row, Some(&error.message));
        }
        if !blameless {
            set_aside_if_at_fault(&mut write, row.node_id, &error.message, now).await?;
        }
        let state = jobs::state(write.connection().await?, row.job_id).await?;
        self.commit(write).await?;
        Ok((false, state))
    }

    /// When the next task that waits after a failure may be handed out, to whom it failed on or to others; `None` if none waits.
    pub async fn next_retry(&self, now: Timestamp) -> Result<Option<Timestamp>, StoreError> {
        let at: Option<i64> = sqlx::query_scalar(
            "SELECT min(CASE WHEN not_before > ?1 THEN not_before ELSE not_before + ?2 END) FROM tasks INDEXED BY tasks_backing_off \
             WHERE state = 'ready' AND not_before > 0 AND not_before + ?2 > ?1",
        )
        .bind(now.micros())
        .bind(HEAD_START)
        .fetch_one(self.readers())
        .await?;
        Ok(at.map(Timestamp::from_micros))
    }
}

/// Names of the nodes on which a task failed, sorted.
async fn nodes_that_failed(write: &mut Write, task: TaskId) -> Result<Vec<String>, StoreError> {
    Ok(sqlx::query_scalar(
        "SELECT DISTINCT n.name FROM leases l JOIN nodes n ON n.id = l.node_id \
         WHERE l.task_id = ? AND l.state = 'failed' ORDER BY n.name",
    )
    .bind(task.0)
    .fetch_all(write.connection().await?)
    .await?)
}

/// Sets a node aside on which too many jobs failed. Failures of tasks that failed for good are not held against it.
async fn set_aside_if_at_fault(
    write: &mut Write,
    node: NodeId,
    error: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    let jobs: i64 = sqlx::query_scalar(
        "SELECT count(DISTINCT t.job_id) FROM leases l INDEXED BY leases_failed_on_node JOIN tasks t ON t.id = l.task_id \
         WHERE l.node_id = ?1 AND l.state = 'failed' AND NOT l.blameless AND t.state <> 'failed' \
         AND l.ended_at > max(?2, (SELECT trusted_since FROM nodes WHERE id = ?1))",
    )
    .bind(node.0)
    .bind(now.plus_micros(-HELD_AGAINST).micros())
    .fetch_one(write.connection().await?)
    .await?;
    if jobs < i64::from(FAILED_JOBS) {
        return Ok(());
    }
    let reason = format!("tasks of {jobs} jobs failed on it within a day, the last one with: {error}");
    let set = sqlx::query("UPDATE nodes SET set_aside = ? WHERE id = ? AND set_aside IS NULL")
        .bind(&reason)
        .bind(node.0)
        .execute(write.connection().await?)
        .await?;
    if set.rows_affected() == 1 {
        let name = nodes::read(write.connection().await?, node).await?.name;
        replans::want(write, &format!("node {name} is set aside")).await?;
        append(
            write,
            Event {
                node_id: Some(node),
                message: Some(format!("{name}: {reason}")),
                ..event(EventKind::NodeSetAside, now)
            },
        )?;
    }
    Ok(())
}
