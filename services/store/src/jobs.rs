//! Jobs: submitting, reading, cancelling, failing.

use forelight_forecast::FIRST_FRAMES;
use forelight_protocol::{
    BundleId, BundleRef, BundleSource, Event, EventKind, FrameSet, Job, JobId, JobRequest, JobState, Money,
    PlanId, RenderSettings, SceneDigest, SceneSummary, TaskKind, Timestamp,
};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use crate::database::Write;
use crate::decode::{id, id_opt, json, json_opt, time, time_opt, to_json, whole, word};
use crate::events::{append, event, job_state};
use crate::idempotency::{Answered, IdempotencyKey, earlier_answer, record};
use crate::live::{self, Occasion};
use crate::progress::{self, Progress};
use crate::tasks::{Common, withdraw};
use crate::{JobOutlook, Store, StoreError, replans};

/// A job that has been checked.
#[derive(Clone, PartialEq, Debug)]
pub struct NewJob {
    /// What was asked for.
    pub request: JobRequest,
    /// What is in the bundle.
    pub scene: SceneSummary,
    /// Where workers find the bundle.
    pub source: BundleSource,
    /// The settings with all defaults filled in.
    pub settings: RenderSettings,
}

/// Which jobs to list.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct JobFilter {
    /// Only jobs in this state.
    pub state: Option<JobState>,
    /// Only jobs of this project.
    pub project: Option<String>,
    /// Only jobs with exactly this name.
    pub name: Option<String>,
}

impl Store {
    /// Remembers a job with its frames and its first task, the preview.
    pub async fn create_job(
        &self,
        new: &NewJob,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Answered<Job>, StoreError> {
        let NewJob { request, scene, source, settings } = new;
        let mut write = self.write().await?;
        if let Some(answer) = earlier_answer(&mut write, key).await? {
            return Ok(Answered::Repeated(answer));
        }
        let job_id = JobId::new();
        sqlx::query(
            "INSERT INTO jobs (id, name, project, state, bundle_id, bundle_path, bundle_source, scene, frames, frames_total, \
             settings, samples, profile_frames, deadline_at, budget, confidence, priority, created_at, limits, within, cache, weight, \
             profiles_more, ladders) VALUES (?, ?, ?, 'previewing', ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(job_id.0)
        .bind(&request.name)
        .bind(&request.project)
        .bind(request.bundle.id.map(|bundle| bundle.0))
        .bind(&request.bundle.path)
        .bind(to_json(source)?)
        .bind(to_json(scene)?)
        .bind(request.frames.to_string())
        .bind(i64::try_from(request.frames.count()).unwrap_or(i64::MAX))
        .bind(to_json(settings)?)
        .bind(i64::from(request.samples))
        .bind(request.profile_frames.map_or(FIRST_FRAMES as i64, i64::from))
        .bind(request.deadline.map(Timestamp::micros))
        .bind(request.budget.map(Money::micro_units))
        .bind(request.confidence.name())
        .bind(i64::from(request.priority))
        .bind(now.micros())
        .bind(to_json(&request.limits)?)
        .bind(request.within.as_ref().map(to_json).transpose()?)
        .bind(request.cache.name())
        .bind(i64::from(request.weight))
        .bind(request.profile_frames.is_none())
        .bind(request.ladders.name())
        .execute(write.connection().await?)
        .await?;
        for frame in request.frames.iter() {
            sqlx::query("INSERT INTO frames (job_id, frame) VALUES (?, ?)")
                .bind(job_id.0)
                .bind(i64::from(frame))
                .execute(write.connection().await?)
                .await?;
        }
        let common = Common {
            job: job_id,
            bundle: source.clone(),
            digest: scene.digest,
            settings: settings.clone(),
            deadline: request.deadline,
            priority: request.priority,
            limits: request.limits,
        };
        common.preview(&mut write, request.frames.iter().collect()).await?;
        append(
            &mut write,
            Event {
                job_id: Some(job_id),
                job_state: Some(JobState::Previewing),
                message: Some(request.name.clone()),
                ..event(EventKind::JobCreated, now)
            },
        )?;
        let job = read(write.connection().await?, job_id).await?;
        record(&mut write, key, 201, &job, now)?;
        self.commit(write).await?;
        Ok(Answered::Fresh(job))
    }

    /// A job.
    pub async fn job(&self, job: JobId) -> Result<Job, StoreError> {
        let mut transaction = self.read().await?;
        read(&mut transaction, job).await
    }

    /// The jobs submitted before `before`, newest first, at most `limit`.
    pub async fn jobs(
        &self,
        filter: &JobFilter,
        before: Option<JobId>,
        limit: u32,
    ) -> Result<Vec<Job>, StoreError> {
        let mut transaction = self.read().await?;
        let rows = sqlx::query(
            "SELECT * FROM jobs WHERE id < ?1 AND (?2 IS NULL OR state = ?2) AND (?3 IS NULL OR project = ?3) \
             AND (?4 IS NULL OR name = ?4) ORDER BY id DESC LIMIT ?5",
        )
        .bind(before.map_or(uuid::Uuid::max(), |job| job.0))
        .bind(filter.state.map(JobState::name))
        .bind(&filter.project)
        .bind(&filter.name)
        .bind(limit)
        .fetch_all(&mut *transaction)
        .await?;
        let mut jobs = Vec::with_capacity(rows.len());
        for row in rows {
            let progress = progress::of_job(&mut transaction, JobId(id(&row, "id")?)).await?;
            jobs.push(decode(&row, progress)?);
        }
        Ok(jobs)
    }

    /// Cancels a job: its workers are told to stop at their next renewal. Cancelling it twice is one cancelling;
    /// a job that is done or failed stays so, and that is a conflict.
    pub async fn cancel_job(&self, job: JobId, now: Timestamp) -> Result<Job, StoreError> {
        let mut write = self.write().await?;
        let current = read(write.connection().await?, job).await?;
        match current.state {
            JobState::Cancelled => return Ok(current),
            JobState::Done | JobState::Failed => {
                return Err(StoreError::Conflict(format!(
                    "the job is {} and cannot be cancelled",
                    current.state
                )));
            }
            JobState::Previewing | JobState::Profiling | JobState::Booked | JobState::Rendering => {}
        }
        withdraw(&mut write, job, now).await?;
        sqlx::query("UPDATE jobs SET state = 'cancelled', finished_at = ? WHERE id = ?")
            .bind(now.micros())
            .bind(job.0)
            .execute(write.connection().await?)
            .await?;
        job_state(&mut write, job, JobState::Cancelled, None, now)?;
        live::update(&mut write, job, Occasion::Ended, now).await?;
        if current.plan_id.is_some() {
            replans::want(&mut write, &format!("job {} was cancelled", current.name)).await?;
        }
        let cancelled = read(write.connection().await?, job).await?;
        self.commit(write).await?;
        Ok(cancelled)
    }

    /// Fails a job for a reason that lies in the job; nothing if it is final already.
    pub async fn fail_job(&self, job: JobId, error: &str, now: Timestamp) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        fail(&mut write, job, error, now).await?;
        self.commit(write).await
    }

    /// The jobs for which the service itself may have something to do: those before `booked`, oldest first.
    pub async fn jobs_to_advance(&self) -> Result<Vec<JobId>, StoreError> {
        let ids: Vec<uuid::Uuid> =
            sqlx::query_scalar("SELECT id FROM jobs WHERE state IN ('previewing', 'profiling') ORDER BY id")
                .fetch_all(self.readers())
                .await?;
        Ok(ids.into_iter().map(JobId).collect())
    }
}

/// Fails a job inside a write for what became of one of its tasks.
pub(crate) async fn fail_for_task(
    write: &mut Write,
    job: JobId,
    (kind, frame): (TaskKind, Option<u32>),
    error: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    let of_frame = frame.map_or(String::new(), |frame| format!(" of frame {frame}"));
    fail(write, job, &format!("{kind}{of_frame}: {error}"), now).await
}

/// Fails a job inside a write; nothing if it is final already.
pub(crate) async fn fail(
    write: &mut Write,
    job: JobId,
    error: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    let failed = sqlx::query(
        "UPDATE jobs SET state = 'failed', error = ?, finished_at = ? WHERE id = ? AND state IN ('previewing', 'profiling', 'booked', 'rendering')",
    )
    .bind(error)
    .bind(now.micros())
    .bind(job.0)
    .execute(write.connection().await?)
    .await?;
    if failed.rows_affected() == 0 {
        return Ok(());
    }
    withdraw(write, job, now).await?;
    live::update(write, job, Occasion::Ended, now).await?;
    let failed = read(write.connection().await?, job).await?;
    if failed.plan_id.is_some() {
        replans::want(write, &format!("job {} failed", failed.name)).await?;
    }
    job_state(write, job, JobState::Failed, Some(error.to_owned()), now)
}

/// A job's state, by one look-up.
pub(crate) async fn state(connection: &mut SqliteConnection, job: JobId) -> Result<JobState, StoreError> {
    let row =
        sqlx::query("SELECT state FROM jobs WHERE id = ?").bind(job.0).fetch_optional(connection).await?;
    word(&row.ok_or(StoreError::NotFound("job"))?, "state")
}

/// A job's row.
pub(crate) async fn row(connection: &mut SqliteConnection, job: JobId) -> Result<SqliteRow, StoreError> {
    let row = sqlx::query("SELECT * FROM jobs WHERE id = ?").bind(job.0).fetch_optional(connection).await?;
    row.ok_or(StoreError::NotFound("job"))
}

pub(crate) async fn read(connection: &mut SqliteConnection, job: JobId) -> Result<Job, StoreError> {
    let row = row(&mut *connection, job).await?;
    let progress = progress::of_job(connection, job).await?;
    decode(&row, progress)
}

/// Where a job's workers find its bundle.
pub(crate) fn source(row: &SqliteRow) -> Result<BundleSource, StoreError> {
    json(row, "bundle_source")
}

/// What the bundle held when the job was submitted.
pub(crate) fn digest(row: &SqliteRow) -> Result<SceneDigest, StoreError> {
    Ok(json::<SceneSummary>(row, "scene")?.digest)
}

/// A job from its row. Its `eta` depends on what else the farm has to do: whoever needs it fills it in from
/// [`crate::project`].
pub(crate) fn decode(row: &SqliteRow, progress: Progress) -> Result<Job, StoreError> {
    let state: JobState = word(row, "state")?;
    let frames: &str = row.try_get("frames")?;
    let frames: FrameSet = frames.parse().map_err(|error| crate::decode::corrupt("frames", error))?;
    let outlook: JobOutlook = json(row, "outlook")?;
    Ok(Job {
        id: JobId(id(row, "id")?),
        name: row.try_get("name")?,
        project: row.try_get("project")?,
        state,
        bundle: BundleRef { id: id_opt(row, "bundle_id")?.map(BundleId), path: row.try_get("bundle_path")? },
        scene: json(row, "scene")?,
        frames,
        settings: json(row, "settings")?,
        cache: word(row, "cache")?,
        seed: progress.seed,
        samples: whole(row, "samples")?,
        profile_frames: if row.try_get("profiles_more")? {
            None
        } else {
            Some(whole(row, "profile_frames")?)
        },
        ladders: word(row, "ladders")?,
        within: json_opt(row, "within")?,
        deadline: time_opt(row, "deadline_at")?,
        budget: row.try_get::<Option<i64>, _>("budget")?.map(Money),
        confidence: word(row, "confidence")?,
        priority: whole(row, "priority")?,
        weight: whole(row, "weight")?,
        limits: json(row, "limits")?,
        frames_total: whole(row, "frames_total")?,
        frames_done: progress.frames_done,
        progress: progress.fraction,
        verdict: json_opt(row, "verdict")?,
        plan_id: id_opt(row, "plan_id")?.map(PlanId),
        // Who has a frame with a worker does not wait, whatever the newest plan knew.
        // Whoever has begun may still be held for money.
        waits: outlook.waits.filter(|waits| (!progress.begun || waits.is_for_money()) && !state.is_final()),
        promise: outlook.promise,
        eta: None,
        spent: None,
        live: progress.live,
        error: row.try_get("error")?,
        created_at: time(row, "created_at")?,
        finished_at: time_opt(row, "finished_at")?,
    })
}
