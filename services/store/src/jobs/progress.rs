//! Progress of jobs.

use forelight_protocol::{JobId, LiveForecast, SharedCacheProgress};
use sqlx::SqliteConnection;

use crate::error::Result;
use crate::living;
use crate::shared_cache::parts;

/// The progress of a job.
#[derive(Clone, PartialEq, Debug)]
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

/// Weighs every frame by its forecast work: with 47 cheap frames and an expensive one, the cheap ones are not
/// 98 %. A frame under way counts by the progress that its worker last reported.
pub(crate) async fn of_job(connection: &mut SqliteConnection, job: JobId) -> Result<Progress> {
    let row = sqlx::query!(
        r#"SELECT coalesce(sum(f.actual IS NOT NULL), 0) AS "done!: u32",
                  coalesce(max(f.actual IS NOT NULL OR coalesce(t.state = 'leased' OR f.parts > 1 AND t.progress > 0, 0)), 0) AS "begun!: bool",
                  coalesce(sum(f.dropped), 0) AS "dropped!: u32",
                  total(CASE WHEN f.dropped THEN 0.0 ELSE coalesce(f.work_mean, 1.0) END) AS "weight!: f64",
                  total(coalesce(f.work_mean, 1.0) * CASE WHEN f.actual IS NOT NULL THEN 1.0
                        WHEN t.state = 'leased' OR f.parts > 1 THEN t.progress ELSE 0.0 END) AS "reached!: f64"
           FROM frames f LEFT JOIN tasks t INDEXED BY tasks_of_frames
                ON t.job_id = f.job_id AND t.kind = 'render' AND t.frame = f.frame
           WHERE f.job_id = ?"#,
        job.0
    )
    .fetch_one(&mut *connection)
    .await?;
    let fraction = if row.weight > 0.0 { (row.reached / row.weight).clamp(0.0, 1.0) } else { 0.0 };
    let live = living::newest(connection, job).await?;
    let shared_cache = parts::progress(connection, job).await?;
    let (frames_done, frames_dropped) = (row.done, row.dropped);
    Ok(Progress { frames_done, frames_dropped, fraction, begun: row.begun, live, shared_cache })
}
