//! What finished frames teach about nodes: by how much longer they take there than the node's calibration says.
//!
//! Only frames of jobs that were profiled on other nodes say something: on its own node a profile's seconds are the node's. The jobs' means are added
//! up in whole millionths, so that what is learnt does not depend on the order in which frames are finished.

use forelight_forecast::log_ratio_millionths;
use forelight_protocol::{Node, RenderStats};
use forelight_quote::JobForecast;
use sqlx::Row as _;

use crate::StoreError;
use crate::database::Write;
use crate::decode::json_opt;
use crate::leases::LeaseRow;

/// Learns from a finished frame inside the write that keeps it.
pub(crate) async fn learn(
    write: &mut Write,
    row: &LeaseRow,
    node: &Node,
    stats: &RenderStats,
) -> Result<(), StoreError> {
    let Some(speed) = node.speed_by_class(stats.work_by_class.as_ref()) else { return Ok(()) };
    // What was taken over was made elsewhere, and its seconds are those of there.
    if stats.reused_work > 0 {
        return Ok(());
    }
    let job = sqlx::query(
        "SELECT forecast, EXISTS (SELECT 1 FROM tasks t JOIN results r ON r.task_id = t.id JOIN leases l ON l.id = r.lease_id \
         WHERE t.job_id = ?1 AND t.kind = 'profile' AND l.node_id = ?2) AS profiled_here FROM jobs WHERE id = ?1",
    )
    .bind(row.job_id.0)
    .bind(row.node_id.0)
    .fetch_one(write.connection().await?)
    .await?;
    let forecast: Option<JobForecast> = json_opt(&job, "forecast")?;
    let (Some(forecast), false) = (forecast, job.try_get("profiled_here")?) else { return Ok(()) };
    // Of the work that the frame really was, so that only time is judged.
    let seconds_at_one = forecast.total.cpu_seconds.mean / forecast.total.work.mean * stats.work as f64;
    let Some(log) = log_ratio_millionths(stats.cpu_seconds, seconds_at_one / speed) else { return Ok(()) };
    let (frames, sum): (i64, i64) = sqlx::query_as(
        "INSERT INTO node_learning (node_id, job_id, frames, log_millionths) VALUES (?, ?, 1, ?) \
         ON CONFLICT (node_id, job_id) DO UPDATE SET frames = frames + 1, log_millionths = log_millionths + excluded.log_millionths \
         RETURNING frames, log_millionths",
    )
    .bind(row.node_id.0)
    .bind(row.job_id.0)
    .bind(log)
    .fetch_one(write.connection().await?)
    .await?;
    let before = if frames == 1 { 0 } else { (sum - log) / (frames - 1) };
    sqlx::query(
        "UPDATE nodes SET learned_millionths = learned_millionths + ?, learned_jobs = learned_jobs + ? WHERE id = ?",
    )
    .bind(sum / frames - before)
    .bind(i64::from(frames == 1))
    .bind(row.node_id.0)
    .execute(write.connection().await?)
    .await?;
    Ok(())
}
