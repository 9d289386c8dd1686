//! Learns from finished frames how much longer they take on a node than its calibration says.
//!
//! Only jobs that were profiled on other nodes count: on the profiling node itself, the profile's seconds are
//! the node's own. The jobs' means are summed in whole millionths, so the result does not depend on the order
//! in which frames finish.

use forelight_protocol::{Node, RenderStats};

use crate::database::Write;
use crate::error::Result;
use crate::leases::LeaseRow;
use crate::policy::learning::{is_lesson, lesson_of_frame, moved_mean};
use crate::quotes::left_out::is_left_out;
use crate::writing::run;

pub(crate) async fn learn(write: &mut Write, row: &LeaseRow, node: &Node, stats: &RenderStats) -> Result<()> {
    let Some(speed) = node.speed_by_class(stats.work_by_class.as_ref()) else { return Ok(()) };
    if !is_lesson(stats) {
        return Ok(());
    }
    let job = sqlx::query!(
        "SELECT forecast, EXISTS (SELECT 1 FROM tasks t JOIN results r ON r.task_id = t.id \
         JOIN leases l ON l.id = r.lease_id WHERE t.job_id = ?1 AND t.kind = 'profile' \
         AND l.node_id = ?2) AS \"profiled_here!: bool\" FROM jobs WHERE id = ?1",
        row.job_id.0,
        row.node_id.0
    )
    .fetch_one(write.connection().await?)
    .await?;
    let (Some(forecast), false) = (job.forecast, job.profiled_here) else { return Ok(()) };
    let Some(log) = lesson_of_frame(stats, speed, &forecast.read()?.total) else { return Ok(()) };
    let learnt = sqlx::query!(
        "INSERT INTO node_learning (node_id, job_id, frames, log_millionths) VALUES (?, ?, 1, ?) \
         ON CONFLICT (node_id, job_id) DO UPDATE SET frames = frames + 1, log_millionths = \
         log_millionths + excluded.log_millionths RETURNING frames, log_millionths",
        row.node_id.0,
        row.job_id.0,
        log
    )
    .fetch_one(write.connection().await?)
    .await?;
    if is_left_out(write, row.job_id).await? {
        return Ok(());
    }
    run!(
        write,
        "UPDATE nodes SET learned_millionths = learned_millionths + ?, learned_jobs = learned_jobs + ? \
         WHERE id = ?",
        moved_mean(learnt.frames, learnt.log_millionths, log),
        i64::from(learnt.frames == 1),
        row.node_id.0
    );
    Ok(())
}
