//! A job's frames, read for the living estimate.

use forelight_protocol::{JobId, Quantiles};
use forelight_quote::living::{FrameCost, FrameState, Frames};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::decode::whole;
use crate::error::StoreError;

/// A job's frames, and the finished pixels of those under way.
pub const FRAMES: &str = "SELECT f.frame, f.clock, f.work_mean, f.work_p50, f.work_p80, f.work_p95, f.cpu_mean, f.cpu_p50, f.cpu_p80, f.cpu_p95, \
    f.actual_work, f.actual_cpu, t.pixels_share, t.pixels_work, t.pixels_cpu FROM frames f \
    LEFT JOIN tasks t INDEXED BY tasks_of_frames ON t.job_id = f.job_id AND t.kind = 'render' AND t.frame = f.frame AND t.state = 'leased' \
    WHERE f.job_id = ? ORDER BY f.frame";

/// Reads a job's frames. `lights` are those of its quote, see [`Frames::new`].
pub(super) async fn read(
    connection: &mut SqliteConnection,
    job: JobId,
    lights: &[u32],
) -> Result<Frames, StoreError> {
    let rows = sqlx::query(FRAMES).bind(job.0).fetch_all(connection).await?;
    let states: Vec<FrameState> = rows.iter().map(decode).collect::<Result<_, _>>()?;
    Ok(Frames::new(&states, lights))
}

fn decode(row: &SqliteRow) -> Result<FrameState, StoreError> {
    let work = ["work_mean", "work_p50", "work_p80", "work_p95"];
    let cpu = ["cpu_mean", "cpu_p50", "cpu_p80", "cpu_p95"];
    Ok(FrameState {
        number: whole(row, "frame")?,
        clock: row.try_get("clock")?,
        share: row.try_get("pixels_share")?,
        work: cost(row, work, "actual_work", "pixels_work")?,
        cpu_seconds: cost(row, cpu, "actual_cpu", "pixels_cpu")?,
    })
}

fn cost(
    row: &SqliteRow,
    [mean, p50, p80, p95]: [&str; 4],
    actual: &str,
    part: &str,
) -> Result<FrameCost, StoreError> {
    // A job that is booked has a forecast of every frame.
    let number =
        |column: &str| Ok::<_, StoreError>(row.try_get::<Option<f64>, _>(column)?.unwrap_or_default());
    let quote = Quantiles { mean: number(mean)?, p50: number(p50)?, p80: number(p80)?, p95: number(p95)? };
    Ok(FrameCost { quote, actual: row.try_get(actual)?, part: row.try_get(part)? })
}
