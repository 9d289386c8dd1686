//! A job's tasks: making them, and taking them all back.

use forelight_protocol::{
    ArtifactHash, BundleSource, JobId, NodeId, PreviewSpec, ProfileSpec, RenderSettings, RenderSpec,
    SceneDigest, TaskId, TaskLimits, TaskSpec, Timestamp,
};

use sqlx::sqlite::SqliteRow;

use crate::database::Write;
use crate::decode::{json, time_opt, to_json, whole};
use crate::{StoreError, jobs};

/// What all tasks of a job have in common.
pub(crate) struct Common {
    pub job: JobId,
    pub bundle: BundleSource,
    /// Of the scene, as it was when the job was submitted.
    pub digest: SceneDigest,
    pub settings: RenderSettings,
    pub deadline: Option<Timestamp>,
    pub priority: i32,
    pub limits: TaskLimits,
}

impl Common {
    /// Read from a job's row.
    pub(crate) fn of(job: JobId, row: &SqliteRow) -> Result<Self, StoreError> {
        Ok(Self {
            job,
            bundle: jobs::source(row)?,
            digest: jobs::digest(row)?,
            settings: json(row, "settings")?,
            deadline: time_opt(row, "deadline_at")?,
            priority: whole(row, "priority")?,
            limits: json(row, "limits")?,
        })
    }

    pub(crate) async fn preview(&self, write: &mut Write, frames: Vec<u32>) -> Result<(), StoreError> {
        let spec = PreviewSpec {
            job_id: self.job,
            bundle: self.bundle.clone(),
            digest: self.digest,
            frames,
            settings: self.settings.clone(),
        };
        self.insert(write, TaskSpec::Preview(spec), None).await
    }

    pub(crate) async fn profile(
        &self,
        write: &mut Write,
        frame: u32,
        samples: u32,
    ) -> Result<(), StoreError> {
        let spec = ProfileSpec {
            job_id: self.job,
            bundle: self.bundle.clone(),
            digest: self.digest,
            frame,
            samples,
            phase_seed: self.settings.seed,
            settings: self.settings.clone(),
        };
        self.insert(write, TaskSpec::Profile(spec), None).await
    }

    pub(crate) async fn render(
        &self,
        write: &mut Write,
        frame: u32,
        booked: Option<(NodeId, Timestamp)>,
        profile: Option<ArtifactHash>,
    ) -> Result<(), StoreError> {
        let spec = RenderSpec {
            job_id: self.job,
            bundle: self.bundle.clone(),
            digest: self.digest,
            frame,
            settings: self.settings.clone(),
            profile,
        };
        self.insert(write, TaskSpec::Render(spec), booked).await
    }

    async fn insert(
        &self,
        write: &mut Write,
        spec: TaskSpec,
        booked: Option<(NodeId, Timestamp)>,
    ) -> Result<(), StoreError> {
        sqlx::query(
            "INSERT INTO tasks (id, job_id, kind, frame, state, spec, due_at, priority, booked_node, booked_at, limits) \
             VALUES (?, ?, ?, ?, 'ready', ?, ?, ?, ?, ?, ?) ON CONFLICT DO NOTHING",
        )
        .bind(TaskId::new().0)
        .bind(self.job.0)
        .bind(spec.kind().name())
        .bind(spec.frame().map(i64::from))
        .bind(to_json(&spec)?)
        .bind(self.deadline.map_or(i64::MAX, Timestamp::micros))
        .bind(i64::from(self.priority))
        .bind(booked.map(|(node, _)| node.0))
        .bind(booked.map(|(_, start)| start.micros()))
        .bind(to_json(&self.limits)?)
        .execute(write.connection())
        .await?;
        write.made_work = true;
        Ok(())
    }
}

/// Takes back all tasks of a job that are not finished. Leases become `revoked`, so that the next renewal of each
/// brings its worker the order to stop.
pub(crate) async fn withdraw(write: &mut Write, job: JobId, now: Timestamp) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE leases SET state = 'revoked', ended_at = ? WHERE state = 'active' \
         AND task_id IN (SELECT id FROM tasks WHERE job_id = ? AND state = 'leased')",
    )
    .bind(now.micros())
    .bind(job.0)
    .execute(write.connection())
    .await?;
    sqlx::query("UPDATE tasks SET state = 'cancelled', finished_at = ? WHERE job_id = ? AND state IN ('ready', 'leased')")
        .bind(now.micros())
        .bind(job.0)
        .execute(write.connection())
        .await?;
    Ok(())
}
