//! Videos of finished frames.
//!
//! The last frame of a job makes its video task ready, in the transaction that ends the job. The job is done
//! without it: a video that fails, or waits for a node with ffmpeg, delays nothing. When frames are rendered
//! again, the video is taken back until the last of them is finished. It goes with the images of its job.

use forelight_protocol::{
    ArtifactHash, AuditAction, FrameRate, FrameState, Job, JobId, JobState, JobVideo, Timestamp, VideoFile,
    VideoRequest,
};
use serde::Deserialize;

use crate::audit::{Deed, note};
use crate::columns::{Json, corrupt};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::jobs::changing::tell;
use crate::jobs::{self, JobRow, read};
use crate::leases::take_task_back;
use crate::tasks::{self, Common};
use crate::writing::run;

/// What a node must have for videos, among its renderers in the database. No renderer can have this name.
pub(crate) const FFMPEG: &str = "(ffmpeg)";

impl Store {
    /// Has a video made of a job's frames, or none with `None`. A job that is done has it made at once, in
    /// place of an earlier one. Repeating this changes nothing, unless the video failed.
    ///
    /// A [`StoreError::Conflict`] if the job was cancelled or failed, or images of it were deleted.
    pub async fn set_video(&self, job: JobId, video: Option<VideoRequest>, now: Timestamp) -> Result<Job> {
        let mut write = self.write().await?;
        let current = read(write.connection().await?, job).await?;
        if let JobState::Cancelled | JobState::Failed = current.state {
            return Err(StoreError::Conflict(format!("the job is {}: it has no video", current.state)));
        }
        if video.is_some() && lacks_images(&mut write, job).await? {
            return Err(StoreError::Conflict(
                "images of the job were deleted: render them again first".to_owned(),
            ));
        }
        let row = jobs::row(write.connection().await?, job).await?;
        let asked = row.video.as_ref().map(|it| it.0);
        let has_failed = current.video.as_ref().is_some_and(|video| video.state == FrameState::Failed);
        if asked == video && !has_failed {
            return Ok(current);
        }
        take_video_back(&mut write, job, "cancelled", now).await?;
        run!(write, "UPDATE jobs SET video = ? WHERE id = ?", video.as_ref().map(Json), job.0);
        if current.state == JobState::Done {
            begin(&mut write, job).await?;
        }
        let what =
            if video.is_some() { "a video is made of its frames" } else { "no video is made of its frames" };
        tell(&mut write, job, what, now);
        let deed = Deed::new(AuditAction::JobChanged, job).of_project(&current.project);
        note(&mut write, deed, Some(&serde_json::json!({ "video": video })), now);
        let changed = read(write.connection().await?, job).await?;
        self.commit(write).await?;
        Ok(changed)
    }
}

/// Whether images of finished frames were deleted.
async fn lacks_images(write: &mut Write, job: JobId) -> Result<bool> {
    let lacks = sqlx::query_scalar!(
        r#"SELECT EXISTS (SELECT 1 FROM frames WHERE job_id = ? AND actual IS NOT NULL AND artifacts IS NULL)
           AS "lacks!: bool""#,
        job.0
    );
    Ok(lacks.fetch_one(write.connection().await?).await?)
}

/// Makes the video task of a job that is done, if a video is asked for. Without all images none can be made:
/// then none is asked for any more.
pub(crate) async fn begin(write: &mut Write, job: JobId) -> Result<()> {
    let row = jobs::row(write.connection().await?, job).await?;
    let Some(rate) = row.frame_rate() else { return Ok(()) };
    if lacks_images(write, job).await? {
        run!(write, "UPDATE jobs SET video = NULL WHERE id = ?", job.0);
        run!(write, "UPDATE tasks SET state = 'cancelled' WHERE job_id = ? AND kind = 'video'", job.0);
        return Ok(());
    }
    let pictures = sqlx::query_scalar!(
        r#"SELECT artifacts ->> 'image_png' AS "picture!: String" FROM frames
           WHERE job_id = ? AND actual IS NOT NULL ORDER BY frame"#,
        job.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    let pictures =
        pictures.iter().map(|picture| picture.parse().map_err(|error| corrupt("artifacts", error)));
    let pictures = pictures.collect::<Result<Vec<ArtifactHash>>>()?;
    Common::of(&row).video(write, rate, pictures).await
}

/// Takes the video back from whoever encodes it, and forgets it. Its task is in this state from then on.
pub(crate) async fn take_video_back(
    write: &mut Write,
    job: JobId,
    state: &'static str,
    now: Timestamp,
) -> Result<()> {
    let task = sqlx::query_scalar!("SELECT id FROM tasks WHERE job_id = ? AND kind = 'video'", job.0);
    let Some(task) = task.fetch_optional(write.connection().await?).await? else { return Ok(()) };
    take_task_back(write, task, now).await?;
    tasks::forget_result(write, task).await?;
    tasks::begin_again(write, task, state).await
}

/// The video task of a job, as far as it concerns the job.
#[derive(Deserialize)]
pub(crate) struct VideoTask {
    state: FrameState,
    progress: f64,
    error: Option<String>,
    file: Option<VideoFile>,
    is_without_node: bool,
}

impl JobRow {
    /// Frames per second of its video. `None` if none is asked for.
    fn frame_rate(&self) -> Option<FrameRate> {
        let asked = self.video.as_ref()?.0;
        Some(asked.frames_per_second.or(self.scene.0.frames_per_second).unwrap_or(FrameRate::FILM))
    }

    /// Its video, if one is asked for.
    pub fn job_video(&self) -> Option<JobVideo> {
        let frames_per_second = self.frame_rate()?;
        let Some(Json(task)) = &self.video_task else {
            let is_over = self.state.0.is_final();
            let state = if is_over { FrameState::Cancelled } else { FrameState::Waiting };
            return Some(JobVideo {
                frames_per_second,
                state,
                progress: 0.0,
                file: None,
                error: None,
                waits: None,
            });
        };
        let waits = (task.state == FrameState::Ready && task.is_without_node).then(|| {
            "no worker that takes tasks has ffmpeg: install it on a node, and start its worker again"
                .to_owned()
        });
        Some(JobVideo {
            frames_per_second,
            state: task.state,
            progress: task.progress,
            file: task.file,
            error: task.error.clone().filter(|_| task.state == FrameState::Failed),
            waits,
        })
    }
}
