//! Progress of jobs.

use std::collections::BTreeMap;

use forelight_protocol::{JobId, LiveForecast, SharedCacheProgress};
use sqlx::SqliteConnection;

use crate::columns::hex_list;
use crate::error::Result;
use crate::living;
use crate::shared_cache::parts;

/// The progress of a job.
#[derive(Clone, PartialEq, Debug, Default)]
pub(crate) struct Progress {
    pub frames_done: u32,
    /// Frames that a person took out of the job.
    pub frames_dropped: u32,
    /// 0 to 1, as a share of the forecast work; without a forecast, of the frames.
    pub fraction: f64,
    /// Estimate of the job's cost; `None` before it is booked.
    pub live: Option<LiveForecast>,
    /// Progress of the shared irradiance cache that the frames wait for, if any.
    pub shared_cache: Option<SharedCacheProgress>,
    /// Whether any frame is done or with a worker.
    pub begun: bool,
}

/// The progress of a job.
pub(crate) async fn of_job(connection: &mut SqliteConnection, job: JobId) -> Result<Progress> {
    Ok(of_jobs(connection, &[job]).await?.remove(&job).unwrap_or_default())
}

/// The progress of each of these jobs.
///
/// Weighs every frame by its forecast work: with 47 cheap frames and an expensive one, the cheap ones are not
/// 98 %. A frame under way counts by the progress that its worker last reported.
pub(crate) async fn of_jobs(
    connection: &mut SqliteConnection,
    jobs: &[JobId],
) -> Result<BTreeMap<JobId, Progress>> {
    let rows = sqlx::query!(
        r#"SELECT f.job_id AS "job_id!", coalesce(sum(f.actual IS NOT NULL), 0) AS "done!: u32",
                  coalesce(max(f.actual IS NOT NULL OR coalesce(t.state = 'leased' OR f.parts > 1 AND t.progress > 0, 0)), 0) AS "begun!: bool",
                  coalesce(sum(f.dropped), 0) AS "dropped!: u32",
                  total(CASE WHEN f.dropped THEN 0.0 ELSE coalesce(f.work_mean, 1.0) END) AS "weight!: f64",
                  total(coalesce(f.work_mean, 1.0) * CASE WHEN f.actual IS NOT NULL THEN 1.0
                        WHEN t.state = 'leased' OR f.parts > 1 THEN t.progress ELSE 0.0 END) AS "reached!: f64"
           FROM frames f LEFT JOIN tasks t INDEXED BY tasks_of_frames
                ON t.job_id = f.job_id AND t.kind = 'render' AND t.frame = f.frame
           WHERE f.job_id IN (SELECT unhex(value) FROM json_each(?)) GROUP BY f.job_id"#,
        hex_list(jobs.iter().map(|job| job.0))
    )
    .fetch_all(&mut *connection)
    .await?;
    let mut live = living::newest(connection, jobs).await?;
    let mut shared_caches = parts::progress_of_jobs(connection, jobs).await?;
    let mut found = BTreeMap::new();
    for row in rows {
        let job = row.job_id.into();
        let fraction = if row.weight > 0.0 { (row.reached / row.weight).clamp(0.0, 1.0) } else { 0.0 };
        let progress = Progress {
            frames_done: row.done,
            frames_dropped: row.dropped,
            fraction,
            live: live.remove(&job),
            shared_cache: shared_caches.remove(&job),
            begun: row.begun,
        };
        found.insert(job, progress);
    }
    Ok(found)
}
