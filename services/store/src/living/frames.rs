//! A job's frames, read for the living estimate.

use forelight_protocol::{JobId, Quantiles};
use forelight_quote::living::{FrameCost, FrameState, Frames};
use sqlx::SqliteConnection;

use crate::error::Result;

/// Reads a job's frames, and the finished pixels of those under way. For `lights` see [`Frames::new`].
pub(super) async fn read(connection: &mut SqliteConnection, job: JobId, lights: &[u32]) -> Result<Frames> {
    let rows = sqlx::query!(
        r#"SELECT f.frame, f.clock, f.work_mean, f.work_p50, f.work_p80, f.work_p95, f.cpu_mean, f.cpu_p50,
                  f.cpu_p80, f.cpu_p95,
                  f.actual_work, f.actual_cpu, f.dropped, t.pixels_share, t.pixels_work, t.pixels_cpu
           FROM frames f LEFT JOIN tasks t INDEXED BY tasks_of_frames
                ON t.job_id = f.job_id AND t.kind = 'render' AND t.frame = f.frame AND (t.state = 'leased' OR f.parts > 1)
           WHERE f.job_id = ? ORDER BY f.frame"#,
        job.0
    )
    .fetch_all(connection)
    .await?;
    // `lights` has a number for each frame of the quote, also for those that were taken out since.
    let stays = rows.iter().map(|row| !row.dropped);
    let lights: Vec<u32> =
        lights.iter().zip(stays).filter_map(|(&lights, stays)| stays.then_some(lights)).collect();
    let states: Vec<FrameState> = rows
        .into_iter()
        .filter(|row| !row.dropped)
        .map(|row| FrameState {
            number: row.frame,
            clock: row.clock,
            share: row.pixels_share,
            work: FrameCost {
                quote: quantiles([row.work_mean, row.work_p50, row.work_p80, row.work_p95]),
                actual: row.actual_work,
                part: row.pixels_work,
            },
            cpu_seconds: FrameCost {
                quote: quantiles([row.cpu_mean, row.cpu_p50, row.cpu_p80, row.cpu_p95]),
                actual: row.actual_cpu,
                part: row.pixels_cpu,
            },
        })
        .collect();
    Ok(Frames::new(&states, &lights))
}

/// A job that is booked has a forecast of every frame.
fn quantiles(columns: [Option<f64>; 4]) -> Quantiles {
    let [mean, p50, p80, p95] = columns.map(Option::unwrap_or_default);
    Quantiles { mean, p50, p80, p95 }
}
