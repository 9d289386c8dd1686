//! The jobs that are not over, with the forecasts of their remaining frames.

use forelight_protocol::{Job, JobId};

use crate::columns::Unread;
use crate::database::Store;
use crate::error::Result;
use crate::jobs::{job_rows, progress};
use forelight_quote::JobForecast;

/// A job that is not over, with its forecast.
#[derive(Clone, PartialEq, Debug)]
pub struct OpenJob {
    /// The job.
    pub job: Job,
    /// Its forecast; `None` before it is booked.
    pub forecast: Option<JobForecast>,
    /// Forecast CPU seconds of its unfinished frames: number, P50 and P80.
    pub frames: Vec<(u32, f64, f64)>,
    /// Its project's budget holds it back, or it is paused.
    pub held: bool,
}

impl Store {
    /// The jobs that are neither done, failed nor cancelled, oldest first.
    pub async fn open_jobs(&self) -> Result<Vec<OpenJob>> {
        let mut transaction = self.read().await?;
        let rows = job_rows!("WHERE stage IN ('previewing', 'profiling', 'booked', 'rendering') ORDER BY id")
            .fetch_all(&mut *transaction)
            .await?;
        let ids: Vec<JobId> = rows.iter().map(|row| row.id.into()).collect();
        let mut done = progress::of_jobs(&mut transaction, &ids).await?;
        let mut open = Vec::with_capacity(rows.len());
        for mut row in rows {
            let job_id = JobId::from(row.id);
            let forecast = row.forecast.take();
            let job = row.job(done.remove(&job_id).unwrap_or_default())?;
            let frames = sqlx::query!(
                r#"SELECT frame, cpu_p50 AS "cpu_p50!", cpu_p80 AS "cpu_p80!" FROM frames
                   WHERE job_id = ? AND finished_at IS NULL AND dropped = 0 AND cpu_p50 IS NOT NULL ORDER BY frame"#,
                job_id.0
            )
            .fetch_all(&mut *transaction)
            .await?;
            let held = sqlx::query_scalar!(
                r#"SELECT EXISTS (SELECT 1 FROM tasks WHERE job_id = ? AND held = 1) AS "held!: bool""#,
                job_id.0
            )
            .fetch_one(&mut *transaction)
            .await?;
            let forecast = forecast.filter(|_| job.state.is_booked());
            open.push(OpenJob {
                forecast: forecast.map(Unread::read).transpose()?,
                frames: frames.into_iter().map(|row| (row.frame, row.cpu_p50, row.cpu_p80)).collect(),
                job,
                held,
            });
        }
        Ok(open)
    }
}
