//! A job's frames: what was said, and what was.

use forelight_protocol::{
    FrameArtifacts, FrameBooking, FrameFigure, FrameForecast, FrameRow, FrameState, JobId, NodeId, Quantiles,
    RenderArtifacts, RenderStats,
};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::database::Store;
use crate::decode::{corrupt, hash_opt, id_opt, json_opt, time, time_opt, whole};
use crate::error::StoreError;
use crate::jobs;

macro_rules! select_frames {
    ($rest:literal) => {
        concat!(
            "SELECT f.frame, f.forecast, f.actual, f.actual_work, f.actual_cpu, f.artifacts, f.preview_png, f.finished_at, \
             t.state, t.node_id, t.fence, t.progress, t.started_at, t.error, \
             b.node_id AS booked_node, b.start_at, b.end_at, n.name AS booked_name \
             FROM frames f JOIN jobs j ON j.id = f.job_id \
             LEFT JOIN tasks t INDEXED BY tasks_of_frames ON t.job_id = f.job_id AND t.kind = 'render' AND t.frame = f.frame \
             LEFT JOIN bookings b ON b.plan_id = j.plan_id AND b.job_id = f.job_id AND b.frame = f.frame \
             LEFT JOIN nodes n ON n.id = b.node_id ",
            $rest
        )
    };
}

/// A job's frames after one of them.
pub(crate) const PAGE: &str = select_frames!("WHERE f.job_id = ? AND f.frame > ? ORDER BY f.frame LIMIT ?");

impl Store {
    /// The job's frames after `after`, ascending, at most `limit`.
    pub async fn frames(
        &self,
        job: JobId,
        after: Option<u32>,
        limit: u32,
    ) -> Result<Vec<FrameRow>, StoreError> {
        let mut transaction = self.read().await?;
        let final_job = jobs::state(&mut transaction, job).await?.is_final();
        let rows = sqlx::query(PAGE)
            .bind(job.0)
            .bind(after.map_or(-1, i64::from))
            .bind(limit)
            .fetch_all(&mut *transaction)
            .await?;
        rows.iter().map(|row| decode(row, final_job)).collect()
    }

    /// One frame of the job.
    pub async fn frame(&self, job: JobId, frame: u32) -> Result<FrameRow, StoreError> {
        let mut transaction = self.read().await?;
        one(&mut transaction, job, frame).await
    }
}

async fn one(connection: &mut SqliteConnection, job: JobId, frame: u32) -> Result<FrameRow, StoreError> {
    let final_job = jobs::state(connection, job).await?.is_final();
    let row = sqlx::query(select_frames!("WHERE f.job_id = ? AND f.frame = ?"))
        .bind(job.0)
        .bind(i64::from(frame))
        .fetch_optional(connection)
        .await?;
    decode(&row.ok_or(StoreError::NotFound("frame"))?, final_job)
}

fn decode(row: &SqliteRow, final_job: bool) -> Result<FrameRow, StoreError> {
    let forecast: Option<FrameForecast> = json_opt(row, "forecast")?;
    let actual: Option<RenderStats> = json_opt(row, "actual")?;
    let images: Option<RenderArtifacts> = json_opt(row, "artifacts")?;
    let task: Option<&str> = row.try_get("state")?;
    let state = match task {
        None if final_job => FrameState::Cancelled,
        None | Some("waiting") => FrameState::Waiting,
        Some("ready") => FrameState::Ready,
        Some("leased") => FrameState::Leased,
        Some("done") => FrameState::Done,
        Some("failed") => FrameState::Failed,
        Some("cancelled") => FrameState::Cancelled,
        Some(other) => return Err(corrupt("state", other)),
    };
    let booked = match id_opt(row, "booked_node")? {
        None => None,
        Some(node) => Some(FrameBooking {
            node_id: NodeId(node),
            node: row.try_get("booked_name")?,
            start: time(row, "start_at")?,
            end: time(row, "end_at")?,
        }),
    };
    Ok(FrameRow {
        frame: whole(row, "frame")?,
        state,
        work: forecast.as_ref().map(|forecast| figure(forecast.work, row, "actual_work")).transpose()?,
        cpu_seconds: forecast
            .as_ref()
            .map(|forecast| figure(forecast.cpu_seconds, row, "actual_cpu"))
            .transpose()?,
        forecast,
        actual,
        booked,
        node: id_opt(row, "node_id")?.map(NodeId),
        attempts: row.try_get::<Option<u32>, _>("fence")?.unwrap_or(0),
        progress: row.try_get::<Option<f64>, _>("progress")?.unwrap_or(0.0),
        started: time_opt(row, "started_at")?,
        finished: time_opt(row, "finished_at")?,
        artifacts: FrameArtifacts {
            preview_png: hash_opt(row, "preview_png")?,
            cost_map_png: images.map(|images| images.cost_map_png),
            image_png: images.map(|images| images.image_png),
            image_exr: images.map(|images| images.image_exr),
        },
        error: row.try_get("error")?,
    })
}

fn figure(forecast: Quantiles, row: &SqliteRow, column: &str) -> Result<FrameFigure, StoreError> {
    let actual: Option<f64> = row.try_get(column)?;
    let error = actual.filter(|&actual| actual > 0.0).map(|actual| forecast.mean / actual - 1.0);
    Ok(FrameFigure { forecast, actual, error })
}
