//! The jobs that are not over, with what their forecasts say of the frames that are left.

use forelight_protocol::{Job, JobId, JobState};
use sqlx::Row as _;

use crate::database::Store;
use crate::decode::id;
use crate::error::StoreError;
use crate::jobs;
use crate::jobs::progress;
use forelight_quote::JobForecast;

/// A job that is booked and not done, with what its forecast says.
#[derive(Clone, PartialEq, Debug)]
pub struct OpenJob {
    /// The job.
    pub job: Job,
    /// Its forecast; none before it is booked.
    pub forecast: Option<JobForecast>,
    /// CPU seconds of its frames that are not there yet, at P50 and P80.
    pub frames: Vec<(u32, f64, f64)>,
    /// Its project's budget holds it back.
    pub held: bool,
}

impl Store {
    /// The jobs that are neither done, failed nor cancelled, oldest first.
    pub async fn open_jobs(&self) -> Result<Vec<OpenJob>, StoreError> {
        let mut transaction = self.read().await?;
        let rows = sqlx::query(
            "SELECT * FROM jobs WHERE state IN ('previewing', 'profiling', 'booked', 'rendering') ORDER BY id",
        )
        .fetch_all(&mut *transaction)
        .await?;
        let mut open = Vec::with_capacity(rows.len());
        for row in &rows {
            let job_id = JobId(id(row, "id")?);
            let done = progress::of_job(&mut transaction, job_id).await?;
            let job = jobs::decode(row, done)?;
            let frames = sqlx::query(
                "SELECT frame, cpu_p50, cpu_p80 FROM frames WHERE job_id = ? AND finished_at IS NULL AND cpu_p50 IS NOT NULL \
                 ORDER BY frame",
            )
            .bind(job_id.0)
            .fetch_all(&mut *transaction)
            .await?;
            let held: bool =
                sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM tasks WHERE job_id = ? AND held = 1)")
                    .bind(job_id.0)
                    .fetch_one(&mut *transaction)
                    .await?;
            let is_booked = matches!(job.state, JobState::Booked | JobState::Rendering);
            open.push(OpenJob {
                forecast: if is_booked { crate::decode::json_opt(row, "forecast")? } else { None },
                frames: frames
                    .iter()
                    .map(|row| Ok((crate::decode::whole(row, "frame")?, row.try_get(1)?, row.try_get(2)?)))
                    .collect::<Result<_, StoreError>>()?,
                job,
                held,
            });
        }
        Ok(open)
    }
}
