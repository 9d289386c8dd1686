//! Jobs that an operator took out of the track record: neither the record nor calibration counts them, and
//! nodes forget what they taught. The reason is kept. A job can be put back.

use forelight_protocol::{AuditAction, JobId, LeftOutJob, Timestamp};
use sqlx::SqliteConnection;

use crate::audit::{Deed, note, note_only};
use crate::columns::Json;
use crate::database::{Store, Write};
use crate::error::Result;
use crate::jobs;
use crate::jobs::changing::tell;
use crate::writing::run;

/// Most jobs that the record lists.
const SHOWN: u32 = 1000;

impl Store {
    /// Takes a job out of the track record. If it is out already, it gets the new reason.
    pub async fn leave_out(&self, job: JobId, reason: &str, now: Timestamp) -> Result<LeftOutJob> {
        let mut write = self.write().await?;
        let found = jobs::read(write.connection().await?, job).await?;
        run!(
            write,
            "INSERT INTO left_out_jobs (job_id, reason, at) VALUES (?, ?, ?) \
             ON CONFLICT (job_id) DO UPDATE SET reason = excluded.reason, at = excluded.at",
            job.0,
            reason,
            now.micros()
        );
        let deed = Deed::new(AuditAction::JobLeftOut, job).of_project(&found.project);
        note(&mut write, deed, Some(&serde_json::json!({ "reason": reason })), now);
        learn_anew(&mut write, job).await?;
        tell(&mut write, job, &format!("it was taken out of the track record: {reason}"), now);
        self.commit(write).await?;
        Ok(LeftOutJob { job_id: job, name: found.name, reason: reason.to_owned(), at: now })
    }

    /// Puts a job back into the track record. Does nothing if it is there.
    pub async fn put_back(&self, job: JobId, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        let found = jobs::read(write.connection().await?, job).await?;
        let was_out = run!(write, "DELETE FROM left_out_jobs WHERE job_id = ?", job.0) > 0;
        if was_out {
            note_only(&mut write, Deed::new(AuditAction::JobCounted, job).of_project(&found.project), now);
            learn_anew(&mut write, job).await?;
            tell(&mut write, job, "it was put back into the track record", now);
        }
        self.commit(write).await
    }
}

/// The jobs that are out of the record, the newest first; those of `projects`, if they are given.
pub(crate) async fn list(
    connection: &mut SqliteConnection,
    projects: Option<&[String]>,
) -> Result<Vec<LeftOutJob>> {
    let rows = sqlx::query!(
        "SELECT o.job_id, j.name, o.reason, o.at FROM left_out_jobs o JOIN jobs j ON j.id = o.job_id \
         WHERE ?1 IS NULL OR j.project IN (SELECT value FROM json_each(?1)) \
         ORDER BY o.at DESC, o.job_id DESC LIMIT ?2",
        projects.map(Json),
        SHOWN
    )
    .fetch_all(connection)
    .await?;
    Ok(rows
        .into_iter()
        .map(|row| LeftOutJob {
            job_id: row.job_id.into(),
            name: row.name,
            reason: row.reason,
            at: row.at.into(),
        })
        .collect())
}

/// Whether a job is out of the record.
pub(crate) async fn is_left_out(write: &mut Write, job: JobId) -> Result<bool> {
    Ok(sqlx::query_scalar!(
        r#"SELECT EXISTS (SELECT 1 FROM left_out_jobs WHERE job_id = ?) AS "is_out!: bool""#,
        job.0
    )
    .fetch_one(write.connection().await?)
    .await?)
}

/// Sums up again what the nodes that rendered a job have learnt: whole numbers, so that the sum is that of
/// the jobs in the record, in whatever order they came.
async fn learn_anew(write: &mut Write, job: JobId) -> Result<()> {
    run!(
        write,
        "UPDATE nodes SET (learned_millionths, learned_jobs) = (SELECT coalesce(sum(n.log_millionths / n.frames), 0), \
         count(*) FROM node_learning n WHERE n.node_id = nodes.id \
         AND n.job_id NOT IN (SELECT job_id FROM left_out_jobs)) \
         WHERE id IN (SELECT node_id FROM node_learning WHERE job_id = ?)",
        job.0
    );
    Ok(())
}
