//! Jobs that end before their last frame: cancelled or failed.

use forelight_protocol::{AuditAction, Job, JobId, JobState, TaskKind, Timestamp};

use crate::audit::{Deed, note_only};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::events::job_state;
use crate::jobs::read;
use crate::leases::LeaseRow;
use crate::living::{self, Occasion};
use crate::plans::replans;
use crate::tasks::withdraw;
use crate::writing::run;

impl Store {
    /// Cancels a job. Its workers are told to stop at their next renewal. Repeating this changes nothing. A
    /// job that is done or failed is a conflict.
    pub async fn cancel_job(&self, job: JobId, now: Timestamp) -> Result<Job> {
        let mut write = self.write().await?;
        let current = read(write.connection().await?, job).await?;
        match current.state {
            JobState::Cancelled => return Ok(current),
            JobState::Done | JobState::Failed => {
                return Err(StoreError::Conflict(format!(
                    "the job is {} and cannot be cancelled",
                    current.state
                )));
            }
            JobState::Previewing
            | JobState::Profiling
            | JobState::Quoted
            | JobState::Booked
            | JobState::Rendering => {}
        }
        cancel(&mut write, &current, now).await?;
        note_only(&mut write, Deed::new(AuditAction::JobCancelled, job).of_project(&current.project), now);
        let cancelled = read(write.connection().await?, job).await?;
        self.commit(write).await?;
        Ok(cancelled)
    }

    /// Fails a job for a reason of its own. Does nothing if the job is over.
    pub async fn fail_job(&self, job: JobId, error: &str, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        fail(&mut write, job, error, now).await?;
        self.commit(write).await
    }
}

/// Cancels an open job inside a write.
pub(crate) async fn cancel(write: &mut Write, job: &Job, now: Timestamp) -> Result<()> {
    withdraw(write, job.id, now).await?;
    run!(write, "UPDATE jobs SET stage = 'cancelled', finished_at = ? WHERE id = ?", now.micros(), job.id.0);
    job_state(write, job.id, JobState::Cancelled, None, now);
    living::update(write, job.id, Occasion::Ended, now).await?;
    if job.plan_id.is_some() {
        replans::want(write, &format!("job {} was cancelled", job.name)).await?;
    }
    Ok(())
}

pub(crate) async fn fail_task_and_job(
    write: &mut Write,
    row: &LeaseRow,
    error: &str,
    now: Timestamp,
) -> Result<()> {
    run!(
        write,
        "UPDATE tasks SET state = 'failed', error = ?, finished_at = ? WHERE id = ?",
        error,
        now.micros(),
        row.task_id.0
    );
    fail_for_task(write, row.job_id, (row.kind, row.frame), error, now).await
}

/// Fails a job inside a write because of one of its tasks.
pub(crate) async fn fail_for_task(
    write: &mut Write,
    job: JobId,
    (kind, frame): (TaskKind, Option<u32>),
    error: &str,
    now: Timestamp,
) -> Result<()> {
    let of_frame = frame.map_or(String::new(), |frame| format!(" of frame {frame}"));
    fail(write, job, &format!("{kind}{of_frame}: {error}"), now).await
}

/// Fails a job inside a write. Does nothing if the job is over.
pub(crate) async fn fail(write: &mut Write, job: JobId, error: &str, now: Timestamp) -> Result<()> {
    let failed = run!(
        write,
        "UPDATE jobs SET stage = 'failed', error = ?, finished_at = ? WHERE id = ? \
         AND stage IN ('previewing', 'profiling', 'booked', 'rendering')",
        error,
        now.micros(),
        job.0
    );
    if failed == 0 {
        return Ok(());
    }
    withdraw(write, job, now).await?;
    living::update(write, job, Occasion::Ended, now).await?;
    let failed = read(write.connection().await?, job).await?;
    if failed.plan_id.is_some() {
        replans::want(write, &format!("job {} failed", failed.name)).await?;
    }
    job_state(write, job, JobState::Failed, Some(error.to_owned()), now);
    Ok(())
}
