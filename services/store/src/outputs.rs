//! Images that are still to be written where their job wants them.

use forelight_protocol::{ArtifactHash, JobId, OutputOf, OutputPattern, RenderArtifacts, Timestamp};

use crate::columns::{Id, Json, corrupt};
use crate::database::Store;
use crate::error::Result;
use crate::writing::run;

/// A frame whose image is to be written.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct DueOutput {
    /// The job.
    pub job: JobId,
    /// The frame.
    pub frame: u32,
    /// Path below the output root.
    pub path: String,
    /// What to write there.
    pub content: ArtifactHash,
}

/// A frame with its job.
struct Row {
    job_id: Id,
    frame: u32,
    name: String,
    project: String,
    output: Option<String>,
    artifacts: Option<Json<RenderArtifacts>>,
}

impl Store {
    /// Images that are still to be written, at most `limit`: those that were never tried, oldest job first, then
    /// those that could not be written, in turn.
    pub async fn due_outputs(&self, limit: u32) -> Result<Vec<DueOutput>> {
        let rows = sqlx::query_as!(
            Row,
            "SELECT f.job_id, f.frame, j.name, j.project, j.output, f.artifacts \
             FROM frames f INDEXED BY frames_output_due JOIN jobs j ON j.id = f.job_id \
             WHERE f.output_due = 1 AND f.artifacts IS NOT NULL ORDER BY f.output_tried_at, f.job_id, f.frame LIMIT ?",
            limit
        )
        .fetch_all(self.readers())
        .await?;
        rows.into_iter().filter_map(|row| row.due().transpose()).collect()
    }

    /// Notes that an image was written, or why not: it stays due then, behind all others. If the frame has another
    /// image by now, nothing is noted: that one is due.
    pub async fn note_output(&self, of: &DueOutput, error: Option<&str>, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        run!(
            write,
            "UPDATE frames SET output_due = ?1 IS NOT NULL, output_error = ?1, output_tried_at = iif(?1 IS NULL, NULL, ?4) \
             WHERE job_id = ?2 AND frame = ?3 AND output_due = 1 \
             AND ?5 IN (artifacts ->> 'image_exr', artifacts ->> 'image_png')",
            error,
            of.job.0,
            of.frame,
            now.micros(),
            of.content.to_string()
        );
        self.commit(write).await
    }
}

impl Row {
    /// `None` if the image was deleted in the meantime.
    fn due(self) -> Result<Option<DueOutput>> {
        let (Some(output), Some(Json(artifacts))) = (self.output, self.artifacts) else { return Ok(None) };
        let pattern = pattern(&output)?;
        let (id, frame) = (self.job_id.into(), self.frame);
        let path = pattern.path(OutputOf { project: &self.project, job: &self.name, id, frame });
        let content = if pattern.is_picture() { artifacts.image_png } else { artifacts.image_exr };
        Ok(Some(DueOutput { job: id, frame, path, content }))
    }
}

/// The pattern in the database.
pub(crate) fn pattern(text: &str) -> Result<OutputPattern> {
    text.parse().map_err(|error| corrupt("output", error))
}
