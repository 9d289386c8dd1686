//! Makes a job's tasks, and takes them all back.

pub(crate) mod listing;

use forelight_protocol::{
    ArtifactHash, BundleSource, CacheFillSpec, CacheMergeSpec, CachePlanSpec, DivideSpec, ErrorTarget,
    FrameRate, JobId, JobSettings, Money, Needs, NodeId, PartRange, Passes, PreviewSpec, ProfileSpec,
    RenderPartSpec, RenderSettings, RenderSpec, RenderedBy, RendererRequest, SampleShare, SceneDigest,
    TaskId, TaskKind, TaskLimits, TaskSpec, Timestamp, VideoSpec,
};
use forelight_quote::serial_time::SerialTime;
use sqlx::SqliteConnection;

use crate::columns::{Id, Json};
use crate::database::Write;
use crate::error::{Result, StoreError};
use crate::jobs::{self, JobRow};
use crate::policy::work_stealing::{Rates, is_bounded};
use crate::videos::FFMPEG;
use crate::writing::run;

/// State of a task that may be handed out.
const READY: &str = "ready";
/// State of a task that waits for another one.
const WAITING: &str = "waiting";

/// Where a task is booked: node, planned start, and the plan's rate there (see `0010_idle_nodes.sql`).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slot {
    pub node: NodeId,
    pub start: Timestamp,
    pub rate: Option<i64>,
}

/// What all tasks of a job have in common.
pub(crate) struct Common {
    pub job: JobId,
    pub bundle: BundleSource,
    /// Digest of the scene when the job was submitted.
    pub digest: SceneDigest,
    pub settings: JobSettings,
    pub renderer: Option<RendererRequest>,
    /// The version of our own renderer that renders the job.
    pub own: Option<RenderedBy>,
    pub denoise: bool,
    pub error_target: Option<ErrorTarget>,
    pub deadline: Option<Timestamp>,
    pub priority: i32,
    pub limits: TaskLimits,
}

/// A profile to make.
pub(crate) struct ProfileAsked {
    pub frame: u32,
    /// Pixels to profile.
    pub samples: u32,
    /// Number of the job's frames that are profiled before this one.
    pub turn: u64,
    /// Whether to measure the ladders of qualities, too.
    pub ladders: bool,
    /// A planned shared cache: the pixels are also measured with it.
    pub cache: Option<ArtifactHash>,
}

/// A part of a frame to render.
#[derive(Clone, Copy)]
pub(crate) struct PartAsked {
    pub frame: u32,
    pub part: u32,
    /// Number of parts of the frame.
    pub parts: u32,
    /// What belongs to the part. `None` until the frame is divided: the part waits for that.
    pub range: Option<PartRange>,
    /// Finished pixels of the frame's profile.
    pub profile: Option<ArtifactHash>,
    /// The complete shared irradiance cache.
    pub cache: Option<ArtifactHash>,
}

/// A frame to render.
pub(crate) struct RenderAsked {
    pub frame: u32,
    /// Largest work of the frame, or with an error target its forecast. `None`: the settings' samples.
    pub work: Option<u64>,
    pub finished: Finished,
}

/// What the profile of a frame has finished of it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Finished {
    /// Pixels, or an irradiance cache.
    pub profile: Option<ArtifactHash>,
    /// Shares of the samples.
    pub shares: Vec<SampleShare>,
}

impl Common {
    pub(crate) fn of(row: &JobRow) -> Self {
        Self {
            job: row.id.into(),
            bundle: row.bundle_source.0.clone(),
            digest: row.scene.0.digest,
            settings: row.settings.0.clone(),
            renderer: row.renderer.as_ref().map(|it| it.0.clone()),
            own: row.rendered_by.as_ref().map(|it| it.0.clone()),
            denoise: row.denoise,
            error_target: row.error_target.as_ref().map(|it| it.0),
            deadline: row.deadline_at.map(Into::into),
            priority: row.priority,
            limits: row.limits.0,
        }
    }

    pub(crate) async fn read(connection: &mut SqliteConnection, job: JobId) -> Result<Self> {
        Ok(Self::of(&jobs::row(connection, job).await?))
    }

    pub(crate) async fn preview(&self, write: &mut Write, frames: Vec<u32>) -> Result<()> {
        let spec = PreviewSpec {
            job_id: self.job,
            bundle: self.bundle.clone(),
            digest: self.digest,
            frames,
            settings: self.settings.clone(),
            renderer: self.renderer.clone(),
        };
        self.insert(write, TaskSpec::Preview(spec), READY, None).await
    }

    /// Makes a profile task. With `waits`, it becomes ready when the shared cache is planned.
    pub(crate) async fn profile(
        &self,
        write: &mut Write,
        ProfileAsked { frame, samples, turn, ladders, cache }: ProfileAsked,
        waits: bool,
    ) -> Result<()> {
        let spec = ProfileSpec {
            job_id: self.job,
            bundle: self.bundle.clone(),
            digest: self.digest,
            frame,
            samples,
            phase_seed: self.settings.own().map_or(turn, |settings| settings.seed),
            settings: self.settings.clone(),
            renderer: self.renderer.clone(),
            ladders,
            denoise: self.denoise,
            error_target: self.error_target,
            cache,
        };
        self.insert(write, TaskSpec::Profile(spec), if waits { WAITING } else { READY }, None).await
    }

    pub(crate) async fn cache_plan(&self, write: &mut Write, frames: Vec<u32>) -> Result<()> {
        let spec = CachePlanSpec {
            job_id: self.job,
            bundle: self.bundle.clone(),
            digest: self.digest,
            frames,
            settings: self.own_settings()?,
        };
        self.insert(write, TaskSpec::CachePlan(spec), READY, None).await
    }

    /// Makes the task of one of `parts` equal parts of a round, from 0. The cache is shared, or of one frame.
    pub(crate) async fn cache_fill(
        &self,
        write: &mut Write,
        (cache, frame): (ArtifactHash, Option<u32>),
        round: u32,
        (part, parts): (u32, u32),
        booked: Option<Slot>,
    ) -> Result<()> {
        let spec = CacheFillSpec {
            job_id: self.job,
            bundle: self.bundle.clone(),
            digest: self.digest,
            frame,
            settings: self.own_settings()?,
            cache,
            round,
            part,
            parts,
        };
        self.insert(write, TaskSpec::CacheFill(spec), READY, booked).await
    }

    pub(crate) async fn cache_merge(
        &self,
        write: &mut Write,
        frame: Option<u32>,
        round: u32,
        parts: Vec<ArtifactHash>,
    ) -> Result<()> {
        let spec = CacheMergeSpec {
            job_id: self.job,
            bundle: self.bundle.clone(),
            digest: self.digest,
            frame,
            round,
            parts,
        };
        self.insert(write, TaskSpec::CacheMerge(spec), READY, None).await
    }

    /// The settings of a job that can have an irradiance cache.
    fn own_settings(&self) -> Result<RenderSettings> {
        let foreign = || StoreError::Conflict("another renderer's job has no irradiance cache".to_owned());
        self.settings.own().cloned().ok_or_else(foreign)
    }

    /// Makes the task of a frame. With `waits`, it waits for the shared cache.
    pub(crate) async fn render(&self, write: &mut Write, asked: RenderAsked, waits: bool) -> Result<()> {
        let RenderAsked { frame, work, finished } = asked;
        let Finished { profile, shares } = finished;
        let spec = RenderSpec {
            job_id: self.job,
            bundle: self.bundle.clone(),
            digest: self.digest,
            frame,
            settings: self.settings.clone(),
            renderer: self.renderer.clone(),
            work,
            error_target: self.error_target,
            denoise: self.denoise,
            profile,
            cache: None,
            frame_cache: None,
            parts: Vec::new(),
            shares,
        };
        self.insert(write, TaskSpec::Render(spec), if waits { WAITING } else { READY }, None).await
    }

    /// Makes the task that finds the parts of a frame, which may be rendered in passes. With `waits`, it waits
    /// for the shared cache.
    pub(crate) async fn divide(
        &self,
        write: &mut Write,
        asked: PartAsked,
        passes: Option<Passes>,
        waits: bool,
    ) -> Result<()> {
        let PartAsked { frame, parts, profile, cache, .. } = asked;
        let spec = DivideSpec {
            job_id: self.job,
            bundle: self.bundle.clone(),
            digest: self.digest,
            frame,
            settings: self.own_settings()?,
            parts,
            profile,
            cache,
            frame_cache: None,
            passes,
        };
        self.insert(write, TaskSpec::Divide(spec), if waits { WAITING } else { READY }, None).await
    }

    /// Makes the task of a part of a frame.
    pub(crate) async fn render_part(&self, write: &mut Write, asked: PartAsked) -> Result<()> {
        let PartAsked { frame, part, parts, range, profile, cache } = asked;
        let spec = RenderPartSpec {
            job_id: self.job,
            bundle: self.bundle.clone(),
            digest: self.digest,
            frame,
            settings: self.settings.clone(),
            renderer: self.renderer.clone(),
            part,
            parts,
            range,
            profile,
            cache,
            frame_cache: None,
            pass: None,
        };
        let state = if range.is_some() { READY } else { WAITING };
        self.insert(write, TaskSpec::RenderPart(spec), state, None).await
    }

    /// Makes the task of one more part of a frame.
    pub(crate) async fn one_more_part(&self, write: &mut Write, spec: RenderPartSpec) -> Result<()> {
        self.insert(write, TaskSpec::RenderPart(spec), READY, None).await
    }

    /// Makes the task of the video, or lets it begin again.
    pub(crate) async fn video(
        &self,
        write: &mut Write,
        frames_per_second: FrameRate,
        pictures: Vec<ArtifactHash>,
    ) -> Result<()> {
        let spec = TaskSpec::Video(VideoSpec { job_id: self.job, frames_per_second, pictures });
        let text = Json(&spec);
        let existing = sqlx::query_scalar!(
            "UPDATE tasks SET spec = ? WHERE job_id = ? AND kind = 'video' RETURNING id AS \"id!: Id\"",
            text,
            self.job.0
        )
        .fetch_optional(write.connection().await?)
        .await?;
        match existing {
            Some(task) => {
                write.made_work = true;
                begin_again(write, task, READY).await
            }
            None => self.insert(write, spec, READY, None).await,
        }
    }

    async fn insert(
        &self,
        write: &mut Write,
        spec: TaskSpec,
        state: &'static str,
        booked: Option<Slot>,
    ) -> Result<()> {
        // What plans book.
        let booked_part = match &spec {
            TaskSpec::RenderPart(spec) => Some(spec.part),
            TaskSpec::Render(_) => Some(0),
            _ => None,
        };
        let needed = match &spec {
            TaskSpec::Video(_) => Some(FFMPEG.to_owned()),
            _ => {
                let denoise = self.denoise && matches!(spec.kind(), TaskKind::Profile | TaskKind::Render);
                Needs::of(spec.renderer(), self.own.as_ref(), denoise).as_ref().map(ToString::to_string)
            }
        };
        run!(
            write,
            "INSERT INTO tasks (id, job_id, kind, frame, round, part, booked_part, state, spec, due_at, priority, \
             booked_node, booked_at, booked_rate, limits, renderer) \
             VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT DO NOTHING",
            TaskId::new().0,
            self.job.0,
            spec.kind().name(),
            spec.frame(),
            spec.round(),
            spec.part(),
            booked_part,
            state,
            Json(&spec),
            self.deadline.map_or(i64::MAX, Timestamp::micros),
            self.priority,
            booked.map(|slot| slot.node.0),
            booked.map(|slot| slot.start.micros()),
            booked.and_then(|slot| slot.rate),
            Json(&self.limits),
            needed
        );
        write.made_work |= state == READY;
        Ok(())
    }
}

/// Takes back all unfinished tasks of a job. Their leases become `revoked`, so that the next renewal brings
/// each worker the order to stop.
pub(crate) async fn withdraw(write: &mut Write, job: JobId, now: Timestamp) -> Result<()> {
    run!(
        write,
        "UPDATE leases SET state = 'revoked', ended_at = coalesce(paid_until, min(?, expires_at)) \
         WHERE state = 'active' AND task_id IN (SELECT id FROM tasks WHERE job_id = ? AND state = 'leased')",
        now.micros(),
        job.0
    );
    run!(
        write,
        "UPDATE tasks SET state = 'cancelled', finished_at = ? WHERE job_id = ? \
         AND state IN ('waiting', 'ready', 'leased')",
        now.micros(),
        job.0
    );
    Ok(())
}

/// Forgets the result of a task that is done.
pub(crate) async fn forget_result(write: &mut Write, task: Id) -> Result<()> {
    run!(write, "DELETE FROM result_artifacts WHERE task_id = ?", task);
    run!(write, "DELETE FROM results WHERE task_id = ?", task);
    Ok(())
}

/// Makes a task as if it had never been handed out, except for its fencing token.
pub(crate) async fn begin_again(write: &mut Write, task: Id, state: &'static str) -> Result<()> {
    run!(
        write,
        "UPDATE tasks SET state = ?1, failures = 0, expiries = 0, progress = 0, error = NULL, not_before = 0, \
         node_id = NULL, started_at = NULL, finished_at = NULL, pixels_share = NULL, pixels_work = NULL, \
         pixels_cpu = NULL, begun_anew = fence, held = EXISTS (SELECT 1 FROM held_jobs h WHERE h.job_id = tasks.job_id) \
         WHERE id = ?2",
        state,
        task
    );
    run!(write, "UPDATE slurm_elements SET is_past = 1 WHERE task_id = ? AND outcome IS NOT NULL", task);
    Ok(())
}

/// What plans pay for the work of a job.
pub(crate) async fn rates(connection: &mut SqliteConnection, job: JobId) -> Result<Rates> {
    let row = sqlx::query!("SELECT deadline_at, budget, work_by_class, serial_one_core, serial_many_cores FROM jobs WHERE id = ?",
        job.0
    )
        .fetch_optional(connection)
        .await?;
    let row = row.ok_or(StoreError::NotFound("job"))?;
    let is_bounded = is_bounded(row.deadline_at.map(Into::into), row.budget.map(Money));
    let serial = SerialTime { one_core: row.serial_one_core, many_cores: row.serial_many_cores };
    Ok(Rates { work: row.work_by_class.map(|it| it.0), is_bounded, serial })
}
