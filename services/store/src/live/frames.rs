//! A job's frames as the living estimate wants them.

use forelight_forecast::{Band, Known, LiveFrame};
use forelight_protocol::JobId;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::StoreError;

/// The job's frames as the forecast wants them.
pub(super) struct Frames {
    pub work: Vec<LiveFrame>,
    pub cpu: Vec<LiveFrame>,
    /// How many of them are finished.
    pub done: u32,
    pub all_done: bool,
    /// The part of the quoted CPU time whose frames, or pixels, are not finished.
    pub share_left: f64,
}

/// A job's frames, and the finished pixels of those under way.
pub const FRAMES: &str = "SELECT f.frame, f.clock, f.work_mean, f.work_p50, f.work_p80, f.work_p95, f.cpu_mean, f.cpu_p50, f.cpu_p80, f.cpu_p95, \
    f.actual_work, f.actual_cpu, t.pixels_share, t.pixels_work, t.pixels_cpu FROM frames f \
    LEFT JOIN tasks t INDEXED BY tasks_of_frames ON t.job_id = f.job_id AND t.kind = 'render' AND t.frame = f.frame AND t.state = 'leased' \
    WHERE f.job_id = ? ORDER BY f.frame";

impl Frames {
    pub async fn read(
        connection: &mut SqliteConnection,
        job: JobId,
        lights: &[u32],
    ) -> Result<Self, StoreError> {
        let rows = sqlx::query(FRAMES).bind(job.0).fetch_all(connection).await?;
        let first: i64 = rows.first().map(|row| row.try_get("frame")).transpose()?.unwrap_or(0);
        let mut frames = Self {
            work: Vec::with_capacity(rows.len()),
            cpu: Vec::with_capacity(rows.len()),
            done: 0,
            all_done: false,
            share_left: 0.0,
        };
        let (mut all, mut left) = (0.0, 0.0);
        for (place, row) in rows.iter().enumerate() {
            let lights = lights.get(place).copied().unwrap_or_default();
            let number: i64 = row.try_get("frame")?;
            let time = row.try_get::<Option<f64>, _>("clock")?.unwrap_or((number - first) as f64);
            let share: Option<f64> = row.try_get("pixels_share")?;
            let known = |actual: &str, part: &str| -> Result<Known, StoreError> {
                let (actual, part): (Option<f64>, Option<f64>) = (row.try_get(actual)?, row.try_get(part)?);
                Ok(match (actual, share, part) {
                    (Some(cost), ..) => Known::All(cost),
                    (None, Some(share), Some(cost)) if share > 0.0 => Known::Part { share, cost },
                    _ => Known::Nothing,
                })
            };
            let work = known("actual_work", "pixels_work")?;
            let cpu = known("actual_cpu", "pixels_cpu")?;
            let quote = band(row, ["work_mean", "work_p50", "work_p80", "work_p95"])?;
            frames.work.push(LiveFrame { time, lights, quote, known: work });
            let quote = band(row, ["cpu_mean", "cpu_p50", "cpu_p80", "cpu_p95"])?;
            frames.cpu.push(LiveFrame { time, lights, quote, known: cpu });
            frames.done += u32::from(matches!(cpu, Known::All(_)));
            all += quote.mean;
            left += quote.mean
                * match cpu {
                    Known::Nothing => 1.0,
                    Known::Part { share, .. } => 1.0 - share,
                    Known::All(_) => 0.0,
                };
        }
        frames.all_done = frames.done as usize == rows.len();
        frames.share_left = if all > 0.0 { left / all } else { 0.0 };
        Ok(frames)
    }
}

fn band(row: &SqliteRow, [mean, p50, p80, p95]: [&str; 4]) -> Result<Band, StoreError> {
    // A job that is booked has a forecast of every frame.
    let number =
        |column: &str| Ok::<_, StoreError>(row.try_get::<Option<f64>, _>(column)?.unwrap_or_default());
    Ok(Band { mean: number(mean)?, p50: number(p50)?, p80: number(p80)?, p95: number(p95)? })
}
