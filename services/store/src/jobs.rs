//! Jobs, as they are read.

pub(crate) mod ending;
pub(crate) mod frames;
pub(crate) mod open_jobs;
pub(crate) mod outlooks;
pub(crate) mod progress;
pub(crate) mod submitting;

use forelight_protocol::{
    BundleId, BundleRef, BundleSource, FrameSet, Job, JobId, JobState, Money, PlanId, SceneDigest,
    SceneSummary,
};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

use self::outlooks::JobOutlook;
use self::progress::Progress;
use crate::database::Store;
use crate::decode::{id, id_opt, json, json_opt, time, time_opt, whole, word};
use crate::error::StoreError;

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

    /// The jobs for which the service itself may have something to do: those before `booked`, oldest first.
    pub async fn jobs_to_advance(&self) -> Result<Vec<JobId>, StoreError> {
        let ids: Vec<uuid::Uuid> =
            sqlx::query_scalar("SELECT id FROM jobs WHERE state IN ('previewing', 'profiling') ORDER BY id")
                .fetch_all(self.readers())
                .await?;
        Ok(ids.into_iter().map(JobId).collect())
    }
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
        seed: progress.shared_cache,
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
