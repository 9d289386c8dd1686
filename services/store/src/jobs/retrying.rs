//! Frames that are rendered again, and frames that are taken out of their job.
//!
//! A person asks for both, so what was acknowledged may be undone here: a finished frame that is rendered
//! again loses its result. Its fencing token grows with the next lease as always, and a late message about
//! the old result is refused.

use forelight_protocol::{AuditAction, FrameSet, Job, JobId, JobState, TaskKind, Timestamp};

use crate::audit::{Deed, note};
use crate::columns::{Id, Word};
use crate::database::{Store, Write};
use crate::division;
use crate::error::{Result, StoreError};
use crate::events::job_state;
use crate::jobs::changing::tell;
use crate::jobs::{ending, read};
use crate::leases::take_task_back;
use crate::living::{self, Occasion};
use crate::plans::replans;
use crate::quotas::check_open_again;
use crate::quotes::calibration;
use crate::shared_cache::parts;
use crate::tasks::{self, begin_again};
use crate::videos;
use crate::writing::run;

/// A frame with its task.
struct Row {
    frame: u32,
    task: Id,
    state: String,
    /// Whether a person took it out of the job.
    dropped: bool,
    /// Whether its files are kept.
    has_files: bool,
}

impl Store {
    /// Renders these frames of a job again, finished ones too, and forgives their failures. A job that is
    /// done goes on. A job that failed goes on with all frames that it had left; one that failed before it was
    /// booked, with its quote.
    ///
    /// A [`StoreError::Conflict`] if the job was cancelled, or has no frames to render yet.
    pub async fn retry_frames(&self, job: JobId, frames: &FrameSet, now: Timestamp) -> Result<Job> {
        let mut write = self.write().await?;
        let current = read(write.connection().await?, job).await?;
        if current.state == JobState::Cancelled {
            return Err(StoreError::Conflict("the job was cancelled; submit it again".to_owned()));
        }
        check_inputs(&mut write, job).await?;
        if current.state == JobState::Failed && quote_again(&mut write, &current, now).await? {
            let going_on = read(write.connection().await?, job).await?;
            self.commit(write).await?;
            return Ok(going_on);
        }
        let rows = rows_of(&mut write, &current).await?;
        let is_left = |row: &Row| !row.dropped && ["failed", "cancelled"].contains(&row.state.as_str());
        let is_again =
            |row: &Row| frames.contains(row.frame) || is_left(row) && current.state == JobState::Failed;
        if current.state.is_final() {
            // Files that are there are replaced.
            let new = rows.iter().filter(|row| is_again(row) && !row.has_files).count() as u64;
            check_open_again(write.connection().await?, &current, new).await?;
        }
        take_all_back(&mut write, asked(&rows, frames), now).await?;
        for row in asked(&rows, frames) {
            if row.state == "done" {
                forget_result(&mut write, job, row).await?;
            }
            run!(write, "UPDATE frames SET dropped = 0 WHERE job_id = ? AND frame = ?", job.0, row.frame);
        }
        // A frame waits for the cache that it shares.
        let shared_cache = parts::progress(write.connection().await?, job).await?;
        let state = if shared_cache.is_some_and(|cache| !cache.ready) { "waiting" } else { "ready" };
        for row in &rows {
            if is_again(row) {
                let is_divided = division::begin_again(&mut write, job, row.frame, state, now).await?;
                begin_again(&mut write, row.task, if is_divided { "waiting" } else { state }).await?;
            }
        }
        if current.state.is_final() {
            go_on(&mut write, &current, now).await?;
        }
        write.made_work = true;
        replans::want(&mut write, &format!("frames of job {} are rendered again", current.name)).await?;
        living::update(&mut write, job, Occasion::Booked, now).await?;
        tell(&mut write, job, &format!("frames {frames} are rendered again"), now);
        let deed = Deed::new(AuditAction::FramesRetried, job).of_project(&current.project);
        note(&mut write, deed, Some(&serde_json::json!({ "frames": frames })), now);
        let going_on = read(write.connection().await?, job).await?;
        self.commit(write).await?;
        Ok(going_on)
    }

    /// Takes these frames out of a job. Finished frames stay. The job is done once the others are; without
    /// any others, it is done, or cancelled if no frame is finished.
    ///
    /// A [`StoreError::Conflict`] if the job is over, or has no frames to render yet.
    pub async fn drop_frames(&self, job: JobId, frames: &FrameSet, now: Timestamp) -> Result<Job> {
        let mut write = self.write().await?;
        let current = read(write.connection().await?, job).await?;
        if current.state.is_final() {
            return Err(StoreError::Conflict(format!("the job is {}", current.state)));
        }
        let rows = rows_of(&mut write, &current).await?;
        let is_open = |row: &&Row| ["waiting", "ready", "leased"].contains(&row.state.as_str());
        let open: Vec<&Row> = asked(&rows, frames).filter(is_open).collect();
        if open.is_empty() {
            return Ok(current);
        }
        take_all_back(&mut write, open.iter().copied(), now).await?;
        for row in &open {
            division::cancel_parts(&mut write, job, row.frame, now).await?;
            run!(
                write,
                "UPDATE tasks SET state = 'cancelled', finished_at = ? WHERE id = ?",
                now.micros(),
                row.task
            );
            run!(write, "UPDATE frames SET dropped = 1 WHERE job_id = ? AND frame = ?", job.0, row.frame);
        }
        tell(&mut write, job, &format!("frames {frames} were cancelled"), now);
        let deed = Deed::new(AuditAction::FramesCancelled, job).of_project(&current.project);
        note(&mut write, deed, Some(&serde_json::json!({ "frames": frames })), now);
        let is_any_left = rows.iter().filter(is_open).count() > open.len();
        if is_any_left {
            living::update(&mut write, job, Occasion::Booked, now).await?;
            replans::want(&mut write, &format!("frames of job {} were cancelled", current.name)).await?;
        } else if current.frames_done == 0 {
            ending::cancel(&mut write, &current, now).await?;
        } else {
            finish(&mut write, &current, now).await?;
        }
        let changed = read(write.connection().await?, job).await?;
        self.commit(write).await?;
        Ok(changed)
    }
}

/// Goes on with the quote of a job that failed before it was booked. What is measured stays. Returns whether there was
/// something of it to do.
async fn quote_again(write: &mut Write, job: &Job, now: Timestamp) -> Result<bool> {
    let tasks = sqlx::query!(
        r#"SELECT id AS "id!: Id", kind AS "kind!: Word<TaskKind>" FROM tasks t WHERE job_id = ?1
           AND kind IN ('preview', 'profile', 'cache_plan') AND state IN ('failed', 'cancelled')
           AND NOT EXISTS (SELECT 1 FROM tasks r WHERE r.job_id = ?1 AND r.kind = 'render')"#,
        job.id.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    if tasks.is_empty() {
        return Ok(false);
    }
    check_open_again(write.connection().await?, job, job.frames.count()).await?;
    let has = |kind: TaskKind| tasks.iter().any(|task| task.kind.0 == kind);
    let (stage, state) = match has(TaskKind::Preview) {
        true => ("previewing", JobState::Previewing),
        false => ("profiling", JobState::Profiling),
    };
    let plans_cache = has(TaskKind::CachePlan);
    for task in &tasks {
        let waits = plans_cache && task.kind.0 == TaskKind::Profile;
        begin_again(write, task.id, if waits { "waiting" } else { "ready" }).await?;
    }
    run!(write, "UPDATE jobs SET stage = ?, error = NULL, finished_at = NULL WHERE id = ?", stage, job.id.0);
    job_state(write, job.id, state, None, now);
    tell(write, job.id, "its quote goes on", now);
    note(write, Deed::new(AuditAction::FramesRetried, job.id).of_project(&job.project), None::<&()>, now);
    write.made_work = true;
    Ok(true)
}

/// A [`StoreError::Conflict`] if the scene or the profiles of a job were deleted.
async fn check_inputs(write: &mut Write, job: JobId) -> Result<()> {
    let row = sqlx::query!(
        r#"SELECT j.profiles_deleted_at IS NOT NULL AS "profiles!: bool",
                  b.id IS NOT NULL AND b.hash IS NULL AS "scene!: bool"
           FROM jobs j LEFT JOIN bundles b ON b.id = j.bundle_id WHERE j.id = ?"#,
        job.0
    )
    .fetch_one(write.connection().await?)
    .await?;
    let what = match (row.scene, row.profiles) {
        (true, _) => "its scene was",
        (false, true) => "its profiles were",
        (false, false) => return Ok(()),
    };
    Err(StoreError::Conflict(format!("{what} deleted, since the job ended long ago; submit it again")))
}

/// The frames of a job with their tasks. A [`StoreError::Conflict`] if it has none yet.
async fn rows_of(write: &mut Write, job: &Job) -> Result<Vec<Row>> {
    let rows = sqlx::query_as!(
        Row,
        r#"SELECT t.frame AS "frame!", t.id AS task, t.state, f.dropped,
                  f.artifacts IS NOT NULL AS "has_files!: bool" FROM tasks t
           JOIN frames f ON f.job_id = t.job_id AND f.frame = t.frame WHERE t.job_id = ? AND t.kind = 'render'
           AND t.frame IS NOT NULL ORDER BY t.frame"#,
        job.id.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    if rows.is_empty() {
        let reason = match job.state {
            JobState::Failed => {
                "the job has no quote, and nothing of it can be tried again; submit it again".to_owned()
            }
            state => format!("the job is {state}: it has no frames to render yet"),
        };
        return Err(StoreError::Conflict(reason));
    }
    Ok(rows)
}

/// Takes the frames back from all workers that have them.
async fn take_all_back<'a>(
    write: &mut Write,
    rows: impl Iterator<Item = &'a Row>,
    now: Timestamp,
) -> Result<()> {
    for row in rows.filter(|row| row.state == "leased") {
        take_task_back(write, row.task, now).await?;
    }
    Ok(())
}

fn asked<'a>(rows: &'a [Row], frames: &'a FrameSet) -> impl Iterator<Item = &'a Row> {
    rows.iter().filter(|row| frames.contains(row.frame))
}

/// Forgets the result of a finished frame.
async fn forget_result(write: &mut Write, job: JobId, row: &Row) -> Result<()> {
    tasks::forget_result(write, row.task).await?;
    run!(
        write,
        "UPDATE frames SET actual = NULL, actual_work = NULL, actual_cpu = NULL, artifacts = NULL, \
         finished_at = NULL, output_due = 0, output_error = NULL WHERE job_id = ? AND frame = ?",
        job.0,
        row.frame
    );
    Ok(())
}

/// Opens a job that is done or failed. Parts of its shared cache that failed or were withdrawn go on too.
async fn go_on(write: &mut Write, job: &Job, now: Timestamp) -> Result<()> {
    let video = if job.video.is_some() { "waiting" } else { "cancelled" };
    videos::take_video_back(write, job.id, video, now).await?;
    let of_cache = sqlx::query_scalar!(
        "SELECT id FROM tasks WHERE job_id = ? AND frame IS NULL AND kind IN ('cache_fill', 'cache_merge') \
         AND state IN ('failed', 'cancelled')",
        job.id.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    for task in of_cache {
        begin_again(write, task, "ready").await?;
    }
    run!(
        write,
        "UPDATE jobs SET stage = 'rendering', error = NULL, finished_at = NULL, images_deleted_at = NULL \
         WHERE id = ?",
        job.id.0
    );
    job_state(write, job.id, JobState::Rendering, None, now);
    Ok(())
}

/// Ends a job whose other frames are all finished.
async fn finish(write: &mut Write, job: &Job, now: Timestamp) -> Result<()> {
    run!(write, "UPDATE jobs SET stage = 'done', finished_at = ? WHERE id = ?", now.micros(), job.id.0);
    calibration::learn(write, job.id, now).await?;
    job_state(write, job.id, JobState::Done, None, now);
    videos::begin(write, job.id).await?;
    living::update(write, job.id, Occasion::Ended, now).await?;
    replans::want(write, &format!("job {} is done without some frames", job.name)).await
}
