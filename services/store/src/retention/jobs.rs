//! Deletes images, profiles, and all the rest of jobs that have ended.

use forelight_protocol::{AuditAction, JobId, RetentionKind, Timestamp};

use crate::audit::{Deed, note_only};
use crate::budgets::past;
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::jobs::read;
use crate::policy::retention::Rules;
use crate::tasks::withdraw;
use crate::videos;
use crate::writing::run;

/// Tasks of a job that has ended may take so long to be cancelled in Slurm, microseconds.
const TO_END_IN_SLURM: i64 = 600_000_000;

/// A job that has ended.
struct Ended {
    job: JobId,
    project: String,
    at: Timestamp,
}

impl Store {
    /// Deletes a job that has ended: its frames, tasks, logs, events and bookings. Its files are deleted once
    /// nothing else refers to them. What it cost stays in the books of its project.
    ///
    /// A [`StoreError::Conflict`] if the job is still open, or Slurm is still told to end its tasks.
    pub async fn delete_job(&self, job: JobId, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        let found = read(write.connection().await?, job).await?;
        if !found.state.is_final() {
            return Err(StoreError::Conflict(format!("the job is {}; cancel it first", found.state)));
        }
        // Afterwards nothing would end them. If Slurm does not answer for long, that is not waited for.
        let is_new = found.finished_at.is_some_and(|at| now.micros_since(at) < TO_END_IN_SLURM);
        if is_new && is_in_slurm(&mut write, job).await? {
            let reason = "its tasks are about to be cancelled in Slurm; delete it in some minutes";
            return Err(StoreError::Conflict(reason.to_owned()));
        }
        note_only(&mut write, Deed::new(AuditAction::JobDeleted, job).of_project(&found.project), now);
        delete(&mut write, job, now).await?;
        self.commit(write).await
    }

    /// Deletes one kind of thing of all jobs whose time is over. Returns how many jobs these are, and the
    /// size of their files.
    pub(super) async fn prune_jobs(
        &self,
        kind: RetentionKind,
        rules: &Rules,
        dry_run: bool,
        now: Timestamp,
    ) -> Result<(u64, u64)> {
        let Some(latest) = rules.latest_cut(kind, now) else { return Ok((0, 0)) };
        let is_over =
            |ended: &Ended| rules.cut(kind, Some(&ended.project), now).is_some_and(|cut| ended.at < cut);
        let (mut number, mut bytes) = (0, 0);
        for ended in self.ended(kind, latest).await?.into_iter().filter(is_over) {
            let size = self.file_bytes(ended.job, kind).await?;
            if !dry_run {
                let mut write = self.write().await?;
                if !is_as_it_ended(&mut write, &ended).await? {
                    continue;
                }
                prune(&mut write, ended.job, kind, now).await?;
                self.commit(write).await?;
            }
            number += 1;
            bytes += size;
        }
        if kind == RetentionKind::Jobs && !dry_run {
            let mut write = self.write().await?;
            run!(write, "DELETE FROM deleted_jobs WHERE deleted_at < ?", latest.micros());
            self.commit(write).await?;
        }
        Ok((number, bytes))
    }

    /// Jobs that ended before an instant and still have this kind of thing, oldest first. Images that wait to be
    /// written to their output folder stay, and so do their jobs.
    async fn ended(&self, kind: RetentionKind, before: Timestamp) -> Result<Vec<Ended>> {
        let (images, profiles) = (kind == RetentionKind::Images, kind == RetentionKind::Profiles);
        let rows = sqlx::query!(
            r#"SELECT id, project, finished_at AS "finished_at!" FROM jobs WHERE finished_at < ?1
               AND (?2 = 0 OR images_deleted_at IS NULL) AND (?3 = 0 OR profiles_deleted_at IS NULL)
               AND (?3 OR NOT EXISTS (SELECT 1 FROM frames f WHERE f.job_id = jobs.id AND f.output_due = 1))
               ORDER BY finished_at, id"#,
            before.micros(),
            images,
            profiles
        )
        .fetch_all(self.readers())
        .await?;
        let ended = rows.into_iter().map(|row| Ended {
            job: row.id.into(),
            project: row.project,
            at: row.finished_at.into(),
        });
        Ok(ended.collect())
    }

    /// Size of the files that the results of a job name: of images, of profiles, or of both.
    async fn file_bytes(&self, job: JobId, kind: RetentionKind) -> Result<u64> {
        let bytes = sqlx::query_scalar!(
            r#"SELECT coalesce(sum(size), 0) AS "bytes!: u64" FROM artifacts WHERE hash IN (
                   SELECT a.hash FROM tasks t JOIN result_artifacts a ON a.task_id = t.id WHERE t.job_id = ?1
                   AND (?2 OR (t.kind IN ('preview', 'render', 'video')) = ?3))"#,
            job.0,
            kind == RetentionKind::Jobs,
            kind == RetentionKind::Images
        )
        .fetch_one(self.readers())
        .await?;
        Ok(bytes)
    }
}

/// Whether a job is still as it ended then: it may be gone, or its frames may have been retried.
async fn is_as_it_ended(write: &mut Write, Ended { job, at, .. }: &Ended) -> Result<bool> {
    let found = sqlx::query_scalar!(
        r#"SELECT EXISTS (SELECT 1 FROM jobs WHERE id = ? AND finished_at = ?) AS "found!: bool""#,
        job.0,
        at.micros()
    );
    Ok(found.fetch_one(write.connection().await?).await?)
}

/// Whether a process or a reservation of the job may be left in Slurm.
async fn is_in_slurm(write: &mut Write, job: JobId) -> Result<bool> {
    let found = sqlx::query_scalar!(
        r#"SELECT EXISTS (SELECT 1 FROM slurm_arrays a WHERE a.job_id = ? AND (a.reservation IS NOT NULL OR EXISTS
               (SELECT 1 FROM slurm_elements e WHERE e.array_id = a.id AND e.outcome IS NULL))) AS "found!: bool""#,
        job.0
    );
    Ok(found.fetch_one(write.connection().await?).await?)
}

/// Deletes one kind of thing of a job that is over.
async fn prune(write: &mut Write, job: JobId, kind: RetentionKind, now: Timestamp) -> Result<()> {
    match kind {
        RetentionKind::Images => delete_images(write, job, now).await,
        RetentionKind::Profiles => delete_profiles(write, job, now).await,
        _ => delete(write, job, now).await,
    }
}

async fn delete_images(write: &mut Write, job: JobId, now: Timestamp) -> Result<()> {
    run!(
        write,
        "DELETE FROM result_artifacts WHERE task_id IN \
         (SELECT id FROM tasks WHERE job_id = ? AND kind IN ('preview', 'render'))",
        job.0
    );
    run!(
        write,
        "UPDATE frames SET artifacts = NULL, preview_png = NULL, output_due = 0 WHERE job_id = ?",
        job.0
    );
    videos::take_video_back(write, job, "cancelled", now).await?;
    run!(write, "UPDATE jobs SET images_deleted_at = ?, video = NULL WHERE id = ?", now.micros(), job.0);
    Ok(())
}

async fn delete_profiles(write: &mut Write, job: JobId, now: Timestamp) -> Result<()> {
    // The pictures that a profile shows go with it.
    run!(
        write,
        "DELETE FROM result_artifacts WHERE task_id IN \
         (SELECT id FROM tasks WHERE job_id = ? AND kind NOT IN ('preview', 'render', 'video'))",
        job.0
    );
    run!(write, "UPDATE jobs SET profiles_deleted_at = ? WHERE id = ?", now.micros(), job.0);
    Ok(())
}

/// Deletes from tables in order: `forget!(write, job, "tasks WHERE job_id = ?", …)`.
macro_rules! forget {
    ($write:expr, $job:expr, $($rows:literal),+ $(,)?) => {
        $(sqlx::query!("DELETE FROM " + $rows, $job.0).execute($write.connection().await?).await?;)+
    };
}

/// Deletes all rows of a job that has ended, those that refer to others first.
async fn delete(write: &mut Write, job: JobId, now: Timestamp) -> Result<()> {
    // A video may still be encoded.
    withdraw(write, job, now).await?;
    past::add(write, job, now).await?;
    // From here on, triggers let its payments and bookings go.
    run!(
        write,
        "INSERT INTO deleted_jobs (id, name, project, deleted_at) \
         SELECT id, name, project, ? FROM jobs WHERE id = ?",
        now.micros(),
        job.0
    );
    forget!(
        write,
        job,
        "result_artifacts WHERE task_id IN (SELECT id FROM tasks WHERE job_id = ?)",
        "results WHERE task_id IN (SELECT id FROM tasks WHERE job_id = ?)",
        "task_logs WHERE task_id IN (SELECT id FROM tasks WHERE job_id = ?)",
        "slurm_elements WHERE task_id IN (SELECT id FROM tasks WHERE job_id = ?)",
        "slurm_arrays WHERE job_id = ?",
        "ledger WHERE job_id = ?",
        "leases WHERE task_id IN (SELECT id FROM tasks WHERE job_id = ?)",
        "tasks WHERE job_id = ?",
        "bookings WHERE job_id = ?",
        "shared_cache_bookings WHERE job_id = ?",
        "forecast_history WHERE job_id = ?",
        "live_forecasts WHERE job_id = ?",
        "quote_spreads WHERE job_id = ?",
        "quotes WHERE job_id = ?",
        "node_learning WHERE job_id = ?",
        "node_use WHERE job_id = ?",
        "left_out_jobs WHERE job_id = ?",
        "frames WHERE job_id = ?",
        "events WHERE job_id = ?",
        "jobs WHERE id = ?",
    );
    Ok(())
}
