//! A job's frames: forecast and actual cost.

use forelight_protocol::{
    FrameArtifacts, FrameBooking, FrameFigure, FrameForecast, FrameOutput, FrameRow, FrameState, JobId,
    OutputOf, Quantiles, RenderArtifacts, RenderStats,
};

use crate::columns::{Hash, Id, Json, Time, corrupt};
use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::{jobs, outputs};

/// A frame's row, with its task and its booking.
struct Row {
    frame: u32,
    parts: u32,
    parts_done: u32,
    /// Whether a worker has had one of its parts.
    is_begun: bool,
    forecast: Option<Json<FrameForecast>>,
    actual: Option<Json<RenderStats>>,
    actual_work: Option<f64>,
    actual_cpu: Option<f64>,
    artifacts: Option<Json<RenderArtifacts>>,
    preview_png: Option<Hash>,
    output_due: bool,
    output_error: Option<String>,
    output: Option<String>,
    job: String,
    project: String,
    job_id: Id,
    finished_at: Option<Time>,
    state: Option<String>,
    node_id: Option<Id>,
    attempts: Option<u32>,
    progress: Option<f64>,
    started_at: Option<Time>,
    error: Option<String>,
    booked_node: Option<Id>,
    booked_name: Option<String>,
    start_at: Option<Time>,
    end_at: Option<Time>,
}

macro_rules! rows {
    ($rest:literal $(, $value:expr)* $(,)?) => {
        sqlx::query_as!(
            Row,
            "SELECT f.frame, f.parts, (SELECT count(*) FROM tasks p INDEXED BY tasks_of_parts WHERE f.parts > 1 \
             AND p.kind = 'render_part' AND p.job_id = f.job_id AND p.frame = f.frame AND p.state = 'done') \
             AS \"parts_done!: u32\", \
             EXISTS (SELECT 1 FROM tasks p INDEXED BY tasks_of_parts WHERE f.parts > 1 AND p.kind = 'render_part' \
             AND p.job_id = f.job_id AND p.frame = f.frame AND p.state IN ('leased', 'done')) AS \"is_begun!: bool\", \
             f.forecast, f.actual, f.actual_work, f.actual_cpu, f.artifacts, f.preview_png, \
             f.output_due, f.output_error, j.output, j.name AS job, j.project, j.id AS job_id, f.finished_at, t.state AS \"state?\", t.node_id, t.fence AS \"attempts?: u32\", \
             t.progress AS \"progress?\", t.started_at, t.error, b.node_id AS \"booked_node?\", \
             n.name AS \"booked_name?\", b.start_at AS \"start_at?\", b.end_at AS \"end_at?\" \
             FROM frames f JOIN jobs j ON j.id = f.job_id \
             LEFT JOIN tasks t INDEXED BY tasks_of_frames \
             ON t.job_id = f.job_id AND t.kind = 'render' AND t.frame = f.frame \
             LEFT JOIN bookings b ON b.plan_id = j.plan_id AND b.job_id = f.job_id AND b.frame = f.frame AND b.part = 0 \
             LEFT JOIN nodes n ON n.id = b.node_id "
                + $rest
            $(, $value)*
        )
    };
}

impl Store {
    /// The job's frames after `after`, ascending, at most `limit`.
    pub async fn frames(&self, job: JobId, after: Option<u32>, limit: u32) -> Result<Vec<FrameRow>> {
        let mut transaction = self.read().await?;
        let is_final = jobs::state(&mut transaction, job).await?.is_final();
        let after = after.map_or(-1, i64::from);
        let rows = rows!("WHERE f.job_id = ? AND f.frame > ? ORDER BY f.frame LIMIT ?", job.0, after, limit)
            .fetch_all(&mut *transaction)
            .await?;
        rows.into_iter().map(|row| row.shown(is_final)).collect()
    }

    /// One frame of the job.
    pub async fn frame(&self, job: JobId, frame: u32) -> Result<FrameRow> {
        let mut transaction = self.read().await?;
        let is_final = jobs::state(&mut transaction, job).await?.is_final();
        let row = rows!("WHERE f.job_id = ? AND f.frame = ?", job.0, frame);
        let row = row.fetch_optional(&mut *transaction).await?;
        row.ok_or(StoreError::NotFound("frame"))?.shown(is_final)
    }
}

impl Row {
    /// The frame as the API shows it. A frame without a task is cancelled if its job is over.
    fn shown(self, job_is_final: bool) -> Result<FrameRow> {
        let state = match self.state.as_deref() {
            None if job_is_final => FrameState::Cancelled,
            None => FrameState::Waiting,
            Some("waiting") if self.is_begun => FrameState::Leased,
            Some(state) => state_of(state)?,
        };
        let booked = match (self.booked_node, self.booked_name, self.start_at, self.end_at) {
            (Some(node_id), Some(node), Some(start), Some(end)) => {
                Some(FrameBooking { node_id: node_id.into(), node, start: start.into(), end: end.into() })
            }
            _ => None,
        };
        let images = self.artifacts.map(|it| it.0);
        let output = self.output.as_deref().map(|text| {
            let (project, job, id) = (&self.project, &self.job, self.job_id.into());
            Ok::<_, StoreError>(FrameOutput {
                path: outputs::pattern(text)?.path(OutputOf { project, job, id, frame: self.frame }),
                written: images.is_some() && !self.output_due,
                error: self.output_error.clone(),
            })
        });
        let output = output.transpose()?;
        let forecast = self.forecast.map(|it| it.0);
        Ok(FrameRow {
            frame: self.frame,
            state,
            work: forecast.as_ref().map(|forecast| figure(forecast.work, self.actual_work)),
            cpu_seconds: forecast.as_ref().map(|forecast| figure(forecast.cpu_seconds, self.actual_cpu)),
            forecast,
            actual: self.actual.map(|it| it.0),
            booked,
            parts: self.parts,
            parts_done: self.parts_done,
            node: self.node_id.map(Into::into),
            attempts: self.attempts.unwrap_or(0),
            progress: self.progress.unwrap_or(0.0),
            started: self.started_at.map(Into::into),
            finished: self.finished_at.map(Into::into),
            artifacts: FrameArtifacts {
                preview_png: self.preview_png.map(Into::into),
                cost_map_png: images.map(|images| images.cost_map_png),
                image_png: images.map(|images| images.image_png),
                image_exr: images.map(|images| images.image_exr),
            },
            output,
            error: self.error,
        })
    }
}

/// The state of a task, from its name.
pub(crate) fn state_of(name: &str) -> Result<FrameState> {
    Ok(match name {
        "waiting" => FrameState::Waiting,
        "ready" => FrameState::Ready,
        "leased" => FrameState::Leased,
        "done" => FrameState::Done,
        "failed" => FrameState::Failed,
        "cancelled" => FrameState::Cancelled,
        other => return Err(corrupt("state", other)),
    })
}

fn figure(forecast: Quantiles, actual: Option<f64>) -> FrameFigure {
    let error = actual.filter(|&actual| actual > 0.0).map(|actual| forecast.mean / actual - 1.0);
    FrameFigure { forecast, actual, error }
}
